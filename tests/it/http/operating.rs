//! Ids, headers, other origins, health, numbers, the reference page.

use super::harness::{idle, with};
use ventricle::{config::Cors, jobs::StoreSettings};

#[tokio::test]
async fn every_answer_has_an_id_the_clients_own_if_it_can_be_used() {
    let service = idle().await;
    assert_eq!(service.call("GET", "/healthz", &[("x-request-id", "my-id.7")]).await.header("x-request-id"), "my-id.7");
    let problem = service.call("GET", "/nothing", &[("x-request-id", "my-id.8")]).await.problem(404, "not_found");
    assert_eq!(problem["request_id"], "my-id.8");
    for unusable in ["", "with space", "<script>", &"x".repeat(129)] {
        let answer = service.call("GET", "/healthz", &[("x-request-id", unusable)]).await;
        assert!(uuid::Uuid::parse_str(answer.header("x-request-id")).is_ok(), "{unusable}");
    }
}

#[tokio::test]
async fn answers_are_neither_sniffed_nor_framed_nor_stored() {
    let service = idle().await;
    for path in ["/healthz", "/v1/reconstructions", "/nothing", "/"] {
        let answer = service.get(path).await;
        assert_eq!((answer.header("x-content-type-options"), answer.header("cache-control")), ("nosniff", "no-store"), "{path}");
        assert!(answer.header("content-security-policy").contains("frame-ancestors 'none'"));
        assert!(!answer.headers.contains_key("access-control-allow-origin"), "other origins are not allowed by default");
    }
}

#[tokio::test]
async fn other_origins_may_call_when_they_are_listed() {
    let viewer = "https://viewer.example";
    let service = with(StoreSettings::default(), None, |state| state.with_cors(Cors::Origins(vec![viewer.into()]))).await;
    let asked = [("origin", viewer), ("access-control-request-method", "POST"), ("access-control-request-headers", "idempotency-key")];
    let preflight = service.call("OPTIONS", "/v1/reconstructions", &asked).await;
    assert_eq!((preflight.status.as_u16(), preflight.header("access-control-allow-origin")), (200, viewer));
    assert!(preflight.header("access-control-allow-headers").contains("idempotency-key"));
    let problem = service.call("GET", "/nothing", &[("origin", viewer)]).await;
    assert_eq!(problem.header("access-control-allow-origin"), viewer, "a page can read why it was refused");
    assert!(problem.header("access-control-expose-headers").contains("x-request-id"));
    let stranger = service.call("GET", "/healthz", &[("origin", "https://stranger.example")]).await;
    assert!(!stranger.headers.contains_key("access-control-allow-origin"));
}

#[tokio::test]
async fn health_is_told_line_by_line() {
    let service = idle().await;
    let ready = service.get("/readyz").await;
    assert_eq!((ready.status.as_u16(), &ready.json()["status"]), (200, &"ready".into()));
    for check in ["store", "workers", "queue", "disk", "service"] {
        assert_eq!(ready.json()["checks"][check]["ok"], true, "{check}");
        assert!(!ready.json()["checks"][check]["detail"].as_str().unwrap().is_empty());
    }
    let dead = with(StoreSettings::default(), None, |state| state.with_workers(|| false).with_disk(std::env::temp_dir(), u64::MAX)).await;
    let checks = dead.get("/readyz").await.problem(503, "not_ready")["checks"].clone();
    assert_eq!((&checks["workers"]["ok"], &checks["disk"]["ok"], &checks["queue"]["ok"]), (&false.into(), &false.into(), &true.into()));
    assert_eq!(dead.get("/healthz").await.status, 200);
}

#[tokio::test]
async fn numbers_count_requests_by_route_not_by_id() {
    let service = idle().await;
    let path = service.submit(0).await;
    service.get(&path).await;
    let metrics = service.get("/metrics").await;
    assert!(metrics.header("content-type").starts_with("text/plain"));
    let text = String::from_utf8(metrics.bytes).unwrap();
    assert!(text.contains("ventricle_http_requests_total{method=\"GET\",path=\"/v1/reconstructions/{id}\",status=\"200\"}"), "{text}");
    assert!(text.contains("ventricle_http_request_duration_seconds_bucket"), "{text}");
    assert!(text.contains("ventricle_queue_jobs"), "{text}");
    assert!(!text.contains(path.rsplit('/').next().unwrap()));
}

#[tokio::test]
async fn the_reference_page_needs_no_network() {
    let service = idle().await;
    let page = service.get("/docs/").await;
    assert_eq!(page.status, 200);
    let html = String::from_utf8(page.bytes).unwrap();
    assert!(!html.contains("http://") && !html.contains("https://"), "{html}");
    for asset in ["swagger-ui-bundle.js", "swagger-ui.css", "swagger-initializer.js"] {
        assert!(html.contains(asset), "{html}");
        assert_eq!(service.get(&format!("/docs/{asset}")).await.status, 200, "{asset}");
    }
    let initializer = String::from_utf8(service.get("/docs/swagger-initializer.js").await.bytes).unwrap();
    assert!(initializer.contains("/openapi.json"), "{initializer}");
    assert_eq!(service.get("/openapi.json").await.json()["info"]["title"], "Ventricle");
    assert!(String::from_utf8(service.get("/").await.bytes).unwrap().contains("/docs/"));
}

#[tokio::test]
async fn parameters_are_listed_with_defaults_and_ranges() {
    let service = idle().await;
    let list = service.get("/v1/parameters").await.json();
    assert_eq!(list["defaults"]["edges"]["sigma"], 1.8);
    let sigma = list["parameters"].as_array().unwrap().iter().find(|one| one["pointer"] == "/edges/sigma").unwrap();
    assert_eq!((&sigma["default"], &sigma["minimum"], &sigma["maximum"]), (&1.8.into(), &0.3.into(), &8.0.into()));
}
