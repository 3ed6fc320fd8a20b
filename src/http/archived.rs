//! Results for PACS and health records, made from what is stored when they are asked for.

use super::{
    AppState,
    extract::{Id, IdAndGate},
    negotiate,
    problem::Problem,
    results::send,
    views::Binary,
};
use crate::{
    archive::{self, Finished},
    export::stl,
    jobs::{Blob, Store, work},
    pipeline::Surface,
    report::Report,
};
use axum::{
    extract::State,
    http::{HeaderMap, header},
    response::{IntoResponse, Response},
};
use uuid::Uuid;

/// Reads the measurements as a DICOM structured report.
///
/// Comprehensive SR by the template Measurement Report (TID 1500): volumes, ejection fraction, mass, the volumes of every gate, uncertainties,
/// quality, parameters, and references to the images. The same reconstruction gives the same bytes and UIDs. Patient attributes are in it
/// only where the operator keeps them (`--keep-patient`).
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/sr.dcm", operation_id = "getStructuredReport", tag = "results",
    params(("id" = String, Path, format = "uuid", description = "Id of the reconstruction")),
    responses(
        (status = 200, description = "DICOM file", body = Binary, content_type = "application/dicom",
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes DICOM", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn sr(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, archive::sr::MEDIA_TYPE)?;
    let document = archive::sr::write(&finished(&state.store, id, "sr.dcm").await?)?;
    Ok(send(&headers, Blob::new(archive::sr::MEDIA_TYPE, document)))
}

/// Reads the measurements as a FHIR R4 bundle.
///
/// A `collection` of a `DiagnosticReport`, an `Observation` a value and a gate, and the `Device`. It names no patient: add `subject` before it
/// goes into a record.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/fhir", operation_id = "getFhirBundle", tag = "results",
    params(("id" = String, Path, format = "uuid", description = "Id of the reconstruction")),
    responses(
        (status = 200, description = "FHIR R4 Bundle", content((Object = "application/fhir+json"), (Object = "application/json")),
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes JSON", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn fhir(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    let media_type = negotiate::first_acceptable(&headers, &archive::fhir::MEDIA_TYPES)?;
    let bundle = archive::fhir::write(&finished(&state.store, id, "fhir").await?)?;
    let vary = [(header::VARY, "accept")];
    Ok((vary, send(&headers, Blob::new(media_type, bundle))).into_response())
}

/// Reads the inner surface of one gate as STL.
///
/// Binary STL in mm along the patient's axes (LPS) or, without an orientation, the grid's, as `wall.vtu`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/endocardial.stl", operation_id = "getEndocardialStl", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
    ),
    responses(
        (status = 200, description = "Binary STL", body = Binary, content_type = "model/stl"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes STL", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn endocardial_stl(
    State(state): State<AppState>,
    IdAndGate(id, gate): IdAndGate,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    plain_stl(&state, id, gate, Surface::Endocardial, &headers).await
}

/// Reads the outer surface of one gate as STL.
///
/// Binary STL in mm along the patient's axes (LPS) or, without an orientation, the grid's, as `wall.vtu`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/epicardial.stl", operation_id = "getEpicardialStl", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
    ),
    responses(
        (status = 200, description = "Binary STL", body = Binary, content_type = "model/stl"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes STL", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn epicardial_stl(
    State(state): State<AppState>,
    IdAndGate(id, gate): IdAndGate,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    plain_stl(&state, id, gate, Surface::Epicardial, &headers).await
}

/// Reads the inner surface of one gate as DICOM.
///
/// Encapsulated STL, with references to the images. Patient attributes as in `sr.dcm`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/endocardial.stl.dcm", operation_id = "getEndocardialStlAsDicom", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
    ),
    responses(
        (status = 200, description = "DICOM file", body = Binary, content_type = "application/dicom"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes DICOM", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn endocardial_stl_dicom(
    State(state): State<AppState>,
    IdAndGate(id, gate): IdAndGate,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    stl_dicom(&state, id, gate, Surface::Endocardial, &headers).await
}

/// Reads the outer surface of one gate as DICOM.
///
/// Encapsulated STL, with references to the images. Patient attributes as in `sr.dcm`.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/gates/{gate}/epicardial.stl.dcm", operation_id = "getEpicardialStlAsDicom", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("gate" = u32, Path, minimum = 1, description = "Gate, counted from 1"),
    ),
    responses(
        (status = 200, description = "DICOM file", body = Binary, content_type = "application/dicom"),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or gate", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes DICOM", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn epicardial_stl_dicom(
    State(state): State<AppState>,
    IdAndGate(id, gate): IdAndGate,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    stl_dicom(&state, id, gate, Surface::Epicardial, &headers).await
}

/// The structured report, to be sent by itself; or why there is none.
pub(super) async fn document(store: &Store, id: Uuid) -> Result<Vec<u8>, String> {
    let finished = finished(store, id, "sr.dcm").await.map_err(|problem| problem.detail)?;
    archive::sr::write(&finished).map_err(|error| error.to_string())
}

async fn plain_stl(state: &AppState, id: Uuid, gate: u32, surface: Surface, headers: &HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(headers, archive::stl::MEDIA_TYPE)?;
    let stl = stored_surface(state, id, gate, surface, "stl").await?;
    Ok(send(headers, Blob::new(archive::stl::MEDIA_TYPE, stl.bytes)))
}

async fn stl_dicom(state: &AppState, id: Uuid, gate: u32, surface: Surface, headers: &HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(headers, archive::sr::MEDIA_TYPE)?;
    let stl = stored_surface(state, id, gate, surface, "stl.dcm").await?;
    let document = archive::stl::write(&finished(&state.store, id, "report").await?, surface, gate as usize, &stl)?;
    Ok(send(headers, Blob::new(archive::sr::MEDIA_TYPE, document)))
}

/// A surface as it is stored, as STL.
async fn stored_surface(state: &AppState, id: Uuid, gate: u32, surface: Surface, form: &str) -> Result<stl::Stl, Problem> {
    match state.store.blob(id, &work::surface_name(gate as usize, surface)).await? {
        Some(glb) => Ok(stl::of_glb(&glb.data)?),
        None => Err(missing(&state.store, id, &format!("gates/{gate}/{}.{form}", surface.name())).await?),
    }
}

/// What results are made from, or why there are none.
pub(super) async fn finished(store: &Store, id: Uuid, name: &str) -> Result<Finished, Problem> {
    let report = stored_report(store, id, name).await?;
    let job = store.get(id).await?.ok_or_else(|| Problem::no_such_reconstruction(id))?;
    let subject = store.subject(id).await?;
    Ok(Finished { id, finished_at: job.finished_at.unwrap_or(job.created_at), report, subject })
}

/// The report as it is stored, for a result of this name; or why there is none.
pub(super) async fn stored_report(store: &Store, id: Uuid, name: &str) -> Result<Report, Problem> {
    let Some(report) = store.blob(id, work::REPORT).await? else { return Err(missing(store, id, name).await?) };
    serde_json::from_slice(&report.data).map_err(|error| {
        tracing::error!(%error, %id, "a stored report cannot be read");
        Problem::internal()
    })
}

/// Why a job has no such result.
pub(super) async fn missing(store: &Store, id: Uuid, name: &str) -> Result<Problem, Problem> {
    let job = store.get(id).await?.ok_or_else(|| Problem::no_such_reconstruction(id))?;
    Ok(Problem::no_result(&job, name))
}
