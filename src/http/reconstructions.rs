//! Reconstructions as a resource: submit, list, look, cancel, delete.

use super::{
    AppState,
    access::{About, Calling},
    body,
    extract::{Id, Query},
    multipart::{Upload, merged_parameters},
    negotiate,
    problem::Problem,
    uploads::Room,
    views::{self, Binary, JobListView, JobState, JobView},
    wishes::{Rules, Wishes},
};
use crate::{
    access::{Caller, Scope},
    intake, jobs,
    jobs::{Deletion, Job, ListQuery, NewJob, Reservation, Submitted},
    parameters,
    study::Format,
};
use axum::{
    Json,
    body::{Body, Bytes},
    extract::State,
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Deserialize;
use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};
use utoipa::IntoParams;
use uuid::Uuid;

/// Longest idempotency key: enough for any UUID or digest a client derives.
const LONGEST_KEY: usize = 255;

/// Query of a submission.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Query)]
#[expect(dead_code, reason = "documents the query; what is read are its raw pairs, since parameters may be given by dotted names")]
pub(super) struct SubmitQuery {
    /// The named set of parameters to start from: `clinical` (the default) or `paper`.
    #[param(example = "clinical")]
    preset: Option<String>,
    /// Distance between voxel centres along slices, rows and columns in mm, `z,y,x`. Needed with `application/x-npy`, which cannot say it, and
    /// refused with all else, which says it.
    #[param(example = "5.74,2.87,2.87")]
    spacing_mm: Option<String>,
    /// Any other parameter by its dotted name, as `mesh.level=4&region.centre_mm=90,85`. Wins over those of the part `parameters` and of a JSON body.
    #[param(style = Form, explode, example = json!({"mesh.level": "3"}))]
    parameters: Option<BTreeMap<String, String>>,
}

/// A study as JSON.
#[derive(Debug, utoipa::ToSchema)]
#[schema(example = json!({
    "grid": {"gates": 8, "shape": [24, 64, 64], "spacing_mm": [5.74, 2.87, 2.87]},
    "dtype": "uint16", "counts": "<base64 of little-endian numbers>", "parameters": {"mesh": {"level": 3}}
}))]
#[expect(dead_code, reason = "documents the body; `intake` reads it")]
pub(super) struct JsonStudy {
    /// The lattice.
    #[schema(inline)]
    grid: JsonGrid,
    /// Type of the numbers in `counts`: `uint16` or `float32`.
    #[schema(example = "uint16")]
    dtype: String,
    /// Counts in the order gate, slice, row, column; little-endian; base64.
    counts: String,
    /// How to reconstruct.
    parameters: Option<parameters::Request>,
}

/// A study as a form.
#[derive(Debug, utoipa::ToSchema)]
#[expect(dead_code, reason = "documents the body; `body` takes it apart")]
pub(super) struct MultipartStudy {
    /// DICOM files of one series, or one file of another format; the name of the part does not matter.
    file: Vec<Binary>,
    /// How to reconstruct.
    parameters: Option<parameters::Request>,
}

/// The lattice of a study as JSON.
#[derive(Debug, utoipa::ToSchema)]
#[expect(dead_code, reason = "documents the body; `intake` reads it")]
pub(super) struct JsonGrid {
    /// Gates; 1 for an ungated study.
    #[schema(minimum = 1, maximum = 64)]
    gates: usize,
    /// Slices, rows, columns.
    shape: [usize; 3],
    /// Distance between voxel centres along slices, rows, columns in mm.
    spacing_mm: [f64; 3],
}

