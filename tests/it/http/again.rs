//! Another job on the input of an earlier one: while that is kept, as a submission would be, and not when it is gone.

use super::harness::{held, idle, instant, request, with, working};
use axum::body::Body;
use serde_json::{Value, json};
use std::sync::{Arc, Mutex};
use ventricle::{jobs::StoreSettings, pipeline::parameters::Parameters, study::Study};

const JSON: &[(&str, &str)] = &[("content-type", "application/json")];

fn keeping() -> StoreSettings {
    StoreSettings { keep_input: true, ..StoreSettings::default() }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_same_study_is_reconstructed_with_other_parameters() {
    let seen: Arc<Mutex<Vec<(Study, Parameters)>>> = Arc::default();
    let work = {
        let seen = Arc::clone(&seen);
        Arc::new(move |study: &Study, parameters: &Parameters, _, _: &_| {
            seen.lock().unwrap().push((study.clone(), parameters.clone()));
            Ok(vec![])
        })
    };
    let service = with(keeping(), Some(work), |state| state).await;
    let first = service.finish(0).await;
    let again = format!("{first}/again");
    for (body, preset) in [(Body::empty(), "clinical"), (Body::from("null"), "clinical"), (Body::from(r#"{"preset": "paper"}"#), "paper")] {
        let answer = service.send(request("POST", &again, JSON, body)).await;
        let job = answer.json();
        assert_eq!((answer.status.as_u16(), &job["state"]), (202, &json!("queued")), "{job}");
        assert_eq!(answer.header("location"), job["links"]["self"].as_str().unwrap());
        assert!(answer.header("retry-after").parse::<u64>().unwrap() >= 1);
        assert_ne!(answer.header("location"), first);
        let path = answer.header("location").to_owned();
        service.call("GET", &path, &[("prefer", "wait=20")]).await;
        let seen = seen.lock().unwrap();
        let (study, parameters) = seen.last().unwrap();
        assert_eq!((study, serde_json::to_value(parameters.preset).unwrap()), (&seen[0].0, json!(preset)));
    }
    assert_eq!(seen.lock().unwrap().len(), 4);
}

#[tokio::test]
async fn parameters_are_checked_as_at_a_submission() {
    let service = idle().await;
    let path = service.submit(0).await;
    let send = async |body: Value| service.send(request("POST", &format!("{path}/again"), JSON, Body::from(body.to_string()))).await;
    send(json!({"edges": {"sigma": 99}})).await.problem(422, "invalid_parameter");
    send(json!({"colour": 1})).await.problem(422, "unknown_parameter");
    send(json!({"callback_url": "https://receiver.example/"})).await.problem(422, "unavailable_parameter");
    send(json!({"region": {"centre_mm": [9999, 3]}})).await.problem(422, "region_outside_study");
    send(json!({"pose": {"apex_mm": [0, 0, 9999]}})).await.problem(422, "region_outside_study");
    send(json!([1])).await.problem(422, "invalid_parameter");
    let not_json = service.send(request("POST", &format!("{path}/again"), JSON, Body::from("preset=paper"))).await;
    not_json.problem(400, "malformed_parameters");
    let large = service.send(request("POST", &format!("{path}/again"), JSON, Body::from(vec![b' '; 300 << 10]))).await;
    large.problem(413, "too_large");
    let coded = [("content-encoding", "gzip")];
    service.send(request("POST", &format!("{path}/again"), &coded, Body::empty())).await.problem(415, "unsupported_encoding");
    service.call("GET", &format!("{path}/again"), &[]).await.problem(405, "method_not_allowed");
    assert_eq!(service.store.counts().await.unwrap().queued, 1, "none of them made a job");
    assert_eq!(service.store.counts().await.unwrap().reserved, 0);
}

#[tokio::test]
async fn a_key_makes_one_job_of_one_request() {
    let service = idle().await;
    let (first, other) = (service.submit(0).await, service.submit(1).await);
    let send = async |path: &str, key: &str, body: &'static str| {
        service.send(request("POST", &format!("{path}/again"), &[("idempotency-key", key)], Body::from(body))).await
    };
    let made = send(&first, "a", r#"{"mesh": {"level": 2}}"#).await;
    assert_eq!(made.status, 202, "{}", made.json());
    let repeated = send(&first, "a", r#"{ "mesh": {"level": 2} }"#).await;
    assert_eq!((repeated.status.as_u16(), repeated.header("location")), (200, made.header("location")));
    send(&first, "a", "{}").await.problem(422, "idempotency_key_reused");
    send(&other, "a", r#"{"mesh": {"level": 2}}"#).await.problem(422, "idempotency_key_reused");
    send(&first, "", "{}").await.problem(400, "invalid_idempotency_key");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_input_that_is_gone_is_told_with_what_to_send() {
    let service = working(instant()).await;
    let path = service.finish(0).await;
    let problem = service.send(request("POST", &format!("{path}/again"), &[], Body::empty())).await.problem(409, "input_not_kept");
    assert!(problem["detail"].as_str().unwrap().contains("`keep_input` true"), "{problem}");
    let unknown = format!("/v1/reconstructions/{}/again", uuid::Uuid::nil());
    service.send(request("POST", &unknown, &[], Body::empty())).await.problem(404, "not_found");
}

#[tokio::test]
async fn a_full_queue_refuses_it_for_the_moment() {
    let settings = StoreSettings { max_queued_jobs: 1, ..StoreSettings::default() };
    let service = with(settings, None, |state| state).await;
    let path = service.submit(0).await;
    let refused = service.send(request("POST", &format!("{path}/again"), &[], Body::empty())).await;
    refused.problem(503, "queue_full");
    assert!(refused.header("retry-after").parse::<u64>().unwrap() >= 1);
    service.state.draining().cancel();
    service.send(request("POST", &format!("{path}/again"), &[], Body::empty())).await.problem(503, "draining");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_says_whether_its_input_is_kept_and_another_run_keeps_it_likewise() {
    let finished = async |service: &super::harness::Service, answer: super::harness::Answer| {
        assert_eq!(answer.status, 202, "{}", answer.json());
        assert_eq!(answer.json()["input_kept"], true, "until its end it is always there");
        service.call("GET", answer.header("location"), &[("prefer", "wait=20")]).await.json()
    };
    for (settings, by_default) in [(StoreSettings::default(), false), (keeping(), true)] {
        let service = with(settings, Some(instant()), |state| state).await;
        for (said, kept) in [("", by_default), ("?keep_input=true", true), ("?keep_input=false", false), ("?keep_input=null", by_default)] {
            let accepted = service.post(said, JSON, super::harness::study(0).to_string()).await;
            let job = finished(&service, accepted).await;
            assert_eq!(job["input_kept"], kept, "{said} where {by_default} is the default");
            if !kept {
                continue;
            }
            let again = format!("{}/again", job["links"]["self"].as_str().unwrap());
            let job = finished(&service, service.send(request("POST", &again, &[], Body::empty())).await).await;
            assert_eq!(job["input_kept"], true, "as the first");
            let job = finished(&service, service.send(request("POST", &again, &[], Body::from(r#"{"keep_input": false}"#))).await).await;
            assert_eq!(job["input_kept"], false, "unless it is asked not to be");
        }
        let problem =
            service.post("?keep_input=perhaps", JSON, super::harness::study(0).to_string()).await.problem(422, "invalid_parameter");
        assert_eq!(problem["detail"], "`keep_input` is \"perhaps\"; a boolean is needed.");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_that_is_not_finished_lends_its_input() {
    let service = working(held(Arc::default())).await;
    let path = service.submit(0).await;
    service.reach(&path, "running").await;
    let answer = service.send(request("POST", &format!("{path}/again"), &[], Body::empty())).await;
    assert_eq!(answer.status, 202, "{}", answer.json());
    for path in [answer.header("location"), &path] {
        service.call("DELETE", path, &[]).await;
    }
    service.reach(&path, "cancelled").await;
}
