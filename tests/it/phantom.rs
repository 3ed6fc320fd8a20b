//! Phantoms: closed forms against what is imaged, invariances, and files as other software reads them.

use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use nifti::{InMemNiftiObject, NiftiObject, NiftiVolume, RandomAccessNiftiVolume};
use std::path::{Path, PathBuf};
use std::process::Command;
use ventricle::phantom::{
    self, Defect, Deformation, Imaging, Liver, Phantom, PhantomError, Pose, Psf, Shape, Simulation, Site, Tail, Uptake, Ventricle,
};
use ventricle::study::Study;
use ventricle::volume::{Grid, Volume};

/// A phantom's wall alone, without blur or noise, 1000 counts a voxel, one gate, on a grid that holds it with room to spare.
fn bare(phantom: &Phantom) -> Phantom {
    let uptake = Uptake { background: 0.0, blood_pool: 0.0, ..Uptake::default() };
    let grid = Grid { shape: [40, 64, 64], spacing_mm: [4.0, 3.0, 3.0] };
    let imaging = Imaging { grid, gates: 1, psf: Psf::gaussian(0.0), counts: 1000.0, noise_seed: None, ..Imaging::default() };
    Phantom { uptake, imaging, ..phantom.clone() }
}

fn simulate(phantom: &Phantom) -> Simulation {
    phantom::simulate(phantom).unwrap()
}

/// The volume (ml) that a first gate's total stands for when `peak` is the count of a voxel that is all wall.
fn imaged_ml(study: &Study, peak: f64) -> f64 {
    study.gates[0].volume.total() / peak * study.grid.voxel_mm3() / 1000.0
}

#[test]
fn what_is_imaged_has_the_closed_forms_volume() {
    // Tolerance of the documentation: 0.1 %. The peak is exact, for without blur a voxel inside the wall is all wall.
    let tilted = Pose { tilt_degrees: [20.0, -35.0], offset_mm: [4.1, -3.3, 2.7], reversed: true };
    let warped = Deformation { bend_mm: 8.0, twist_degrees: 50.0, ovality: 0.3, base_tilt_degrees: 10.0 };
    for shape in [Phantom::paper(), Phantom::normal(), Phantom::dilated(), Phantom::small()] {
        for (pose, deformation) in [(Pose::default(), Deformation::default()), (tilted, Deformation::default()), (tilted, warped)] {
            let wall_only = Phantom { pose, deformation, ..bare(&shape) };
            let Simulation { study, truth } = simulate(&wall_only);
            let (imaged, exact) = (imaged_ml(&study, 1000.0), truth.gates[0].myocardial_ml);
            assert!((imaged / exact - 1.0).abs() < 1e-3, "wall {imaged} ml, exactly {exact} ml: {wall_only:?}");

            let mut filled = wall_only;
            filled.uptake.blood_pool = 1.0;
            let (imaged, exact) = (imaged_ml(&simulate(&filled).study, 1000.0), truth.gates[0].epicardial_ml);
            assert!((imaged / exact - 1.0).abs() < 1e-3, "epicardial {imaged} ml, exactly {exact} ml: {filled:?}");
        }
    }
}

#[test]
fn the_paper_s_volumes() {
    let truth = simulate(&Phantom::paper()).truth;
    assert!((truth.gates[0].endocardial_ml - 89.794).abs() < 1e-9);
    assert!((truth.gates[0].epicardial_ml - 305.310).abs() < 1e-3);
    assert!(truth.ef_percent.abs() < 1e-12);
}

#[test]
fn gates_have_their_own_ejection_fraction() {
    let ef = |phantom: Phantom, gates: usize| {
        let imaging = Imaging { gates, grid: Grid { shape: [8, 8, 8], spacing_mm: [15.0; 3] }, ..Imaging::default() };
        simulate(&Phantom { imaging, ..phantom }).truth.ef_percent
    };
    assert!((ef(Phantom::normal(), 8) - 56.5).abs() < 0.1);
    assert!((ef(Phantom::normal(), 16) - 59.5).abs() < 0.1, "{}", ef(Phantom::normal(), 16));
    assert!((ef(Phantom::normal(), 64) - 60.0).abs() < 0.1);
    assert!((ef(Phantom::dilated(), 64) - 25.0).abs() < 0.1);
    assert!((ef(Phantom::small(), 64) - 80.0).abs() < 0.1);
}