/// Submits a study.
///
/// The body is recognised by its content; the `Content-Type` decides only where the content does not say, and for multipart. What is
/// wrong with the file or the parameters is answered at once (4xx); 202 means that the job is stored on disk and will be worked on, whatever
/// happens to the service. Send an `Idempotency-Key` to be able to repeat a request safely: the same key with the same request gives the
/// same job, as long as that is there: when it was deleted or has expired, the key is free again.
#[utoipa::path(
    post, path = "/v1/reconstructions", operation_id = "submitReconstruction", tag = "reconstructions",
    params(
        SubmitQuery,
        ("Idempotency-Key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[ -~]+$", description = "Up to 255 visible ASCII characters of the client's choice, one for each request meant."),
    ),
    request_body(description = "One study. Multipart bodies hold several DICOM files (one multi-frame, or one file a slice or gate) or one NIfTI file, \
                                and may have a part named `parameters` with JSON.", content(
        (Binary = "application/dicom"), (Binary = "application/x-nifti"), (Binary = "application/gzip"), (Binary = "application/x-npy"),
        (JsonStudy = "application/json"), (MultipartStudy = "multipart/form-data"), (Binary = "multipart/related"), (Binary = "application/octet-stream"),
    )),
    responses(
        (status = 202, description = "Accepted and stored; `Location` leads to the job", body = JobView,
         headers(("Location" = String, description = "Path of the job"), ("Retry-After" = u64, description = "Seconds until looking is worth it"))),
        (status = 200, description = "The job that an earlier request with the same `Idempotency-Key` made", body = JobView),
        (status = 400, description = "The body does not follow its own format", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The body came too slowly", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "Larger than accepted", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "A format or encoding that is not read here", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Understood and refused: not a reconstructed nuclear medicine study, parameters unknown or out of range, \
                                      idempotency key used for another request", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The queue is full (`queue_full`), no room for bodies is left (`uploads_full`), the database is away or full (`store_unavailable`), compressed images cannot be decoded now (`decoder_unavailable`), or the service is stopping (`draining`); `Retry-After` says when to try again", body = Problem,
         content_type = "application/problem+json", headers(("Retry-After" = u64, description = "Seconds"))),
    ),
)]
pub(super) async fn submit(
    State(state): State<AppState>,
    calling: Calling,
    Query(query): Query<Vec<(String, String)>>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let (idempotency_key, mut reservation, room) = match admit(&state, &calling, &headers).await {
        Ok(admitted) => admitted,
        Err(refusal) => {
            body::discard(&headers, body, state.limits.body_bytes as u64).await;
            return Err(refusal);
        }
    };
    let bytes = body::read(&headers, body, reservation.bytes(), state.pace).await?;
    reservation.resize(bytes.len() as u64)?;
    let content_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).map(str::to_owned);
    let (rules, keep_subject) = (Rules::of(&state), state.keep_patient);
    let submission = Submission { caller: Arc::clone(&calling.0), content_type, bytes, query, idempotency_key };
    let parsing = move |limits: &_| {
        let _room = room; // held to the end even if the client goes away
        receive(submission, limits, &rules, keep_subject)
    };
    let new = state.parse(parsing).await?;
    match state.store.submit(reservation, new).await? {
        Submitted::Created(job) => Ok(located(StatusCode::ACCEPTED, job, &calling)),
        Submitted::Existing(job) => Ok(located(StatusCode::OK, job, &calling)),
    }
}

/// What the headers of a submission decide: its key, its place in the queue and its room in the memory, taken before the body is read.
async fn admit(state: &AppState, calling: &Calling, headers: &HeaderMap) -> Result<(Option<String>, Reservation, Room), Problem> {
    negotiate::acceptable(headers, "application/json")?;
    state.accepts_work()?;
    body::plain(headers)?;
    let idempotency_key = idempotency_key(headers)?;
    let announced = body::announced(headers, state.limits.body_bytes as u64)?;
    let reservation = state.store.reserve(announced)?;
    Ok((idempotency_key, reservation, state.uploads.room(calling.0.sees_only(), announced).await?))
}

/// A submission as it came.
struct Submission {
    caller: Arc<Caller>,
    content_type: Option<String>,
    bytes: Bytes,
    query: Vec<(String, String)>,
    idempotency_key: Option<String>,
}

