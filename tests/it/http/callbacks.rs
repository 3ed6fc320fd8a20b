//! `callback_url` as a client meets it.

use super::harness::{self, Service, instant, study};
use serde_json::{Value, json};
use std::{sync::Arc, time::Duration};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpListener,
};
use ventricle::{
    callbacks::{Allowed, Rules},
    config::ServeSettings,
    http,
    jobs::{StoreSettings, WorkerSettings},
};

const DEFAULT: &str = "https://default.example/hook";

async fn service(default_url: Option<&str>) -> Service {
    let allowed = Arc::new(Allowed::parse(["inside.example:8080"]).unwrap());
    let rules = Rules { allowed, default_url: default_url.map(str::to_owned) };
    harness::with(StoreSettings::default(), None, |state| state.with_callbacks(rules)).await
}

fn with_url(url: &Value) -> String {
    let mut body = study(1);
    body["parameters"] = json!({"callback_url": url});
    body.to_string()
}

/// Submits, cancels, and tells how many deliveries that makes.
async fn told_of(service: &Service, query: &str, body: String) -> usize {
    let answer = service.post(query, &[("content-type", "application/json")], body).await;
    assert_eq!(answer.status, 202, "{}", answer.json());
    let job = answer.json()["id"].as_str().unwrap().parse().unwrap();
    let cancelled = service.call("DELETE", answer.header("location"), &[]).await;
    assert_eq!(cancelled.json()["state"], "cancelled");
    service.store.deliveries(job).await.unwrap().len()
}

#[tokio::test]
async fn a_url_comes_by_body_query_or_default_and_its_job_is_told_of() {
    let plain = service(None).await;
    assert_eq!(told_of(&plain, "", with_url(&json!("https://receiver.example/done"))).await, 1);
    assert_eq!(told_of(&plain, "", with_url(&json!("http://inside.example:8080/done"))).await, 1);
    assert_eq!(told_of(&plain, "?callback_url=https%3A%2F%2Freceiver.example%2Fdone%3Fa%3D1%2C2", study(1).to_string()).await, 1);
    assert_eq!(told_of(&plain, "", with_url(&Value::Null)).await, 0);
    assert_eq!(told_of(&plain, "", study(1).to_string()).await, 0);
    assert_eq!(told_of(&service(Some(DEFAULT)).await, "", study(1).to_string()).await, 1);
}

#[tokio::test]
async fn a_url_that_may_not_be_called_is_refused_before_anything_is_stored() {
    let service = service(Some(DEFAULT)).await;
    for (url, reason) in [
        (json!("https://127.0.0.1/"), "127.0.0.1, which is loopback"),
        (json!("https://[fd00::1]/"), "which is private"),
        (json!("http://receiver.example/"), "begins with https://"),
        (json!("https://me:pw@receiver.example/"), "user name or password"),
        (json!("https://receiver.example/#x"), "fragment"),
        (json!("receiver.example"), "not an absolute URL"),
        (json!(format!("https://receiver.example/{}", "a".repeat(2048))), "at most 2048"),
        (json!(7), "a string is needed"),
    ] {
        let answer = service.post("", &[("content-type", "application/json")], with_url(&url)).await;
        let problem = answer.problem(422, "invalid_parameter");
        assert_eq!(problem["errors"][0]["pointer"], "/callback_url");
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.starts_with("`callback_url`") && detail.contains(reason) && detail.len() < 400, "{url}: {detail}");
    }
    let unsigned = harness::idle().await;
    let answer = unsigned.post("", &[("content-type", "application/json")], with_url(&json!("https://receiver.example/"))).await;
    answer.problem(422, "unavailable_parameter");
    for service in [service, unsigned] {
        assert_eq!(service.get("/v1/reconstructions").await.json()["reconstructions"], json!([]));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_with_a_secret_tells_of_a_job_by_itself() {
    let receiver = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}/done", receiver.local_addr().unwrap());
    let directory = harness::Directory::new();
    std::fs::create_dir_all(&directory.0).unwrap();
    let authorities = directory.0.join("roots.pem");
    std::fs::write(&authorities, rcgen::generate_simple_self_signed(["unused".to_owned()]).unwrap().cert.pem()).unwrap();
    let flags = [
        ("--listen", "127.0.0.1:0"),
        ("--data-dir", directory.0.to_str().unwrap()),
        ("--callback-url", url.as_str()),
        ("--callback-secret", "0123456789abcdef"),
        ("--callback-allow", "127.0.0.1"),
        ("--callback-ca-file", authorities.to_str().unwrap()),
    ];
    let settings = |flags: &[(&str, &str)]| ServeSettings::from_flags(flags.iter().flat_map(|(flag, value)| [*flag, *value])).unwrap();
    let workers = || WorkerSettings { work: instant(), poll: Duration::from_millis(20), ..WorkerSettings::default() };
    // Not allowed: it says so and does not start.
    let refused = http::start(&settings(&[&flags[..4], &flags[5..]].concat()), workers()).await.err().unwrap().to_string();
    assert!(refused.contains("--callback-url is http to `127.0.0.1`") || refused.contains("which is loopback"), "{refused}");

    let running = http::start(&settings(&flags), workers()).await.unwrap();
    let (address, body) = (running.address(), study(1).to_string());
    let submitted = tokio::task::spawn_blocking(move || {
        ureq::post(&format!("http://{address}/v1/reconstructions")).header("content-type", "application/json").send(body).unwrap().status()
    });
    let (mut stream, _) = tokio::time::timeout(Duration::from_secs(20), receiver.accept()).await.unwrap().unwrap();
    assert_eq!(submitted.await.unwrap(), 202);
    let mut text = String::new();
    while !text.ends_with('}') {
        let mut bytes = [0; 4096];
        let count = stream.read(&mut bytes).await.unwrap();
        assert!(count > 0, "{text}");
        text.push_str(std::str::from_utf8(&bytes[..count]).unwrap());
    }
    assert!(text.contains("\"state\":\"succeeded\"") && text.to_lowercase().contains("ventricle-signature: t="), "{text}");
    stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n").await.unwrap();
    running.stop().await.unwrap();
}
