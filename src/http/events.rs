//! Progress of a reconstruction as server-sent events.

use super::{AppState, access::Calling, extract::Id, negotiate, problem::Problem, views::JobView};
use crate::jobs::Job;
use axum::{
    extract::State,
    http::{HeaderMap, StatusCode},
    response::{
        IntoResponse, Response, Sse,
        sse::{Event, KeepAlive},
    },
};
use futures_util::{Stream, stream};
use std::{convert::Infallible, time::Duration};
use utoipa::ToSchema;

/// Time between comments that keep idle connections open: below the usual 60 s of proxies.
pub(super) const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// Longest single wait for a change; only bounds how long a forgotten wait lives.
const WAIT: Duration = Duration::from_mins(1);

/// The fields of an event; OpenAPI 3.1 has no other word for a stream.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "documents the stream")]
pub(super) struct ProgressEvent {
    /// What kind of event it is.
    #[schema(example = "progress")]
    event: String,
    /// The job's version.
    #[schema(example = "7")]
    id: String,
    /// The job as JSON: the schema `Job`.
    #[schema(content_media_type = "application/json")]
    data: String,
}

/// Follows a reconstruction.
///
/// Server-sent events named `progress`: the data is the job as JSON, the id its version. The first event tells how the job is now, the
/// last its final state; then the stream ends. After a lost connection `Last-Event-ID` continues without repeating; when everything was
/// received already the answer is 204, at which browsers stop reconnecting.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/events", operation_id = "followReconstruction", tag = "reconstructions",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("Last-Event-ID" = Option<i64>, Header, description = "Id of the last event received"),
    ),
    responses(
        (status = 200, description = "The stream; the data of each event is a job", body = ProgressEvent, content_type = "text/event-stream"),
        (status = 204, description = "The job is finished and its last event was received"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes `text/event-stream`", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn events(State(state): State<AppState>, calling: Calling, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, "text/event-stream")?;
    let job = state.store.get(id).await?.ok_or_else(|| Problem::no_such_reconstruction(id))?;
    let seen = headers.get("last-event-id").and_then(|value| value.to_str().ok()?.trim().parse::<i64>().ok());
    let repeated = seen == Some(job.version);
    if repeated && job.state.is_final() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let first = if repeated { Next::After(job) } else { Next::Send(job) };
    Ok(Sse::new(follow(state, calling, first)).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// What the stream does next.
enum Next {
    /// Sends the job as it is.
    Send(Job),
    /// Waits until the job differs from what was sent.
    After(Job),
}

/// The events from here to the final state, the job's deletion, the end of what the caller may, or that of the service.
fn follow(state: AppState, calling: Calling, first: Next) -> impl Stream<Item = Result<Event, Infallible>> {
    stream::unfold((state, calling, first), |(state, calling, next)| async move {
        let job = match next {
            Next::Send(job) => job,
            Next::After(job) => changed(&state, job).await?,
        };
        let event = event(&job).filter(|_| state.access.stands(&calling.0))?;
        Some((Ok(event), (state, calling, Next::After(job))))
    })
}

/// The job at its next version; `None` when there is nothing more to tell.
async fn changed(state: &AppState, job: Job) -> Option<Job> {
    if job.state.is_final() {
        return None;
    }
    loop {
        let now = tokio::select! {
            now = state.store.wait_for_change(job.id, job.version, WAIT) => now.ok()??,
            () = state.draining.cancelled() => return None,
        };
        if now.version != job.version {
            return Some(now);
        }
    }
}

fn event(job: &Job) -> Option<Event> {
    Event::default().event("progress").id(job.version.to_string()).json_data(JobView::from(job)).ok()
}
