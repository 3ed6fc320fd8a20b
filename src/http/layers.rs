//! What happens to every request: an id, a line in the log, numbers, cautious headers, and a problem document for whatever went wrong.

use super::{problem::Problem, traces};
use crate::{config::Cors, traces::Traces};
use axum::{
    body::{Body, HttpBody},
    extract::{MatchedPath, Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use std::{any::Any, sync::Arc, time::Instant};
use tower_http::cors::{AllowOrigin, CorsLayer};
use tracing::{Instrument, field};
use uuid::Uuid;

/// Header of the request's id, in and out.
pub(super) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Longest id taken over from a client.
const LONGEST_ID: usize = 128;
/// Most bytes of a request's headers, names and values.
pub(super) const MOST_HEADER_BYTES: usize = 32 << 10;
/// Most bytes of a request's path and query.
const MOST_URI_BYTES: usize = 8 << 10;

/// The headers of every answer that depend on the settings.
#[derive(Debug, Clone)]
pub(super) struct Policies {
    /// That browsers are to come by HTTPS only.
    strict_transport: Option<HeaderValue>,
    /// Whether pages of other origins may show what is here.
    resources: HeaderValue,
}

impl Policies {
    /// Where browsers are to come by HTTPS only for so many seconds, if any, and these pages may call.
    pub(super) fn new(hsts_seconds: Option<u64>, cors: &Cors) -> Self {
        let strict_transport = hsts_seconds.and_then(|seconds| HeaderValue::from_str(&format!("max-age={seconds}")).ok());
        // Who may read it by CORS may show it too.
        let resources = HeaderValue::from_static(if *cors == Cors::Off { "same-origin" } else { "cross-origin" });
        Self { strict_transport, resources }
    }
}

/// Refuses a request whose head is larger than any that is meant.
pub(super) async fn limit_head(request: Request, next: Next) -> Response {
    let uri = request.uri();
    if uri.path().len() + uri.query().map_or(0, |query| query.len() + 1) > MOST_URI_BYTES {
        return StatusCode::URI_TOO_LONG.into_response();
    }
    if request.headers().iter().map(|(name, value)| name.as_str().len() + value.len()).sum::<usize>() > MOST_HEADER_BYTES {
        return StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE.into_response();
    }
    next.run(request).await
}

/// The request's id, for who tells of it later.
#[derive(Debug, Clone)]
pub(super) struct RequestId(pub(super) String);

/// Gives the request an id (the client's own, if it sends a usable one), logs, traces and counts it, and finishes the answer.
pub(super) async fn observe(State((policies, traces)): State<(Arc<Policies>, Traces)>, mut request: Request, next: Next) -> Response {
    let began = Instant::now();
    let _in_flight = InFlight::begin();
    let id = request_id(request.headers());
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let matched = request.extensions().get::<MatchedPath>().map_or("unmatched", MatchedPath::as_str).to_owned();
    request.extensions_mut().insert(RequestId(id.clone()));
    let traced = traces::span(&traces, &request);
    let span = tracing::info_span!("request", request_id = %id, %method, path = matched, trace_id = traced.trace_id().map(field::display));
    async {
        let response = traced.scope(next.run(request)).await;
        let mut response = finish(response, &method, path, &id);
        harden(response.headers_mut(), &matched, &policies);
        if let Ok(id) = HeaderValue::from_str(&id) {
            response.headers_mut().insert(REQUEST_ID, id);
        }
        record(&method, &matched, response.status().as_u16(), began);
        traced.answered(response.status().as_u16());
        response
    }
    .instrument(span)
    .await
}

/// A request that is counted as long as it is here: also one whose client goes away is counted down.
struct InFlight(metrics::Gauge);

impl InFlight {
    fn begin() -> Self {
        let requests = metrics::gauge!("ventricle_http_requests_in_flight");
        requests.increment(1.0);
        Self(requests)
    }
}

impl Drop for InFlight {
    fn drop(&mut self) {
        self.0.decrement(1.0);
    }
}

fn request_id(headers: &HeaderMap) -> String {
    let usable = |id: &&str| {
        (1..=LONGEST_ID).contains(&id.len()) && id.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.:/+=".contains(&byte))
    };
    let sent = headers.get(REQUEST_ID).and_then(|value| value.to_str().ok()).filter(usable);
    sent.map_or_else(|| Uuid::now_v7().to_string(), str::to_owned)
}

/// Marks an answer that says itself what went wrong, in a form of its own.
#[derive(Debug, Clone, Copy)]
pub(super) struct Told;

/// Makes every error a problem document with the request's path and id; what the router or a layer refused by status alone gets one too.
fn finish(mut response: Response, method: &Method, path: String, id: &str) -> Response {
    let status = response.status();
    // A refusal in the words of another standard is one already.
    let told = response.extensions_mut().remove::<Told>().is_some();
    if told || (!status.is_client_error() && !status.is_server_error()) {
        return response;
    }
    let problem = response.extensions_mut().remove::<Problem>().unwrap_or_else(|| Problem::of_status(status));
    // Codes are names in this program: no request can make a new one.
    metrics::counter!("ventricle_http_problems_total", "code" => problem.code.clone()).increment(1);
    let mut finished = Problem { instance: Some(path), request_id: Some(id.to_owned()), ..problem }.into_response();
    *finished.status_mut() = status;
    for name in response.headers().keys().filter(|name| *name != header::CONTENT_TYPE && *name != header::CONTENT_LENGTH) {
        finished.headers_mut().remove(name);
        for value in response.headers().get_all(name) {
            finished.headers_mut().append(name, value.clone());
        }
    }
    if method == Method::HEAD {
        let length = finished.body().size_hint().exact().unwrap_or_default();
        finished.headers_mut().insert(header::CONTENT_LENGTH, HeaderValue::from(length));
        *finished.body_mut() = Body::empty();
    }
    finished
}

/// Headers that keep browsers from guessing, framing, storing and sharing; a handler that knows better has set its own.
fn harden(headers: &mut HeaderMap, matched: &str, policies: &Policies) {
    // The reference page runs its own scripts and styles; nothing else here is a page that needs any.
    let policy = if matched.starts_with("/docs") {
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'"
    } else {
        "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'"
    };
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CACHE_CONTROL, "no-store"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CONTENT_SECURITY_POLICY, policy),
        (HeaderName::from_static("permissions-policy"), "camera=(), geolocation=(), microphone=(), payment=(), usb=()"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    ] {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    headers.entry(HeaderName::from_static("cross-origin-resource-policy")).or_insert_with(|| policies.resources.clone());
    if let Some(value) = &policies.strict_transport {
        headers.insert(header::STRICT_TRANSPORT_SECURITY, value.clone());
    }
}

fn record(method: &Method, matched: &str, status: u16, began: Instant) {
    let seconds = began.elapsed().as_secs_f64();
    let known = [Method::GET, Method::HEAD, Method::POST, Method::DELETE, Method::OPTIONS];
    let method = known.iter().find(|known| *known == method).map_or("other", Method::as_str).to_owned();
    let labels = [("method", method), ("path", matched.to_owned()), ("status", status.to_string())];
    metrics::counter!("ventricle_http_requests_total", &labels).increment(1);
    metrics::histogram!("ventricle_http_request_duration_seconds", &labels[..2]).record(seconds);
    let duration_ms = (seconds * 1e4).round() / 10.0;
    match matched {
        matched if is_look(matched) && status < 500 => tracing::debug!(status, duration_ms, "answered"),
        _ => tracing::info!(status, duration_ms, "answered"),
    }
}

/// Whether a route only looks whether the service is well: monitors ask so all the time.
pub(super) fn is_look(matched: &str) -> bool {
    matches!(matched, "/healthz" | "/readyz" | "/metrics")
}

/// A panic of a handler, as a problem that says nothing of the inside.
#[expect(clippy::needless_pass_by_value, reason = "the shape that the layer calls")]
pub(super) fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response {
    let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
    tracing::error!(panic = text, "a handler panicked");
    Problem::internal().into_response()
}

/// The layer that lets pages of other origins call the service, if any may.
pub(super) fn cors(cors: &Cors) -> Option<CorsLayer> {
    let origins = match cors {
        Cors::Off => return None,
        Cors::Any => AllowOrigin::any(),
        Cors::Origins(origins) => AllowOrigin::list(origins.iter().filter_map(|origin| origin.parse().ok())),
    };
    let prefer = HeaderName::from_static("prefer");
    let last_event_id = HeaderName::from_static("last-event-id");
    let idempotency_key = HeaderName::from_static("idempotency-key");
    let preference_applied = HeaderName::from_static("preference-applied");
    let layer = CorsLayer::new()
        .allow_origin(origins)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
        .allow_headers([
            header::ACCEPT,
            header::AUTHORIZATION,
            header::CONTENT_TYPE,
            header::IF_NONE_MATCH,
            REQUEST_ID,
            prefer,
            last_event_id,
            idempotency_key,
        ])
        .expose_headers([header::ETAG, header::LOCATION, header::RETRY_AFTER, REQUEST_ID, preference_applied])
        .max_age(std::time::Duration::from_hours(1));
    Some(layer)
}
