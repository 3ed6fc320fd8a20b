//! The published JSON Schemas: that they are the committed ones, that reports of every kind hold to them by a validator of others, that a broken
//! one does not, and that nothing is sent that they do not name. Besides, the comparison of two of those reports with the truth.

use crate::shared::absent;
use serde_json::{Value, json};
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    process::Command,
    sync::LazyLock,
};
use ventricle::{
    analysis::analyse,
    phantom::{self, Defect, Phantom, Shape, Site, Truth, Ventricle},
    pipeline::{
        self,
        monitor::Silent,
        parameters::{Metadata, Parameters},
    },
    report::{self, PublishedSchema, Report, Timing},
    volume::Grid,
};

/// A report and what is true of what it is of.
struct Measured {
    name: &'static str,
    report: Report,
    truth: Truth,
}

/// Two normal hearts of one patient: at rest, and dilated after stress with a defect.
const REST: Ventricle = Ventricle::NORMAL;
const STRESS: Ventricle = Ventricle { edv_ml: 144.0, esv_ml: 66.0, ..REST };

fn phantom(shape: Ventricle, gates: usize) -> Phantom {
    let mut phantom = Phantom::of(Shape::Ventricle(shape));
    phantom.imaging.grid = Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] };
    phantom.imaging.gates = gates;
    phantom.imaging.noise_seed = None;
    phantom
}

fn measured(name: &'static str, phantom: &Phantom, parameters: &Parameters) -> Measured {
    let simulated = phantom::simulate(phantom).unwrap();
    let mut study = simulated.study;
    study.acquisition.height_m = Some(1.7);
    let reconstruction = pipeline::reconstruct(&study, parameters, &Silent).unwrap();
    let analysis = analyse(&study, &reconstruction);
    let report = report::build(name, &study, &reconstruction, &analysis, &Timing::default());
    Measured { name, report, truth: simulated.truth }
}

/// Reports of every kind, reconstructed once.
static REPORTS: LazyLock<Vec<Measured>> = LazyLock::new(|| {
    let mut level_2 = Parameters::clinical();
    level_2.mesh.level = 2;
    let mut sized = Parameters::clinical();
    sized.metadata = Metadata { height_m: None, weight_kg: Some(70.0) };
    let mut unrefined = level_2.clone();
    unrefined.refine.enabled = false;
    let mut paper = Parameters::paper();
    paper.deform.record_distances = true;
    let mut nowhere = phantom(REST, 2);
    nowhere.imaging.oriented = false;
    let mut dark = phantom(STRESS, 4);
    dark.uptake.defects = vec![Defect { site: Site::Inferior, extent: 0.2, severity: 0.7 }];
    vec![
        measured("rest", &phantom(REST, 8), &sized),
        measured("stress", &phantom(STRESS, 8), &sized),
        measured("defect", &dark, &level_2),
        measured("paper", &phantom(REST, 4), &paper),
        measured("ungated", &phantom(REST, 1), &level_2),
        measured("unoriented", &nowhere, &level_2),
        measured("unrefined", &nowhere, &unrefined),
    ]
});

fn named(name: &str) -> &'static Measured {
    REPORTS.iter().find(|measured| measured.name == name).unwrap()
}

fn document(schema: PublishedSchema) -> Value {
    serde_json::from_str(&schema.document()).unwrap()
}

fn committed(schema: PublishedSchema) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("openapi/{}.json", schema.name()))
}

#[test]
fn the_committed_schemas_are_those_of_the_types() {
    for schema in PublishedSchema::ALL {
        let committed = std::fs::read_to_string(committed(schema)).unwrap_or_default();
        assert!(committed == schema.document(), "openapi/{}.json differs from the types. Run `make openapi` and commit it.", schema.name());
        let document = document(schema);
        assert_eq!(document["$schema"], "https://json-schema.org/draft/2020-12/schema");
        assert_eq!(document["$id"], format!("urn:ventricle:schema:{}", schema.name()));
        let output = Command::new(env!("CARGO_BIN_EXE_ventricle")).args(["openapi", "--schema", schema.name()]).output().unwrap();
        assert_eq!(String::from_utf8(output.stdout).unwrap(), schema.document());
    }
}

