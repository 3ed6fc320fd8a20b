//! A reconstruction once more, on the input that was kept, with other parameters.

use super::{
    AppState,
    access::Calling,
    body,
    body::BodyError,
    extract::Id,
    negotiate,
    problem::Problem,
    reconstructions::{idempotency_key, located},
    views::JobView,
    wishes::{Rules, Wishes},
};
use crate::{
    access::Caller,
    jobs::{KeptInput, NewJob, Store, Submitted, input},
    parameters,
};
use axum::{
    body::Body,
    extract::State,
    http::{HeaderMap, StatusCode},
    response::Response,
};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::sync::Arc;
use uuid::Uuid;

/// Reconstructs the same study once more.
///
/// A new job on the input of an earlier one, while that is kept (`input_kept`). The body has parameters as a submission's, or is empty; what is left
/// out has the preset's value, not that of the earlier job. Only `keep_input` is then as in the request of the earlier job. All else is as for a
/// submission: 202 means that the job is stored, and an `Idempotency-Key` makes the request safe to repeat.
#[utoipa::path(
    post, path = "/v1/reconstructions/{id}/again", operation_id = "reconstructAgain", tag = "reconstructions",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the earlier reconstruction"),
        ("Idempotency-Key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[ -~]+$", description = "Up to 255 visible ASCII characters of the client's choice, one for each request meant."),
    ),
    request_body(content = Option<parameters::Request>, description = "Parameters; may be left out", content_type = "application/json"),
    responses(
        (status = 202, description = "Accepted and stored; `Location` leads to the job", body = JobView,
         headers(("Location" = String, description = "Path of the job"), ("Retry-After" = u64, description = "Seconds until looking is worth it"))),
        (status = 200, description = "The job that an earlier request with the same `Idempotency-Key` made", body = JobView),
        (status = 400, description = "The body is not JSON", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The body came too slowly", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`input_not_kept`: send the study again, with `keep_input`", body = Problem,
         content_type = "application/problem+json"),
        (status = 413, description = "Larger than parameters are", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "A body with a `Content-Encoding`", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Parameters unknown or out of range, marks outside of the study, idempotency key used for another request",
         body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The queue is full or the service is stopping; `Retry-After` says when to try again", body = Problem,
         content_type = "application/problem+json", headers(("Retry-After" = u64, description = "Seconds"))),
    ),
)]
pub(super) async fn again(
    State(state): State<AppState>,
    calling: Calling,
    Id(id): Id,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, "application/json")?;
    state.accepts_work()?;
    body::plain(&headers)?;
    let idempotency_key = idempotency_key(&headers)?;
    let _room = state.uploads.room(calling.0.sees_only(), body::MOST_PARAMETER_BYTES as u64).await?;
    let written = written(&body::read(&headers, body, body::MOST_PARAMETER_BYTES as u64, state.pace).await?)?;
    // A place before the study is read.
    let mut reservation = state.store.reserve(0)?;
    let kept = kept_input(&state.store, id).await?;
    reservation.resize(kept.study.len() as u64)?;
    let (rules, caller) = (Rules::of(&state), Arc::clone(&calling.0));
    let new = state.parse(move |_| new_job(id, &caller, kept, &written, idempotency_key, &rules)).await?;
    match state.store.submit(reservation, new).await? {
        Submitted::Created(job) => Ok(located(StatusCode::ACCEPTED, job, &calling)),
        Submitted::Existing(job) => Ok(located(StatusCode::OK, job, &calling)),
    }
}

/// The input of a job, or why it is not there.
pub(super) async fn kept_input(store: &Store, id: Uuid) -> Result<KeptInput, Problem> {
    if let Some(kept) = store.kept_input(id).await? {
        return Ok(kept);
    }
    let job = store.get(id).await?.ok_or_else(|| Problem::no_such_reconstruction(id))?;
    Err(Problem::input_not_kept(&job))
}

/// The parameters of a body, which may be empty.
fn written(bytes: &[u8]) -> Result<Value, BodyError> {
    let written = match bytes.trim_ascii() {
        [] => Value::Null,
        text => serde_json::from_slice(text).map_err(|error| BodyError::BodyNotJson { why: error.to_string() })?,
    };
    Ok(if written.is_null() { Value::Object(serde_json::Map::new()) } else { written })
}

/// Slow for large studies; not for a thread of the runtime.
fn new_job(
    id: Uuid,
    caller: &Caller,
    kept: KeptInput,
    written: &Value,
    idempotency_key: Option<String>,
    rules: &Rules,
) -> Result<NewJob, Problem> {
    let study = input::decode(&kept.study).map_err(|error| {
        tracing::error!(%error, %id, "a kept input cannot be read");
        Problem::internal()
    })?;
    let mut wishes = Wishes::read(written, rules, &study)?;
    wishes.keep_input = wishes.keep_input.or(kept.keep_input);
    let mut hash = Sha256::new();
    hash.update(b"again");
    hash.update(id.as_bytes());
    hash.update(written.to_string());
    Ok(wishes.job(caller, study, kept.subject, idempotency_key, hash.finalize().into()))
}
