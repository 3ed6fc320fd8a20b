//! Two finished reconstructions set against each other, made from their reports when it is asked for.

use super::{
    AppState,
    access::{About, Calling},
    archived::stored_report,
    extract::{Id, Query},
    negotiate,
    problem::Problem,
    results::send,
};
use crate::{
    jobs::Blob,
    report::{self, Comparison},
};
use axum::{
    extract::State,
    http::{HeaderMap, StatusCode},
    response::Response,
};
use serde::Deserialize;
use std::sync::Arc;
use utoipa::IntoParams;
use uuid::Uuid;

/// Media type of a comparison.
const JSON: &str = "application/json";

/// Query of a comparison.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct With {
    /// Id of the other reconstruction: the rest study, where `{id}` is the stress study.
    #[param(format = "uuid", value_type = String)]
    with: Uuid,
}

/// Compares two reconstructions.
///
/// Stress and rest, or before and after: transient ischaemic dilation and the differences of volumes, ejection fraction, mass, perfusion,
/// thickening and motion, by segments and territories. Every difference is `{id}` less `with`. Whether both are of one patient cannot be
/// seen here: `notes` tells where they are of different studies, and what else stands against comparing them.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/comparison", operation_id = "compareReconstructions", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"), With,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
    ),
    responses(
        (status = 200, description = "The comparison", body = Comparison, headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 400, description = "`with` is missing or no id", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "One of the two does not exist", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "One of the two is not finished, has failed or was cancelled; or its report is from a version without segments \
                                      (`result_too_old`)", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Both are the same (`same_reconstruction`)", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn comparison(
    State(state): State<AppState>,
    calling: Calling,
    Id(id): Id,
    Query(With { with }): Query<With>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, JSON)?;
    if id == with {
        let detail = format!("`with` names the reconstruction itself, {id}; name another one, as that of the rest study.");
        return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "same_reconstruction", detail));
    }
    let with = calling.sees(&state, with).await?;
    let first = stored_report(&state.store, id, "comparison").await.map_err(|problem| of_one(id, problem))?;
    let second = stored_report(&state.store, with, "comparison").await.map_err(|problem| of_one(with, problem))?;
    let comparison = report::compare(&first, &second)?;
    let body = serde_json::to_vec(&comparison).map_err(|error| {
        tracing::error!(%error, "a comparison could not be written");
        Problem::internal()
    })?;
    let mut response = send(&headers, Blob::new(JSON, body));
    response.extensions_mut().insert(About(Arc::new([with])));
    Ok(response)
}

/// Says which of the two a problem is about.
fn of_one(id: Uuid, problem: Problem) -> Problem {
    if problem.status == StatusCode::CONFLICT {
        Problem { detail: format!("Of the two, {id}: {}", problem.detail), ..problem }
    } else {
        problem
    }
}
