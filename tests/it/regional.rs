//! What is said of parts of the wall: simulated hearts that contract late in one sector or not at all, or take up less, and what must not change it.
//! How large the errors are on a family of hearts is in `docs/accuracy.md`.

use glam::DVec3;
use ndarray::Axis;
use serde_json::Value;
use std::sync::OnceLock;
use ventricle::{
    analysis::segments::Average,
    analysis::{Analysis, RotationSource, analyse, phase::circular_mean, segments::means},
    phantom::{self, Defect, Imaging, Phantom, Pose, Regional, Site},
    pipeline::{self, Reconstruction, monitor::Silent, parameters::Parameters},
    report::{self, Timing},
    study::{Gate, Orientation, Study},
    volume::{Grid, Volume},
};

/// The usual clinical pixel, so that a reconstruction is quick.
const COARSE: Grid = Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] };

/// A normal heart on the coarse grid with many counts: what is asked here is where things are, not how much noise there is.
fn heart() -> Phantom {
    let imaging = Imaging { grid: COARSE, counts: 1000.0, ..Imaging::default() };
    Phantom { imaging, ..Phantom::normal() }
}

fn simulate(phantom: &Phantom) -> Study {
    phantom::simulate(phantom).unwrap().study
}

fn reconstruct(study: &Study, parameters: &Parameters) -> Reconstruction {
    pipeline::reconstruct(study, parameters, &Silent).unwrap()
}

fn analysed(study: &Study) -> Analysis {
    analyse(study, &reconstruct(study, &Parameters::clinical()))
}

/// The normal heart, its study and what is derived from it: made once.
fn normal() -> &'static (Study, Analysis) {
    static NORMAL: OnceLock<(Study, Analysis)> = OnceLock::new();
    NORMAL.get_or_init(|| {
        let study = simulate(&heart());
        let analysis = analysed(&study);
        (study, analysis)
    })
}

fn segment_means(analysis: &Analysis, values: &[Option<f64>], average: Average) -> Vec<f64> {
    means(values, &analysis.places, average).into_iter().map(|mean| mean.unwrap()).collect()
}

fn phases(analysis: &Analysis) -> Vec<f64> {
    segment_means(analysis, &analysis.phase.as_ref().unwrap().degrees, Average::Circular)
}

fn apart(one: f64, other: f64) -> f64 {
    (one - other + 180.0).rem_euclid(360.0) - 180.0
}

/// Basal and mid inferoseptal, and what a sector of 60° about 120° does not touch: half of 14 and 15 lie in it.
const INSIDE: [usize; 2] = [3, 9];
const TOUCHED: [usize; 5] = [3, 9, 14, 15, 17];

#[test]
fn a_sector_that_contracts_late_is_late_in_its_segments_alone() {
    let late = Regional { edge_degrees: 0.0, delay: 0.25, ..Regional::sector(120.0, 60.0) };
    let analysis = analysed(&simulate(&Phantom { regional: vec![late], ..heart() }));
    let phases = phases(&analysis);
    let of = |wanted: &dyn Fn(usize) -> bool| {
        circular_mean((1..).zip(&phases).filter(|(number, _)| wanted(*number)).map(|(_, &degrees)| (degrees, 1.0))).unwrap()
    };
    let rest = of(&|number| !TOUCHED.contains(&number));
    // Counts of both sides mix in a sector of 30 mm: it looks later by less than its 90° (docs/accuracy.md has by how much, and that the 90 ± 20°
    // asked for there are not met). It must be told from the rest.
    for number in INSIDE {
        let delay = apart(phases[number - 1], rest);
        assert!((40.0..110.0).contains(&delay), "segment {number} is {delay} later: {phases:?}");
    }
    for (number, &degrees) in (1..).zip(&phases).filter(|(number, _)| !TOUCHED.contains(number)) {
        assert!(apart(degrees, rest).abs() < 20.0, "segment {number}: {degrees}, the rest {rest}");
    }
    let (late, usual) = (analysis.phase.unwrap(), normal().1.phase.clone().unwrap());
    assert!(late.sd_degrees > 2.0 * usual.sd_degrees && late.bandwidth_degrees > 60.0, "{} {}", late.sd_degrees, late.bandwidth_degrees);
}

#[test]
fn a_heart_that_beats_all_at_once_has_a_narrow_histogram() {
    let phase = normal().1.phase.as_ref().unwrap();
    assert!(phase.sd_degrees < 8.0 && phase.bandwidth_degrees < 30.0, "{} {}", phase.sd_degrees, phase.bandwidth_degrees);
}

