//! The report: what follows from known meshes, and that its JSON is the contract's.

use crate::surfaces::{beating, oblique};
use glam::DVec3;
use serde_json::Value;
use std::collections::BTreeMap;
use ventricle::{
    analysis::analyse,
    pipeline::{
        Reconstruction, Surface,
        clinical::{GateFit, ModelFit, PsfEstimate, PsfSource, Referee, Residual, Uncertainty},
        parameters::Parameters,
        pose::{Pose, PoseConfidence},
    },
    report::{self, Report, Timing},
    study::{Orientation, Study, Warning},
};

fn timing() -> Timing {
    Timing { total_ms: 12.5, stages_ms: BTreeMap::from([("edges".to_owned(), 3.5)]) }
}

#[test]
fn function_follows_from_the_largest_and_smallest_cavity() {
    let (study, reconstruction) = beating(8, 3, Some(oblique(false)));
    let report = report::build("some-id", &study, &reconstruction, &analyse(&study, &reconstruction), &timing());
    let function = report.function.unwrap();
    let volume = |gate: usize| reconstruction.gates[gate - 1].volume_ml(Surface::Endocardial);
    assert_eq!((function.end_diastolic_gate, function.end_systolic_gate), (1, 5));
    assert_eq!((function.edv_ml, function.esv_ml), (volume(1), volume(5)));
    assert!((function.sv_ml - (volume(1) - volume(5))).abs() < 1e-12);
    // Axes shrink to two thirds, so the volume to 8/27.
    assert!((function.ef_percent - 100.0 * (1.0 - 8.0 / 27.0)).abs() < 1e-9);
    assert_eq!(report.gates.len(), 8);
    for gate in &report.gates {
        assert!((gate.myocardial_ml - (gate.epicardial_ml - gate.endocardial_ml)).abs() < 1e-12);
    }
    assert!((report.myocardium.mass_g / report.myocardium.mean_ml - 1.05).abs() < 1e-12);
    assert!(report.myocardium.variation_percent.unwrap() < 1e-6);
    assert!(report.quality.flags.is_empty() && report.warnings.is_empty());
    // 97 % of the particles within a voxel: three fifths of the way to the limit of 95 %.
    assert!((report.quality.score - 0.7).abs() < 1e-9, "{:?}", report.quality);
}

/// The same as the preset `clinical` would give it.
fn fitted(gates: usize, orientation: Option<Orientation>) -> (Study, Reconstruction) {
    let (study, mut reconstruction) = beating(gates, 2, orientation);
    for gate in &mut reconstruction.gates {
        for fit in [&mut gate.fits.endocardial, &mut gate.fits.epicardial] {
            fit.evolution = None;
        }
    }
    let confidence = PoseConfidence { score: 0.9, ridge: 0.95, explained: 0.8, flip_margin: 0.2, ends_given: false };
    let several = |value: f64| (gates > 1).then_some(value);
    let numbers = GateFit { relative_residual: 0.05, activity: 120.0, base_tilt_degrees: 4.0, length_mm: 88.0 };
    reconstruction.region = None;
    reconstruction.pose =
        Some(Pose { apex_mm: DVec3::new(90.0, 80.0, 10.0), base_mm: DVec3::new(90.0, 80.0, 100.0), radius_mm: 30.0, confidence });
    reconstruction.model = Some(ModelFit {
        refined: true,
        psf: PsfEstimate { fwhm_mm: 11.0, source: PsfSource::Estimated, standard_error_mm: 0.4, at_bound: false, edv_percent_per_mm: 9.0 },
        residual: Residual { relative: 0.05, over_noise: 1.25 },
        uncertainty: Some(Uncertainty { edv_ml: 3.0, esv_ml: several(2.0), ef_percent: several(1.0), mass_g: 4.0 }),
        low_uptake_fraction: 0.01,
        extrapolated_fraction: 0.02,
        referee: Referee { gradient_ef_percent: several(68.0), counts_ef_percent: several(72.0) },
        steps: 9,
        converged: true,
        gates: vec![numbers; gates],
    });
    reconstruction.parameters = Parameters::clinical();
    (study, reconstruction)
}

