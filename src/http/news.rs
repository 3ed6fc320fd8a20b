//! What happens to all reconstructions as server-sent events.

use super::{AppState, events::KEEP_ALIVE, negotiate, problem::Problem, views::JobView};
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

/// Follows all reconstructions.
///
/// Server-sent events. `hello` (an empty object) comes first, and again when changes may have been missed: read the list now, what happens later will be told.
/// `job`: a job is new or has changed; the data is the job as in the list. `deleted`: a job is gone; the data is its `id`. A change may be
/// told twice; `state` and `progress` are those of when it was told. The stream does not end by itself, and has no past: `Last-Event-ID` is not looked at.
#[utoipa::path(
    get, path = "/v1/reconstructions/events", operation_id = "followReconstructions", tag = "reconstructions",
    responses(
        (status = 200, description = "The stream; the data of each event `job` is a job", body = JobView, content_type = "text/event-stream"),
        (status = 406, description = "`Accept` excludes `text/event-stream`", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn news(State(state): State<AppState>, headers: HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, "text/event-stream")?;
    state.accepts_work()?;
    let events = follow(state.store.news(), state);
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// The events from now to the end of the service.
fn follow(news: Receiver<News>, state: AppState) -> impl Stream<Item = Result<Event, Infallible>> {
    stream::unfold((news, state, true), |(mut news, state, first)| async move {
        let event = if first { hello() } else { next(&mut news, &state).await? };
        Some((Ok(event), (news, state, false)))
    })
}

async fn next(news: &mut Receiver<News>, state: &AppState) -> Option<Event> {
    let told = tokio::select! {
        told = news.recv() => told,
        () = state.draining.cancelled() => return None,
    };
    match told {
        Ok(News::Changed(job)) => Event::default().event("job").json_data(JobView::from(&*job)).ok(),
        Ok(News::Deleted(id)) => Event::default().event("deleted").json_data(DeletedView { id }).ok(),
        Ok(News::Missed) | Err(RecvError::Lagged(_)) => Some(hello()),
        Err(RecvError::Closed) => None,
    }
}

/// That the list is to be read.
fn hello() -> Event {
    Event::default().event("hello").data("{}")
}
