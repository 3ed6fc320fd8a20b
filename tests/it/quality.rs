//! Each quality flag of the clinical preset, raised by a study that deserves it.

use ventricle::{
    accuracy::spoiled::family::Damage,
    analysis::analyse,
    phantom::{self, Defect, Liver, Phantom, Shape, Site},
    pipeline::{self, monitor::Silent, parameters::Parameters},
    report::{self, Timing},
    study::Study,
    volume::Grid,
};

const COARSE: Grid = Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] };

/// A normal heart on a coarse grid, changed.
fn study(change: impl FnOnce(&mut Phantom)) -> Study {
    let mut phantom = Phantom::normal();
    phantom.imaging.grid = COARSE;
    phantom.imaging.counts = 150.0;
    phantom.imaging.noise_seed = Some(5);
    change(&mut phantom);
    phantom::simulate(&phantom).unwrap().study
}

fn flags(study: &Study, parameters: &Parameters) -> Vec<String> {
    let reconstruction = pipeline::reconstruct(study, parameters, &Silent).unwrap();
    let report = report::build("some-id", study, &reconstruction, &analyse(study, &reconstruction), &Timing::default());
    for flag in &report.quality.flags {
        assert!(report.warnings.iter().any(|warning| warning.code == *flag && warning.message.len() > 40), "{flag} is not explained");
    }
    report.quality.flags
}

#[track_caller]
fn assert_flagged(flag: &str, study: &Study) {
    let flags = flags(study, &Parameters::clinical());
    assert!(flags.iter().any(|found| found == flag), "{flag} is not among {flags:?}");
}

#[test]
fn a_normal_heart_has_none() {
    assert_eq!(flags(&study(|_| ()), &Parameters::clinical()), Vec::<String>::new());
}

#[test]
fn half_a_wall_that_is_dark_is_extrapolated() {
    let defect = Defect { site: Site::Lateral, extent: 0.53, severity: 1.0 };
    assert_flagged("wall_extrapolated", &study(|phantom| phantom.uptake.defects.push(defect)));
}

#[test]
fn a_camera_sharper_than_any_is_at_the_bound() {
    let sharp = study(|phantom| {
        phantom.imaging.psf.fwhm_mm = 4.0;
        phantom.imaging.grid = Grid { shape: [32, 44, 44], spacing_mm: [4.0; 3] };
    });
    assert_flagged("psf_at_bound", &sharp);
}

#[test]
fn a_dark_apex_without_orientation_leaves_pose_and_fraction_in_doubt() {
    let defect = Defect { site: Site::Apical, extent: 0.32, severity: 1.0 };
    let apical = Study { orientation: None, ..study(|phantom| phantom.uptake.defects.push(defect)) };
    assert_flagged("pose_uncertain", &apical);
    assert_flagged("methods_disagree", &apical);
}

#[test]
fn a_hot_liver_on_the_wall_is_left_unexplained() {
    assert_flagged("poor_residual", &study(|phantom| phantom.uptake.liver = Some(Liver { gap_mm: 0.0, uptake: 3.0 })));
}

#[test]
fn two_hearts_in_one_cycle_do_not_conserve_the_wall() {
    let of_wall = |ml: f64| {
        study(|phantom| {
            if let Shape::Ventricle(ventricle) = &mut phantom.shape {
                ventricle.wall_ml = ml;
            }
        })
    };
    let (mut mixed, other) = (of_wall(90.0), of_wall(150.0));
    mixed.gates[4..].clone_from_slice(&other.gates[4..]);
    assert_flagged("myocardial_volume_not_conserved", &mixed);
}

#[test]
fn a_blur_that_is_not_the_cameras_does_not_come_to_rest() {
    let mut parameters = Parameters::clinical();
    parameters.refine.psf_fwhm_mm = Some(25.0);
    let flags = flags(&study(|_| ()), &parameters);
    assert!(flags.iter().any(|flag| flag == "not_converged"), "{flags:?}");
}

/// A normal heart whose images are damaged.
fn damaged(damage: &Damage) -> Study {
    damage.done_to(&study(|_| ()))
}

/// Voxels that are left along one axis.
fn kept(axis: usize, of: [usize; 2]) -> Damage {
    let mut kept = COARSE.shape.map(|voxels| [0, voxels]);
    kept[axis] = of;
    Damage { kept: Some(kept), ..Damage::default() }
}

#[test]
fn gates_that_lost_beats_or_stand_in_the_wrong_order_are_flagged() {
    assert_flagged("gating", &damaged(&Damage { last_gates: vec![0.2, 0.3], ..Damage::default() }));
    assert_flagged("gating", &damaged(&Damage { order: Some(vec![3, 4, 5, 6, 7, 0, 1, 2]), ..Damage::default() }));
    assert_flagged("gating", &damaged(&Damage { order: Some(vec![0, 5, 2, 7, 4, 1, 6, 3]), ..Damage::default() }));
}

#[test]
fn next_to_no_counts_are_flagged() {
    assert_flagged("low_counts", &study(|phantom| phantom.imaging.counts = 4.0));
}

#[test]
fn a_wall_that_the_image_cuts_is_flagged() {
    assert_flagged("truncated", &damaged(&kept(2, [0, 19])));
}

#[test]
fn a_base_beyond_the_last_slice_is_flagged() {
    assert_flagged("valve_plane", &damaged(&kept(0, [0, 17])));
}

#[test]
fn a_patient_who_moved_along_the_axis_is_flagged() {
    assert_flagged("motion", &damaged(&Damage { moved: Some(([4, 0, 0], 0.45)), ..Damage::default() }));
}

#[test]
fn a_hot_liver_and_a_dark_wall_are_named() {
    assert_flagged("extracardiac_activity", &study(|phantom| phantom.uptake.liver = Some(Liver { gap_mm: 0.0, uptake: 3.0 })));
    let defect = Defect { site: Site::Inferior, extent: 0.5, severity: 1.0 };
    assert_flagged("large_defect", &study(|phantom| phantom.uptake.defects.push(defect)));
}

#[test]
fn a_small_ventricle_is_flagged() {
    let small = study(|phantom| {
        if let Shape::Ventricle(ventricle) = &mut phantom.shape {
            (ventricle.edv_ml, ventricle.esv_ml, ventricle.wall_ml) = (40.0, 10.0, 85.0);
        }
        phantom.imaging.grid = Grid { shape: [36, 48, 48], spacing_mm: [4.0; 3] };
    });
    assert_flagged("small_heart", &small);
}

#[test]
fn a_wall_thicker_than_any_is_flagged() {
    let thick = study(|phantom| {
        if let Shape::Ventricle(ventricle) = &mut phantom.shape {
            (ventricle.edv_ml, ventricle.esv_ml, ventricle.wall_ml) = (120.0, 60.0, 420.0);
        }
    });
    assert_flagged("shape", &thick);
}