/// From bytes to what is stored: takes the body apart, reads the study, resolves the parameters. Slow; not for a thread of the runtime.
fn receive(submission: Submission, limits: &intake::Limits, rules: &Rules, keep_subject: bool) -> Result<NewJob, Problem> {
    let Submission { caller, content_type, bytes, mut query, idempotency_key } = submission;
    let upload = Upload::new(content_type.as_deref(), bytes)?;
    let request_hash = upload.hash(&query);
    let options = intake::Options { spacing_mm: take_spacing(&mut query)?, keep_subject };
    let query = parameters::from_query(&query)?;
    let parts: Vec<_> = upload
        .files
        .iter()
        .map(|file| intake::Part { media_type: file.media_type.as_deref(), filename: file.filename.as_deref(), bytes: &file.bytes })
        .collect();
    let received = intake::read(&parts, &options, limits)?;
    if options.spacing_mm.is_some() && received.study.acquisition.format != Format::Npy {
        let detail =
            "The query gives `spacing_mm`, but the study says itself how far apart its voxels are. Leave it out: it is for NPY alone.";
        return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "needless_spacing", detail));
    }
    let wishes = Wishes::read(&merged_parameters(received.parameters, upload.parameters, query), rules, &received.study)?;
    Ok(wishes.job(&caller, received.study, received.subject, idempotency_key, request_hash))
}

/// Takes `spacing_mm=z,y,x` out of the query.
fn take_spacing(query: &mut Vec<(String, String)>) -> Result<Option<[f64; 3]>, Problem> {
    let Some(at) = query.iter().position(|(key, _)| key == "spacing_mm") else { return Ok(None) };
    let (_, text) = query.remove(at);
    if query.iter().any(|(key, _)| key == "spacing_mm") {
        return Err(Problem::new(StatusCode::BAD_REQUEST, "invalid_query", "The query gives `spacing_mm` more than once."));
    }
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    let spacing = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    let detail = "The query's `spacing_mm` must be three numbers in mm, `z,y,x`, as spacing_mm=5.74,2.87,2.87.";
    spacing.map(Some).ok_or_else(|| Problem::new(StatusCode::BAD_REQUEST, "invalid_query", detail))
}

pub(super) fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(value) = headers.get("idempotency-key") else { return Ok(None) };
    let key = value.to_str().ok().filter(|key| (1..=LONGEST_KEY).contains(&key.len()));
    let detail = format!("The header Idempotency-Key must have 1 to {LONGEST_KEY} visible ASCII characters.");
    key.map(|key| Some(key.to_owned())).ok_or_else(|| Problem::new(StatusCode::BAD_REQUEST, "invalid_idempotency_key", detail))
}

/// The job that a submission made, or had made before. Whoever may not read is not told what came of it.
pub(super) fn located(status: StatusCode, job: Job, calling: &Calling) -> Response {
    let job = if calling.0.may(Scope::Read) { job } else { Job { summary: None, ..job } };
    let mut response = views::job(status, &job);
    if let Ok(path) = HeaderValue::from_str(&views::path(&job)) {
        response.headers_mut().insert(header::LOCATION, path);
    }
    response.extensions_mut().insert(About(Arc::new([job.id])));
    response
}

/// Query of the list.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct Listing {
    /// Only reconstructions in this state.
    #[param(inline, nullable = false)]
    state: Option<JobState>,
    /// Only reconstructions of this DICOM study.
    study_instance_uid: Option<String>,
    /// At most so many.
    #[param(minimum = 1, maximum = 500, default = 50)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    #[param(value_type = Option<String>, format = "uuid")]
    cursor: Option<Uuid>,
}

