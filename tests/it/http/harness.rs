//! A service in process: real store in a directory of its own, real workers, work that the test decides.

use axum::{
    Router,
    body::Body,
    http::{HeaderMap, Request, StatusCode},
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use tower::ServiceExt;
use ventricle::{
    http::{AppState, router},
    jobs::{Backend, Output, Store, StoreSettings, Work, WorkError, WorkerSettings, Workers, start_workers},
    pipeline::monitor::Monitor,
};

/// A directory that goes with the test.
pub(super) struct Directory(pub PathBuf);

impl Directory {
    pub(super) fn new() -> Self {
        Self(std::env::temp_dir().join(format!("ventricle-http-{}", uuid::Uuid::now_v7())))
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub(super) struct Service {
    pub router: Router,
    pub state: AppState,
    pub store: Store,
    pub workers: Option<Workers>,
    pub directory: Directory,
}

/// A service without workers: what is submitted stays queued.
pub(super) async fn idle() -> Service {
    with(StoreSettings::default(), None, |state| state).await
}

/// A service whose worker does this.
pub(super) async fn working(work: Work) -> Service {
    with(StoreSettings::default(), Some(work), |state| state).await
}

pub(super) async fn with(settings: StoreSettings, work: Option<Work>, adapt: impl FnOnce(AppState) -> AppState) -> Service {
    let directory = Directory::new();
    let store = Store::open(StoreSettings { backend: Backend::Sqlite { directory: directory.0.clone() }, ..settings }).await.unwrap();
    let quick = Duration::from_millis(20);
    let workers = work.map(|work| {
        let settings = WorkerSettings { work, heartbeat: quick, progress_interval: quick, poll: quick, ..WorkerSettings::default() };
        start_workers(store.clone(), settings).unwrap()
    });
    // Without the viewer, whether it was built or not.
    let state = adapt(AppState::new(store.clone()).with_viewer(BTreeMap::new()));
    Service { router: router(state.clone()), state, store, workers, directory }
}

/// Work that is done at once.
pub(super) fn instant() -> Work {
    Arc::new(|_, _, id, _| Ok(outputs(&id.to_string())))
}

/// Work that fails as a study without a ventricle does.
pub(super) fn failing() -> Work {
    Arc::new(|_, _, _, _| {
        Err(WorkError::Failed { code: "no_left_ventricle", message: "No left ventricle was found: the counts are flat.".into() })
    })
}

/// Work that makes progress and then waits until it is let go or cancelled.
pub(super) fn held(go: Arc<AtomicBool>) -> Work {
    Arc::new(move |_, _, id, progress| {
        progress.advance(1, 4);
        while !go.load(Ordering::SeqCst) {
            if progress.is_cancelled() {
                return Err(WorkError::Cancelled);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(outputs(&id.to_string()))
    })
}

fn outputs(id: &str) -> Vec<Output> {
    let report = json!({"schema": "ventricle.report/1", "id": id}).to_string().into_bytes();
    let glb = |name: &str| Output { name: name.into(), media_type: "model/gltf-binary", data: format!("glTF {name}").into_bytes() };
    vec![
        Output { name: "report".into(), media_type: "application/json", data: report },
        glb("surfaces.glb"),
        glb("gates/1/endocardial.glb"),
        glb("gates/1/epicardial.glb"),
        Output { name: "gates/1/wall.vtu".into(), media_type: "application/xml", data: b"<VTKFile/>".to_vec() },
    ]
}

/// A small study as JSON. Other seeds are other studies.
pub(super) fn study(seed: u16) -> Value {
    let (gates, shape) = (2, [6, 16, 16]);
    let voxels = gates * shape.iter().product::<usize>();
    let counts: Vec<u8> = (0..voxels).flat_map(|i| ((i % 97) as u16 + seed).to_le_bytes()).collect();
    json!({
        "grid": {"gates": gates, "shape": shape, "spacing_mm": [5.0, 5.0, 5.0]},
        "dtype": "uint16", "counts": STANDARD.encode(counts),
    })
}

#[derive(Debug)]
pub(super) struct Answer {
    pub status: StatusCode,
    pub headers: HeaderMap,
    pub bytes: Vec<u8>,
}

impl Answer {
    pub(super) fn json(&self) -> Value {
        serde_json::from_slice(&self.bytes).unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&self.bytes)))
    }

    pub(super) fn header(&self, name: &str) -> &str {
        self.headers.get(name).unwrap_or_else(|| panic!("no {name} in {:?}", self.headers)).to_str().unwrap()
    }

    /// Checks that this is a problem document of this status and code, and returns it.
    pub(super) fn problem(&self, status: u16, code: &str) -> Value {
        assert_eq!(self.header("content-type"), "application/problem+json");
        let problem = self.json();
        assert_eq!((self.status.as_u16(), problem["code"].as_str()), (status, Some(code)), "{problem}");
        assert_eq!(problem["status"], status);
        assert_eq!(problem["type"], format!("urn:problem-type:ventricle:{code}"));
        assert_eq!(problem["request_id"], self.header("x-request-id"));
        assert!(problem["instance"].as_str().unwrap().starts_with('/'));
        assert!(problem["detail"].as_str().unwrap().len() > 10 && !problem["title"].as_str().unwrap().is_empty());
        problem
    }
}

impl Service {
    pub(super) async fn send(&self, request: Request<Body>) -> Answer {
        let response = self.router.clone().oneshot(request).await.unwrap();
        let (parts, body) = response.into_parts();
        let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap().to_vec();
        Answer { status: parts.status, headers: parts.headers, bytes }
    }

    pub(super) async fn call(&self, method: &str, path: &str, headers: &[(&str, &str)]) -> Answer {
        self.send(request(method, path, headers, Body::empty())).await
    }

    pub(super) async fn get(&self, path: &str) -> Answer {
        self.call("GET", path, &[]).await
    }

    pub(super) async fn post(&self, query: &str, headers: &[(&str, &str)], body: impl Into<Body>) -> Answer {
        self.send(request("POST", &format!("/v1/reconstructions{query}"), headers, body.into())).await
    }

    /// Submits a small study and returns the path of its job.
    pub(super) async fn submit(&self, seed: u16) -> String {
        let answer = self.post("", &[("content-type", "application/json")], study(seed).to_string()).await;
        assert_eq!(answer.status, 202, "{}", answer.json());
        answer.header("location").to_owned()
    }

    /// Submits a study and waits for its end.
    pub(super) async fn finish(&self, seed: u16) -> String {
        let path = self.submit(seed).await;
        let answer = self.call("GET", &path, &[("prefer", "wait=20")]).await;
        assert!(["succeeded", "failed"].contains(&answer.json()["state"].as_str().unwrap()), "{}", answer.json());
        path
    }

    /// Waits until a job is in a state.
    pub(super) async fn reach(&self, path: &str, state: &str) -> Value {
        for _ in 0..400 {
            let job = self.get(path).await.json();
            if job["state"] == state {
                return job;
            }
            tokio::time::sleep(Duration::from_millis(25)).await;
        }
        panic!("{path} did not become {state}");
    }
}

pub(super) fn request(method: &str, path: &str, headers: &[(&str, &str)], body: Body) -> Request<Body> {
    let builder = Request::builder().method(method).uri(path);
    headers.iter().fold(builder, |builder, (name, value)| builder.header(*name, *value)).body(body).unwrap()
}
