//! What happens to all reconstructions as server-sent events.

use super::{AppState, access::Calling, events::KEEP_ALIVE, negotiate, problem::Problem, views::JobView};
use crate::jobs::News;
use axum::{
    extract::State,
    http::HeaderMap,
    response::{
        IntoResponse, Response, Sse,
        sse::{Event, KeepAlive},
    },
};
use futures_util::{Stream, stream};
use serde::Serialize;
use std::convert::Infallible;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use utoipa::ToSchema;
use uuid::Uuid;

/// The data of the event `deleted`.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct DeletedView {
    /// The job that is gone.
    #[schema(value_type = String, format = "uuid")]
    id: Uuid,
}

/// The fields of an event; OpenAPI 3.1 has no other word for a stream.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "documents the stream")]
pub(super) struct NewsEvent {
    /// `hello`, `job` or `deleted`.
    #[schema(example = "job")]
    event: String,
    /// What it is about as JSON: nothing, the schema `Job`, or an `id`.
    #[schema(content_media_type = "application/json")]
    data: String,
}

/// Follows all reconstructions.
///
/// Server-sent events. `hello` (an empty object) comes first, and again when changes may have been missed: read the list now, what happens later will be told.
/// `job`: a job is new or has changed; the data is the job as in the list. `deleted`: a job is gone; the data is its `id`. A change may be
/// told twice; `state` and `progress` are those of when it was told. The stream does not end by itself, and has no past: `Last-Event-ID` is not looked at.
#[utoipa::path(
    get, path = "/v1/reconstructions/events", operation_id = "followReconstructions", tag = "reconstructions",
    responses(
        (status = 200, description = "The stream; the data of each event `job` is a job", body = NewsEvent, content_type = "text/event-stream"),
        (status = 406, description = "`Accept` excludes `text/event-stream`", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn news(State(state): State<AppState>, calling: Calling, headers: HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, "text/event-stream")?;
    state.accepts_work()?;
    let events = follow(state.store.news(), calling, state);
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// The events of what the caller sees, from now to the end of the service.
fn follow(news: Receiver<News>, calling: Calling, state: AppState) -> impl Stream<Item = Result<Event, Infallible>> {
    stream::unfold((news, calling, state, true), |(mut news, calling, state, first)| async move {
        let event = if first { hello() } else { next(&mut news, calling.0.sees_only(), &state).await? };
        state.access.stands(&calling.0).then_some((Ok(event), (news, calling, state, false)))
    })
}

/// The next event of what belongs to the owner, or of all.
async fn next(news: &mut Receiver<News>, only: Option<&str>, state: &AppState) -> Option<Event> {
    let seen = |owner: &str| only.is_none_or(|only| only == owner);
    loop {
        let told = tokio::select! {
            told = news.recv() => told,
            () = state.draining.cancelled() => return None,
        };
        return match told {
            Ok(News::Changed(job)) if seen(&job.owner) => Event::default().event("job").json_data(JobView::from(&*job)).ok(),
            Ok(News::Deleted { id, owner }) if only.is_none() || owner.as_deref().is_some_and(seen) => {
                Event::default().event("deleted").json_data(DeletedView { id }).ok()
            }
            // Of somebody else.
            Ok(News::Changed(_) | News::Deleted { owner: Some(_), .. }) => continue,
            // Whose it was is not known: the list tells.
            Ok(News::Missed | News::Deleted { owner: None, .. }) | Err(RecvError::Lagged(_)) => Some(hello()),
            Err(RecvError::Closed) => None,
        };
    }
}

/// That the list is to be read.
fn hello() -> Event {
    Event::default().event("hello").data("{}")
}
