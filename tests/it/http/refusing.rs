//! What is refused, with which status, and that every refusal is a problem document.

use super::harness::{idle, instant, request, study, with, working};
use axum::body::{Body, Bytes};
use futures_util::{StreamExt, stream};
use std::{
    convert::Infallible,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};
use ventricle::jobs::StoreSettings;

const NOWHERE: &str = "/v1/reconstructions/01900000-0000-7000-8000-000000000000";

#[tokio::test]
async fn unknown_paths_and_ids_are_problems() {
    let service = idle().await;
    for path in ["/nothing", "/v1/nothing", "/v1/reconstructions/7", "/v1/reconstructions/7/report", "/docs/nothing.js", NOWHERE] {
        let problem = service.get(path).await.problem(404, "not_found");
        assert_eq!(problem["instance"], path);
    }
    let head = service.call("HEAD", NOWHERE, &[]).await;
    assert_eq!((head.status.as_u16(), head.bytes.len()), (404, 0));
    assert_eq!(head.header("content-type"), "application/problem+json");
}

#[tokio::test]
async fn a_wrong_method_is_told_the_right_ones() {
    let service = idle().await;
    for (method, path, allowed) in
        [("PUT", "/v1/reconstructions", ["GET", "POST"]), ("PATCH", NOWHERE, ["GET", "DELETE"]), ("POST", "/healthz", ["GET", "HEAD"])]
    {
        let answer = service.call(method, path, &[]).await;
        answer.problem(405, "method_not_allowed");
        assert!(allowed.iter().all(|method| answer.header("allow").contains(method)), "{}", answer.header("allow"));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_client_does_not_accept_is_not_made() {
    let service = working(instant()).await;
    let path = service.finish(0).await;
    for (suffix, accept) in [
        ("", "text/html"),
        ("/report", "model/gltf-binary"),
        ("/surfaces.glb", "application/json"),
        ("/gates/1/wall.vtu", "model/gltf-binary"),
        ("/events", "text/html"),
    ] {
        service.call("GET", &format!("{path}{suffix}"), &[("accept", accept)]).await.problem(406, "not_acceptable");
    }
    service.call("GET", "/v1/reconstructions", &[("accept", "text/html")]).await.problem(406, "not_acceptable");
    service.post("", &[("accept", "text/html")], study(0).to_string()).await.problem(406, "not_acceptable");
    assert_eq!(service.call("GET", &path, &[("accept", "text/html, */*;q=0.1")]).await.status, 200);
}

#[tokio::test]
async fn a_body_over_the_limit_is_refused_announced_or_not() {
    let limit = 10_000;
    let service = with(StoreSettings::default(), None, |state| state.with_body_limit(limit)).await;
    let announced = service.post("", &[("content-length", "10001")], Body::empty()).await;
    let problem = announced.problem(413, "too_large");
    assert!(problem["detail"].as_str().unwrap().contains("10000"));
    let endless = stream::repeat(Ok::<_, Infallible>(Bytes::from_static(&[0; 1000]))).boxed();
    service.post("", &[], Body::from_stream(endless)).await.problem(413, "too_large");
    assert_eq!(service.store.counts().await.unwrap().reserved, 0, "refused bodies hold no place");
}

#[tokio::test]
async fn a_body_that_does_not_come_is_given_up() {
    let service = with(StoreSettings::default(), None, |state| state.with_upload_time(Duration::from_millis(100))).await;
    let body = Body::from_stream(stream::pending::<Result<Bytes, Infallible>>());
    service.post("", &[], body).await.problem(408, "request_timeout");
    let patient = with(StoreSettings::default(), None, |state| state.with_upload_pause(Duration::from_millis(100))).await;
    let half = || Body::from_stream(stream::iter([Ok::<_, Infallible>(Bytes::from_static(b"--x\r\n"))]).chain(stream::pending()));
    patient.post("", &[], half()).await.problem(408, "request_timeout");
    // As much as is announced makes no difference, nor does what the parts are.
    for (content_type, length) in [("application/dicom", "1000"), ("multipart/related; boundary=x", "900000000")] {
        let headers = [("content-type", content_type), ("content-length", length)];
        let stalled = patient.send(request("POST", "/dicom-web/studies", &headers, half())).await;
        let problem = stalled.problem(408, "request_timeout");
        assert!(problem["detail"].as_str().unwrap().starts_with("No byte of the body came for"), "{problem}");
    }
    let broken = stream::iter([Ok(Bytes::from_static(b"half")), Err(std::io::Error::other("gone"))]);
    service.post("", &[], Body::from_stream(broken)).await.problem(400, "incomplete_body");
    assert_eq!(service.store.counts().await.unwrap().reserved, 0, "lost bodies hold no place");
}

#[tokio::test]
async fn what_is_no_study_is_refused_by_kind() {
    let service = idle().await;
    service.post("", &[], "").await.problem(400, "empty_body");
    service.post("", &[("content-type", "text/plain")], "hello, is this a heart?").await.problem(415, "unknown_format");
    service.post("", &[("content-type", "application/json")], "{\"grid\":").await.problem(400, "malformed_json");
    service.post("", &[("content-length", "many")], "x").await.problem(400, "invalid_content_length");
    for (content_type, body) in [
        ("multipart/form-data", "x"),
        ("multipart/form-data; boundary=x", "no boundary anywhere"),
        ("multipart/related; boundary=x", "--x\r\nContent-Type: application/dicom\r\n\r\ncut off"),
    ] {
        service.post("", &[("content-type", content_type)], body).await.problem(400, "malformed_multipart");
    }
    let mut flat = study(0);
    flat["counts"] = "AAAA".repeat(flat["counts"].as_str().unwrap().len() / 4).into();
    service.post("", &[("content-type", "application/json")], flat.to_string()).await.problem(422, "no_counts");
}

#[tokio::test]
async fn a_body_compressed_on_the_way_is_refused_as_such() {
    let service = idle().await;
    let json = ("content-type", "application/json");
    for encoding in ["gzip", "br", "identity, gzip"] {
        let answer = service.post("", &[json, ("content-encoding", encoding)], study(0).to_string()).await;
        let problem = answer.problem(415, "unsupported_encoding");
        assert!(problem["detail"].as_str().unwrap().contains(encoding), "{problem}");
    }
    assert_eq!(service.post("", &[json, ("content-encoding", "identity")], study(0).to_string()).await.status, 202);
}

#[tokio::test]
async fn marks_outside_of_the_study_are_refused_at_once() {
    let service = idle().await;
    let json = [("content-type", "application/json")];
    for query in
        ["?region.first_slice=100", "?region.last_slice=7", "?region.first_slice=3&region.last_slice=3", "?region.centre_mm=1e300,2"]
    {
        service.post(query, &json, study(0).to_string()).await.problem(422, "region_outside_study");
    }
    for query in
        ["?pose.apex_mm=40,40,-3", "?pose.base_mm=40,77.6,0", "?pose.base_mm=[1e300,1,1]", "?pose.apex_mm=40,40,5&pose.base_mm=40,40,20"]
    {
        let problem = service.post(query, &json, study(0).to_string()).await.problem(422, "region_outside_study");
        assert!(problem["detail"].as_str().unwrap().contains("_mm` "), "{problem}");
    }
    assert_eq!(service.post("?pose.apex_mm=5,40,5&pose.base_mm=70,40,20", &json, study(0).to_string()).await.status, 202);
    assert_eq!(service.post("?region.centre_mm=40,35.5&region.last_slice=6", &json, study(0).to_string()).await.status, 202);
}

#[tokio::test]
async fn a_spacing_that_would_not_be_used_is_refused() {
    let service = idle().await;
    let json = [("content-type", "application/json")];
    service.post("?spacing_mm=1,1,1", &json, study(0).to_string()).await.problem(422, "needless_spacing");
    service.post("?spacing_mm=1,1,1&spacing_mm=2,2,2", &json, study(0).to_string()).await.problem(400, "invalid_query");
}

/// A client that sends all before it listens would find its connection reset and never learn why.
#[tokio::test]
async fn a_refused_body_is_let_in_unless_the_client_waits_to_be_asked() {
    let service = with(StoreSettings { max_queued_jobs: 1, ..StoreSettings::default() }, None, |state| state).await;
    service.submit(0).await;
    for (headers, chunks) in [(&[][..], 5), (&[("expect", "100-continue")][..], 0)] {
        let read = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&read);
        let body = stream::iter((0..5).map(|_| Bytes::from_static(&[0; 1000])))
            .map(move |chunk| Ok::<_, Infallible>((counted.fetch_add(1, Ordering::SeqCst), chunk).1));
        service.post("", headers, Body::from_stream(body)).await.problem(503, "queue_full");
        assert_eq!(read.load(Ordering::SeqCst), chunks, "{headers:?}");
    }
}

#[tokio::test]
async fn a_full_queue_says_when_to_come_back() {
    let service = with(StoreSettings { max_queued_jobs: 1, ..StoreSettings::default() }, None, |state| state).await;
    let path = service.submit(0).await;
    let full = service.post("", &[("content-type", "application/json")], study(1).to_string()).await;
    full.problem(503, "queue_full");
    assert!(full.header("retry-after").parse::<u64>().unwrap() >= 1);
    let checks = service.get("/readyz").await.problem(503, "not_ready")["checks"].clone();
    assert_eq!((&checks["queue"]["ok"], &checks["store"]["ok"]), (&false.into(), &true.into()));
    assert_eq!(service.call("DELETE", &path, &[]).await.status, 200);
    assert_eq!(service.get("/readyz").await.status, 200);
    service.submit(1).await;
}

#[tokio::test]
async fn a_panic_is_a_problem_that_tells_nothing_and_the_service_goes_on() {
    let service = with(StoreSettings::default(), None, |state| state.with_workers(|| panic!("the secret inside"))).await;
    let answer = service.call("GET", "/readyz", &[("x-request-id", "abc-1")]).await;
    let problem = answer.problem(500, "internal_error");
    assert_eq!(problem["request_id"], "abc-1");
    assert!(!String::from_utf8_lossy(&answer.bytes).contains("secret"));
    assert_eq!(service.get("/healthz").await.status, 200);
}
