//! What clients see of jobs.

use super::problem::Problem;
use crate::{
    jobs::{Job, Page, State},
    report::Summary,
};
use axum::{
    Json,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Seconds between two looks at a job that is not finished, when the queue says nothing better.
const POLL_S: f64 = 1.0;
/// Most seconds a client is told to wait before it looks again.
const LONGEST_POLL_S: f64 = 30.0;

/// The bytes of a file.
#[derive(Debug, ToSchema)]
#[schema(value_type = String, format = Binary)]
pub(super) struct Binary(#[expect(dead_code, reason = "documents bodies that are passed on as they are")] Vec<u8>);

/// A reconstruction and how far it is.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Job, example = json!({
    "id": "0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11", "state": "running",
    "progress": {"fraction": 0.42, "stage": "model_fit", "gates_done": 3, "gates_total": 8},
    "queue_position": null, "eta_seconds": 1.8, "attempt": 1, "cancel_requested": false, "study_instance_uid": null,
    "created_at": "2026-01-02T03:04:05Z", "started_at": "2026-01-02T03:04:06Z", "finished_at": null, "expires_at": null,
    "input_kept": true, "error": null, "summary": null,
    "links": {
        "self": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11",
        "events": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/events",
        "report": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/report",
        "surfaces": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/surfaces.glb",
        "polar_maps": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/polar-maps",
        "page": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/report.html",
        "sr": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/sr.dcm",
        "fhir": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/fhir",
        "slices": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/slices",
        "wall": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/gates/1/wall.vtu",
        "endocardial_stl": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/gates/1/endocardial.stl",
        "epicardial_stl": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/gates/1/epicardial.stl",
        "again": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/again"
    }
}))]
pub struct JobView {
    /// UUID; ids of later jobs sort after those of earlier ones.
    #[schema(format = "uuid")]
    pub id: String,
    /// Where the job is in its life; the last three states are final.
    pub state: JobState,
    /// How far it is.
    pub progress: ProgressView,
    /// Place in the queue, from 1; null when it is not waiting.
    #[schema(required)]
    pub queue_position: Option<u64>,
    /// Estimated time to the end in s; null when finished or when nothing was measured yet.
    #[schema(required)]
    pub eta_seconds: Option<f64>,
    /// How often a worker began the job: more than 1 after a crash or a restart.
    pub attempt: u32,
    /// Whether it was asked to stop.
    pub cancel_requested: bool,
    /// DICOM Study Instance UID of the input, if it has one.
    #[schema(required)]
    pub study_instance_uid: Option<String>,
    /// When it was accepted, RFC 3339 in UTC.
    #[schema(format = DateTime)]
    pub created_at: String,
    /// When the latest attempt began.
    #[schema(required, format = DateTime)]
    pub started_at: Option<String>,
    /// When it reached its final state.
    #[schema(required, format = DateTime)]
    pub finished_at: Option<String>,
    /// When it is deleted with all its data; null while it is not finished, and where it is kept until someone deletes it.
    #[schema(required, format = DateTime)]
    pub expires_at: Option<String>,
    /// Whether its input is there: true until its end, and after it where it is kept (`keep_input`, `--keep-input`). Pictures of slices and `again` need it.
    pub input_kept: bool,
    /// Why it failed; null unless `state` is `failed`.
    #[schema(required)]
    pub error: Option<Problem>,
    /// The result in a few numbers; null unless `state` is `succeeded`, and in jobs of versions that did not store it.
    #[schema(required)]
    pub summary: Option<Summary>,
    /// Where everything about it is.
    pub links: Links,
}