#[test]
fn an_akinetic_sector_neither_moves_nor_thickens() {
    let still = Regional { amplitude: 0.0, ..Regional::sector(180.0, 110.0) };
    let analysis = analysed(&simulate(&Phantom { regional: vec![still], ..heart() }));
    let usual = &normal().1;
    for number in [4, 10] {
        let of = |analysis: &Analysis, values: &[Option<f64>]| segment_means(analysis, values, Average::Plain)[number - 1];
        let (motion, beside) = (of(&analysis, &analysis.walls.motion_mm), of(usual, &usual.walls.motion_mm));
        assert!(beside > 5.0 && motion < 0.35 * beside, "segment {number}: moves {motion} mm, a normal one {beside}");
        let (thickening, beside) = (of(&analysis, &analysis.walls.thickening_percent), of(usual, &usual.walls.thickening_percent));
        // The base comes down all round, which the wall of the sector gives way to.
        assert!(beside > 30.0 && thickening < 0.6 * beside, "segment {number}: thickens by {thickening} %, a normal one by {beside}");
    }
    let motion = segment_means(&analysis, &analysis.walls.motion_mm, Average::Plain);
    assert!(motion[0] > 4.0 && motion[6] > 4.0, "the anterior wall moves: {motion:?}");
}

#[test]
fn a_perfusion_defect_is_found_where_it_is() {
    let mut phantom = heart();
    phantom.uptake.defects = vec![Defect { site: Site::Lateral, extent: 0.25, severity: 0.9 }];
    let study = simulate(&phantom);
    let reconstruction = reconstruct(&study, &Parameters::clinical());
    let report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &Timing::default());
    let perfusion = report.perfusion.unwrap();
    assert!((15.0..35.0).contains(&perfusion.extent_percent), "{}", perfusion.extent_percent);
    // A quarter about the lateral wall: the lateral segments at every level, and no other side.
    assert!(perfusion.defect_segments.contains(&16), "{:?}", perfusion.defect_segments);
    assert!(perfusion.defect_segments.iter().all(|number| [5, 6, 11, 12, 16].contains(number)), "{:?}", perfusion.defect_segments);
    assert!(perfusion.severity_percent > 20.0);
    assert!(normal().1.perfusion.extent_percent < 1.0, "{}", normal().1.perfusion.extent_percent);
}

/// Without noise or blur in the way of it: stress after rest.
#[test]
fn the_cavity_of_a_pair_has_the_ratio_that_it_has() {
    let phantom::Shape::Ventricle(mut ventricle) = heart().shape else { panic!() };
    ventricle.edv_ml *= 1.2;
    ventricle.esv_ml *= 1.2;
    let stress = Phantom { shape: phantom::Shape::Ventricle(ventricle), ..heart() };
    let volume = |study: &Study| report_of(study)["function"]["edv_ml"].as_f64().unwrap();
    let ratio = volume(&simulate(&stress)) / volume(&normal().0);
    assert!((ratio / 1.2 - 1.0).abs() < 0.03, "{ratio}");
}

fn report_of(study: &Study) -> Value {
    let reconstruction = reconstruct(study, &Parameters::clinical());
    serde_json::to_value(report::build("x", study, &reconstruction, &analyse(study, &reconstruction), &Timing::default())).unwrap()
}

fn changed(study: &Study, orientation: Option<Orientation>, change: impl Fn(&Volume) -> Volume) -> Study {
    let gates: Vec<_> = study.gates.iter().map(|gate| Gate { volume: change(&gate.volume), duration_ms: gate.duration_ms }).collect();
    Study { grid: gates[0].volume.grid, gates, orientation, ..study.clone() }
}

/// The study as it would be stored with its axes in another order `[slice, row, column]`, some of them reversed: the same patient.
fn stored(study: &Study, order: [usize; 3], reversed: &[usize]) -> Study {
    let grid = study.grid;
    let old = study.orientation.unwrap();
    let axes = [old.slices, old.rows, old.columns];
    let mut directions = order.map(|axis| axes[axis]);
    let mut origin_mm = old.origin_mm;
    for &axis in reversed {
        let length = (grid.shape[order[axis]] - 1) as f64 * grid.spacing_mm[order[axis]];
        origin_mm += directions[axis] * length;
        directions[axis] = -directions[axis];
    }
    let orientation = Orientation { slices: directions[0], rows: directions[1], columns: directions[2], origin_mm };
    changed(study, Some(orientation), |volume| {
        let mut counts = volume.counts.clone().permuted_axes(order);
        for &axis in reversed {
            counts.invert_axis(Axis(axis));
        }
        let counts = counts.as_standard_layout().into_owned();
        let (a, b, c) = counts.dim();
        Volume { grid: Grid { shape: [a, b, c], spacing_mm: order.map(|axis| grid.spacing_mm[axis]) }, counts }
    })
}