/// Lists reconstructions, newest first.
#[utoipa::path(
    get, path = "/v1/reconstructions", operation_id = "listReconstructions", tag = "reconstructions", params(Listing),
    responses(
        (status = 200, description = "A page of reconstructions", body = JobListView),
        (status = 400, description = "The query cannot be understood", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn list(
    State(state): State<AppState>,
    calling: Calling,
    Query(query): Query<Listing>,
    headers: HeaderMap,
) -> Result<Json<JobListView>, Problem> {
    negotiate::acceptable(&headers, "application/json")?;
    let limit = query.limit.unwrap_or(ListQuery::DEFAULT_LIMIT);
    if !(1..=ListQuery::LARGEST_LIMIT).contains(&limit) {
        let detail = format!("The query's `limit` is {limit}; allowed is 1 to {}.", ListQuery::LARGEST_LIMIT);
        return Err(Problem::new(StatusCode::BAD_REQUEST, "invalid_query", detail));
    }
    let state_wanted = query.state.map(jobs::State::from);
    let owner = calling.0.sees_only().map(str::to_owned);
    let wanted = ListQuery { state: state_wanted, study_instance_uid: query.study_instance_uid, owner, limit, cursor: query.cursor };
    Ok(Json((&state.store.list(wanted).await?).into()))
}

/// Looks at a reconstruction.
///
/// Three ways to follow one: poll with `If-None-Match` and get 304 while nothing changes; add `Prefer: wait=N` to have the answer wait, up to
/// 30 s, until the job is finished or, with `If-None-Match`, until it has changed; or listen to `/events`. A failed job is still a 200, with
/// its problem in `error`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}", operation_id = "getReconstruction", tag = "reconstructions",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: seconds the answer may wait, at most 30 (RFC 7240)"),
    ),
    responses(
        (status = 200, description = "The job", body = JobView, headers(
            ("ETag" = String, description = "Changes with the job"),
            ("Retry-After" = u64, description = "While it is not finished: seconds until looking again is worth it"),
            ("Preference-Applied" = String, description = "The wait that was applied"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn get(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, "application/json")?;
    let wait = negotiate::wait(&headers);
    let job = settled(&state, id, &headers, wait.unwrap_or_default()).await?;
    let unchanged = negotiate::none_match(&headers, &views::etag(&job));
    let mut response = if unchanged { views::job_not_modified(&job) } else { views::job(StatusCode::OK, &job) };
    if let Some(wait) = wait {
        let applied = HeaderValue::from_str(&format!("wait={}", wait.as_secs()));
        applied.map(|applied| response.headers_mut().insert(HeaderName::from_static("preference-applied"), applied)).ok();
    }
    Ok(response)
}

/// The job once it is what the client waits for, or when the time is over or the service stops: finished, or with `If-None-Match` other
/// than the copy at hand.
async fn settled(state: &AppState, id: Uuid, headers: &HeaderMap, wait: Duration) -> Result<Job, Problem> {
    let until = Instant::now() + wait;
    let conditional = headers.contains_key(header::IF_NONE_MATCH);
    let mut job = state.store.get(id).await?.ok_or_else(|| Problem::no_such_reconstruction(id))?;
    loop {
        let left = until.saturating_duration_since(Instant::now());
        let news = conditional && !negotiate::none_match(headers, &views::etag(&job));
        if job.state.is_final() || news || left.is_zero() || state.draining.is_cancelled() {
            return Ok(job);
        }
        tokio::select! {
            changed = state.store.wait_for_change(id, job.version, left) => {
                job = changed?.ok_or_else(|| Problem::no_such_reconstruction(id))?;
            }
            () = state.draining.cancelled() => {}
        }
    }
}

/// Cancels or deletes a reconstruction.
///
/// One that is not finished is cancelled: at once while it waits (200), within about a second while it runs (202). One that is finished is
/// deleted with all its data (204).
#[utoipa::path(
    delete, path = "/v1/reconstructions/{id}", operation_id = "deleteReconstruction", tag = "reconstructions",
    params(("id" = String, Path, format = "uuid", description = "Id of the reconstruction")),
    responses(
        (status = 200, description = "It was waiting and is cancelled", body = JobView),
        (status = 202, description = "It is running and was told to stop", body = JobView),
        (status = 204, description = "It was finished; it and its data are gone"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn delete(State(state): State<AppState>, Id(id): Id) -> Result<Response, Problem> {
    match state.store.delete(id).await? {
        Deletion::Cancelling(job) => Ok(views::job(StatusCode::ACCEPTED, &job)),
        Deletion::Cancelled(job) => Ok(views::job(StatusCode::OK, &job)),
        Deletion::Deleted => Ok(StatusCode::NO_CONTENT.into_response()),
        Deletion::NotFound => Err(Problem::no_such_reconstruction(id)),
    }
}
