//! What may be posted, in which wrappings, and what comes of posting it twice.

use super::harness::{Service, idle, study};
use axum::body::Body;
use futures_util::stream;
use serde_json::{Value, json};
use std::convert::Infallible;

const JSON: &[(&str, &str)] = &[("content-type", "application/json")];

#[tokio::test]
async fn an_accepted_study_is_a_job_with_its_address() {
    let service = idle().await;
    let answer = service.post("?preset=paper", JSON, study(0).to_string()).await;
    assert_eq!(answer.status, 202);
    let job = answer.json();
    assert_eq!(answer.header("location"), format!("/v1/reconstructions/{}", job["id"].as_str().unwrap()));
    assert!(answer.header("retry-after").parse::<u64>().unwrap() >= 1);
    assert_eq!(job["state"], "queued");
    assert_eq!(job["progress"], json!({"fraction": 0.0, "stage": null, "gates_done": 0, "gates_total": 2}));
    assert_eq!(job["queue_position"], 1);
    assert!(job["error"].is_null() && job["created_at"].as_str().unwrap().ends_with('Z'));
    assert_eq!(service.get(answer.header("location")).await.json()["id"], job["id"]);
    for link in job["links"].as_object().unwrap().values() {
        assert!(link.as_str().unwrap().starts_with(answer.header("location")));
    }
}

#[tokio::test]
async fn the_content_decides_whatever_it_is_called() {
    let service = idle().await;
    let npy = npy();
    for media_type in ["application/x-npy", "application/octet-stream", "application/x-www-form-urlencoded", ""] {
        let headers = [("content-type", media_type)];
        let headers = if media_type.is_empty() { &headers[..0] } else { &headers[..] };
        let answer = service.post("?spacing_mm=5,4.5,4.5", headers, npy.clone()).await;
        assert_eq!(answer.status, 202, "{media_type}: {}", answer.json());
    }
    service.post("", &[("content-type", "application/x-npy")], npy.clone()).await.problem(422, "missing_spacing");
    service.post("?spacing_mm=5", &[("content-type", "application/x-npy")], npy).await.problem(400, "invalid_query");
}

/// Six slices of 16 × 16 bytes as NPY.
fn npy() -> Vec<u8> {
    let header = format!("{:<117}\n", "{'descr': '|u1', 'fortran_order': False, 'shape': (6, 16, 16), }");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend((0..6 * 16 * 16).map(|i| (i % 200) as u8));
    bytes
}

#[tokio::test]
async fn a_dicom_file_is_accepted_also_when_mislabelled() {
    let service = idle().await;
    let phantom = ventricle::phantom::Phantom::demo();
    let dicom = ventricle::phantom::dicom::write(&ventricle::phantom::simulate(&phantom).unwrap().study).unwrap();
    for media_type in ["application/dicom", "application/x-www-form-urlencoded"] {
        let answer = service.post("", &[("content-type", media_type)], dicom.clone()).await;
        assert_eq!(answer.status, 202, "{}", answer.json());
        let uid = answer.json()["study_instance_uid"].as_str().unwrap().to_owned();
        let found = service.get(&format!("/v1/reconstructions?study_instance_uid={uid}")).await.json();
        assert!(found["reconstructions"].as_array().unwrap().iter().any(|job| job["id"] == answer.json()["id"]));
    }
}

fn multipart(boundary: &str, parts: &[(&str, &str)], start: &str, end: &str) -> String {
    let parts: Vec<String> = parts.iter().map(|(head, body)| format!("--{boundary}\r\n{head}\r\n\r\n{body}\r\n")).collect();
    format!("{start}{}--{boundary}--{end}", parts.concat())
}

#[tokio::test]
async fn multipart_comes_as_real_clients_send_it() {
    let service = idle().await;
    let study = study(0).to_string();
    // Orthanc: 73 characters, unquoted; python dicomweb-client: leading CRLF, quoted; neither ends its body with CRLF.
    let long = "4d36e8bc-2f0e-4a0c-9f0b-33a3a5c7d5f1-7f3d1a52-8f77-4b7e-9a62-0c5e3d5b6d1a";
    assert_eq!(long.len(), 73);
    let length = format!("Content-Type: application/json\r\nContent-Length: {}", study.len());
    for (content_type, boundary, head, start, end) in [
        (format!("multipart/related; type=\"application/dicom\"; boundary={long}"), long, length.as_str(), "", ""),
        ("multipart/related; boundary=\"a b\"; type=x/y".into(), "a b", "Content-Type: application/json", "\r\n", ""),
        ("multipart/form-data; boundary=x".into(), "x", "Content-Disposition: form-data; name=\"file\"; filename=\"a.json\"", "", "\r\n"),
    ] {
        let body = multipart(boundary, &[(head, &study)], start, end);
        let answer = service.post("", &[("content-type", &content_type)], body).await;
        assert_eq!(answer.status, 202, "{content_type}: {}", answer.json());
    }
}

