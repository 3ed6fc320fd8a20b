//! The committed contract is the one the routes make, and says what a front end needs.

use serde_json::Value;
use std::{collections::BTreeSet, path::Path, process::Command};
use ventricle::pipeline::monitor::Stage;

fn document() -> Value {
    serde_json::from_str(&ventricle::http::openapi_json()).unwrap()
}

#[test]
fn the_committed_document_is_the_one_the_routes_make() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == ventricle::http::openapi_json(),
        "openapi/openapi.json differs from the routes. Run `make openapi` and commit it."
    );
}

#[test]
fn the_command_prints_the_same_document() {
    let output = Command::new(env!("CARGO_BIN_EXE_ventricle")).arg("openapi").output().unwrap();
    assert!(output.status.success());
    assert_eq!(String::from_utf8(output.stdout).unwrap(), ventricle::http::openapi_json());
}

#[test]
fn every_route_of_the_contract_is_documented() {
    let document = document();
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"), "{}", document["openapi"]);
    let mut operations = BTreeSet::new();
    let mut ids = BTreeSet::new();
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            operations.insert(format!("{method} {path}"));
            assert!(ids.insert(operation["operationId"].as_str().unwrap().to_owned()), "{operation}");
            assert!(operation["summary"].is_string() && operation["tags"][0].is_string(), "{method} {path} is not described");
            for (status, response) in operation["responses"].as_object().unwrap() {
                let is_problem = status == "default" || status.starts_with(['4', '5']);
                let content =
                    response["content"].as_object().map(|content| content.keys().cloned().collect::<Vec<_>>()).unwrap_or_default();
                // STOW-RS refuses in its own words.
                if path.starts_with("/dicom-web/") && status == "409" {
                    assert_eq!(content, ["application/dicom+json"]);
                    continue;
                }
                assert_eq!(content == ["application/problem+json"], is_problem, "{method} {path} {status}: {content:?}");
            }
        }
    }
    let expected = [
        "delete /v1/reconstructions/{id}",
        "get /healthz",
        "get /metrics",
        "get /openapi.json",
        "get /readyz",
        "get /schemas/comparison-1.json",
        "get /schemas/report-1.json",
        "get /v1/parameters",
        "get /v1/phantom.dcm",
        "get /v1/reconstructions",
        "get /v1/reconstructions/events",
        "get /v1/reconstructions/{id}",
        "get /v1/reconstructions/{id}/comparison",
        "get /v1/reconstructions/{id}/events",
        "get /v1/reconstructions/{id}/fhir",
        "get /v1/reconstructions/{id}/gates/{gate}/endocardial.glb",
        "get /v1/reconstructions/{id}/gates/{gate}/endocardial.stl",
        "get /v1/reconstructions/{id}/gates/{gate}/endocardial.stl.dcm",
        "get /v1/reconstructions/{id}/gates/{gate}/epicardial.glb",
        "get /v1/reconstructions/{id}/gates/{gate}/epicardial.stl",
        "get /v1/reconstructions/{id}/gates/{gate}/epicardial.stl.dcm",
        "get /v1/reconstructions/{id}/gates/{gate}/slices.png",
        "get /v1/reconstructions/{id}/gates/{gate}/wall.vtu",
        "get /v1/reconstructions/{id}/polar-maps",
        "get /v1/reconstructions/{id}/polar-maps/{image}",
        "get /v1/reconstructions/{id}/report",
        "get /v1/reconstructions/{id}/report.html",
        "get /v1/reconstructions/{id}/slices",
        "get /v1/reconstructions/{id}/sr.dcm",
        "get /v1/reconstructions/{id}/surfaces.glb",
        "post /dicom-web/studies",
        "post /dicom-web/studies/{study_instance_uid}",
        "post /v1/reconstructions",
        "post /v1/reconstructions/{id}/again",
    ];
    assert_eq!(operations, expected.map(str::to_owned).into());
}

#[test]
fn every_reference_leads_somewhere() {
    fn references(value: &Value, found: &mut Vec<String>) {
        match value {
            Value::Object(fields) => {
                for (name, value) in fields {
                    match value {
                        Value::String(target) if name == "$ref" => found.push(target.clone()),
                        value => references(value, found),
                    }
                }
            }
            Value::Array(items) => items.iter().for_each(|item| references(item, found)),
            _ => {}
        }
    }
    let document = document();
    let mut found = Vec::new();
    references(&document, &mut found);
    assert!(found.len() > 20, "{found:?}");
    for target in found {
        let pointer = target.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some(), "{target} is not there");
    }
}

#[test]
fn every_stage_and_every_flag_is_told_in_the_contract() {
    let document = document();
    let told = |pointer: &str| document.pointer(pointer).unwrap()["description"].as_str().unwrap().to_owned();
    let stages = told("/components/schemas/Progress/properties/stage");
    for stage in Stage::ALL {
        assert!(stages.contains(&format!("`{}`", stage.name())), "{} is not told: {stages}", stage.name());
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/report/quality");
    let code: String = ["fit.rs", "heart.rs"].map(|file| std::fs::read_to_string(folder.join(file)).unwrap()).concat();
    let flags: BTreeSet<&str> = ["measured(\"", "told(\"", "fact(\"", "Warning::at_gate(gate.gate, \""]
        .into_iter()
        .flat_map(|raised| code.split(raised).skip(1).map(|after| after.split('"').next().unwrap()))
        .collect();
    assert!(flags.len() >= 16 && flags.contains("gating"), "{flags:?}");
    let quality = told("/components/schemas/Quality/properties/flags");
    // The tables of all languages have the same keys, or the pages do not build.
    let words = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("web/src/languages/en.ts")).unwrap();
    for flag in flags {
        assert!(quality.contains(&format!("`{flag}`")), "{flag} is not told: {quality}");
        assert!(words.contains(&format!("\"flag.{flag}\":")), "the pages have no words for {flag}");
    }
}