#[test]
fn a_fitted_study_has_its_pose_its_model_and_how_uncertain_it_is() {
    let (study, reconstruction) = fitted(8, Some(oblique(false)));
    let report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &timing());
    assert!(report.quality.flags.is_empty() && report.warnings.is_empty(), "{:?}", report.warnings);
    let json = serde_json::to_value(&report).unwrap();
    for path in [
        "/pose/apex_mm",
        "/pose/base_mm",
        "/pose/axis",
        "/pose/length_mm",
        "/pose/radius_mm",
        "/pose/patient/apex_mm",
        "/pose/patient/axis",
        "/pose/confidence/score",
        "/pose/confidence/ends_given",
        "/model/refined",
        "/model/psf/fwhm_mm",
        "/model/psf/source",
        "/model/psf/standard_error_mm",
        "/model/psf/at_bound",
        "/model/psf/edv_percent_per_mm",
        "/model/residual/relative",
        "/model/residual/over_noise",
        "/model/residual/unexplained",
        "/model/low_uptake_percent",
        "/model/extrapolated_percent",
        "/model/referee/gradient_ef_percent",
        "/model/referee/counts_ef_percent",
        "/model/steps",
        "/model/converged",
        "/gates/7/model/relative_residual",
        "/gates/7/model/activity",
        "/gates/7/model/base_tilt_degrees",
        "/gates/7/model/length_mm",
        "/uncertainty/edv_ml/standard_error",
        "/uncertainty/esv_ml/low_95",
        "/uncertainty/ef_percent/high_95",
        "/uncertainty/mass_g/standard_error",
        "/quality/score",
    ] {
        assert!(!json.pointer(path).unwrap_or(&Value::Null).is_null(), "{path} is missing in {json:#}");
    }
    assert_eq!((&json["region"], &json["parameters"]["preset"]), (&Value::Null, &"clinical".into()));
    assert_eq!(json["gates"][0]["fit"]["endocardial"]["within_one_voxel_percent"], Value::Null);
    assert_eq!(json["model"]["psf"]["source"], "estimated");
    let (edv, errors) = (report.function.unwrap().edv_ml, report.uncertainty.unwrap().edv_ml);
    assert!((errors.low_95 - (edv - 1.96 * 3.0)).abs() < 1e-9 && (errors.high_95 - (edv + 1.96 * 3.0)).abs() < 1e-9);
    let (pose, patient) = (report.pose.unwrap(), report.pose.unwrap().patient.unwrap());
    assert_eq!((pose.length_mm, pose.axis), (90.0, [0.0, 0.0, 1.0]));
    let apart = DVec3::from_array(patient.base_mm) - DVec3::from_array(patient.apex_mm);
    assert!((apart.length() - 90.0).abs() < 1e-9 && (apart / 90.0).distance(DVec3::from_array(patient.axis)) < 1e-12);
    assert_eq!(serde_json::from_value::<Report>(json).unwrap(), report);
}

#[test]
fn one_fitted_gate_has_the_error_of_its_volume() {
    let (study, reconstruction) = fitted(1, None);
    let report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &timing());
    let errors = report.uncertainty.unwrap();
    assert_eq!((errors.esv_ml, errors.ef_percent, report.pose.unwrap().patient), (None, None, None));
    assert!((errors.edv_ml.high_95 - report.gates[0].endocardial_ml - 1.96 * 3.0).abs() < 1e-9);
    assert!(report.quality.flags.is_empty());
}

/// Who says which wall is anterior is not told that it is unknown.
#[test]
fn an_assumed_rotation_is_told_and_a_given_one_is_not() {
    let (study, mut reconstruction) = beating(8, 2, None);
    let codes = |reconstruction: &Reconstruction| {
        let report = report::build("x", &study, reconstruction, &analyse(&study, reconstruction), &timing());
        assert!(report.quality.flags.is_empty());
        report.warnings.into_iter().map(|warning| (warning.code, warning.message)).collect::<Vec<_>>()
    };
    let told = codes(&reconstruction);
    assert_eq!(told.len(), 1);
    assert!(told[0].0 == "rotation_unknown" && told[0].1.contains("`analysis.anterior`"), "{told:?}");
    reconstruction.parameters.analysis.anterior = Some([0.0, -1.0, 0.0]);
    assert_eq!(codes(&reconstruction), []);
}

/// Rates of few gates are told with a caution beside them; eight gates are usual and no warning.
#[test]
fn few_gates_are_a_caution_and_no_warning() {
    for (gates, coarse) in [(4, true), (8, true), (15, true), (16, false), (24, false)] {
        let (study, reconstruction) = beating(gates, 2, Some(oblique(false)));
        let report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &timing());
        let cycle = report.cycle.unwrap();
        assert_eq!((cycle.coarse, cycle.caution.is_some()), (coarse, coarse), "{gates}");
        assert!(
            cycle
                .caution
                .is_none_or(|caution| caution.starts_with(&format!("{gates} gates")) && caution.contains("coarse (docs/accuracy.md)"))
        );
        assert!(report.warnings.is_empty(), "{:?}", report.warnings);
    }
}