#[test]
fn the_wall_is_conserved_over_the_cycle_and_end_systole_is_in_the_first_half() {
    let truth = simulate(&Phantom::demo()).truth;
    assert_eq!(truth.gates.len(), 8);
    for gate in &truth.gates {
        assert!((gate.myocardial_ml - 120.0).abs() < 1e-9);
        assert!((gate.epicardial_ml - gate.endocardial_ml - gate.myocardial_ml).abs() < 1e-9);
    }
    assert_eq!(truth.end_systolic_gate, 3);
    assert!([1, 8].contains(&truth.end_diastolic_gate));
    assert!(truth.within_grid);
}

#[test]
fn blur_keeps_the_counts_away_from_borders() {
    let mut phantom = bare(&Phantom::small());
    let wall_voxels = simulate(&phantom).study.gates[0].volume.total() / 1000.0;
    // A background at half of the wall's uptake: far from the heart it tells the scale, which blur changes. Each voxel of wall then adds one
    // background to the total.
    phantom.uptake.background = 0.5;
    phantom.uptake.blood_pool = 0.5;
    for psf in [
        Psf::gaussian(9.0),
        Psf { tail: Some(Tail { fraction: 0.3, fwhm_mm: 20.0 }), ..Psf::gaussian(8.0) },
        Psf { growth: 0.04, ..Psf::gaussian(10.0) },
    ] {
        phantom.imaging.psf = psf;
        let volume = simulate(&phantom).study.gates[0].volume.clone();
        let background = f64::from(volume.counts[[0, 0, 0]]);
        let excess = volume.total() / background - volume.grid.voxels() as f64;
        assert!((excess / wall_voxels - 1.0).abs() < 1e-4, "{psf:?}: {excess} against {wall_voxels}");
    }
}

/// Second central moments along (x, y, z) in mm² of a volume.
fn variances_mm2(volume: &Volume) -> [f64; 3] {
    let weigh = |power: i32, centre: [f64; 3]| -> [f64; 3] {
        let mut sums = [0.0; 3];
        for ((z, y, x), &count) in volume.counts.indexed_iter() {
            let position = volume.grid.position_mm([z, y, x]).to_array();
            for axis in 0..3 {
                sums[axis] += f64::from(count) * (position[axis] - centre[axis]).powi(power);
            }
        }
        sums.map(|sum| sum / volume.total())
    };
    weigh(2, weigh(1, [0.0; 3]))
}

#[test]
fn blur_adds_its_variance() {
    let image = |psf: Psf| {
        let mut phantom = bare(&Phantom::small());
        phantom.imaging.psf = psf;
        variances_mm2(&simulate(&phantom).study.gates[0].volume)
    };
    let variance = |fwhm_mm: f64| (fwhm_mm / 2.354_82_f64).powi(2);
    // Both images are smooth, so the voxel box adds a twelfth of its squared side to each (Sheppard) and cancels.
    let little = image(Psf::gaussian(8.0));
    let blurred = image(Psf::gaussian(14.0));
    let tailed = image(Psf { tail: Some(Tail { fraction: 0.25, fwhm_mm: 20.0 }), ..Psf::gaussian(10.0) });
    for axis in 0..3 {
        let added = blurred[axis] - little[axis];
        assert!((added / (variance(14.0) - variance(8.0)) - 1.0).abs() < 5e-3, "axis {axis}: {added}");
        let added = tailed[axis] - little[axis];
        let expected = 0.75 * variance(10.0) + 0.25 * variance(20.0) - variance(8.0);
        assert!((added / expected - 1.0).abs() < 5e-3, "tail, axis {axis}: {added} against {expected}");
    }
}