/// What a callback says: that a job has reached its final state. Nothing of the patient or the study.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Callback, example = json!({
    "id": "0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11", "state": "failed", "version": 9, "finished_at": "2026-01-02T03:04:09Z",
    "error_code": "no_left_ventricle",
    "links": {
        "self": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11",
        "events": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/events",
        "report": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/report",
        "surfaces": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/surfaces.glb",
        "polar_maps": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/polar-maps",
        "page": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/report.html",
        "sr": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/sr.dcm",
        "fhir": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/fhir",
        "slices": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/slices",
        "wall": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/gates/1/wall.vtu",
        "endocardial_stl": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/gates/1/endocardial.stl",
        "epicardial_stl": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/gates/1/epicardial.stl",
        "again": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/again"
    }
}))]
pub struct CallbackView {
    /// The job.
    #[schema(format = "uuid")]
    pub id: String,
    /// `succeeded`, `failed` or `cancelled`.
    pub state: JobState,
    /// The job's version, as in its `ETag`.
    pub version: i64,
    /// When it reached its final state, RFC 3339 in UTC.
    #[schema(required, format = DateTime)]
    pub finished_at: Option<String>,
    /// The code of its error; null unless `state` is `failed`.
    #[schema(required)]
    pub error_code: Option<String>,
    /// Where everything about it is, as paths on the service.
    pub links: Links,
}

impl From<&Job> for CallbackView {
    fn from(job: &Job) -> Self {
        Self {
            id: job.id.to_string(),
            state: job.state.into(),
            version: job.version,
            finished_at: job.finished_at.map(|time| time.to_string()),
            error_code: job.error.as_ref().map(|error| error.code.clone()),
            links: Links::of(job),
        }
    }
}

/// The body of a callback.
pub fn callback_body(job: &Job) -> Vec<u8> {
    serde_json::to_vec(&CallbackView::from(job)).unwrap_or_default()
}

/// Where a job is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Accepted, waiting for a worker.
    Queued,
    /// Being computed.
    Running,
    /// Finished with results.
    Succeeded,
    /// Finished without results.
    Failed,
    /// Stopped on request.
    Cancelled,
}

impl From<State> for JobState {
    fn from(state: State) -> Self {
        match state {
            State::Queued => Self::Queued,
            State::Running => Self::Running,
            State::Succeeded => Self::Succeeded,
            State::Failed => Self::Failed,
            State::Cancelled => Self::Cancelled,
        }
    }
}

impl From<JobState> for State {
    fn from(state: JobState) -> Self {
        match state {
            JobState::Queued => Self::Queued,
            JobState::Running => Self::Running,
            JobState::Succeeded => Self::Succeeded,
            JobState::Failed => Self::Failed,
            JobState::Cancelled => Self::Cancelled,
        }
    }
}

/// How far a job is.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Progress)]
pub struct ProgressView {
    /// Part of the work done, 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    pub fraction: f64,
    /// What is being computed; null when not running. Preset `clinical`: `localisation`, `rays`, `model_fit`, `wall`, `measurement`. Preset `paper`:
    /// `region`, `edges`, `borders`, `gradient_vector_flow`, `deformation`, `wall`, `measurement`. Others may be added.
    #[schema(required)]
    pub stage: Option<String>,
    /// Gates finished.
    pub gates_done: u64,
    /// Gates of the study.
    pub gates_total: u64,
}

/// Where everything about a job is, as paths on this server. All but `self`, `events` and `again` answer 409 until the job has succeeded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Links {
    /// The job itself.
    #[serde(rename = "self")]
    pub this: String,
    /// Its progress as server-sent events.
    pub events: String,
    /// Its report.
    pub report: String,
    /// Its surfaces over the cycle as animated glTF.
    pub surfaces: String,
    /// Its polar maps as numbers.
    pub polar_maps: String,
    /// Its report as a page for people.
    pub page: String,
    /// Its measurements as a DICOM structured report.
    pub sr: String,
    /// Its measurements as a FHIR bundle.
    pub fhir: String,
    /// The contours of both surfaces on slices.
    pub slices: String,
    /// The wall of the first gate as tetrahedra; the others have their own number instead of 1.
    pub wall: String,
    /// The inner surface of the first gate as STL, likewise.
    pub endocardial_stl: String,
    /// The outer surface of the first gate as STL, likewise.
    pub epicardial_stl: String,
    /// Where a POST reconstructs the same study once more, while its input is kept.
    pub again: String,
}

