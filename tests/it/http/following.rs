//! Following a job to its end: list, poll, long-poll, events, results, cancel, delete.

use super::harness::{failing, held, idle, instant, request, working};
use axum::body::Body;
use futures_util::StreamExt;
use serde_json::{Value, json};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};
use tower::ServiceExt;

#[tokio::test]
async fn the_list_is_newest_first_and_goes_on_by_cursor() {
    let service = idle().await;
    let mut paths = Vec::new();
    for seed in 0..5 {
        paths.insert(0, service.submit(seed).await);
    }
    let mut listed = Vec::new();
    let mut query = "?limit=2&state=queued".to_owned();
    loop {
        let page = service.get(&format!("/v1/reconstructions{query}")).await.json();
        let jobs = page["reconstructions"].as_array().unwrap().clone();
        assert!(jobs.len() <= 2);
        listed.extend(jobs.iter().map(|job| job["links"]["self"].as_str().unwrap().to_owned()));
        let Some(cursor) = page["next_cursor"].as_str() else { break };
        query = format!("?limit=2&cursor={cursor}");
    }
    assert_eq!(listed, paths);
    assert_eq!(service.get("/v1/reconstructions?state=failed").await.json(), json!({"reconstructions": [], "next_cursor": null}));
    for wrong in ["?state=lost", "?limit=0", "?limit=501", "?cursor=7", "?colour=red"] {
        service.get(&format!("/v1/reconstructions{wrong}")).await.problem(400, "invalid_query");
    }
}