#[test]
fn a_growing_blur_is_wider_in_later_rows() {
    // The same heart displaced up and down the rows, seen by a camera whose blur grows along them.
    let width = |offset_mm: f64| {
        let mut phantom = bare(&Phantom::small());
        phantom.pose.offset_mm = [0.0, offset_mm, 0.0];
        phantom.imaging.psf = Psf { growth: 0.1, ..Psf::gaussian(10.0) };
        variances_mm2(&simulate(&phantom).study.gates[0].volume)[0]
    };
    let variance = |fwhm_mm: f64| (fwhm_mm / 2.354_82_f64).powi(2);
    let difference = width(20.0) - width(-20.0);
    let expected = variance(12.0) - variance(8.0);
    assert!((difference / expected - 1.0).abs() < 0.05, "{difference} against {expected}");
}

#[test]
fn voxels_far_from_the_border_are_the_tissue() {
    let mut phantom = bare(&Phantom::paper());
    phantom.uptake.blood_pool = 0.3;
    let volume = simulate(&phantom).study.gates[0].volume.clone();
    // Tip at -45.5 mm and base at +45.5 mm from the grid's centre at (94.5, 94.5, 78) mm; wall from 20 to 35 mm.
    let at = |x: f64, y: f64, z: f64| volume.counts[volume.grid.voxel_at(glam::DVec3::new(94.5 + x, 94.5 + y, 78.0 + z)).unwrap()];
    assert!((at(27.5, 0.0, 10.0) - 1000.0).abs() < 1e-2);
    assert!((at(0.0, -27.5, 40.0) - 1000.0).abs() < 1e-2);
    assert!((at(0.0, 0.0, -39.0) - 1000.0).abs() < 1e-2, "the apex is apical: towards slice 0");
    assert!((at(0.0, 0.0, 10.0) - 300.0).abs() < 1e-2);
    assert!(at(0.0, 0.0, 52.0).abs() < 1e-6 && at(45.0, 0.0, 0.0).abs() < 1e-6);
}

#[test]
fn defects_take_their_share_of_the_wall() {
    let oval = Deformation { twist_degrees: 40.0, ovality: 0.2, ..Deformation::default() };
    for deformation in [Deformation::default(), oval] {
        let mut phantom = Phantom { deformation, ..bare(&Phantom::normal()) };
        let whole = simulate(&phantom).study.gates[0].volume.total();
        for site in [Site::Apical, Site::Anterior, Site::Inferior, Site::Septal, Site::Lateral] {
            for extent in [0.10, 0.53] {
                phantom.uptake.defects = vec![Defect { site, extent, severity: 0.8 }];
                let lost = 1.0 - simulate(&phantom).study.gates[0].volume.total() / whole;
                assert!((lost - 0.8 * extent).abs() < 2e-3, "{site:?} {extent}: {lost}");
            }
        }
    }
}

#[test]
fn defects_and_liver_lie_where_they_are_said_to() {
    let mut phantom = bare(&Phantom::normal());
    let centre = |volume: &Volume| {
        let mut sum = glam::DVec3::ZERO;
        for ((z, y, x), &count) in volume.counts.indexed_iter() {
            sum += volume.grid.position_mm([z, y, x]) * f64::from(count);
        }
        sum / volume.total()
    };
    let whole = centre(&simulate(&phantom).study.gates[0].volume);
    let mut shift = |site| {
        phantom.uptake.defects = vec![Defect { site, extent: 0.3, severity: 1.0 }];
        centre(&simulate(&phantom).study.gates[0].volume) - whole
    };
    // Activity moves away from where it is lost. x: lateral, y: inferior, z: base.
    assert!(shift(Site::Apical).z > 3.0);
    assert!(shift(Site::Inferior).y < -3.0);
    assert!(shift(Site::Anterior).y > 3.0);
    assert!(shift(Site::Lateral).x < -3.0);
    assert!(shift(Site::Septal).x > 3.0);
    phantom.uptake.defects.clear();
    phantom.uptake.liver = Some(Liver { gap_mm: 6.0, uptake: 2.0 });
    assert!((centre(&simulate(&phantom).study.gates[0].volume) - whole).y > 10.0);
}

