//! The HTTP service: routes, layers and what handlers share.
//!
//! A handler extracts, makes one domain call and shows the answer; errors of all layers become problem documents in `problem` and nowhere
//! else. The OpenAPI document is made from the very routes that serve.

#![expect(clippy::result_large_err, reason = "a refusal is made once a request: moving it costs nothing beside writing it as JSON")]

mod access;
mod activity;
mod admission;
mod again;
mod archived;
mod body;
mod client;
mod comparison;
mod configured;
mod connections;
mod demonstration;
mod dicomweb;
mod docs;
mod events;
mod extract;
mod health;
mod layers;
mod listener;
mod multipart;
mod negotiate;
mod news;
mod pace;
mod pictures;
mod problem;
mod reconstructions;
mod results;
mod service;
mod site;
mod slices;
mod stored;
mod traces;
mod uploads;
mod viewer;
mod views;
mod wishes;

pub use access::routes as guarded_routes;
pub use health::{Check, Checks};
pub use problem::Problem;
pub use service::{Running, ServeError, serve, start};
pub use views::{CallbackView, JobListView, JobState, JobView, Links, ProgressView, callback_body};

use self::pace::Pace;
use crate::{
    access::{Access, Audit},
    assembly::{self, Assembler, NotParsed, Parsers},
    callbacks::Rules,
    codecs::Decoder,
    config::{Cors, Hosts},
    intake,
    jobs::Store,
    telemetry,
    traces::Traces,
};
use axum::{Router, http::StatusCode, middleware};
use metrics_exporter_prometheus::PrometheusHandle;
use std::{path::PathBuf, sync::Arc, time::Duration};
use tokio_util::sync::CancellationToken;
use tower_http::{catch_panic::CatchPanicLayer, timeout::TimeoutLayer};
use utoipa::OpenApi as _;
use utoipa_axum::{router::OpenApiRouter, routes};

/// Studies parsed at once. One takes up to some 300 MB ([`intake::Limits`]); parsing is short beside reconstructing.
const PARSED_AT_ONCE: usize = 2;
/// Time an answer may take: the longest wait a client can ask for, and as much again as a loaded disk needs.
const ANSWER_TIME: Duration = Duration::from_secs(45);
/// Most bytes of a request with a whole study, if nothing else is said: rest and stress with projections, CT and screens were seen to have 300 MB.
const STUDY_BYTES: u64 = 1 << 30;
/// Pause after which a series is taken as it is, if nothing else is said: PACS send one instance right after the other.
const QUIET: Duration = Duration::from_secs(10);
/// Longest time in which no byte of a body comes: connections over which people work lose packets for some seconds, not for more.
const BODY_PAUSE: Duration = Duration::from_secs(30);
/// Bodies received at once, if nothing else is said, and the bytes that they may hold.
const UPLOADS: (usize, u64) = (64, 512 << 20);
/// Longest a client may have its job kept, if nothing else is said: a year.
const LONGEST_RETENTION: Duration = Duration::from_hours(365 * 24);

/// What handlers share. Clones are cheap.
#[derive(Clone)]
pub struct AppState {
    store: Store,
    limits: Arc<intake::Limits>,
    /// Most bytes of a request that holds a whole study, of which most may be none of ours.
    study_bytes: u64,
    /// When a series that does not say how much of it there is goes without more.
    quiet: Duration,
    pace: Pace,
    uploads: uploads::Uploads,
    longest_retention: Duration,
    keep_patient: bool,
    parsers: Parsers,
    workers_alive: Arc<dyn Fn() -> bool + Send + Sync>,
    disk: Option<Disk>,
    cors: Cors,
    /// How long browsers are to come by HTTPS only, where the service encrypts.
    hsts_seconds: Option<u64>,
    callbacks: Option<Arc<Rules>>,
    phantom: Arc<demonstration::Made>,
    viewer: viewer::Files,
    access: Arc<Access>,
    /// Names under which everybody may come in where nobody is asked.
    hosts: Arc<Hosts>,
    audit: Option<Audit>,
    traces: Traces,
    draining: CancellationToken,
    metrics: PrometheusHandle,
    openapi: Arc<str>,
}

impl axum::extract::FromRef<AppState> for viewer::Files {
    fn from_ref(state: &AppState) -> Self {
        Self::clone(&state.viewer)
    }
}

/// Room a directory must have.
#[derive(Debug, Clone)]
struct Disk {
    directory: PathBuf,
    bytes: u64,
}

