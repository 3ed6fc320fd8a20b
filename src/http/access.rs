//! Who may call which route, asked before any handler: what each route needs, and what is answered to whom it is refused.

use super::{AppState, body, client::ClientAddress, layers, problem::Problem, site};
use crate::{
    access::{Caller, DayBytes, Deed, Left, OverLimit, Refusal, Scope, TokenError},
    traces,
};
use axum::{
    BoxError, RequestExt as _,
    body::Body,
    extract::{FromRequestParts, MatchedPath, RawPathParams, Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header, request::Parts},
    middleware::Next,
    response::{IntoResponse, Response},
};
use futures_util::StreamExt as _;
use jiff::Timestamp;
use std::{
    net::{IpAddr, Ipv4Addr},
    sync::Arc,
};
use tracing::Instrument as _;
use uuid::Uuid;

/// What a route needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Needs {
    /// Nothing: it tells nothing of anybody.
    Nothing,
    /// A caller with this scope.
    A(Scope),
}

const PUBLIC: Needs = Needs::Nothing;
const SUBMIT: Needs = Needs::A(Scope::Submit);
const READ: Needs = Needs::A(Scope::Read);
const ADMIN: Needs = Needs::A(Scope::Admin);

/// Every route. What is missing here needs [`ADMIN`], and fails the test that compares this table with the routes.
const ROUTES: [(&str, &str, Needs); 43] = [
    ("POST", "/v1/reconstructions", SUBMIT),
    ("POST", "/v1/reconstructions/{id}/again", SUBMIT),
    ("DELETE", "/v1/reconstructions/{id}", SUBMIT),
    ("POST", "/dicom-web/studies", SUBMIT),
    ("POST", "/dicom-web/studies/", SUBMIT),
    ("POST", "/dicom-web/studies/{study_instance_uid}", SUBMIT),
    ("POST", "/dicom-web/studies/{study_instance_uid}/", SUBMIT),
    ("GET", "/v1/reconstructions", READ),
    ("GET", "/v1/reconstructions/events", READ),
    ("GET", "/v1/reconstructions/{id}", READ),
    ("GET", "/v1/reconstructions/{id}/comparison", READ),
    ("GET", "/v1/reconstructions/{id}/events", READ),
    ("GET", "/v1/reconstructions/{id}/fhir", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/endocardial.glb", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/endocardial.stl", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/endocardial.stl.dcm", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/epicardial.glb", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/epicardial.stl", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/epicardial.stl.dcm", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/slices.png", READ),
    ("GET", "/v1/reconstructions/{id}/gates/{gate}/wall.vtu", READ),
    ("GET", "/v1/reconstructions/{id}/polar-maps", READ),
    ("GET", "/v1/reconstructions/{id}/polar-maps/{image}", READ),
    ("GET", "/v1/reconstructions/{id}/report", READ),
    ("GET", "/v1/reconstructions/{id}/report.html", READ),
    ("GET", "/v1/reconstructions/{id}/slices", READ),
    ("GET", "/v1/reconstructions/{id}/sr.dcm", READ),
    ("GET", "/v1/reconstructions/{id}/surfaces.glb", READ),
    ("GET", "/v1/phantom.dcm", READ),
    // The viewer's pages hold nothing, but a browser that is asked here sends what it is told with all that the page fetches.
    ("GET", "/", READ),
    ("GET", "/studies/{id}", READ),
    ("GET", "/metrics", ADMIN),
    ("GET", "/healthz", PUBLIC),
    ("GET", "/readyz", PUBLIC),
    ("GET", "/v1/parameters", PUBLIC),
    ("GET", "/openapi.json", PUBLIC),
    ("GET", "/schemas/report-1.json", PUBLIC),
    ("GET", "/schemas/comparison-1.json", PUBLIC),
    ("GET", "/assets/{*file}", PUBLIC),
    ("GET", "/embed/{*file}", PUBLIC),
    ("GET", "/docs", PUBLIC),
    ("GET", "/docs/", PUBLIC),
    ("GET", "/docs/{*rest}", PUBLIC),
];

/// Every route: its method, its path as it is matched, and the scope it needs, if any.
pub fn routes() -> impl Iterator<Item = (&'static str, &'static str, Option<Scope>)> {
    ROUTES.into_iter().map(|(method, path, needs)| match needs {
        Needs::Nothing => (method, path, None),
        Needs::A(scope) => (method, path, Some(scope)),
    })
}

/// Bytes of a refused body that are let in so that the refusal arrives: a gated study of the usual size.
const REFUSED_BYTES: u64 = 8 << 20;

/// What a request needs. `HEAD` is `GET` without the body; where there is no route, there is nothing to guard.
pub(super) fn needs(method: &Method, matched: Option<&str>) -> Needs {
    let Some(path) = matched else { return PUBLIC };
    let method = if method == Method::HEAD { "GET" } else { method.as_str() };
    let of_path = || ROUTES.iter().filter(|(_, route, _)| *route == path);
    match of_path().find(|(of, ..)| *of == method) {
        Some((_, _, needs)) => *needs,
        // A method that a public path does not know is answered 405 to everybody.
        None if of_path().count() > 0 && of_path().all(|(_, _, needs)| *needs == PUBLIC) => PUBLIC,
        None => ADMIN,
    }
}

/// The caller of a guarded route.
pub(super) struct Calling(pub(super) Arc<Caller>);

impl<S: Send + Sync> FromRequestParts<S> for Calling {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        parts.extensions.get::<Arc<Caller>>().cloned().map(Self).ok_or_else(|| {
            tracing::error!("a handler asks who calls on a route that asks nobody");
            Problem::internal()
        })
    }
}

