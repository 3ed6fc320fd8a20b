//! How long jobs are kept, as clients see it.

use super::harness::{held, instant, study, with};
use serde_json::{Value, json};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use ventricle::jobs::StoreSettings;

const JSON: &[(&str, &str)] = &[("content-type", "application/json")];

/// Seconds from the end of a job to its deletion.
fn kept_s(job: &Value) -> i64 {
    let time = |field: &str| job[field].as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    time("expires_at").duration_since(time("finished_at")).as_secs()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_says_how_long_its_job_is_kept_within_the_cap() {
    let settings = StoreSettings { retention: Some(Duration::from_hours(1)), ..StoreSettings::default() };
    let service = with(settings, Some(instant()), |state| state.with_longest_retention(Duration::from_hours(2))).await;
    let send = async |query: &str, parameters: Value| {
        let mut body = study(0);
        body["parameters"] = parameters;
        service.post(query, JSON, body.to_string()).await
    };
    let kept = async |query: &str, parameters: Value| {
        let accepted = send(query, parameters).await;
        assert_eq!((accepted.status.as_u16(), &accepted.json()["expires_at"]), (202, &Value::Null), "{}", accepted.json());
        let path = accepted.header("location").to_owned();
        kept_s(&service.call("GET", &path, &[("prefer", "wait=20")]).await.json())
    };
    assert_eq!(kept("", json!({})).await, 3600, "what is configured");
    assert_eq!(kept("", json!({"retention_seconds": null})).await, 3600);
    assert_eq!(kept("", json!({"retention_seconds": 7200, "mesh": {"level": 2}})).await, 7200);
    assert_eq!(kept("?retention_seconds=60", json!({"retention_seconds": 7200})).await, 60, "the query wins");
    for (wrong, detail) in [
        ("7201", "`retention_seconds` is 7201; allowed is 60 to 7200."),
        ("59", "`retention_seconds` is 59; allowed is 60 to 7200."),
        ("-1", "`retention_seconds` is -1; allowed is 60 to 7200."),
        ("1h", "`retention_seconds` is \"1h\"; an integer is needed."),
    ] {
        let problem = send(&format!("?retention_seconds={wrong}"), json!({})).await.problem(422, "invalid_parameter");
        assert_eq!((&problem["detail"], &problem["errors"][0]["pointer"]), (&json!(detail), &json!("/retention_seconds")));
    }
    let list = service.get("/v1/parameters").await.json();
    let told = list["parameters"].as_array().unwrap().iter().find(|one| one["pointer"] == "/retention_seconds").unwrap();
    assert_eq!((told["minimum"].as_f64(), told["maximum"].as_f64()), (Some(60.0), Some(7200.0)));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_has_expired_is_gone_everywhere_and_streams_of_it_end() {
    let settings =
        StoreSettings { retention: Some(Duration::from_millis(1)), lease: Duration::from_millis(150), ..StoreSettings::default() };
    let go = Arc::new(AtomicBool::new(false));
    let service = with(settings, Some(held(Arc::clone(&go))), |state| state).await;
    let path = service.submit(0).await;
    service.reach(&path, "running").await;
    let stream = format!("{path}/events");
    let (follow, wait) = (service.call("GET", &stream, &[]), service.call("GET", &path, &[("prefer", "wait=20")]));
    let release = async { go.store(true, Ordering::SeqCst) };
    // Each sees the end, or, where the job was gone before they looked, that there is none.
    let (followed, waited, ()) =
        tokio::time::timeout(Duration::from_secs(15), async { tokio::join!(follow, wait, release) }).await.unwrap();
    assert_eq!(followed.status, 200);
    assert!([200, 404].contains(&waited.status.as_u16()), "{waited:?}");
    let mut looks = 0;
    while service.get(&path).await.status != 404 {
        looks += 1;
        assert!(looks < 400, "the job does not expire");
        tokio::time::sleep(Duration::from_millis(25)).await;
    }
    let problem = service.get(&path).await.problem(404, "not_found");
    assert!(problem["detail"].as_str().unwrap().contains("has expired"), "{problem}");
    for gone in ["/report", "/surfaces.glb", "/gates/1/wall.vtu", "/events"] {
        service.get(&format!("{path}{gone}")).await.problem(404, "not_found");
    }
    service.call("GET", &path, &[("prefer", "wait=20")]).await.problem(404, "not_found");
    service.call("DELETE", &path, &[]).await.problem(404, "not_found");
    assert_eq!(service.get("/v1/reconstructions").await.json()["reconstructions"], json!([]));
    let metrics = String::from_utf8(service.get("/metrics").await.bytes).unwrap();
    let counted = metrics.lines().find_map(|line| line.strip_prefix("ventricle_jobs_expired_total ")).unwrap();
    assert!(counted.parse::<u64>().unwrap() >= 1, "{counted}");
}