#[test]
fn the_liver_keeps_its_distance() {
    let mut phantom = bare(&Phantom::paper());
    phantom.uptake.liver = Some(Liver { gap_mm: 9.0, uptake: 2.0 });
    phantom.imaging.grid = Grid { shape: [60, 200, 40], spacing_mm: [2.0, 1.0, 2.0] };
    let volume = simulate(&phantom).study.gates[0].volume.clone();
    // Down from the axis at the level where both are nearest: cavity, wall, 9 mm of nothing, liver.
    let column: Vec<f32> = (100..200).map(|y| volume.counts[[38, y, 20]]).collect();
    let after_wall = column.iter().rposition(|&count| count > 900.0 && count < 1100.0).unwrap();
    let gap = column[after_wall + 1..].iter().take_while(|&&count| count < 900.0).count();
    assert!((8..=10).contains(&gap), "{gap} mm: {column:?}");
}

#[test]
fn counts_noise_and_seeds() {
    let phantom = Phantom::demo();
    let (first, second) = (simulate(&phantom), simulate(&phantom));
    assert_eq!(first, second);
    let mut other = phantom.clone();
    other.imaging.noise_seed = Some(2);
    assert_ne!(first.study.gates[0], simulate(&other).study.gates[0]);
    assert_ne!(first.study.gates[0].volume, first.study.gates[1].volume);

    other.imaging.noise_seed = None;
    let expected = simulate(&other).study;
    let mut brightest = 0.0_f32;
    for (noisy, mean) in first.study.gates.iter().zip(&expected.gates) {
        assert!(noisy.volume.counts.iter().all(|count| count.fract() == 0.0 && *count >= 0.0));
        // A Poisson total deviates by its square root: five of them.
        let (total, mean_total) = (noisy.volume.total(), mean.volume.total());
        assert!((total - mean_total).abs() < 5.0 * mean_total.sqrt(), "{total} against {mean_total}");
        // χ²/n of all voxels is 1 ± √(2/n), a little more where means are small.
        let chi: f64 =
            noisy.volume.counts.iter().zip(&mean.volume.counts).map(|(&n, &m)| f64::from(n - m).powi(2) / f64::from(m)).sum::<f64>();
        assert!((chi / 98_304.0 - 1.0).abs() < 0.03, "{chi}");
        brightest = brightest.max(mean.volume.maximum());
    }
    assert!((f64::from(brightest) - phantom.imaging.counts).abs() < 1e-3);
}

#[test]
fn reversing_flips_the_slices_and_nothing_in_the_patient() {
    let mut phantom = Phantom::demo();
    phantom.imaging.noise_seed = None;
    let forward = simulate(&phantom);
    phantom.pose.reversed = true;
    let backward = simulate(&phantom);
    let mut flipped = backward.study.gates[3].volume.counts.clone();
    flipped.invert_axis(ndarray::Axis(0));
    assert_eq!(forward.study.gates[3].volume.counts, flipped);
    let (ahead, behind) = (forward.study.orientation.unwrap(), backward.study.orientation.unwrap());
    assert!(!ahead.mirrors() && behind.mirrors());
    for gate in 0..8 {
        let landmark = |point: Option<[f64; 3]>| glam::DVec3::from_array(point.unwrap());
        let (one, other) = (&forward.truth.gates[gate], &backward.truth.gates[gate]);
        for (a, b) in [(one.apex_mm, other.apex_mm), (one.base_mm, other.base_mm)] {
            assert!((ahead.patient_mm(landmark(a)) - behind.patient_mm(landmark(b))).length() < 1e-9);
        }
    }
    // The apex lies to the left (x), in front (−y) of and below (−z) the base.
    let direction = ahead.direction(glam::DVec3::NEG_Z);
    assert!(direction.x > 0.3 && direction.y < -0.3 && direction.z < -0.3);
    for axes in [ahead, behind] {
        let dots = [axes.columns.dot(axes.rows), axes.rows.dot(axes.slices), axes.slices.dot(axes.columns)];
        assert!(dots.iter().all(|dot| dot.abs() < 1e-12));
        assert!([axes.columns, axes.rows, axes.slices].iter().all(|axis| (axis.length() - 1.0).abs() < 1e-12));
    }
}

