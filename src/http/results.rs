//! The results of a finished reconstruction. Each is stored as it is sent: nothing is computed here.

use super::{
    AppState,
    extract::{Id, IdAndGate},
    negotiate,
    problem::Problem,
    views::Binary,
};
use crate::{
    jobs::Blob,
    report::{PolarMaps, Report},
};
use axum::{
    extract::State,
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use uuid::Uuid;

/// Media type of a binary glTF file.
const GLB: &str = "model/gltf-binary";
/// Media type of a VTK XML file, which has none of its own.
const VTU: &str = "application/xml";

/// Reads the report.
///
/// Volumes, ejection fraction, fits, quality and warnings. Never changes once it is there: keep it by its `ETag`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/report", operation_id = "getReport", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
    ),
    responses(
        (status = 200, description = "The report", body = Report, headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "`not_finished`, `reconstruction_failed` (with the job's problem in `cause`) or `reconstruction_cancelled`",
         body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn report(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    result(&state, id, &headers, "application/json", "report").await
}

/// Reads the polar maps as numbers.
///
/// Perfusion, thickness, thickening, motion and phase of the wall on 20 rings of 60 sectors, anterior up and septal left. As pictures they are
/// `polar-maps/{quantity}.png` and `.svg`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/polar-maps", operation_id = "getPolarMaps", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
    ),
    responses(
        (status = 200, description = "The maps", body = PolarMaps, headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction, or one of a version before 0.2 (`no_such_result`)", body = Problem,
         content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn polar_maps(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    result(&state, id, &headers, "application/json", "polar-maps").await
}

/// Reads both surfaces over the whole cycle.
///
/// Binary glTF in metres, +Y up: nodes `endocardial` and `epicardial`, a morph target a gate and a looping animation over the R-R interval. The wall's
/// perfusion, thickness, thickening, motion and phase can be chosen as colours (`KHR_materials_variants`) and are attributes of the vertices.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/surfaces.glb", operation_id = "getSurfaces", tag = "results",
    params(("id" = String, Path, format = "uuid", description = "Id of the reconstruction")),
    responses(
        (status = 200, description = "Animated binary glTF", body = Binary, content_type = "model/gltf-binary"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes glTF", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn surfaces(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    result(&state, id, &headers, GLB, "surfaces.glb").await
}

/// Reads the inner surface of one gate.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/endocardial.glb", operation_id = "getEndocardialSurface", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
    ),
    responses(
        (status = 200, description = "Binary glTF", body = Binary, content_type = "model/gltf-binary"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes glTF", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn endocardial(
    State(state): State<AppState>,
    IdAndGate(id, gate): IdAndGate,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    result(&state, id, &headers, GLB, &format!("gates/{gate}/endocardial.glb")).await
}

/// Reads the outer surface of one gate.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/epicardial.glb", operation_id = "getEpicardialSurface", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
    ),
    responses(
        (status = 200, description = "Binary glTF", body = Binary, content_type = "model/gltf-binary"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes glTF", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn epicardial(
    State(state): State<AppState>,
    IdAndGate(id, gate): IdAndGate,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    result(&state, id, &headers, GLB, &format!("gates/{gate}/epicardial.glb")).await
}

/// Reads the wall of one gate.
///
/// Tetrahedra between both surfaces as a VTK XML file (`UnstructuredGrid`), in mm along the patient's axes (LPS) or, without an orientation,
/// the grid's. Points carry `thickness_mm`, `surface` (0 endocardial, 1 epicardial), `lid` (1 in the valve plane, where the thickness is
/// nominal) and `displacement_mm` (since the end-diastolic gate), cells `volume_mm3`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/wall.vtu", operation_id = "getWall", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
    ),
    responses(
        (status = 200, description = "VTK XML file", body = Binary, content_type = "application/xml"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes XML", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn wall(State(state): State<AppState>, IdAndGate(id, gate): IdAndGate, headers: HeaderMap) -> Result<Response, Problem> {
    result(&state, id, &headers, VTU, &format!("gates/{gate}/wall.vtu")).await
}

/// One stored result, or why there is none.
pub(super) async fn result(
    state: &AppState,
    id: Uuid,
    headers: &HeaderMap,
    media_type: &'static str,
    name: &str,
) -> Result<Response, Problem> {
    negotiate::acceptable(headers, media_type)?;
    if let Some(blob) = state.store.blob(id, name).await? {
        return Ok(send(headers, blob));
    }
    let job = state.store.get(id).await?.ok_or_else(|| Problem::no_such_reconstruction(id))?;
    Err(Problem::no_result(&job, name))
}

/// A blob, or 304 where the client has it. Caches may keep it but must ask again, since it can be deleted.
pub(super) fn send(headers: &HeaderMap, blob: Blob) -> Response {
    let etag = format!("\"{}\"", blob.sha256);
    let unchanged = negotiate::none_match(headers, &etag);
    let head = [(header::ETAG, etag), (header::CACHE_CONTROL, "private, no-cache".to_owned())];
    if unchanged {
        return (StatusCode::NOT_MODIFIED, head).into_response();
    }
    (head, [(header::CONTENT_TYPE, blob.media_type)], blob.data).into_response()
}