/// What the validator finds in each document, in order; `None` where it is not installed.
fn findings(schema: PublishedSchema, documents: &[(&str, &Value)]) -> Option<Vec<(bool, Value)>> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("schema");
    std::fs::create_dir_all(&folder).unwrap();
    let files = documents.iter().map(|(name, document)| {
        let path = folder.join(format!("{}-{name}.json", schema.name()));
        std::fs::write(&path, document.to_string()).unwrap();
        path
    });
    let files: Vec<PathBuf> = files.collect();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/tools/validate-json.mjs");
    let output = match Command::new("node").arg(script).arg(committed(schema)).args(&files).output() {
        Ok(output) if output.status.code() != Some(2) => output,
        _ => {
            absent("nodejs");
            return None;
        }
    };
    let lines = String::from_utf8(output.stdout).unwrap();
    let found: Vec<(bool, Value)> = lines
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap())
        .map(|line| (line["valid"] == true, line["messages"].clone()))
        .collect();
    assert_eq!(found.len(), documents.len(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.success(), found.iter().all(|(valid, _)| *valid));
    Some(found)
}

#[test]
fn reports_of_every_kind_hold_to_the_schema() {
    let documents: Vec<(&str, Value)> = REPORTS.iter().map(|measured| (measured.name, json!(measured.report))).collect();
    let documents: Vec<(&str, &Value)> = documents.iter().map(|(name, document)| (*name, document)).collect();
    for (name, document) in &documents {
        assert_named(document, &self::document(PublishedSchema::Report), name);
    }
    let Some(found) = findings(PublishedSchema::Report, &documents) else { return };
    for ((name, _), (valid, messages)) in documents.iter().zip(found) {
        assert!(valid, "{name}: {messages:#}");
    }
}

#[test]
fn comparisons_hold_to_the_schema() {
    let pairs = [("stress", "rest"), ("paper", "ungated"), ("ungated", "unoriented"), ("unrefined", "defect")];
    let made = |(first, second): (&str, &str)| json!(report::compare(&named(first).report, &named(second).report).unwrap());
    let documents: Vec<(&str, Value)> = pairs.map(|pair| (pair.0, made(pair))).into();
    for (name, document) in &documents {
        assert_named(document, &self::document(PublishedSchema::Comparison), name);
    }
    let documents: Vec<(&str, &Value)> = documents.iter().map(|(name, document)| (*name, document)).collect();
    let Some(found) = findings(PublishedSchema::Comparison, &documents) else { return };
    for ((name, _), (valid, messages)) in documents.iter().zip(found) {
        assert!(valid, "{name}: {messages:#}");
    }
}

/// The check can fail: each of these is a report but for one thing.
#[test]
fn a_broken_report_does_not_hold() {
    let whole = json!(named("rest").report);
    let broken = |change: &dyn Fn(&mut Value)| {
        let mut report = whole.clone();
        change(&mut report);
        report
    };
    let cases = [
        ("version", broken(&|report| report["schema"] = json!("ventricle.report/2")), "/schema"),
        ("missing", broken(&|report| drop(report.as_object_mut().unwrap().remove("quality"))), ""),
        ("nullless", broken(&|report| drop(report.as_object_mut().unwrap().remove("region"))), ""),
        ("type", broken(&|report| report["gates"][0]["gate"] = json!("1")), "/gates/0/gate"),
        // A number that was not finite is written as null.
        ("infinite", broken(&|report| report["function"]["edv_ml"] = json!(f64::NAN)), "/function"),
        ("within", broken(&|report| drop(report["regional"]["segments"][3].as_object_mut().unwrap().remove("motion_mm"))), "/regional"),
        ("source", broken(&|report| report["body"]["height_source"] = json!(1)), "/body"),
        ("vector", broken(&|report| report["study"]["rr_window_ms"] = json!([700])), "/study/rr_window_ms"),
    ];
    let documents: Vec<(&str, &Value)> = cases.iter().map(|(name, document, _)| (*name, document)).collect();
    let Some(found) = findings(PublishedSchema::Report, &documents) else { return };
    for ((name, _, pointer), (valid, messages)) in cases.iter().zip(found) {
        let told = messages.as_array().unwrap().iter().any(|message| message["instancePath"].as_str().unwrap().starts_with(pointer));
        assert!(!valid && told, "{name}: {messages:#}");
    }
    // Fields are added under the same version.
    let mut later = whole.clone();
    later["study"]["added_later"] = json!({"by": "another version"});
    later["added_later"] = json!(1);
    assert!(findings(PublishedSchema::Report, &[("later", &later)]).is_none_or(|found| found[0].0), "a later field is refused");
}