#[test]
fn masks_last_gate_and_motion() {
    let mut phantom = Phantom::normal();
    phantom.imaging.noise_seed = None;
    phantom.imaging.field_of_view_mm = Some(50.0);
    phantom.imaging.last_gate_fraction = 0.7;
    let study = simulate(&phantom).study;
    let volume = &study.gates[0].volume;
    assert!(volume.counts[[12, 0, 0]] == 0.0 && volume.counts[[12, 31, 14]] == 0.0 && volume.counts[[12, 31, 15]] > 0.0);
    let ratio = study.gates[7].volume.total() / study.gates[6].volume.total();
    assert!((ratio - 0.7).abs() < 0.01, "{ratio}");

    let mut moving = Phantom::normal();
    moving.imaging.motion_samples = 4;
    let truth = simulate(&moving).truth;
    let still = simulate(&Phantom::normal()).truth;
    assert!((truth.gates[0].endocardial_ml - still.gates[0].endocardial_ml).abs() > 0.1);
    assert!((truth.gates[0].myocardial_ml - 120.0).abs() < 1e-9);
}

#[test]
fn an_empty_phantom_is_background() {
    let Simulation { study, truth } = simulate(&Phantom::empty());
    assert!(!truth.has_ventricle && truth.edv_ml == 0.0 && truth.ef_percent == 0.0 && truth.gates[0].apex_mm.is_none());
    let mean = study.gates[0].volume.total() / study.grid.voxels() as f64;
    assert!((mean - 150.0 * 0.08).abs() < 0.1, "{mean}");
}

#[test]
fn impossible_phantoms_are_refused() {
    let mut phantom = Phantom::demo();
    phantom.shape = Shape::Ventricle(Ventricle { wall_ml: f64::NAN, ..Ventricle::NORMAL });
    assert!(matches!(phantom::simulate(&phantom), Err(PhantomError::Invalid { what: "wall volume (ml)", .. })));
}

// ---- files ----

fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("phantom");
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

/// What `dciodvfy` says of a file, or `None` (after saying so) where it is not installed; with CI set that is a failure.
#[allow(clippy::disallowed_methods, reason = "tests ask whether they run in CI")]
fn dciodvfy(path: &Path) -> Option<String> {
    match Command::new("dciodvfy").arg(path).output() {
        Ok(output) => Some(String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout)),
        Err(error) => {
            assert!(std::env::var_os("CI").is_none(), "dciodvfy must be installed in CI: {error}");
            println!("skipped: dciodvfy is absent (Debian package dicom3tools)");
            None
        }
    }
}

#[test]
fn dciodvfy_finds_no_errors() {
    let mut reversed = Phantom::demo();
    reversed.pose.reversed = true;
    let mut anywhere = Phantom::demo();
    anywhere.imaging.oriented = false;
    let mut sixteen = Phantom::small();
    sixteen.imaging.gates = 16;
    sixteen.imaging.rr_interval_ms = 700.0;
    let phantoms =
        [("gated", Phantom::demo()), ("reversed", reversed), ("unoriented", anywhere), ("sixteen", sixteen), ("ungated", Phantom::paper())];
    for (name, phantom) in phantoms {
        let path = scratch(&format!("{name}.dcm"));
        std::fs::write(&path, phantom::dicom::write(&simulate(&phantom).study).unwrap()).unwrap();
        let Some(said) = dciodvfy(&path) else { return };
        assert!(said.contains("NMImage"), "{said}");
        assert!(!said.contains("Error") && !said.contains("Warning"), "{name}: {said}");
    }
}