/// As the version before wrote it: without `pose`, `model`, `uncertainty`, and `pose` and `refine` among the parameters.
#[test]
fn a_report_of_the_version_before_is_still_read() {
    let (study, reconstruction) = beating(8, 2, None);
    let report = report::build("some-id", &study, &reconstruction, &analyse(&study, &reconstruction), &timing());
    let mut before = serde_json::to_value(&report).unwrap();
    for later in ["pose", "model", "uncertainty"] {
        assert_eq!(before.as_object_mut().unwrap().remove(later), Some(Value::Null), "{later}");
    }
    for later in ["pose", "refine"] {
        assert!(before["parameters"].as_object_mut().unwrap().remove(later).is_some());
    }
    for gate in before["gates"].as_array_mut().unwrap() {
        assert_eq!(gate.as_object_mut().unwrap().remove("model"), Some(Value::Null));
    }
    assert_eq!(serde_json::from_value::<Report>(before).unwrap(), report);
}

#[test]
fn one_gate_has_no_function_and_says_null() {
    let (study, reconstruction) = beating(1, 2, None);
    let json = serde_json::to_value(report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &timing())).unwrap();
    assert_eq!(json["function"], Value::Null);
    assert!(json.as_object().unwrap().contains_key("function"));
    assert_eq!(json["myocardium"]["variation_percent"], Value::Null);
    assert!(json["myocardium"]["mass_g"].as_f64().unwrap() > 0.0);
}

#[test]
fn the_json_has_the_names_of_the_contract_and_reads_back() {
    let (study, reconstruction) = beating(8, 2, None);
    let report = report::build("some-id", &study, &reconstruction, &analyse(&study, &reconstruction), &timing());
    let json = serde_json::to_value(&report).unwrap();
    for path in [
        "/schema",
        "/id",
        "/software/name",
        "/software/version",
        "/study/study_instance_uid",
        "/study/series_instance_uid",
        "/study/format",
        "/study/gates",
        "/study/grid/shape",
        "/study/grid/spacing_mm",
        "/function/edv_ml",
        "/function/esv_ml",
        "/function/sv_ml",
        "/function/ef_percent",
        "/function/end_diastolic_gate",
        "/function/end_systolic_gate",
        "/gates/0/gate",
        "/gates/0/endocardial_ml",
        "/gates/0/epicardial_ml",
        "/gates/0/myocardial_ml",
        "/gates/0/fit/endocardial/within_one_voxel_percent",
        "/gates/0/fit/endocardial/mean_distance_mm",
        "/gates/0/fit/epicardial/steps",
        "/gates/0/fit/epicardial/frozen_percent",
        "/gates/0/fit/epicardial/gvf/residual",
        "/myocardium/mass_g",
        "/region/centre_mm",
        "/quality/score",
        "/quality/flags",
        "/parameters/mesh/level",
        "/warnings",
        "/timing_ms/total",
        "/timing_ms/stages/edges",
    ] {
        assert!(json.pointer(path).is_some(), "{path} is missing in {json:#}");
    }
    assert_eq!((&json["schema"], &json["id"]), (&"ventricle.report/1".into(), &"some-id".into()));
    assert_eq!(serde_json::from_value::<Report>(json).unwrap(), report);
}

#[test]
fn what_is_doubtful_is_flagged_and_told_in_a_sentence() {
    let (mut study, mut reconstruction) = beating(8, 2, None);
    study.warnings.push(Warning::new("input_odd", "The input is odd."));
    reconstruction.warnings.push(Warning::at_gate(3, "partial_border", "The border is partial."));
    reconstruction.gates[2].fits.epicardial.evolution.as_mut().unwrap().within_one_voxel = 0.5;
    let swap = &mut reconstruction.gates[4].fits;
    std::mem::swap(&mut swap.endocardial.mesh, &mut swap.epicardial.mesh);
    let report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), &timing());
    // The exchanged surfaces raise more than these, which come first.
    assert_eq!(report.quality.flags[..3], ["not_converged", "surfaces_cross", "myocardial_volume_not_conserved"]);
    let told: Vec<(&str, Option<usize>)> = report.warnings.iter().map(|warning| (warning.code.as_str(), warning.gate)).collect();
    let expected = [
        ("input_odd", None),
        ("partial_border", Some(3)),
        ("rotation_unknown", None),
        ("not_converged", Some(3)),
        ("surfaces_cross", Some(5)),
        ("myocardial_volume_not_conserved", None),
    ];
    assert_eq!(told[..expected.len()], expected);
    assert!(report.quality.score < 0.5);
}

#[test]
fn timing_is_the_only_part_that_may_differ_between_runs() {
    let (study, reconstruction) = beating(8, 2, None);
    let strip = |timing: &Timing| {
        let mut report = report::build("x", &study, &reconstruction, &analyse(&study, &reconstruction), timing);
        report.timing_ms = report::TimingReport::default();
        serde_json::to_string(&report).unwrap()
    };
    assert_eq!(strip(&timing()), strip(&Timing::default()));
}
