//! The report: what follows from known meshes, and that its JSON is the contract's.

use crate::surfaces::beating;
use serde_json::Value;
use std::collections::BTreeMap;
use ventricle::{
    pipeline::Surface,
    report::{self, Report, Timing},
    study::Warning,
};

fn timing() -> Timing {
    Timing { total_ms: 12.5, stages_ms: BTreeMap::from([("edges".to_owned(), 3.5)]) }
}

#[test]
fn function_follows_from_the_largest_and_smallest_cavity() {
    let (study, reconstruction) = beating(8, 3, None);
    let report = report::build("some-id", &study, &reconstruction, &timing());
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
    assert!((report.quality.score - 0.97).abs() < 1e-12);
}

#[test]
fn one_gate_has_no_function_and_says_null() {
    let (study, reconstruction) = beating(1, 2, None);
    let json = serde_json::to_value(report::build("x", &study, &reconstruction, &timing())).unwrap();
    assert_eq!(json["function"], Value::Null);
    assert!(json.as_object().unwrap().contains_key("function"));
    assert_eq!(json["myocardium"]["variation_percent"], Value::Null);
    assert!(json["myocardium"]["mass_g"].as_f64().unwrap() > 0.0);
}

#[test]
fn the_json_has_the_names_of_the_contract_and_reads_back() {
    let (study, reconstruction) = beating(8, 2, None);
    let report = report::build("some-id", &study, &reconstruction, &timing());
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
    let report = report::build("x", &study, &reconstruction, &timing());
    assert_eq!(report.quality.flags, ["not_converged", "surfaces_cross", "myocardial_volume_not_conserved"]);
    let told: Vec<(&str, Option<usize>)> = report.warnings.iter().map(|warning| (warning.code.as_str(), warning.gate)).collect();
    let expected = [
        ("input_odd", None),
        ("partial_border", Some(3)),
        ("not_converged", Some(3)),
        ("surfaces_cross", Some(5)),
        ("myocardial_volume_not_conserved", None),
    ];
    assert_eq!(told, expected);
    assert!(report.quality.score < 0.97);
}

#[test]
fn timing_is_the_only_part_that_may_differ_between_runs() {
    let (study, reconstruction) = beating(8, 2, None);
    let strip = |timing: &Timing| {
        let mut report = report::build("x", &study, &reconstruction, timing);
        report.timing_ms = report::TimingReport::default();
        serde_json::to_string(&report).unwrap()
    };
    assert_eq!(strip(&timing()), strip(&Timing::default()));
}