impl Calling {
    /// Refuses a job that the caller does not see as one that is not there.
    pub(super) async fn sees(&self, state: &AppState, id: Uuid) -> Result<Uuid, Problem> {
        let Some(owner) = self.0.sees_only() else { return Ok(id) };
        match state.store.owner(id).await? {
            Some(of_job) if of_job == owner => Ok(id),
            _ => Err(Problem::no_such_reconstruction(id)),
        }
    }
}

/// Marks an answer with the jobs that it is about, beside the one of the path: what a request made, or compared with.
#[derive(Debug, Clone)]
pub(super) struct About(pub(super) Arc<[Uuid]>);

/// Lets in who may come in, counts what is used, and tells the audit log.
pub(super) async fn guard(State(state): State<AppState>, request: Request, next: Next) -> Response {
    let matched = request.extensions().get::<MatchedPath>().map(|path| path.as_str().to_owned());
    let Needs::A(scope) = needs(request.method(), matched.as_deref()) else { return next.run(request).await };
    let safe = request.method().is_safe();
    let guarded = guarded(state, scope, matched.unwrap_or_default(), request, next);
    if safe {
        return guarded.await;
    }
    // What changes something goes on when the client goes away, and so must what tells of it.
    let guarded = traces::current().scope(guarded).in_current_span();
    match tokio::spawn(guarded).await {
        Ok(response) => response,
        Err(ended) => match ended.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => Problem::internal().into_response(),
        },
    }
}

/// A request from the question who calls to the line in the audit log.
async fn guarded(state: AppState, scope: Scope, matched: String, mut request: Request, next: Next) -> Response {
    let address = request.extensions().get::<ClientAddress>().map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |client| client.0);
    let request_id = request.extensions().get::<layers::RequestId>().map(|id| id.0.clone()).unwrap_or_default();
    let mut deed = Deed::asked(format!("{} {matched}", request.method()), address, request_id);
    if matched.starts_with("/v1/reconstructions/{id}") {
        deed.jobs.extend(job_of(&mut request).await);
    }
    let admitted = admit(&state, request.method(), request.uri(), request.headers(), scope, address, &mut deed).await;
    let response = match admitted {
        Ok(Admitted { caller, left, day }) => {
            if let Some(day) = day {
                request = request.map(|body| counted(body, day));
            }
            request.extensions_mut().insert(Arc::new(caller));
            let mut response = next.run(request).await;
            if let Some(left) = left {
                tell_left(response.headers_mut(), left);
            }
            response
        }
        Err(refusal) => {
            let (parts, body) = request.into_parts();
            body::discard(&parts.headers, body, REFUSED_BYTES).await;
            refusal.into_response()
        }
    };
    // Where nothing has changed nothing was told.
    if let Some(audit) = state.audit.as_ref().filter(|_| response.status() != StatusCode::NOT_MODIFIED) {
        deed.status = Some(response.status().as_u16());
        deed.refused = response.extensions().get::<Problem>().map(|problem| problem.code.clone());
        deed.jobs.extend(response.extensions().get::<About>().iter().flat_map(|about| about.0.iter()));
        audit.tell(deed).await;
    }
    response
}

/// Who was let in, what is left of its requests, and what its body takes of the day.
struct Admitted {
    caller: Caller,
    left: Option<Left>,
    day: Option<DayBytes>,
}

/// Looks at all that the head of a request decides: who calls, from whose page, whether it may, and within which limits.
async fn admit(
    state: &AppState,
    method: &Method,
    uri: &Uri,
    headers: &HeaderMap,
    scope: Scope,
    address: IpAddr,
    deed: &mut Deed,
) -> Result<Admitted, Refused> {
    if state.access.is_open() {
        site::admit(&state.hosts, &state.cors, method, uri, headers)?;
    }
    let authorization = headers.get(header::AUTHORIZATION).map(HeaderValue::as_bytes);
    let caller = state.access.admit(authorization, address).await?;
    (deed.owner, deed.who) = (Some(caller.owner.clone()), Some(caller.known_as.clone()));
    if !caller.may(scope) {
        return Err(Refused::Scope(scope));
    }
    if caller.by_basic && !method.is_safe() && site::from_elsewhere(uri, headers) {
        return Err(Refused::CrossSite);
    }
    let Some(allowance) = &caller.allowance else { return Ok(Admitted { caller, left: None, day: None }) };
    let left = allowance.request()?;
    let mut day = None;
    if method == Method::POST {
        let announced = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse().ok()).unwrap_or(0);
        day = allowance.body(announced, Timestamp::now())?;
        if let Some(most) = allowance.queued_jobs() {
            state.store.admits(&caller.owner, most).await.map_err(Problem::from)?;
        }
    }
    Ok(Admitted { caller, left, day })
}