#[tokio::test]
async fn a_job_is_not_sent_twice_unless_it_changed() {
    let service = idle().await;
    let path = service.submit(0).await;
    let first = service.get(&path).await;
    let etag = first.header("etag").to_owned();
    let again = service.call("GET", &path, &[("if-none-match", &etag)]).await;
    assert_eq!((again.status.as_u16(), again.bytes.len()), (304, 0));
    assert_eq!(again.header("etag"), etag);
    assert_eq!(service.call("DELETE", &path, &[]).await.status, 200);
    let changed = service.call("GET", &path, &[("if-none-match", &etag)]).await;
    assert_eq!(changed.status, 200);
    assert_eq!(changed.json()["state"], "cancelled");
    assert!(changed.headers.get("retry-after").is_none(), "nothing more will happen");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn waiting_ends_with_the_job_or_the_time() {
    let go = Arc::new(AtomicBool::new(false));
    let service = working(held(Arc::clone(&go))).await;
    let path = service.submit(0).await;
    let running = service.reach(&path, "running").await;
    assert_eq!(running["attempt"], 1);
    assert!(running["queue_position"].is_null());

    let began = Instant::now();
    let waited = service.call("GET", &path, &[("prefer", "wait=1")]).await;
    assert!(began.elapsed() >= Duration::from_secs(1));
    assert_eq!((waited.header("preference-applied"), waited.json()["state"].as_str()), ("wait=1", Some("running")));
    let etag = waited.header("etag").to_owned();
    let unchanged = service.call("GET", &path, &[("prefer", "wait=1"), ("if-none-match", &etag)]).await;
    assert_eq!(unchanged.status, 304);

    let began = Instant::now();
    let waiting = service.call("GET", &path, &[("prefer", "wait=99")]);
    let release = async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        go.store(true, Ordering::SeqCst);
    };
    let (finished, ()) = tokio::join!(waiting, release);
    assert!(began.elapsed() < Duration::from_secs(10));
    assert_eq!((finished.header("preference-applied"), finished.json()["state"].as_str()), ("wait=30", Some("succeeded")));
    assert_eq!(finished.json()["progress"]["fraction"], 1.0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn results_come_with_the_end_and_are_kept_by_their_tag() {
    let go = Arc::new(AtomicBool::new(false));
    let service = working(held(Arc::clone(&go))).await;
    let path = service.submit(0).await;
    service.reach(&path, "running").await;
    for name in ["report", "surfaces.glb", "gates/1/endocardial.glb", "gates/1/wall.vtu"] {
        let early = service.get(&format!("{path}/{name}")).await;
        early.problem(409, "not_finished");
        assert_eq!(early.header("retry-after"), "1");
    }
    go.store(true, Ordering::SeqCst);
    service.reach(&path, "succeeded").await;

    let report = service.get(&format!("{path}/report")).await;
    assert_eq!((report.header("content-type"), report.header("cache-control")), ("application/json", "private, no-cache"));
    assert_eq!(report.json()["id"].as_str().unwrap(), path.rsplit('/').next().unwrap());
    let etag = report.header("etag");
    assert!(etag.len() == 66 && etag.starts_with('"'), "{etag}");
    let again = service.call("GET", &format!("{path}/report"), &[("if-none-match", etag)]).await;
    assert_eq!((again.status.as_u16(), again.bytes.len()), (304, 0));
    let head = service.call("HEAD", &format!("{path}/report"), &[]).await;
    assert_eq!((head.status.as_u16(), head.bytes.len()), (200, 0));
    assert_eq!((head.header("etag"), head.header("content-length")), (etag, report.bytes.len().to_string().as_str()));

    for name in ["surfaces.glb", "gates/1/endocardial.glb", "gates/1/epicardial.glb"] {
        let surface = service.get(&format!("{path}/{name}")).await;
        assert_eq!(surface.header("content-type"), "model/gltf-binary");
        assert_eq!(surface.bytes, format!("glTF {name}").into_bytes());
    }
    let wall = service.get(&format!("{path}/gates/1/wall.vtu")).await;
    assert_eq!((wall.header("content-type"), &wall.bytes[..]), ("application/xml", b"<VTKFile/>".as_slice()));
    let again = service.call("GET", &format!("{path}/gates/1/wall.vtu"), &[("if-none-match", wall.header("etag"))]).await;
    assert_eq!(again.status, 304);
    service.get(&format!("{path}/gates/9/wall.vtu")).await.problem(404, "no_such_result");
    service.get(&format!("{path}/gates/9/endocardial.glb")).await.problem(404, "no_such_result");
    service.get(&format!("{path}/gates/one/endocardial.glb")).await.problem(404, "not_found");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_failed_job_says_why_everywhere() {
    let service = working(failing()).await;
    let path = service.finish(0).await;
    let job = service.get(&path).await;
    assert_eq!((job.status.as_u16(), job.json()["state"].as_str()), (200, Some("failed")));
    assert_eq!(job.json()["error"]["code"], "no_left_ventricle");
    assert_eq!(job.json()["error"]["status"], 422);
    let problem = service.get(&format!("{path}/report")).await.problem(409, "reconstruction_failed");
    assert_eq!(problem["cause"]["code"], "no_left_ventricle");
    assert_eq!(problem["cause"]["detail"], "No left ventricle was found: the counts are flat.");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn deleting_cancels_first_and_then_deletes() {
    let service = working(held(Arc::default())).await;
    let running = service.submit(0).await;
    service.reach(&running, "running").await;
    let queued = service.submit(1).await;
    let cancelled = service.call("DELETE", &queued, &[]).await;
    assert_eq!((cancelled.status.as_u16(), cancelled.json()["state"].as_str()), (200, Some("cancelled")));
    let cancelling = service.call("DELETE", &running, &[]).await;
    assert_eq!((cancelling.status.as_u16(), &cancelling.json()["cancel_requested"]), (202, &json!(true)));
    let began = Instant::now();
    service.reach(&running, "cancelled").await;
    assert!(began.elapsed() < Duration::from_secs(2));
    service.get(&format!("{running}/report")).await.problem(409, "reconstruction_cancelled");
    for path in [&queued, &running] {
        assert_eq!(service.call("DELETE", path, &[]).await.status, 204);
        service.call("DELETE", path, &[]).await.problem(404, "not_found");
        service.get(path).await.problem(404, "not_found");
        service.get(&format!("{path}/report")).await.problem(404, "not_found");
        service.get(&format!("{path}/events")).await.problem(404, "not_found");
    }
}

/// The events of a stream: id, name, data.
fn events(text: &str) -> Vec<(i64, String, Value)> {
    let field = |event: &str, name: &str| event.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default().trim().to_owned();
    text.split("\n\n")
        .filter(|event| event.contains("data:"))
        .map(|event| (field(event, "id:").parse().unwrap(), field(event, "event:"), serde_json::from_str(&field(event, "data:")).unwrap()))
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn events_tell_every_version_once_and_end_with_the_job() {
    let go = Arc::new(AtomicBool::new(false));
    let service = working(held(Arc::clone(&go))).await;
    let path = service.submit(0).await;
    let release = async {
        service.reach(&path, "running").await;
        tokio::time::sleep(Duration::from_millis(200)).await;
        go.store(true, Ordering::SeqCst);
    };
    let stream = format!("{path}/events");
    let (answer, ()) = tokio::join!(service.call("GET", &stream, &[("accept", "text/event-stream")]), release);
    assert_eq!(answer.header("content-type"), "text/event-stream");
    assert_eq!(answer.header("x-content-type-options"), "nosniff");
    let told = events(std::str::from_utf8(&answer.bytes).unwrap());
    assert!(told.len() >= 2, "{told:?}");
    assert!(told.iter().all(|(_, name, job)| name == "progress" && job["links"]["self"] == path.as_str()));
    assert!(told.windows(2).all(|pair| pair[0].0 < pair[1].0), "versions grow: {told:?}");
    assert!(told[..told.len() - 1].iter().all(|(_, _, job)| job["state"] != "succeeded"), "only the last is final");
    let (last, _, job) = told.last().unwrap();
    assert_eq!(job["state"], "succeeded");

    let after_first = service.call("GET", &stream, &[("last-event-id", &told[0].0.to_string())]).await;
    let resumed = events(std::str::from_utf8(&after_first.bytes).unwrap());
    assert_eq!(resumed.iter().map(|event| event.0).collect::<Vec<_>>(), [*last], "what was missed is told by the last version");
    let all_seen = service.call("GET", &stream, &[("last-event-id", &last.to_string())]).await;
    assert_eq!((all_seen.status.as_u16(), all_seen.bytes.len()), (204, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stopping_ends_streams_and_waits_and_refuses_work() {
    let service = working(held(Arc::default())).await;
    let path = service.submit(0).await;
    service.reach(&path, "running").await;
    let response = service.router.clone().oneshot(request("GET", &format!("{path}/events"), &[], Body::empty())).await.unwrap();
    let mut stream = response.into_body().into_data_stream();
    assert!(stream.next().await.unwrap().is_ok(), "the first event comes at once");
    let stop = async {
        tokio::time::sleep(Duration::from_millis(200)).await;
        service.state.draining().cancel();
    };
    let began = Instant::now();
    let (waited, ended, ()) =
        tokio::join!(service.call("GET", &path, &[("prefer", "wait=20")]), async { while stream.next().await.is_some() {} }, stop);
    let () = ended;
    assert!(began.elapsed() < Duration::from_secs(5));
    assert_eq!(waited.json()["state"], "running");
    let refused = service.post("", &[], "anything").await;
    refused.problem(503, "draining");
    assert!(refused.headers.contains_key("retry-after"));
    let problem = service.get("/readyz").await.problem(503, "not_ready");
    assert_eq!(problem["checks"]["service"]["ok"], false);
    assert_eq!(problem["checks"]["store"]["ok"], true);
    assert_eq!(service.get("/healthz").await.status, 200, "stopping is not dying");
    service.workers.as_ref().unwrap().drain(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn finished_work_needs_no_waiting() {
    let service = working(instant()).await;
    let path = service.finish(0).await;
    let began = Instant::now();
    let answer = service.call("GET", &path, &[("prefer", "wait=20")]).await;
    assert!(began.elapsed() < Duration::from_secs(2));
    assert_eq!(answer.json()["state"], "succeeded");
}