#[tokio::test]
async fn parameters_come_by_part_and_query_and_are_named_when_wrong() {
    let service = idle().await;
    let study = study(0).to_string();
    let send = async |query: &str, parameters: &str| {
        let parts =
            [("Content-Disposition: form-data; name=\"parameters\"", parameters), ("Content-Disposition: form-data; name=\"f\"", &study)];
        service.post(query, &[("content-type", "multipart/form-data; boundary=x")], multipart("x", &parts, "", "")).await
    };
    assert_eq!(send("?mesh.level=2&preset=paper", "{\"edges\":{\"sigma\":1.5}}").await.status, 202);
    let problem = send("", "{\"edges\":{\"sigma\":99},\"colour\":1}").await;
    let problem = problem.json();
    assert_eq!(problem["status"], 422);
    let errors: Vec<_> = problem["errors"].as_array().unwrap().iter().map(|error| (&error["code"], &error["pointer"])).collect();
    assert!(errors.contains(&(&json!("invalid_parameter"), &json!("/edges/sigma"))), "{problem}");
    assert!(errors.contains(&(&json!("unknown_parameter"), &json!("/colour"))), "{problem}");
    send("?callback_url=https://a.example", "{}").await.problem(422, "unavailable_parameter");
    send("?nothing=1", "{}").await.problem(422, "unknown_parameter");
    send("", "{").await.problem(400, "malformed_parameters");
    let body = json!({"grid": self::study_grid(), "dtype": "uint16", "counts": "", "parameters": {"mesh": {"level": 9}}});
    assert_eq!(service.post("", JSON, body.to_string()).await.status, 400, "the counts are missing");
    let mut body: Value = serde_json::from_str(&study).unwrap();
    body["parameters"] = json!({"mesh": {"level": 9}});
    service.post("", JSON, body.to_string()).await.problem(422, "invalid_parameter");
    assert_eq!(service.post("?mesh.level=4", JSON, body.to_string()).await.status, 202, "the query wins over the body");
}

fn study_grid() -> Value {
    study(0)["grid"].clone()
}

fn chunked(service_body: &str) -> Body {
    let chunks: Vec<_> = service_body.as_bytes().chunks(100).map(|chunk| Ok::<_, Infallible>(chunk.to_vec())).collect();
    Body::from_stream(stream::iter(chunks))
}

#[tokio::test]
async fn a_body_may_come_in_chunks() {
    let service = idle().await;
    let answer = service.post("", JSON, chunked(&study(0).to_string())).await;
    assert_eq!(answer.status, 202, "{}", answer.json());
}

async fn keyed(service: &Service, key: &str, query: &str, seed: u16) -> super::harness::Answer {
    service.post(query, &[("content-type", "application/json"), ("idempotency-key", key)], study(seed).to_string()).await
}

#[tokio::test]
async fn the_same_key_and_request_is_the_same_job() {
    let service = idle().await;
    let first = keyed(&service, "k-1", "", 0).await;
    let again = keyed(&service, "k-1", "", 0).await;
    assert_eq!((first.status.as_u16(), again.status.as_u16()), (202, 200));
    assert_eq!(first.json()["id"], again.json()["id"]);
    assert_eq!(first.header("location"), again.header("location"));
    keyed(&service, "k-1", "", 1).await.problem(422, "idempotency_key_reused");
    keyed(&service, "k-1", "?mesh.level=2", 0).await.problem(422, "idempotency_key_reused");
    assert_ne!(keyed(&service, "k-2", "", 0).await.json()["id"], first.json()["id"]);
    keyed(&service, "", "", 0).await.problem(400, "invalid_idempotency_key");
    keyed(&service, &"x".repeat(256), "", 0).await.problem(400, "invalid_idempotency_key");
    assert_eq!(service.get("/v1/reconstructions").await.json()["reconstructions"].as_array().unwrap().len(), 2);
}