/// Members that may be left out: those of warnings, and what was asked for.
const OPTIONAL: [&str; 5] = ["gate", "affected", "arc", "distances", "examples"];

/// That a document has no member that its schema does not name, and that what may be absent is known.
fn assert_named(document: &Value, schema: &Value, name: &str) {
    fn resolve<'a>(schema: &'a Value, root: &'a Value) -> Vec<&'a Value> {
        let mut found = vec![schema];
        if let Some(target) = schema["$ref"].as_str() {
            found.extend(resolve(root.pointer(&target[1..]).unwrap_or_else(|| panic!("{target} is not there")), root));
        }
        for part in ["oneOf", "anyOf", "allOf"].into_iter().filter_map(|keyword| schema[keyword].as_array()).flatten() {
            found.extend(resolve(part, root));
        }
        found
    }
    fn check(value: &Value, schemas: &[&Value], root: &Value, pointer: &str) {
        match value {
            Value::Array(items) => {
                let of_items: Vec<&Value> = schemas.iter().flat_map(|schema| resolve(&schema["items"], root)).collect();
                items.iter().enumerate().for_each(|(index, item)| check(item, &of_items, root, &format!("{pointer}/{index}")));
            }
            Value::Object(members) => {
                let open = schemas.iter().all(|schema| schema["properties"].is_null());
                for (member, value) in members {
                    let told = schemas.iter().filter_map(|schema| schema["properties"].get(member));
                    let of_member: Vec<&Value> = told.flat_map(|schema| resolve(schema, root)).collect();
                    assert!(open || !of_member.is_empty(), "{pointer}/{member} is not in the schema");
                    check(value, &of_member, root, &format!("{pointer}/{member}"));
                }
                for schema in schemas.iter().filter(|schema| schema["properties"].is_object()) {
                    let required: BTreeSet<&str> = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
                    for property in schema["properties"].as_object().unwrap().keys() {
                        assert!(
                            required.contains(property.as_str()) || OPTIONAL.contains(&property.as_str()),
                            "{pointer}/{property} is always sent, and the schema does not say so"
                        );
                    }
                }
            }
            _ => {}
        }
    }
    check(document, &resolve(schema, schema), schema, name);
}

#[test]
fn the_dilation_of_a_pair_and_its_differences_are_the_phantoms() {
    let (stress, rest) = (named("stress"), named("rest"));
    let comparison = report::compare(&stress.report, &rest.report).unwrap();
    let mean = |truth: &Truth| truth.gates.iter().map(|gate| gate.endocardial_ml).sum::<f64>() / truth.gates.len() as f64;
    let expected = mean(&stress.truth) / mean(&rest.truth);
    let found = comparison.tid_ratio.unwrap();
    println!("TID {found:.4}, exactly {expected:.4}");
    assert!(expected > 1.2 && (found / expected - 1.0).abs() < 0.03, "{found} is not {expected}");
    let exact = stress.truth.edv_ml - rest.truth.edv_ml;
    let edv = comparison.edv_ml;
    assert!((edv.values.difference.unwrap() - exact).abs() < 0.1 * exact, "{edv:?} is not {exact}");
    assert!(edv.standard_error.unwrap() > 0.0);
    // The same heart is no other: the ratio is 1, and every difference 0.
    let same = report::compare(&rest.report, &rest.report).unwrap();
    assert_eq!(same.tid_ratio, Some(1.0));
    assert!(same.segments.iter().all(|segment| segment.values.motion_mm.difference == Some(0.0)));
    assert_eq!((same.segments.len(), same.territories.len()), (17, 3));
    // Swapped, it is the inverse.
    let swapped = report::compare(&rest.report, &stress.report).unwrap();
    assert!((swapped.tid_ratio.unwrap() * found - 1.0).abs() < 1e-12);
    assert_eq!(swapped.ef_percent.values.difference, comparison.ef_percent.values.difference.map(|difference| -difference));
}

#[test]
fn a_defect_shows_in_its_segments_and_territory() {
    let comparison = report::compare(&named("defect").report, &named("rest").report).unwrap();
    let difference = |segment: usize| comparison.segments[segment - 1].values.perfusion_percent.difference.unwrap();
    // 4 and 10 are inferior, 1 and 7 anterior.
    assert!(difference(4) < -20.0 && difference(10) < -20.0, "{} {}", difference(4), difference(10));
    assert!(difference(1).abs() < 10.0 && difference(7).abs() < 10.0, "{} {}", difference(1), difference(7));
    let territory = |name: &str| {
        let found = comparison.territories.iter().find(|territory| territory.territory == name).unwrap();
        found.values.perfusion_percent.difference.unwrap()
    };
    assert!(territory("RCA") < territory("LAD") - 10.0, "{} {}", territory("RCA"), territory("LAD"));
    assert!(comparison.perfusion_extent_percent.difference.unwrap() > 5.0, "{:?}", comparison.perfusion_extent_percent);
}

