//! Results for people, made from what is stored when they are asked for: polar maps as pictures, the report as a page.

use super::{
    AppState,
    archived::{finished, missing},
    extract::{Id, IdAndImage},
    negotiate,
    problem::Problem,
    results::send,
    views::Binary,
};
use crate::{
    archive::{self, page},
    jobs::{Blob, Store, work},
    report::{PolarMaps, Quantity},
};
use axum::{
    extract::State,
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use uuid::Uuid;

/// What a browser is to allow a drawing that it shows as a document: the pixels inside of it.
const DRAWING_POLICY: &str =
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; sandbox";

/// Draws a polar map.
///
/// A bull's-eye with the outlines and means of the seventeen segments and a colour bar: PNG of 900 × 800 pixels, or self-contained SVG. Made from
/// `polar-maps`; the same reconstruction gives the same bytes. Colours mean the same in every study. Magnitudes are drawn in perceptually uniform
/// scales, phase in one that closes.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/polar-maps/{image}", operation_id = "getPolarMapImage", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("image" = String, Path, example = "perfusion.png",
         pattern = "^(perfusion|end_diastolic_thickness|end_systolic_thickness|thickening|motion|phase)\\.(png|svg)$",
         description = "Quantity and form: `perfusion`, `end_diastolic_thickness`, `end_systolic_thickness`, `thickening`, `motion` or `phase`, then \
                        `.png` or `.svg`"),
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
    ),
    responses(
        (status = 200, description = "The picture", content((Binary = "image/png"), (String = "image/svg+xml")),
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction or map (`no_such_result`): an ungated study has perfusion and thickness alone",
         body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes the picture", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn polar_map(
    State(state): State<AppState>,
    IdAndImage(id, image): IdAndImage,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let name = format!("polar-maps/{image}");
    let asked = image.rsplit_once('.').and_then(|(quantity, form)| Some((Quantity::named(quantity)?, form.to_owned())));
    let Some((quantity, form)) = asked.filter(|(_, form)| ["png", "svg"].contains(&form.as_str())) else {
        return Err(no_map(&state.store, id, &name, &Quantity::ALL).await?);
    };
    let media_type = if form == "png" { archive::polar::PNG } else { archive::polar::SVG };
    negotiate::acceptable(&headers, media_type)?;
    let Some(maps) = polar_maps(&state.store, id).await? else { return Err(missing(&state.store, id, &name).await?) };
    let there: Vec<Quantity> = maps.maps.iter().map(|map| map.quantity).collect();
    let drawn = state
        .parse(move |_| {
            let picture = match media_type {
                archive::polar::PNG => archive::polar::png(&maps, quantity)?,
                _ => archive::polar::svg(&maps, quantity)?.map(String::into_bytes),
            };
            Ok(picture)
        })
        .await?;
    match drawn {
        Some(picture) => Ok(with_policy(DRAWING_POLICY.to_owned(), send(&headers, Blob::new(media_type, picture)))),
        None => Err(no_map(&state.store, id, &name, &there).await?),
    }
}

/// Reads the report as a page.
///
/// One self-contained page for people, which prints on one sheet: time-volume curve, bull's-eyes, tables, phase histogram, pictures of both surfaces,
/// flags and warnings in words. No scripts, no network, nothing that names the patient. The same reconstruction gives the same bytes.
#[utoipa::path(
    get, path = "/v1/reconstructions/{id}/report.html", operation_id = "getReportPage", tag = "results",
    params(
        ("id" = String, Path, format = "uuid", description = "Id of the reconstruction"),
        ("If-None-Match" = Option<String>, Header, description = "`ETag` of the copy at hand"),
    ),
    responses(
        (status = 200, description = "The page", body = String, content_type = "text/html",
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
        (status = 404, description = "No such reconstruction", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes HTML", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Not finished, failed or cancelled", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn report_page(State(state): State<AppState>, Id(id): Id, headers: HeaderMap) -> Result<Response, Problem> {
    negotiate::acceptable(&headers, "text/html")?;
    let finished = finished(&state.store, id, "report.html").await?;
    let Some(surfaces) = state.store.blob(id, work::SURFACES).await? else { return Err(missing(&state.store, id, "report.html").await?) };
    let maps = polar_maps(&state.store, id).await?;
    let html = state.parse(move |_| Ok(page::write(&finished, &page::Parts { maps: maps.as_ref(), surfaces: &surfaces.data })?)).await?;
    Ok(with_policy(page::policy(), send(&headers, Blob::new(page::MEDIA_TYPE, html.into_bytes()))))
}

/// The stored maps; `None` where there are none, as of a job that is not finished.
async fn polar_maps(store: &Store, id: Uuid) -> Result<Option<PolarMaps>, Problem> {
    let Some(blob) = store.blob(id, work::POLAR_MAPS).await? else { return Ok(None) };
    serde_json::from_slice(&blob.data).map(Some).map_err(|error| {
        tracing::error!(%error, %id, "stored polar maps cannot be read");
        Problem::internal()
    })
}

/// That a finished job has no such map, with those that there are; or what else is in the way.
async fn no_map(store: &Store, id: Uuid, name: &str, there: &[Quantity]) -> Result<Problem, Problem> {
    let problem = missing(store, id, name).await?;
    if problem.code != "no_such_result" {
        return Ok(problem);
    }
    let there: Vec<&str> = there.iter().map(|quantity| quantity.name()).collect();
    let detail = format!("The reconstruction has no result {name}. Maps are {}, each with `.png` or `.svg`.", there.join(", "));
    Ok(Problem::new(StatusCode::NOT_FOUND, "no_such_result", detail))
}

fn with_policy(policy: String, response: Response) -> Response {
    ([(header::CONTENT_SECURITY_POLICY, policy)], response).into_response()
}