/// A body of which more than the day has left is an error, once: what comes behind that can be let in so that the refusal arrives.
fn counted(body: Body, mut day: DayBytes) -> Body {
    let mut told = false;
    Body::from_stream(body.into_data_stream().map(move |chunk| -> Result<_, BoxError> {
        let chunk = chunk?;
        if !told {
            day.came(chunk.len() as u64, Timestamp::now()).inspect_err(|_| told = true)?;
        }
        Ok(chunk)
    }))
}

/// The job in a path, as the handler reads it: `%30` is a digit too.
async fn job_of(request: &mut Request) -> Option<Uuid> {
    let parameters = request.extract_parts::<RawPathParams>().await.ok()?;
    parameters.iter().find(|(name, _)| *name == "id").and_then(|(_, id)| id.parse().ok())
}

/// `RateLimit-Policy` and `RateLimit` (draft-ietf-httpapi-ratelimit-headers-10).
fn tell_left(headers: &mut HeaderMap, left: Left) {
    let policy = format!("\"requests\";q={};w=1", left.per_second);
    let state = format!("\"requests\";r={};t=1", left.left);
    for (name, value) in [("ratelimit-policy", policy), ("ratelimit", state)] {
        if let Ok(value) = HeaderValue::from_str(&value) {
            headers.insert(HeaderName::from_static(name), value);
        }
    }
}

/// Why a request goes no further.
enum Refused {
    Stranger(Refusal),
    Scope(Scope),
    CrossSite,
    OverLimit(OverLimit),
    Other(Box<Problem>),
}

impl From<Refusal> for Refused {
    fn from(refusal: Refusal) -> Self {
        Self::Stranger(refusal)
    }
}

impl From<OverLimit> for Refused {
    fn from(over: OverLimit) -> Self {
        Self::OverLimit(over)
    }
}

impl From<Problem> for Refused {
    fn from(problem: Problem) -> Self {
        Self::Other(Box::new(problem))
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        let challenge = match &self {
            // RFC 6750 §3: what was presented was looked at.
            Self::Stranger(Refusal::Nothing) => Some("Bearer realm=\"ventricle\"".to_owned()),
            Self::Scope(scope) => Some(format!("Bearer realm=\"ventricle\", error=\"insufficient_scope\", scope=\"{}\"", scope.name())),
            Self::Stranger(Refusal::TooManyAttempts { .. } | Refusal::Token(TokenError::Unavailable))
            | Self::CrossSite
            | Self::OverLimit(_)
            | Self::Other(_) => None,
            Self::Stranger(_) => Some("Bearer realm=\"ventricle\", error=\"invalid_token\"".to_owned()),
        };
        let asked = matches!(self, Self::Stranger(_));
        let problem = Problem::from(self);
        let mut response = problem.into_response();
        if let Some(challenge) = challenge.and_then(|text| HeaderValue::from_str(&text).ok()) {
            response.headers_mut().append(header::WWW_AUTHENTICATE, challenge);
            if asked {
                // The one that browsers have a window for.
                let basic = HeaderValue::from_static("Basic realm=\"ventricle\", charset=\"UTF-8\"");
                response.headers_mut().append(header::WWW_AUTHENTICATE, basic);
            }
        }
        response
    }
}

impl From<Refused> for Problem {
    fn from(refused: Refused) -> Self {
        let too_many = |code, detail: String, retry_after_s| Self {
            retry_after_s: Some(retry_after_s),
            ..Self::new(StatusCode::TOO_MANY_REQUESTS, code, detail)
        };
        match refused {
            Refused::Other(problem) => *problem,
            Refused::OverLimit(over) => over.into(),
            Refused::Scope(scope) => {
                let detail = format!("The key or token does not have the scope `{}`, which this needs.", scope.name());
                Self::new(StatusCode::FORBIDDEN, "insufficient_scope", detail)
            }
            Refused::CrossSite => {
                let detail = "A page of another site made the browser send this with the credentials that it keeps. Pages of other sites send \
                              `Authorization: Bearer …` themselves.";
                Self::new(StatusCode::FORBIDDEN, "cross_site_request", detail)
            }
            Refused::Stranger(refusal) => match refusal {
                Refusal::TooManyAttempts { retry_after_s } => too_many("too_many_attempts", refusal.to_string(), retry_after_s),
                Refusal::Token(TokenError::Unavailable) => {
                    Self { retry_after_s: Some(5), ..Self::new(StatusCode::SERVICE_UNAVAILABLE, "issuer_unavailable", refusal.to_string()) }
                }
                refusal => {
                    let code = match &refusal {
                        Refusal::Nothing => "credentials_missing",
                        Refusal::Expired | Refusal::Token(TokenError::Expired) => "credentials_expired",
                        _ => "credentials_invalid",
                    };
                    Self::new(StatusCode::UNAUTHORIZED, code, refusal.to_string())
                }
            },
        }
    }
}