#[test]
fn volumes_are_indexed_by_the_surface_of_the_body() {
    let body = named("rest").report.body.unwrap();
    // 1.7 m by the header, 70 kg by the request: 1.8097 m² by Du Bois and Du Bois.
    let told = json!(body);
    assert_eq!((&told["height_source"], &told["weight_source"]), (&json!("header"), &json!("request")));
    assert!((body.surface_area_m2.unwrap() - 1.8097).abs() < 1e-4);
    let function = named("rest").report.function.unwrap();
    for (indexed, value) in [
        (body.edv_ml_per_m2, function.edv_ml),
        (body.esv_ml_per_m2, function.esv_ml),
        (body.sv_ml_per_m2, function.sv_ml),
        (body.mass_g_per_m2, named("rest").report.myocardium.mass_g),
    ] {
        assert!((indexed.unwrap() * body.surface_area_m2.unwrap() - value).abs() < 1e-9);
    }
    let half = named("defect").report.body.unwrap();
    assert_eq!((half.height_m, half.weight_kg, half.surface_area_m2, half.edv_ml_per_m2), (Some(1.7), None, None, None));
    assert!(json!(half)["weight_source"].is_null());
}

#[test]
fn what_is_known_of_beats_and_gates_is_told() {
    let told = json!(named("rest").report);
    assert_eq!(told["study"]["beats_accepted"], 1000);
    assert_eq!((&told["study"]["beats_rejected"], &told["study"]["beat_rejection"]), (&json!(0), &json!(true)));
    assert_eq!(told["study"]["rr_window_ms"], json!([666.0, 1000.0]));
    let caution = told["cycle"]["caution"].as_str().unwrap();
    assert!(caution.starts_with("8 gates") && told["cycle"]["coarse"] == true, "{caution}");
    // The usual eight gates are no warning, nor a flag.
    assert_eq!((&told["warnings"], &told["quality"]["flags"]), (&json!([]), &json!([])));
    let still = json!(named("ungated").report);
    assert!(still["study"]["beats_accepted"].is_null() && still["cycle"].is_null());
    let codes = |name: &str| named(name).report.warnings.iter().map(|warning| warning.code.clone()).collect::<Vec<_>>();
    assert!(codes("unoriented").contains(&"rotation_unknown".to_owned()), "{:?}", codes("unoriented"));
    assert!(!codes("paper").contains(&"rotation_unknown".to_owned()));
}

/// What stands against comparing two studies is said.
#[test]
fn notes_say_what_stands_against_a_comparison() {
    let codes = |first: &Report, second: &Report| {
        let comparison = report::compare(first, second).unwrap();
        assert!(comparison.notes.iter().all(|note| note.message.len() > 30));
        comparison.notes.into_iter().map(|note| note.code).collect::<Vec<_>>()
    };
    let rest = &named("rest").report;
    assert_eq!(codes(rest, rest), [""; 0]);
    let mut other = rest.clone();
    other.study.study_instance_uid = Some("1.2.3".to_owned());
    assert_eq!(codes(rest, &other), ["study_differs"]);
    other.study.study_instance_uid = None;
    other.software.version = "0.0.1".to_owned();
    other.parameters.analysis.perfusion_threshold_percent = 50.0;
    other.quality.flags = vec!["partial_border".to_owned()];
    assert_eq!(codes(rest, &other), ["study_unknown", "versions_differ", "thresholds_differ", "quality_flagged"]);
    let found = codes(&named("ungated").report, &named("paper").report);
    assert!(found.contains(&"presets_differ".to_owned()) && found.contains(&"gating_differs".to_owned()), "{found:?}");
    assert!(codes(rest, &named("unoriented").report).contains(&"rotation_unknown".to_owned()));
    let ungated = report::compare(&named("ungated").report, rest).unwrap();
    assert!(ungated.edv_ml.values.first.is_none() && ungated.edv_ml.values.second.is_some() && ungated.edv_ml.values.difference.is_none());
}
