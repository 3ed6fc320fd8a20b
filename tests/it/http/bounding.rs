//! What every answer carries for browsers, how large a head may be, and how much of the memory bodies may take.

use super::{
    guarded::Guarded,
    harness::{Answer, Service, idle, request, study, with},
};
use axum::body::{Body, Bytes};
use futures_util::{StreamExt, stream};
use std::{
    convert::Infallible,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use tokio::sync::oneshot;
use ventricle::{
    access::{Attempts, Scope, Standing},
    config::Cors,
    http::{AppState, router},
    jobs::StoreSettings,
};

#[tokio::test]
async fn every_answer_tells_browsers_to_be_careful() {
    let service = idle().await;
    for (method, path, status) in
        [("GET", "/healthz", 200), ("GET", "/v1/reconstructions", 200), ("GET", "/nothing", 404), ("PUT", "/", 405)]
    {
        let answer = service.call(method, path, &[]).await;
        assert_eq!(answer.status, status, "{path}");
        for (name, value) in [
            ("x-content-type-options", "nosniff"),
            ("referrer-policy", "no-referrer"),
            ("permissions-policy", "camera=(), geolocation=(), microphone=(), payment=(), usb=()"),
            ("cross-origin-opener-policy", "same-origin"),
            ("cross-origin-resource-policy", "same-origin"),
            ("cache-control", "no-store"),
        ] {
            assert_eq!(answer.header(name), value, "{path}");
        }
        assert!(answer.header("content-security-policy").starts_with("default-src 'none';"), "{path}");
        for absent in ["server", "x-powered-by", "strict-transport-security"] {
            assert!(!answer.headers.contains_key(absent), "{path}: {absent}");
        }
    }
}

#[tokio::test]
async fn the_settings_decide_who_may_show_results_and_whether_browsers_must_encrypt() {
    let service = with(StoreSettings::default(), None, |state| state.with_cors(Cors::Any).with_hsts(600)).await;
    let answer = service.get("/healthz").await;
    assert_eq!(answer.header("cross-origin-resource-policy"), "cross-origin");
    assert_eq!(answer.header("strict-transport-security"), "max-age=600");
}

#[tokio::test]
async fn heads_are_limited_and_the_refusal_says_what_is_too_large() {
    let service = idle().await;
    let path = |bytes: usize| format!("/healthz?{}", "x".repeat(bytes - "/healthz?".len()));
    assert_eq!(service.get(&path(8 << 10)).await.status, 200);
    service.get(&path((8 << 10) + 1)).await.problem(414, "uri_too_long");
    let cookie = "x".repeat((32 << 10) - "cookie".len());
    assert_eq!(service.call("GET", "/healthz", &[("cookie", &cookie)]).await.status, 200);
    service.call("GET", "/healthz", &[("cookie", &cookie), ("a", "")]).await.problem(431, "headers_too_large");
}

/// A submission whose body comes when it is told to, and whether any of it was asked for.
fn held(body: String) -> (axum::http::Request<Body>, oneshot::Sender<()>, Arc<AtomicBool>) {
    let (go, gone) = oneshot::channel();
    let asked = Arc::new(AtomicBool::new(false));
    let (length, seen) = (body.len().to_string(), Arc::clone(&asked));
    let chunks = stream::once(async move {
        seen.store(true, Ordering::SeqCst);
        let _ = gone.await;
        Ok::<_, Infallible>(Bytes::from(body))
    });
    let headers = [("content-type", "application/json"), ("content-length", &*length)];
    (request("POST", "/v1/reconstructions", &headers, Body::from_stream(chunks.boxed())), go, asked)
}

/// Sends a request on a task of its own.
fn sent(service: &Service, request: axum::http::Request<Body>) -> tokio::task::JoinHandle<Answer> {
    let service = Service { router: service.router.clone(), ..alone(service) };
    tokio::spawn(async move { service.send(request).await })
}

/// The same service without what ends with it.
fn alone(service: &Service) -> Service {
    let directory = super::harness::Directory(std::env::temp_dir().join(format!("ventricle-none-{}", uuid::Uuid::now_v7())));
    Service { router: router(service.state.clone()), state: service.state.clone(), store: service.store.clone(), workers: None, directory }
}

async fn becomes(flag: &AtomicBool) {
    for _ in 0..1000 {
        if flag.load(Ordering::SeqCst) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("nothing was read in 10 s");
}

#[tokio::test]
async fn a_body_without_room_is_not_read_until_there_is_some() {
    let body = study(0).to_string();
    let room = body.len() as u64 + 1024;
    let service = with(StoreSettings::default(), None, |state| state.with_uploads(8, room, Duration::from_mins(1))).await;
    let (first, go_first, first_asked) = held(body);
    let first = sent(&service, first);
    becomes(&first_asked).await;
    let (second, go_second, second_asked) = held(study(1).to_string());
    let second = sent(&service, second);
    go_second.send(()).unwrap();
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert!(!second_asked.load(Ordering::SeqCst), "the second is read although the first fills the memory");
    // What needs no room is answered meanwhile.
    assert_eq!(service.get("/healthz").await.status, 200);
    go_first.send(()).unwrap();
    for answer in [first.await.unwrap(), second.await.unwrap()] {
        assert_eq!(answer.status, 202, "{}", answer.json());
    }
}

#[tokio::test]
async fn one_owner_leaves_room_for_others() {
    let change = |state: AppState| state.with_uploads(4, 512 << 20, Duration::from_millis(200));
    let guarded = Guarded::with(None, Standing::default(), Attempts::default(), change).await;
    let (ours, theirs) = (guarded.key("ours", &[Scope::Submit]), guarded.key("theirs", &[Scope::Submit]));
    let bearer = format!("Bearer {ours}");
    let mut held_back = Vec::new();
    for _ in 0..12 {
        let (mut request, go, asked) = held(study(0).to_string());
        request.headers_mut().insert("authorization", bearer.parse().unwrap());
        held_back.push((sent(&guarded.service, request), go, asked));
    }
    for _ in 0..500 {
        // Two are received, two wait, and of eight what is sent is let in so that they are told.
        if held_back.iter().filter(|(.., asked)| asked.load(Ordering::SeqCst)).count() >= 10 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(guarded.submit(1, &theirs).await.status, 202, "while the first owner has all that one may have, and all places in line");
    let mut answers = Vec::new();
    for (sent, go, asked) in held_back {
        // Those that found no room wait for the end of what they sent, so that the refusal arrives.
        let _ = go.send(());
        answers.push((sent.await.unwrap().status.as_u16(), asked.load(Ordering::SeqCst)));
    }
    // Those that waited may have found room when the first two were done.
    let count = |wanted| answers.iter().filter(|(status, _)| *status == wanted).count();
    assert!((2..=4).contains(&count(202)) && count(202) + count(503) == answers.len(), "{answers:?}");
}

#[tokio::test]
async fn who_finds_no_room_for_long_is_told_when_to_come_back() {
    let body = study(0).to_string();
    // Chunked, so it may have as much as any; and as many at once as there may be.
    for (at_once, memory) in [(8, 64), (1, 512 << 20)] {
        let service = with(StoreSettings::default(), None, |state| state.with_uploads(at_once, memory, Duration::from_millis(50))).await;
        let (first, go_first, first_asked) = held(body.clone());
        let first = sent(&service, first);
        becomes(&first_asked).await;
        let refused = service.post("", &[("content-type", "application/json")], body.clone()).await;
        refused.problem(503, "uploads_full");
        assert_eq!(refused.header("retry-after"), "5");
        let refused = service.send(request("POST", "/dicom-web/studies", &[("content-type", "application/dicom")], Body::from("x"))).await;
        refused.problem(503, "uploads_full");
        go_first.send(()).unwrap();
        assert_eq!(first.await.unwrap().status, 202);
        assert_eq!(
            service.post("", &[("content-type", "application/json")], study(1).to_string()).await.status,
            202,
            "the room is given back"
        );
    }
}