fn read_dicom(bytes: &[u8]) -> InMemDicomObject {
    dicom_object::from_reader(std::io::Cursor::new(bytes)).unwrap().into_inner()
}

#[test]
fn dicom_reads_back_voxel_for_voxel() {
    let study = simulate(&Phantom::demo()).study;
    let object = read_dicom(&phantom::dicom::write(&study).unwrap());
    let pixels = object.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap();
    let counts: Vec<f32> = study.gates.iter().flat_map(|gate| gate.volume.counts.iter().copied()).collect();
    assert!(pixels.iter().map(|&pixel| f32::from(pixel)).eq(counts));

    let text = |tag| object.element(tag).unwrap().to_str().unwrap().into_owned();
    assert_eq!(text(tags::IMAGE_TYPE), "ORIGINAL\\PRIMARY\\RECON GATED TOMO\\EMISSION");
    assert_eq!(text(tags::PATIENT_NAME).trim(), "PHANTOM^VENTRICLE");
    assert_eq!(Some(text(tags::STUDY_INSTANCE_UID)), study.acquisition.study_instance_uid);
    assert_eq!(text(tags::PIXEL_SPACING), "2.87\\2.87");
    assert_eq!(text(tags::SPACING_BETWEEN_SLICES).trim(), "5.74");
    assert_eq!(object.element(tags::NUMBER_OF_FRAMES).unwrap().to_int::<usize>().unwrap(), 192);
    let slots = object.element(tags::TIME_SLOT_VECTOR).unwrap().to_multi_int::<u16>().unwrap();
    assert_eq!((slots[0], slots[23], slots[24], slots[191]), (1, 1, 2, 8));
    let slices = object.element(tags::SLICE_VECTOR).unwrap().to_multi_int::<u16>().unwrap();
    assert_eq!((slices[0], slices[23], slices[24], slices[191]), (1, 24, 1, 24));
    let frame_time = object.value_at((tags::GATED_INFORMATION_SEQUENCE, tags::DATA_INFORMATION_SEQUENCE, tags::FRAME_TIME)).unwrap();
    assert!((frame_time.to_float64().unwrap() - 833.0 / 8.0).abs() < 1e-9);
    let position = object.value_at((tags::DETECTOR_INFORMATION_SEQUENCE, tags::IMAGE_POSITION_PATIENT)).unwrap();
    let origin = study.orientation.unwrap().origin_mm;
    let position = position.to_multi_float64().unwrap();
    assert!((glam::DVec3::new(position[0], position[1], position[2]) - origin).length() < 1e-9);
}

#[test]
fn reversed_slices_have_a_negative_spacing_and_expected_counts_are_scaled() {
    let mut phantom = Phantom::demo();
    phantom.pose.reversed = true;
    phantom.imaging.noise_seed = None;
    let study = simulate(&phantom).study;
    let object = read_dicom(&phantom::dicom::write(&study).unwrap());
    assert_eq!(object.element(tags::SPACING_BETWEEN_SLICES).unwrap().to_str().unwrap().trim(), "-5.74");
    let scale = phantom::dicom::scale(&study);
    let pixels = object.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap();
    assert_eq!(pixels.iter().max(), Some(&30_000));
    let counts = study.gates.iter().flat_map(|gate| gate.volume.counts.iter());
    assert!(pixels.iter().zip(counts).all(|(&pixel, &count)| (f64::from(pixel) - f64::from(count) * scale).abs() <= 0.5));
}

