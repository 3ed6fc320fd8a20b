//! A service that asks who calls: every route for every kind of caller, and what one owner learns of another's jobs.

use super::harness::{Answer, Service, held, instant, request, study, with};
use axum::body::Body;
use futures_util::StreamExt;
use jiff::{SignedDuration, Timestamp};
use serde_json::Value;
use std::{
    collections::BTreeSet,
    fs,
    num::NonZeroU32,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use tower::ServiceExt;
use ventricle::{
    access::{self, Access, Allowances, Attempts, KeyRecord, Keyring, Scope, Standing, Wished},
    http::{AppState, guarded_routes, openapi_document},
    jobs::{StoreSettings, Work},
};

/// A service with a file of keys.
pub(super) struct Guarded {
    pub(super) service: Service,
    pub(super) file: PathBuf,
    pub(super) access: Arc<Keyring>,
}

/// Makes a key; returns what follows `Bearer`.
pub(super) fn key(file: &Path, owner: &str, scopes: &[Scope], limits: Wished, expires_at: Option<Timestamp>) -> String {
    let made = access::add(file, |made| KeyRecord {
        id: made.id.clone(),
        note: String::new(),
        owner: owner.to_owned(),
        scopes: scopes.to_vec(),
        sha256: made.sha256.clone(),
        created_at: Timestamp::now(),
        expires_at,
        limits,
    });
    made.unwrap().text
}

impl Guarded {
    pub(super) async fn new(work: Option<Work>, standing: Standing) -> Self {
        Self::with(work, standing, Attempts::default(), |state| state).await
    }

    /// With another limit on wrong keys, and other settings.
    pub(super) async fn with(
        work: Option<Work>,
        standing: Standing,
        attempts: Attempts,
        change: impl FnOnce(AppState) -> AppState,
    ) -> Self {
        let file = std::env::temp_dir().join(format!("ventricle-keys-{}.json", uuid::Uuid::now_v7()));
        key(&file, "nobody", &[], Wished::default(), None);
        let ring = Arc::new(Keyring::open(&file).unwrap());
        let access = Access::new(Some(Arc::clone(&ring)), None, Allowances::new(standing)).with_attempts(attempts);
        let service = with(StoreSettings::default(), work, |state| change(state.with_access(access))).await;
        Self { service, file, access: ring }
    }

    pub(super) fn key(&self, owner: &str, scopes: &[Scope]) -> String {
        self.key_with(owner, scopes, Wished::default())
    }

    pub(super) fn key_with(&self, owner: &str, scopes: &[Scope], limits: Wished) -> String {
        let key = key(&self.file, owner, scopes, limits, None);
        self.access.refresh().unwrap();
        key
    }

    /// Asks with a key, or without.
    pub(super) async fn ask(&self, method: &str, path: &str, key: Option<&str>) -> Answer {
        self.ask_with(method, path, key, &[], Body::empty()).await
    }

    pub(super) async fn ask_with(&self, method: &str, path: &str, key: Option<&str>, headers: &[(&str, &str)], body: Body) -> Answer {
        let bearer = key.map(|key| format!("Bearer {key}"));
        let mut headers = headers.to_vec();
        headers.extend(bearer.as_deref().map(|bearer| ("authorization", bearer)));
        self.service.send(request(method, path, &headers, body)).await
    }

    /// Submits a small study.
    pub(super) async fn submit(&self, seed: u16, key: &str) -> Answer {
        let body = Body::from(study(seed).to_string());
        self.ask_with("POST", "/v1/reconstructions", Some(key), &[("content-type", "application/json")], body).await
    }

    /// A finished job of a key's owner: its path.
    pub(super) async fn finished(&self, seed: u16, key: &str) -> String {
        let path = self.submit(seed, key).await.header("location").to_owned();
        let job = self.ask_with("GET", &path, Some(key), &[("prefer", "wait=20")], Body::empty()).await;
        assert_eq!(job.json()["state"], "succeeded", "{}", job.json());
        path
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        for ending in ["", ".lock"] {
            let _ = fs::remove_file(format!("{}{ending}", self.file.display()));
        }
    }
}

/// A path that a route matches: about this job.
fn filled(path: &str, job: &str) -> String {
    let id = job.rsplit('/').next().unwrap();
    let path = path.replace("{gate}", "1").replace("{image}", "perfusion.png").replace("{*file}", "x").replace("{*rest}", "index.html");
    path.replace("{id}", id).replace("{study_instance_uid}", "1.2.3")
}

/// The routes of the contract, and those that the sources add beside it.
fn all_routes() -> BTreeSet<(String, String)> {
    let contract = serde_json::to_value(openapi_document()).unwrap();
    let mut routes = BTreeSet::new();
    for (path, item) in contract["paths"].as_object().unwrap() {
        for method in item.as_object().unwrap().keys().filter(|key| ["get", "post", "put", "patch", "delete"].contains(&key.as_str())) {
            routes.insert((method.to_uppercase(), path.clone()));
        }
    }
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/http");
    for entry in fs::read_dir(sources).unwrap() {
        let text = fs::read_to_string(entry.unwrap().path()).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap();
        for added in text.split(".route(\"").skip(1) {
            let (path, rest) = added.split_once("\", ").unwrap();
            let method =
                if rest.contains("routing::post(") && !rest[..rest.find('\n').unwrap()].contains("routing::get(") { "POST" } else { "GET" };
            routes.insert((method.to_owned(), path.to_owned()));
        }
    }
    // The reference page's own, from its library.
    routes.extend(["/docs", "/docs/", "/docs/{*rest}"].map(|path| ("GET".to_owned(), path.to_owned())));
    routes
}

#[test]
fn every_route_says_what_it_needs_and_nothing_else_does() {
    let told: BTreeSet<(String, String)> = guarded_routes().map(|(method, path, _)| (method.to_owned(), path.to_owned())).collect();
    let there = all_routes();
    assert_eq!(there.difference(&told).collect::<Vec<_>>(), Vec::<&(String, String)>::new(), "routes without a row in http/access.rs");
    assert_eq!(told.difference(&there).collect::<Vec<_>>(), Vec::<&(String, String)>::new(), "rows without a route");
}

#[tokio::test]
async fn every_route_lets_in_whom_it_should_and_nobody_else() {
    // Every wrong key is to be refused as such.
    let patient = Attempts::new(NonZeroU32::MAX);
    let guarded = Guarded::with(Some(instant()), Standing::default(), patient, |state| state).await;
    let [submit, read, admin] = Scope::ALL.map(|scope| (scope, guarded.key("ours", &[scope])));
    let stranger = guarded.key("theirs", &[Scope::Admin]);
    let none = guarded.key("ours", &[]);
    let expired = key(&guarded.file, "ours", &Scope::ALL, Wished::default(), Some(Timestamp::now() - SignedDuration::from_secs(1)));
    guarded.access.refresh().unwrap();
    let wrong = format!("{}x", admin.1);
    for (method, route, needed) in guarded_routes() {
        // A job of its own for each route: one of them deletes.
        let path = filled(route, &guarded.finished(7, &admin.1).await);
        let about_a_job = route.contains("{id}") && route.starts_with("/v1/");
        let Some(needed) = needed else {
            for key in [None, Some(wrong.as_str()), Some(none.as_str())] {
                let status = guarded.ask(method, &path, key).await.status.as_u16();
                assert!(![401, 403, 429].contains(&status), "{method} {route} is for everybody: {status}");
            }
            continue;
        };
        for (key, code) in [(None, "credentials_missing"), (Some(&wrong), "credentials_invalid"), (Some(&expired), "credentials_expired")] {
            let answer = guarded.ask(method, &path, key.map(String::as_str)).await;
            if method != "HEAD" {
                answer.problem(401, code);
            }
            let challenges: Vec<_> = answer.headers.get_all("www-authenticate").iter().map(|value| value.to_str().unwrap()).collect();
            assert!(challenges[0].starts_with("Bearer realm=") && challenges[1].starts_with("Basic realm="), "{challenges:?}");
        }
        guarded.ask(method, &path, Some(&none)).await.problem(403, "insufficient_scope");
        for (scope, key) in [&submit, &read] {
            if *scope != needed {
                let answer = guarded.ask(method, &path, Some(key)).await;
                answer.problem(403, "insufficient_scope");
                assert!(answer.header("www-authenticate").contains(&format!("scope=\"{}\"", needed.name())));
            }
        }
        if about_a_job {
            guarded.ask(method, &path, Some(&stranger)).await.problem(404, "not_found");
        }
        let keys: Vec<&str> = [&submit, &read, &admin]
            .into_iter()
            .filter(|(scope, _)| *scope == needed || *scope == Scope::Admin)
            .map(|(_, key)| key.as_str())
            .collect();
        for key in keys {
            let status = guarded
                .service
                .router
                .clone()
                .oneshot(request(method, &path, &[("authorization", &format!("Bearer {key}"))], Body::empty()))
                .await
                .unwrap()
                .status()
                .as_u16();
            // What the route then does is not asked here: the results of this work are none.
            assert!(![401, 403, 429].contains(&status), "{method} {route} with the scope {}: {status}", needed.name());
        }
    }
}

#[tokio::test]
async fn a_key_comes_as_bearer_or_as_the_password_of_basic() {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let guarded = Guarded::new(None, Standing::default()).await;
    let key = guarded.key("ours", &[Scope::Read]);
    let list = async |value: String| guarded.service.call("GET", "/v1/reconstructions", &[("authorization", &value)]).await;
    assert_eq!(list(format!("Bearer {key}")).await.status, 200);
    assert_eq!(list(format!("Basic {}", STANDARD.encode(format!("pacs:{key}")))).await.status, 200);
    assert_eq!(list(format!("Basic {}", STANDARD.encode(format!(":{key}")))).await.status, 200);
    for wrong in
        [format!("Basic {}", STANDARD.encode(format!("{key}:"))), format!("Token {key}"), "Basic ?".to_owned(), "Bearer".to_owned()]
    {
        list(wrong).await.problem(401, "credentials_invalid");
    }
    // HEAD is guarded as GET is.
    assert_eq!(guarded.ask("HEAD", "/v1/reconstructions", None).await.status, 401);
    assert_eq!(guarded.ask("PUT", "/v1/reconstructions", None).await.status, 401);
}

#[tokio::test]
async fn pages_of_other_sites_cannot_use_what_a_browser_keeps() {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let guarded = Guarded::new(Some(instant()), Standing::default()).await;
    let key = guarded.key("ours", &[Scope::Submit, Scope::Read]);
    let path = guarded.finished(1, &key).await;
    let (basic, bearer) = (format!("Basic {}", STANDARD.encode(format!("x:{key}"))), format!("Bearer {key}"));
    let delete = async |authorization: &str, site: &str| {
        guarded.service.call("DELETE", &path, &[("authorization", authorization), ("sec-fetch-site", site)]).await
    };
    delete(&basic, "cross-site").await.problem(403, "cross_site_request");
    delete(&basic, "same-site").await.problem(403, "cross_site_request");
    assert_eq!(delete(&bearer, "cross-site").await.status, 204, "whoever writes the header knows the key");
    let path = guarded.finished(2, &key).await;
    let answer = guarded.service.call("DELETE", &path, &[("authorization", &basic), ("sec-fetch-site", "same-origin")]).await;
    assert_eq!(answer.status, 204);
    // Where nothing is encrypted browsers send `Origin` alone.
    let path = guarded.finished(3, &key).await;
    let delete = async |origin: &str| {
        let headers = [("authorization", basic.as_str()), ("host", "spect.example:8080"), ("origin", origin)];
        guarded.service.call("DELETE", &path, &headers).await
    };
    for elsewhere in ["http://evil.example", "http://spect.example", "null"] {
        delete(elsewhere).await.problem(403, "cross_site_request");
    }
    assert_eq!(delete("http://spect.example:8080").await.status, 204);
}

#[tokio::test]
async fn owners_neither_see_nor_disturb_each_other() {
    let guarded = Guarded::new(Some(instant()), Standing::default()).await;
    let both = [Scope::Submit, Scope::Read];
    let (ours, colleague, theirs) = (guarded.key("ours", &both), guarded.key("ours", &both), guarded.key("theirs", &both));
    let (job, other) = (guarded.finished(1, &ours).await, guarded.finished(2, &theirs).await);
    let listed = async |key: &str| -> Vec<String> {
        let list = guarded.ask("GET", "/v1/reconstructions", Some(key)).await.json();
        list["reconstructions"].as_array().unwrap().iter().map(|job| job["links"]["self"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(
        (listed(&ours).await, listed(&colleague).await, listed(&theirs).await),
        (vec![job.clone()], vec![job.clone()], vec![other.clone()])
    );
    let id = other.rsplit('/').next().unwrap();
    guarded.ask("GET", &format!("{job}/comparison?with={id}"), Some(&ours)).await.problem(404, "not_found");
    guarded.ask("DELETE", &other, Some(&ours)).await.problem(404, "not_found");
    assert_eq!(guarded.ask("GET", &other, Some(&theirs)).await.status, 200, "it is still there");
    // The same idempotency key is another's.
    let submit = async |key: &str, seed: u16| {
        let headers = [("content-type", "application/json"), ("idempotency-key", "once")];
        guarded.ask_with("POST", "/v1/reconstructions", Some(key), &headers, Body::from(study(seed).to_string())).await
    };
    let (first, second) = (submit(&ours, 3).await, submit(&theirs, 4).await);
    assert_eq!((first.status.as_u16(), second.status.as_u16()), (202, 202));
    assert_eq!(submit(&colleague, 3).await.json()["id"], first.json()["id"]);
}

/// What a listener hears, up to an event that contains a text.
async fn heard(guarded: &Guarded, key: &str) -> futures_util::stream::BoxStream<'static, String> {
    let bearer = format!("Bearer {key}");
    let asked = request("GET", "/v1/reconstructions/events", &[("accept", "text/event-stream"), ("authorization", &bearer)], Body::empty());
    let response = guarded.service.router.clone().oneshot(asked).await.unwrap();
    assert_eq!(response.status(), 200);
    response.into_body().into_data_stream().map(|chunk| String::from_utf8(chunk.unwrap().to_vec()).unwrap()).boxed()
}

#[tokio::test]
async fn listeners_hear_of_their_owner_alone_and_no_more_when_their_key_is_revoked() {
    let go = Arc::new(AtomicBool::new(true));
    let guarded = Guarded::new(Some(held(Arc::clone(&go))), Standing::default()).await;
    let both = [Scope::Submit, Scope::Read];
    let (ours, theirs) = (guarded.key("ours", &both), guarded.key("theirs", &both));
    let mut listener = heard(&guarded, &ours).await;
    let (other, job) = (guarded.finished(1, &theirs).await, guarded.finished(2, &ours).await);
    assert_eq!(guarded.ask("DELETE", &other, Some(&theirs)).await.status, 204);
    assert_eq!(guarded.ask("DELETE", &job, Some(&ours)).await.status, 204);
    let id = |path: &str| path.rsplit('/').next().unwrap().to_owned();
    let mut text = String::new();
    while !text.contains("event: deleted") {
        text += &tokio::time::timeout(Duration::from_secs(20), listener.next()).await.expect("nothing is told").unwrap();
    }
    assert!(text.contains(&id(&job)) && !text.contains(&id(&other)), "{text}");
    assert_eq!(text.matches("event: hello").count(), 1, "{text}");
    // Revoked: the next event is not told any more.
    let name = ours.split('_').nth(1).unwrap();
    access::revoke(&guarded.file, name).unwrap();
    guarded.access.refresh().unwrap();
    let again = guarded.key("ours", &both);
    guarded.finished(3, &again).await;
    let rest = tokio::time::timeout(Duration::from_secs(20), listener.collect::<Vec<_>>()).await.expect("the stream ends");
    assert!(!rest.concat().contains("event: job"), "{rest:?}");
    guarded.ask("GET", "/v1/reconstructions", Some(&ours)).await.problem(401, "credentials_invalid");
    go.store(true, Ordering::SeqCst);
}

#[tokio::test]
async fn wrong_keys_are_told_to_wait_and_right_ones_are_not() {
    let guarded = Guarded::new(None, Standing::default()).await;
    let key = guarded.key("ours", &[Scope::Read]);
    let mut statuses = Vec::new();
    for _ in 0..30 {
        statuses.push(guarded.ask("GET", "/v1/reconstructions", Some("ventricle_000000000000_x")).await.status.as_u16());
    }
    assert_eq!((statuses[0], statuses[29]), (401, 429), "{statuses:?}");
    let answer = guarded.ask("GET", "/v1/reconstructions", Some("ventricle_000000000000_x")).await;
    answer.problem(429, "too_many_attempts");
    assert!(answer.header("retry-after").parse::<u64>().unwrap() >= 1);
    assert_eq!(guarded.ask("GET", "/v1/reconstructions", Some(&key)).await.status, 200, "who shares the address with it is let in");
    assert_eq!(guarded.ask("GET", "/v1/reconstructions", None).await.status, 401, "to be asked is no attempt");
}

#[test]
fn the_contract_says_what_each_operation_needs() {
    let contract: Value = serde_json::to_value(openapi_document()).unwrap();
    assert_eq!(contract["components"]["securitySchemes"]["bearer"]["scheme"], "bearer");
    assert_eq!(contract["components"]["securitySchemes"]["basic"]["scheme"], "basic");
    for (method, path, needed) in guarded_routes() {
        let operation = &contract["paths"][path][method.to_lowercase()];
        if operation.is_null() {
            continue;
        }
        let refusals = ["401", "403", "429"].map(|status| operation["responses"][status].is_object());
        assert_eq!(refusals, [needed.is_some(); 3], "{method} {path}");
        let schemes = operation["security"].as_array().unwrap();
        assert_eq!(schemes.len(), if needed.is_some() { 2 } else { 0 }, "{method} {path}");
    }
}
