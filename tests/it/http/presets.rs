//! The presets through the interface: what comes back by default, that it can be asked for again, and how it fails.

use super::harness::{Answer, Service, idle, study, with};
use crate::shared;
use serde_json::{Value, json};
use ventricle::{
    jobs::{StoreSettings, WorkerSettings},
    phantom::{self, Phantom},
};

/// A service that reconstructs.
async fn reconstructing() -> Service {
    with(StoreSettings::default(), Some(WorkerSettings::default().work), |state| state).await
}

/// The demo's ventricle at four gates, as DICOM.
fn dicom(phantom: &Phantom) -> Vec<u8> {
    let mut phantom = phantom.clone();
    phantom.imaging.gates = 4;
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

async fn send(service: &Service, file: &[u8], parameters: &Value) -> Answer {
    let part = |head: &str| format!("--x\r\nContent-Disposition: form-data; {head}\r\n\r\n").into_bytes();
    let mut body = part("name=\"parameters\"");
    body.extend(format!("{parameters}\r\n").into_bytes());
    body.extend(part("name=\"file\"; filename=\"study.dcm\""));
    body.extend(file);
    body.extend(b"\r\n--x--\r\n");
    service.post("", &[("content-type", "multipart/form-data; boundary=x")], body).await
}

/// The job at its end.
async fn finished(service: &Service, accepted: &Answer) -> Value {
    assert_eq!(accepted.status, 202, "{}", accepted.json());
    let path = accepted.header("location");
    for _ in 0..20 {
        let job = service.call("GET", path, &[("prefer", "wait=30")]).await.json();
        if ["succeeded", "failed"].contains(&job["state"].as_str().unwrap()) {
            return job;
        }
    }
    panic!("{path} did not end");
}

async fn report(service: &Service, job: &Value) -> Value {
    assert_eq!(job["state"], "succeeded", "{job}");
    assert_eq!(job["progress"]["gates_done"], job["progress"]["gates_total"], "{job}");
    service.get(job["links"]["report"].as_str().unwrap()).await.json()
}

/// Without what may differ between two runs.
fn comparable(mut report: Value) -> Value {
    report["id"].take();
    report["timing_ms"].take();
    report
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_default_is_clinical_and_its_report_can_be_asked_for_again() {
    let service = reconstructing().await;
    let file = dicom(&Phantom::demo());
    let first = service.post("", &[("content-type", "application/dicom")], file.clone()).await;
    let first = report(&service, &finished(&service, &first).await).await;
    assert_eq!(first["parameters"]["preset"], "clinical");
    for path in ["/pose/patient/apex_mm", "/pose/confidence/score", "/model/psf/fwhm_mm", "/gates/3/model", "/uncertainty/ef_percent"] {
        assert!(first.pointer(path).is_some_and(|value| !value.is_null()), "{path} is missing in {first:#}");
    }
    assert!(first["quality"]["score"].as_f64().is_some_and(|score| (0.0..=1.0).contains(&score)));
    for stage in ["localisation", "rays", "model_fit", "wall"] {
        assert!(first["timing_ms"]["stages"][stage].is_number(), "{stage} is missing in {}", first["timing_ms"]);
    }
    let again = send(&service, &file, &first["parameters"]).await;
    let again = report(&service, &finished(&service, &again).await).await;
    assert_eq!(comparable(again), comparable(first));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_papers_report_has_none_of_it_and_can_be_asked_for_again() {
    let service = reconstructing().await;
    let file = dicom(&Phantom::demo());
    let first = service.post("?preset=paper", &[("content-type", "application/dicom")], file.clone()).await;
    let first = report(&service, &finished(&service, &first).await).await;
    assert_eq!(first["parameters"]["preset"], "paper");
    for absent in ["pose", "model", "uncertainty"] {
        assert_eq!(first[absent], Value::Null, "{absent}");
        assert!(first.as_object().unwrap().contains_key(absent));
    }
    assert!(first["region"].is_object());
    let mut before = first["parameters"].clone();
    for later in ["pose", "refine"] {
        before.as_object_mut().unwrap().remove(later);
    }
    for parameters in [&first["parameters"], &before] {
        let again = send(&service, &file, parameters).await;
        let again = report(&service, &finished(&service, &again).await).await;
        assert_eq!(comparable(again), comparable(first.clone()));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_study_without_a_ventricle_is_accepted_and_fails_by_name() {
    let service = reconstructing().await;
    let accepted = service.post("", &[("content-type", "application/dicom")], dicom(&Phantom::empty())).await;
    let job = finished(&service, &accepted).await;
    assert_eq!(
        (&job["state"], &job["error"]["code"], &job["error"]["status"]),
        (&json!("failed"), &json!("no_left_ventricle"), &json!(422))
    );
    let looked = service.get(accepted.header("location")).await;
    assert_eq!(looked.status, 200);
    let problem = service.get(job["links"]["report"].as_str().unwrap()).await.problem(409, "reconstruction_failed");
    assert_eq!(problem["cause"]["code"], "no_left_ventricle");
    let why = problem["cause"]["detail"].as_str().unwrap();
    assert!(why.starts_with("No left ventricle was found: ") && why.contains("`pose`"), "{why}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn long_axis_slices_are_no_obstacle() {
    let Some(folder) = shared::folder("long-axis") else { return };
    let file = std::fs::read(folder.join("NM-MONO2-16-13x-heart.dcm")).unwrap();
    let service = reconstructing().await;
    let accepted = service.post("", &[("content-type", "application/dicom")], file).await;
    let job = finished(&service, &accepted).await;
    let report = report(&service, &job).await;
    assert_eq!((&report["function"], &report["pose"]["patient"]), (&Value::Null, &Value::Null), "one gate, no orientation");
    let told: Vec<&str> = report["warnings"].as_array().unwrap().iter().map(|warning| warning["code"].as_str().unwrap()).collect();
    assert!(told.contains(&"long_axis_slices"), "{told:?}");
    assert!(!report["quality"]["flags"].as_array().unwrap().contains(&json!("long_axis_slices")));
    for name in ["surfaces.glb", "gates/1/endocardial.glb", "gates/1/wall.vtu"] {
        assert_eq!(service.get(&format!("{}/{name}", accepted.header("location"))).await.status, 200, "{name}");
    }
}

#[tokio::test]
async fn what_changes_nothing_is_refused_by_name_while_the_client_waits() {
    let service = idle().await;
    for (query, pointer) in [
        ("?edges.sigma=1.5", "/edges/sigma"),
        ("?gvf.mu=25", "/gvf/mu"),
        ("?deform.model=plane", "/deform/model"),
        ("?mesh.seed=previous_gate", "/mesh/seed"),
        ("?mesh.seed_scale=1.5", "/mesh/seed_scale"),
        ("?preset=paper&pose.apex_mm=10,40,5", "/pose/apex_mm"),
        ("?preset=paper&refine.psf_fwhm_mm=12", "/refine/psf_fwhm_mm"),
        ("?preset=paper&refine.enabled=false", "/refine/enabled"),
        ("?refine.enabled=false&refine.psf_fwhm_mm=12", "/refine/psf_fwhm_mm"),
        ("?refine.enabled=false&refine.uptake_map=false", "/refine/uptake_map"),
        ("?refine.psf_fwhm_mm=3.9", "/refine/psf_fwhm_mm"),
        ("?refine.psf_fwhm_mm=31", "/refine/psf_fwhm_mm"),
    ] {
        let answer = service.post(query, &[("content-type", "application/json")], study(0).to_string()).await;
        let problem = answer.problem(422, "invalid_parameter");
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{query}: {problem}");
    }
}

#[tokio::test]
async fn the_list_of_parameters_tells_both_presets() {
    let service = idle().await;
    let list = service.get("/v1/parameters").await.json();
    assert_eq!(list["defaults"], list["presets"]["clinical"]);
    assert_eq!((&list["defaults"]["preset"], &list["presets"]["paper"]["preset"]), (&json!("clinical"), &json!("paper")));
    let of = |pointer: &str| list["parameters"].as_array().unwrap().iter().find(|one| one["pointer"] == pointer).cloned().unwrap();
    assert_eq!(of("/refine/psf_fwhm_mm")["presets"], json!(["clinical"]));
    assert_eq!((&of("/edges/sigma")["presets"], &of("/edges/sigma")["default"]), (&json!(["paper"]), &json!(1.8)));
    assert_eq!(of("/mesh/level")["presets"], json!(["clinical", "paper"]));
    let accepted = service.post("?refine.psf_fwhm_mm=12.5", &[("content-type", "application/json")], study(0).to_string()).await;
    assert_eq!(accepted.status, 202);
}
