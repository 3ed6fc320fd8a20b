//! A study to try the service with, made by the service.

use super::{AppState, problem::Problem, results::send, views::Binary};
use crate::{
    jobs::Blob,
    phantom::{self, Phantom},
};
use axum::{
    extract::State,
    http::{HeaderMap, header},
    response::{IntoResponse, Response},
};
use tokio::sync::OnceCell;

/// The file, once somebody asked for it.
pub(super) type Made = OnceCell<Blob>;

/// Reads a study to try the service with.
///
/// A simulated beating ventricle as a DICOM file of a gated study, the one that `ventricle demo` posts: to be submitted as any other. The same bytes each time.
#[utoipa::path(
    get, path = "/v1/phantom.dcm", operation_id = "getPhantom", tag = "operation",
    params(("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand")),
    responses(
        (status = 200, description = "DICOM file", body = Binary, content_type = "application/dicom",
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
    ),
)]
pub(super) async fn phantom(State(state): State<AppState>, headers: HeaderMap) -> Result<Response, Problem> {
    let make = || state.parse(|_| Ok(Blob::new("application/dicom", phantom::dicom::write(&phantom::simulate(&Phantom::demo())?.study)?)));
    let file = state.phantom.get_or_try_init(make).await?;
    let name = [(header::CONTENT_DISPOSITION, "attachment; filename=\"phantom.dcm\"")];
    Ok((name, send(&headers, file.clone())).into_response())
}