#[test]
fn nifti_reads_back_voxel_for_voxel_and_in_ras() {
    let study = simulate(&Phantom::demo()).study;
    let plain = phantom::nifti::write(&study);
    let gzipped = phantom::nifti::write_gzipped(&study).unwrap();
    assert_eq!(gzipped, phantom::nifti::write_gzipped(&study).unwrap());
    let mut unzipped = Vec::new();
    std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&gzipped[..]), &mut unzipped).unwrap();
    assert_eq!(plain, unzipped);

    let object = InMemNiftiObject::from_reader(&plain[..]).unwrap();
    assert_eq!(object.volume().dim(), &[64, 64, 24, 8]);
    for (gate, [z, y, x]) in [(0, [0, 0, 0]), (3, [12, 40, 20]), (7, [23, 63, 63]), (5, [9, 31, 44])] {
        let read = object.volume().get_f32(&[x as u16, y as u16, z as u16, gate as u16]).unwrap();
        assert_eq!(read.to_bits(), study.gates[gate].volume.counts[[z, y, x]].to_bits());
    }
    let header = object.header();
    let affine = [header.srow_x, header.srow_y, header.srow_z];
    let orientation = study.orientation.unwrap();
    for [z, y, x] in [[0, 0, 0], [23, 10, 50]] {
        let lps = orientation.patient_mm(study.grid.position_mm([z, y, x]));
        let index = [x as f64, y as f64, z as f64, 1.0];
        let ras: Vec<f64> = (0..3).map(|row| (0..4).map(|column| f64::from(affine[row][column]) * index[column]).sum()).collect();
        assert!((ras[0] + lps.x).abs() < 1e-4 && (ras[1] + lps.y).abs() < 1e-4 && (ras[2] - lps.z).abs() < 1e-4, "{ras:?} {lps}");
    }
    assert!((f64::from(object.header().pixdim[4]) - 833.0 / 8.0).abs() < 1e-3);
}

#[test]
fn the_command_writes_what_it_says() {
    let (file, truth) = (scratch("command.nii.gz"), scratch("command.json"));
    let run = |arguments: &[&str]| Command::new(env!("CARGO_BIN_EXE_ventricle")).arg("phantom").args(arguments).output().unwrap();
    let output = run(&[
        "--preset",
        "normal",
        "--edv",
        "150",
        "--ef",
        "40",
        "--gates",
        "4",
        "--grid",
        "32x30x20",
        "--spacing",
        "6x6x6",
        "--tilt",
        "-10,5",
        "--defect",
        "inferior:0.3:0.9",
        "--liver",
        "5:1.5",
        "--fwhm",
        "12",
        "--seed",
        "9",
        "--format",
        "nifti-gz",
        "-o",
        file.to_str().unwrap(),
        "--truth",
        truth.to_str().unwrap(),
    ]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{said} {}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("continuous cycle: 40.0 %") && said.contains(file.to_str().unwrap()), "{said}");
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&truth).unwrap()).unwrap();
    assert_eq!(json["truth"]["gates"].as_array().unwrap().len(), 4);
    assert_eq!(json["phantom"]["pose"]["tilt_degrees"], serde_json::json!([-10.0, 5.0]));
    // The parameters in the truth make the same study again.
    let again: Phantom = serde_json::from_value(json["phantom"].clone()).unwrap();
    assert_eq!(std::fs::read(&file).unwrap(), phantom::nifti::write_gzipped(&simulate(&again).study).unwrap());

    for (wrong, names) in [
        (vec!["--preset", "paper", "--edv", "100"], "--edv"),
        (vec!["--defect", "somewhere:0.1:1"], "somewhere"),
        (vec!["--gates", "0"], "gates"),
        (vec!["--grid", "64x64"], "3 numbers"),
    ] {
        let output = run(&[&wrong[..], &["-o", file.to_str().unwrap()]].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(names), "{wrong:?}: {said}");
    }
}

#[test]
fn help_names_every_part() {
    let output = Command::new(env!("CARGO_BIN_EXE_ventricle")).args(["phantom", "--help"]).output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    for word in ["--preset", "--edv", "--defect", "--liver", "--fwhm", "--truth", "--reversed", "Examples:", "RECON GATED TOMO", "dilated"]
    {
        assert!(help.contains(word), "{word}");
    }
}
