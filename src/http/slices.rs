//! Slices through the counts with the contours of both surfaces: the contours as JSON, the counts as pictures.

use super::{
    AppState,
    again::kept_input,
    archived::missing,
    extract::{Id, IdAndGate, Query},
    negotiate,
    problem::Problem,
    results::{result, send},
    views::Binary,
};
use crate::{
    export,
    jobs::{Blob, input, work},
    report::{PlaneName, Slices},
};
use axum::{extract::State, http::HeaderMap, response::Response};
use serde::Deserialize;
use utoipa::IntoParams;
use uuid::Uuid;

/// Reads the contours on slices.
///
/// Where both surfaces cut slices of the study at every gate: short-axis slices and two long-axis planes laid about the ventricle, and the input's own.
/// The counts under them are `gates/{gate}/slices.png`, while the input is kept.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/slices", operation_id = "getSlices", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
    ),
    responses(
        (status = 200, description = "Geometry and contours", body = Slices, headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction, or one of a version that stored none (`no_such_result`)", body = Problem,
         content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn slices(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    result(&state, id, &headers, "application/json", work::SLICES).await
}

/// Query of the picture.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct Wanted {
    /// Which slices.
    #[param(inline, nullable = false, default = "short_axis")]
    plane: Option<PlaneName>,
}

/// Draws the counts on the slices of one gate.
///
/// All slices of the plane in the order of `slices`, one under another: a PNG of 8-bit grey, `width` × `height` · `slices` pixels, from 0 (black) to
/// `white_counts` (white), the same for all gates. Made from the input, so only while that is kept (`input_kept`).
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/slices.png", operation_id = "getSlicesImage", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
        Wanted,
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
    ),
    responses(
        (status = 200, description = "The picture", body = Binary, content_type = "image/png",
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 400, description = "No such plane", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes PNG", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled; or `input_not_kept`: the counts are no longer there", body = Problem,
         content_type = "application/problem+json"),
    ),
)]
pub(super) async fn picture(
    State(state): State<AppState>,
    IdAndGate(id, gate): IdAndGate,
    Query(wanted): Query<Wanted>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, export::slices::MEDIA_TYPE)?;
    let plane = wanted.plane.unwrap_or(PlaneName::ShortAxis);
    let name = format!("gates/{gate}/slices.png");
    let Some(stored) = state.store.blob(id, work::SLICES).await? else { return Err(missing(&state.store, id, &name).await?) };
    // Half a megabyte of numbers: some milliseconds.
    let read = move |_: &_| serde_json::from_slice(&stored.data).map_err(|error| damaged(id, &error));
    let slices: Slices = state.parse(read).await?;
    if !(1..=slices.gates).contains(&(gate as usize)) {
        return Err(missing(&state.store, id, &name).await?);
    }
    let kept = kept_input(&state.store, id).await?;
    let draw = move |_: &_| {
        let study = input::decode(&kept.study).map_err(|error| damaged(id, &error))?;
        Ok(export::slices::png(&study, gate as usize, &slices.rectangles(plane), slices.white_counts)?)
    };
    let png = state.parse(draw).await?;
    Ok(send(&headers, Blob::new(export::slices::MEDIA_TYPE, png)))
}

/// That something stored cannot be read.
fn damaged(id: Uuid, error: &dyn std::fmt::Display) -> Problem {
    tracing::error!(%error, %id, "what slices are drawn from cannot be read");
    Problem::internal()
}
