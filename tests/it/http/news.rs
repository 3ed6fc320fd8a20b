//! The stream of all jobs: what it tells, to how many, and when it ends.

use super::harness::{Service, held, idle, request, working};
use axum::body::Body;
use futures_util::{StreamExt, stream::BoxStream};
use serde_json::{Value, json};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use tower::ServiceExt;

/// Longer than anything takes here.
const LONG: Duration = Duration::from_secs(20);

/// A listener and what it has heard but not looked at.
struct Listener {
    stream: BoxStream<'static, Result<axum::body::Bytes, axum::Error>>,
    text: String,
}

impl Listener {
    async fn of(service: &Service) -> Self {
        let asked = request("GET", "/v1/reconstructions/events", &[("accept", "text/event-stream")], Body::empty());
        let response = service.router.clone().oneshot(asked).await.unwrap();
        assert_eq!((response.status().as_u16(), &response.headers()["content-type"]), (200, &"text/event-stream".parse().unwrap()));
        let mut listener = Self { stream: response.into_body().into_data_stream().boxed(), text: String::new() };
        assert_eq!(listener.next().await, Some(("hello".to_owned(), json!({}))));
        listener
    }

    /// The next event's name and data; `None` at the end of the stream.
    async fn next(&mut self) -> Option<(String, Value)> {
        loop {
            if let Some((event, rest)) = self.text.split_once("\n\n") {
                let field = |name: &str| event.lines().find_map(|line| line.strip_prefix(name)).map(|value| value.trim().to_owned());
                let told = field("event:").zip(field("data:")).map(|(name, data)| (name, serde_json::from_str(&data).unwrap()));
                self.text = rest.into();
                match told {
                    Some(told) => return Some(told),
                    None => continue,
                }
            }
            let chunk = tokio::time::timeout(LONG, self.stream.next()).await.expect("nothing is told")?.unwrap();
            self.text.push_str(std::str::from_utf8(&chunk).unwrap());
        }
    }

    /// Reads on to a job in a state.
    async fn until(&mut self, path: &str, state: &str) -> Value {
        loop {
            let (name, data) = self.next().await.expect("the stream goes on");
            if name == "job" && data["links"]["self"] == path && data["state"] == state {
                return data;
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn all_listeners_are_told_of_all_jobs() {
    let go = Arc::new(AtomicBool::new(false));
    let service = working(held(Arc::clone(&go))).await;
    let (mut one, mut other) = (Listener::of(&service).await, Listener::of(&service).await);
    let first = service.submit(0).await;
    for listener in [&mut one, &mut other] {
        let running = listener.until(&first, "running").await;
        assert_eq!((&running["input_kept"], &running["error"]), (&json!(true), &Value::Null), "a job as in the list");
    }
    let second = service.submit(1).await;
    one.until(&second, "queued").await;
    let mut late = Listener::of(&service).await;
    go.store(true, Ordering::SeqCst);
    for listener in [&mut one, &mut other, &mut late] {
        listener.until(&first, "succeeded").await;
        let done = listener.until(&second, "succeeded").await;
        assert_eq!(done, service.get(&second).await.json());
    }
    assert_eq!(service.call("DELETE", &first, &[]).await.status, 204);
    for listener in [&mut one, &mut other, &mut late] {
        let id = first.rsplit('/').next().unwrap();
        // A change may be told twice.
        loop {
            let (name, data) = listener.next().await.unwrap();
            if name == "deleted" {
                assert_eq!(data, json!({"id": id}));
                break;
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_falls_behind_is_told_to_read_the_list() {
    let service = idle().await;
    let mut listener = Listener::of(&service).await;
    let path = service.submit(0).await;
    listener.until(&path, "queued").await;
    // More than is kept for one who does not read: each is a job and its cancelling.
    for seed in 1..=200 {
        let path = service.submit(seed).await;
        service.call("DELETE", &path, &[]).await;
    }
    let mut told = 0;
    while listener.next().await.unwrap().0 != "hello" {
        told += 1;
    }
    assert!(told < 400, "{told} events were kept for a listener that did not read");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_stream_ends_with_the_service_and_is_refused_after() {
    let service = idle().await;
    let mut listener = Listener::of(&service).await;
    service.state.draining().cancel();
    assert_eq!(listener.next().await, None);
    service.get("/v1/reconstructions/events").await.problem(503, "draining");
    let json_only = [("accept", "application/json")];
    service.call("GET", "/v1/reconstructions/events", &json_only).await.problem(406, "not_acceptable");
}