impl Links {
    fn of(job: &Job) -> Self {
        let this = path(job);
        Self {
            events: format!("{this}/events"),
            report: format!("{this}/report"),
            surfaces: format!("{this}/surfaces.glb"),
            polar_maps: format!("{this}/polar-maps"),
            page: format!("{this}/report.html"),
            sr: format!("{this}/sr.dcm"),
            fhir: format!("{this}/fhir"),
            slices: format!("{this}/slices"),
            wall: format!("{this}/gates/1/wall.vtu"),
            endocardial_stl: format!("{this}/gates/1/endocardial.stl"),
            epicardial_stl: format!("{this}/gates/1/epicardial.stl"),
            again: format!("{this}/again"),
            this,
        }
    }
}

/// Reconstructions, newest first.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = JobList)]
pub struct JobListView {
    /// The reconstructions of this page.
    pub reconstructions: Vec<JobView>,
    /// Give it as `cursor` to get the next page; null on the last.
    #[schema(required)]
    pub next_cursor: Option<String>,
}

impl From<&Job> for JobView {
    fn from(job: &Job) -> Self {
        Self {
            id: job.id.to_string(),
            state: job.state.into(),
            progress: ProgressView {
                fraction: job.progress,
                stage: job.stage.clone(),
                gates_done: job.gates_done,
                gates_total: job.gates_total,
            },
            queue_position: job.queue_position,
            eta_seconds: job.eta_seconds.map(|seconds| (seconds * 10.0).round() / 10.0),
            attempt: job.attempt,
            cancel_requested: job.cancel_requested,
            study_instance_uid: job.study_instance_uid.clone(),
            created_at: job.created_at.to_string(),
            started_at: job.started_at.map(|time| time.to_string()),
            finished_at: job.finished_at.map(|time| time.to_string()),
            expires_at: job.expires_at.map(|time| time.to_string()),
            input_kept: job.input_kept,
            error: job.error.as_ref().map(Problem::from),
            summary: job.summary.clone(),
            links: Links::of(job),
        }
    }
}

impl From<&Page> for JobListView {
    fn from(page: &Page) -> Self {
        Self {
            reconstructions: page.jobs.iter().map(JobView::from).collect(),
            next_cursor: page.next_cursor.map(|cursor| cursor.to_string()),
        }
    }
}

/// The path of a job.
pub(super) fn path(job: &Job) -> String {
    format!("/v1/reconstructions/{}", job.id)
}

/// The entity tag of a job: its version and its place in the queue, which moves without the job changing. Weak, since the estimate of the
/// time left is not in it.
pub(super) fn etag(job: &Job) -> String {
    match job.queue_position {
        Some(position) => format!("W/\"{}-{position}\"", job.version),
        None => format!("W/\"{}\"", job.version),
    }
}

/// A job as a response, with its entity tag and, while it is not finished, when to look again.
pub(super) fn job(status: StatusCode, job: &Job) -> Response {
    with_job_headers((status, Json(JobView::from(job))).into_response(), job)
}

/// That the client's copy of a job is still right.
pub(super) fn job_not_modified(job: &Job) -> Response {
    with_job_headers(StatusCode::NOT_MODIFIED.into_response(), job)
}

fn with_job_headers(mut response: Response, job: &Job) -> Response {
    let headers = response.headers_mut();
    if let Ok(tag) = HeaderValue::from_str(&etag(job)) {
        headers.insert(header::ETAG, tag);
    }
    if !job.state.is_final() {
        let seconds = job.eta_seconds.unwrap_or(POLL_S).clamp(POLL_S, LONGEST_POLL_S).ceil();
        headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds as u64));
    }
    response
}