impl AppState {
    /// State over a store, with the default limits and nobody else to ask.
    pub fn new(store: Store) -> Self {
        Self {
            store,
            limits: Arc::default(),
            study_bytes: STUDY_BYTES,
            quiet: QUIET,
            pace: Pace { pause: BODY_PAUSE, time: Duration::from_mins(2), longer_by_bytes: u64::MAX },
            uploads: uploads::Uploads::new(UPLOADS.0, UPLOADS.1),
            longest_retention: LONGEST_RETENTION,
            keep_patient: false,
            parsers: Parsers::new(PARSED_AT_ONCE),
            workers_alive: Arc::new(|| true),
            disk: None,
            cors: Cors::Off,
            hsts_seconds: None,
            callbacks: None,
            phantom: Arc::default(),
            viewer: viewer::embedded(),
            access: Arc::new(Access::open()),
            hosts: Arc::new(Hosts::Any),
            audit: None,
            traces: Traces::default(),
            draining: CancellationToken::new(),
            metrics: telemetry::metrics(),
            openapi: openapi_json().into(),
        }
    }

    /// With another limit on the bytes of a body.
    #[must_use]
    pub fn with_body_limit(mut self, bytes: usize) -> Self {
        Arc::make_mut(&mut self.limits).body_bytes = bytes;
        self
    }

    /// With a program that decodes compressed images. Without one they are refused.
    #[must_use]
    pub fn with_decoder(mut self, decoder: Decoder) -> Self {
        Arc::make_mut(&mut self.limits).decoder = Some(decoder);
        self
    }

    /// With another limit on the bytes of a request that holds a whole study, and another time after which a series is taken as it is.
    #[must_use]
    pub fn with_studies(self, study_bytes: u64, quiet: Duration) -> Self {
        Self { study_bytes, quiet, ..self }
    }

    /// With another time for a body to arrive.
    #[must_use]
    pub fn with_upload_time(mut self, time: Duration) -> Self {
        self.pace.time = time;
        self
    }

    /// With another time that a body may make a pause.
    #[must_use]
    pub fn with_upload_pause(mut self, pause: Duration) -> Self {
        self.pace.pause = pause;
        self
    }

    /// With another limit on bodies received at once and the bytes that they may hold, and another time to wait for room.
    #[must_use]
    pub fn with_uploads(self, at_once: usize, bytes: u64, patience: Duration) -> Self {
        Self { uploads: uploads::Uploads::with_patience(at_once, bytes, patience), ..self }
    }

    /// Telling browsers to come by HTTPS only for so many seconds.
    #[must_use]
    pub fn with_hsts(self, seconds: u64) -> Self {
        Self { hsts_seconds: Some(seconds), ..self }
    }

    /// With another limit on how long a client may have its job kept.
    #[must_use]
    pub fn with_longest_retention(self, longest_retention: Duration) -> Self {
        Self { longest_retention, ..self }
    }

    /// Keeping whom DICOM studies are of, for DICOM results.
    #[must_use]
    pub fn with_patients_kept(self, keep_patient: bool) -> Self {
        Self { keep_patient, ..self }
    }

    /// With someone who knows whether the workers run.
    #[must_use]
    pub fn with_workers(self, alive: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self { workers_alive: Arc::new(alive), ..self }
    }

    /// With a directory that must have room.
    #[must_use]
    pub fn with_disk(self, directory: PathBuf, bytes: u64) -> Self {
        Self { disk: Some(Disk { directory, bytes }), ..self }
    }

    /// With pages of other origins that may call.
    #[must_use]
    pub fn with_cors(self, cors: Cors) -> Self {
        Self { cors, ..self }
    }

    /// With callbacks, under these rules. Without them a `callback_url` is refused.
    #[must_use]
    pub fn with_callbacks(self, rules: Rules) -> Self {
        Self { callbacks: Some(Arc::new(rules)), ..self }
    }

    /// Called by these names only, where nobody is asked who he is.
    #[must_use]
    pub fn with_hosts(self, hosts: Hosts) -> Self {
        Self { hosts: Arc::new(hosts), ..self }
    }

    /// Asking callers who they are. Without it everybody may do everything.
    #[must_use]
    pub fn with_access(self, access: Access) -> Self {
        Self { access: Arc::new(access), ..self }
    }

    /// Telling who did what.
    #[must_use]
    pub fn with_audit(self, audit: Audit) -> Self {
        Self { audit: Some(audit), ..self }
    }

    /// Telling what requests took.
    #[must_use]
    pub fn with_traces(self, traces: Traces) -> Self {
        Self { traces, ..self }
    }

    /// With another viewer than the one built in: its files by name. With none, the root says that there is no viewer.
    #[must_use]
    pub fn with_viewer(self, files: std::collections::BTreeMap<String, Vec<u8>>) -> Self {
        Self { viewer: viewer::given(files), ..self }
    }

    /// Cancel it to refuse new work, end waiting answers and call the service not ready.
    pub fn draining(&self) -> CancellationToken {
        self.draining.clone()
    }

    /// What puts studies together from DICOM instances.
    pub fn assembler(&self) -> Assembler {
        let settings = assembly::Settings {
            limits: intake::Limits::clone(&self.limits),
            quiet: self.quiet,
            keep_subject: self.keep_patient,
            callback_url: self.callbacks.as_ref().and_then(|rules| rules.default_url.clone()),
        };
        Assembler::new(self.store.clone(), settings, self.parsers.clone(), Arc::clone(&self.access))
    }