/// A heart whose sides differ in everything: uptake, timing, thickness.
fn uneven() -> Phantom {
    let mut phantom = heart();
    phantom.uptake.defects = vec![Defect { site: Site::Anterior, extent: 0.2, severity: 0.6 }];
    let late = Regional { delay: 0.2, ..Regional::sector(240.0, 80.0) };
    Phantom { regional: vec![late], ..phantom }
}

/// Largest differences of segments' perfusion (points), thickness, motion (mm) and phase (°).
fn differences(a: &Analysis, b: &Analysis) -> [f64; 4] {
    let worst = |of: &dyn Fn(&Analysis) -> Vec<f64>, difference: &dyn Fn(f64, f64) -> f64| {
        of(a).into_iter().zip(of(b)).map(|(one, other)| difference(one, other).abs()).fold(0.0, f64::max)
    };
    let plain = |one: f64, other: f64| one - other;
    [
        worst(&|x| segment_means(x, &x.perfusion.percent, Average::Plain), &plain),
        worst(&|x| segment_means(x, &x.walls.thickness_mm[x.end_diastole], Average::Plain), &plain),
        worst(&|x| segment_means(x, &x.walls.motion_mm, Average::Plain), &plain),
        worst(&phases, &apart),
    ]
}

#[test]
fn how_a_study_is_stored_leaves_segments_as_they_are() {
    let study = simulate(&uneven());
    let upright = analysed(&study);
    // Columns reversed; rows and columns exchanged; slices reversed; slices as columns.
    let others: [([usize; 3], &[usize]); 4] = [([0, 1, 2], &[2]), ([0, 2, 1], &[]), ([0, 1, 2], &[0]), ([1, 2, 0], &[1])];
    for (order, reversed) in others {
        let other = analysed(&stored(&study, order, reversed));
        assert_eq!(other.places.rotation, RotationSource::Patient);
        let found = differences(&upright, &other);
        let within = found[0] < 4.0 && found[1] < 0.8 && found[2] < 0.8 && found[3] < 12.0;
        assert!(within, "{order:?} {reversed:?}: {found:?}");
    }
}

#[test]
fn more_counts_of_the_same_change_nothing_but_counts() {
    let study = simulate(&uneven());
    let fourfold = changed(&study, study.orientation, |volume| Volume { grid: volume.grid, counts: &volume.counts * 4.0 });
    let (one, four) = (report_of(&study), report_of(&fourfold));
    for part in ["regional", "cycle", "shape", "phase", "function"] {
        assert_eq!(one[part], four[part], "{part}");
    }
    let (once, times) = (one["perfusion"].clone(), four["perfusion"].clone());
    let counts = |perfusion: &Value| perfusion["maximum_counts"].as_f64().unwrap();
    assert!((counts(&times) / counts(&once) - 4.0).abs() < 1e-9);
    assert_eq!(once["defect_segments"], times["defect_segments"]);
    assert_eq!(once["extent_percent"], times["extent_percent"]);
}

#[test]
fn which_side_is_anterior_is_assumed_said_and_can_be_given() {
    let study = simulate(&uneven());
    let known = analysed(&study);
    let bare = Study { orientation: None, ..study };
    let reconstruction = reconstruct(&bare, &Parameters::clinical());
    let assumed = analyse(&bare, &reconstruction);
    assert_eq!(assumed.places.rotation, RotationSource::Assumed);
    // Stacks are laid out so that the assumption is right here: the same segments.
    let found = differences(&known, &assumed);
    assert!(found[0] < 4.0 && found[3] < 12.0, "{found:?}");
    let report = report::build("x", &bare, &reconstruction, &assumed, &Timing::default());
    assert_eq!(serde_json::to_value(&report).unwrap()["regional"]["rotation"]["source"], "assumed");
    // The inferior wall, told to be the anterior one: the defect is in inferior segments.
    let mut parameters = Parameters::clinical();
    parameters.analysis.anterior = Some([0.0, 3.0, 0.0]);
    let turned = analyse(&bare, &reconstruct(&bare, &parameters));
    assert_eq!(turned.places.rotation, RotationSource::Given);
    let perfusion = |analysis: &Analysis| segment_means(analysis, &analysis.perfusion.percent, Average::Plain);
    for (anterior, inferior) in [(1, 4), (7, 10)] {
        assert!(perfusion(&assumed)[anterior - 1] < perfusion(&assumed)[inferior - 1] - 20.0, "{:?}", perfusion(&assumed));
        assert!((perfusion(&turned)[inferior - 1] - perfusion(&assumed)[anterior - 1]).abs() < 2.0, "{:?}", perfusion(&turned));
    }
}

/// No number of the JSON is one that JSON has no word for: serde writes those as null, so that the report would not read back.
#[track_caller]
fn assert_readable(study: &Study, parameters: &Parameters) -> Value {
    let reconstruction = reconstruct(study, parameters);
    let report = report::build("x", study, &reconstruction, &analyse(study, &reconstruction), &Timing::default());
    let text = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<report::Report>(&text).unwrap(), report);
    serde_json::from_str(&text).unwrap()
}

#[test]
fn one_gate_has_what_needs_no_cycle() {
    let mut phantom = heart();
    phantom.imaging.gates = 1;
    let json = assert_readable(&simulate(&phantom), &Parameters::clinical());
    assert_eq!((&json["cycle"], &json["phase"]), (&Value::Null, &Value::Null));
    assert_eq!(json["shape"]["end_systole"], Value::Null);
    for segment in json["regional"]["segments"].as_array().unwrap() {
        assert!(segment["perfusion_percent"].as_f64().unwrap() > 60.0 && segment["end_diastolic_thickness_mm"].as_f64().unwrap() > 4.0);
        for of_cycle in ["end_systolic_thickness_mm", "thickening_percent", "motion_mm", "phase_degrees"] {
            assert_eq!(segment[of_cycle], Value::Null, "{of_cycle}");
        }
    }
}

#[test]
fn the_paper_s_preset_has_segments_too() {
    let json = assert_readable(
        &simulate(&Phantom { imaging: Imaging { grid: COARSE, ..heart().imaging }, ..Phantom::dilated() }),
        &Parameters::paper(),
    );
    let segments = json["regional"]["segments"].as_array().unwrap();
    assert_eq!(segments.len(), 17);
    // Its surfaces are not those of the camera's model, and a vertex is a piece of the wall only nearly: values are there, and are possible ones.
    for segment in segments {
        assert!((20.0..=100.0).contains(&segment["perfusion_percent"].as_f64().unwrap()), "{segment}");
        assert!((2.0..40.0).contains(&segment["end_diastolic_thickness_mm"].as_f64().unwrap()), "{segment}");
        assert!((-20.0..30.0).contains(&segment["motion_mm"].as_f64().unwrap()), "{segment}");
    }
    assert!(json["phase"]["counted_percent"].as_f64().unwrap() > 50.0);
    assert!(json["regional"]["whole"]["area_cm2"].as_f64().unwrap() > 50.0);
}

#[test]
fn a_tilted_heart_has_the_segments_of_an_upright_one() {
    let tilted = Phantom { pose: Pose { tilt_degrees: [14.0, -11.0], ..Pose::default() }, ..uneven() };
    let found = differences(&analysed(&simulate(&uneven())), &analysed(&simulate(&tilted)));
    assert!(found[0] < 8.0 && found[1] < 1.5 && found[2] < 1.5 && found[3] < 20.0, "{found:?}");
}

/// The definition that the surfaces' truth is made of, against the closed form: the widest level of an upright ellipsoid.
#[test]
fn exact_surfaces_have_the_thickness_and_motion_of_their_closed_form() {
    let late = Regional { edge_degrees: 0.0, amplitude: 0.0, ..Regional::sector(270.0, 90.0) };
    let phantom = Phantom { regional: vec![late], ..heart() };
    let [diastole, systole] = [0, 2].map(|gate| phantom.exact_surfaces(gate).unwrap());
    let truth = phantom::truth(&phantom).unwrap();
    for (surfaces, gate) in [(&diastole, 0), (&systole, 2)] {
        for (mesh, ml) in
            [(&surfaces.endocardial, truth.gates[gate].endocardial_ml), (&surfaces.epicardial, truth.gates[gate].epicardial_ml)]
        {
            // The mesh has a ramp of 5° where the sector has a step: up to 1 % of the volume at end systole.
            let most = if gate == 0 { 0.004 } else { 0.012 };
            assert!((mesh.volume_ml() / ml - 1.0).abs() < most, "{} {ml}", mesh.volume_ml());
        }
    }
    // The widest ring's vertices: those of the still sector keep their distance from the axis, the others come nearer.
    let radius = |point: DVec3, surfaces: &phantom::ExactSurfaces| {
        let from = point - surfaces.base_mm;
        from.x.hypot(from.y)
    };
    let moved: Vec<(f64, f64)> = diastole
        .endocardial
        .positions
        .iter()
        .zip(&systole.endocardial.positions)
        .take(diastole.lid_from)
        .map(|(&at_first, &after)| {
            let from = at_first - diastole.base_mm;
            (from.y.atan2(from.x).to_degrees(), radius(at_first, &diastole) - radius(after, &systole))
        })
        .collect();
    let still = moved.iter().filter(|(degrees, _)| degrees.abs() < 44.0).map(|(_, mm)| mm.abs()).fold(0.0, f64::max);
    let beating = moved.iter().filter(|(degrees, _)| degrees.abs() > 46.0).map(|(_, mm)| *mm).fold(0.0, f64::max);
    assert!(still < 0.7 && beating > 5.0, "{still} {beating}");
}