    fn accepts_work(&self) -> Result<(), Problem> {
        if self.draining.is_cancelled() { Err(Problem::draining()) } else { Ok(()) }
    }

    /// Runs a parser on a thread that may take its time, no more than [`PARSED_AT_ONCE`] at once.
    async fn parse<T: Send + 'static>(
        &self,
        parser: impl FnOnce(&intake::Limits) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        let limits = Arc::clone(&self.limits);
        self.parsers.run(move || parser(&limits)).await.unwrap_or_else(|error| match error {
            NotParsed::Closed => Err(Problem::draining()),
            NotParsed::Panicked => Err(Problem::internal()),
        })
    }
}

/// The routes of the contract, each with its documentation.
fn routes() -> OpenApiRouter<AppState> {
    let timeout = || TimeoutLayer::with_status_code(StatusCode::SERVICE_UNAVAILABLE, ANSWER_TIME);
    let timely = OpenApiRouter::new()
        .routes(routes!(reconstructions::list))
        .routes(routes!(reconstructions::get, reconstructions::delete))
        .routes(routes!(events::events))
        .routes(routes!(news::news))
        .routes(routes!(results::report))
        .routes(routes!(results::surfaces))
        .routes(routes!(results::endocardial))
        .routes(routes!(results::epicardial))
        .routes(routes!(results::wall))
        .routes(routes!(comparison::comparison))
        .routes(routes!(results::polar_maps))
        .routes(routes!(slices::slices))
        .routes(routes!(slices::picture))
        .routes(routes!(pictures::polar_map))
        .routes(routes!(pictures::report_page))
        .routes(routes!(archived::sr))
        .routes(routes!(archived::fhir))
        .routes(routes!(archived::endocardial_stl))
        .routes(routes!(archived::epicardial_stl))
        .routes(routes!(archived::endocardial_stl_dicom))
        .routes(routes!(archived::epicardial_stl_dicom))
        .routes(routes!(docs::list_parameters))
        .routes(routes!(demonstration::phantom))
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::metrics))
        .routes(routes!(docs::openapi))
        .routes(routes!(docs::report_schema))
        .routes(routes!(docs::comparison_schema))
        .layer(timeout());
    // A submission has its own time for the body, and none for being parsed: its place is taken and its size known.
    OpenApiRouter::with_openapi(docs::Contract::openapi())
        .routes(routes!(reconstructions::submit))
        .routes(routes!(again::again))
        .routes(routes!(dicomweb::store))
        .routes(routes!(dicomweb::store_of_study))
        .merge(timely)
}

/// The whole service as one router.
pub fn router(state: AppState) -> Router {
    let (contract, _) = routes().split_for_parts();
    let policies = Arc::new(layers::Policies::new(state.hsts_seconds, &state.cors));
    let router = contract
        .merge(docs::reference())
        .route("/", axum::routing::get(viewer::page))
        .route("/studies/{id}", axum::routing::get(viewer::page))
        .route("/assets/{*file}", axum::routing::get(viewer::file))
        .route("/embed/{*file}", axum::routing::get(viewer::file))
        .fallback(viewer::other)
        // The same with a slash at the end, as configurations written by hand have it: no client of STOW-RS follows a redirect.
        .route("/dicom-web/studies/", axum::routing::post(dicomweb::store))
        .route("/dicom-web/studies/{study_instance_uid}/", axum::routing::post(dicomweb::store_of_study))
        .layer(middleware::from_fn_with_state(state.clone(), access::guard))
        .layer(CatchPanicLayer::custom(layers::panicked))
        .layer(middleware::from_fn(layers::limit_head))
        .layer(middleware::from_fn_with_state((policies, state.traces.clone()), layers::observe));
    let router = match layers::cors(&state.cors) {
        Some(cors) => router.layer(cors),
        None => router,
    };
    router.with_state(state)
}

/// The OpenAPI document of the routes.
pub fn openapi_document() -> utoipa::openapi::OpenApi {
    let mut document = routes().into_openapi();
    docs::document_other_problems(&mut document);
    docs::document_callback(&mut document);
    docs::document_access(&mut document);
    document
}

/// The OpenAPI document as text, as `openapi/openapi.json` has it.
pub fn openapi_json() -> String {
    openapi_document().to_pretty_json().unwrap_or_default() + "\n"
}

/// Takes a body apart as a submission is; the number of its files. For the fuzz target of multipart bodies.
#[doc(hidden)]
pub fn take_apart(content_type: &str, body: Vec<u8>) -> Result<usize, String> {
    multipart::Upload::new(Some(content_type), body.into()).map(|upload| upload.files.len()).map_err(|error| error.to_string())
}
