//! STOW-RS (PS3.18 §10.5): DICOM instances as a PACS sends them.
//!
//! A request may hold a whole study with hundreds of megabytes of objects that are none of ours, so it is read as a stream: each part is
//! looked at when it is there, and what is not needed is forgotten. The answer names every instance that is committed to disk, since that is
//! what PACS check.

use super::{
    AppState, body,
    body::BodyError,
    extract::StudyUid,
    negotiate,
    problem::Problem,
    views::{Binary, StoreInstancesResponse},
};
use crate::{
    assembly::{Received, Reception},
    jobs::ANONYMOUS,
};
use axum::{
    body::{Body, Bytes},
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use futures_util::StreamExt;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

/// Media type of DICOM as JSON (PS3.18 annex F).
const DICOM_JSON: &str = "application/dicom+json";
/// Most bytes of a multipart body between one part's content and the next: their headers.
const MOST_HEADER_BYTES: u64 = 64 << 10;
/// Most jobs that the answer links to.
const MOST_LINKS: usize = 16;

/// Stores DICOM instances (STOW-RS).
///
/// For PACS: each instance that is, or is part of, a tomographic reconstruction is committed to disk and becomes a job, by itself or with the
/// other parts of its series; `GET /v1/reconstructions?study_instance_uid=` finds it. The same instance again is the same job. Bodies are
/// `multipart/related` with DICOM files, or one DICOM file. What is refused is stored nowhere; the answer says why, in
/// Failed SOP Sequence (0008,1198) and, in words, in Error Comment (0000,0902).
#[utoipa::path(
    post, path = "/dicom-web/studies", operation_id = "storeInstances", tag = "dicomweb",
    request_body(description = "DICOM files (Part 10).", content((Binary = "multipart/related"), (Binary = "application/dicom"))),
    responses(
        (status = 200, description = "All instances are stored", body = StoreInstancesResponse, content_type = "application/dicom+json"),
        (status = 202, description = "Some are stored, some refused", body = StoreInstancesResponse, content_type = "application/dicom+json"),
        (status = 400, description = "The body does not follow its own format", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes DICOM JSON; there is no XML", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The body came too slowly", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "All instances are refused", body = StoreInstancesResponse, content_type = "application/dicom+json"),
        (status = 413, description = "Larger than accepted", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Compressed on the way", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The queue is full or the service is stopping; `Retry-After` says when to try again", body = Problem,
         content_type = "application/problem+json", headers(("Retry-After" = u64, description = "Seconds"))),
    ),
)]
pub(super) async fn store(State(state): State<AppState>, headers: HeaderMap, body: Body) -> Result<Response, Problem> {
    receive(&state, None, &headers, body).await
}

/// Stores DICOM instances of one study (STOW-RS).
///
/// As `/dicom-web/studies`; instances of other studies are refused.
#[utoipa::path(
    post, path = "/dicom-web/studies/{study_instance_uid}", operation_id = "storeInstancesOfStudy", tag = "dicomweb",
    params(("study_instance_uid" = String, Path, description = "Study Instance UID")),
    request_body(description = "DICOM files (Part 10).", content((Binary = "multipart/related"), (Binary = "application/dicom"))),
    responses(
        (status = 200, description = "All instances are stored", body = StoreInstancesResponse, content_type = "application/dicom+json"),
        (status = 202, description = "Some are stored, some refused", body = StoreInstancesResponse, content_type = "application/dicom+json"),
        (status = 400, description = "The body does not follow its own format", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "The address holds no UID", body = Problem, content_type = "application/problem+json"),
        (status = 406, description = "`Accept` excludes DICOM JSON; there is no XML", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The body came too slowly", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "All instances are refused", body = StoreInstancesResponse, content_type = "application/dicom+json"),
        (status = 413, description = "Larger than accepted", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Compressed on the way", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "The queue is full or the service is stopping; `Retry-After` says when to try again", body = Problem,
         content_type = "application/problem+json", headers(("Retry-After" = u64, description = "Seconds"))),
    ),
)]
pub(super) async fn store_of_study(
    State(state): State<AppState>,
    StudyUid(study_uid): StudyUid,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    receive(&state, Some(study_uid), &headers, body).await
}

async fn receive(state: &AppState, study_uid: Option<String>, headers: &HeaderMap, body: Body) -> Result<Response, Problem> {
    if let Err(refusal) = admit(state, headers) {
        body::discard(headers, body, state.study_bytes).await;
        return Err(refusal);
    }
    let reception = state.assembler().reception(ANONYMOUS, study_uid);
    let reading = read(state, headers, body, reception);
    let reception = tokio::time::timeout(state.study_time(), reading)
        .await
        .unwrap_or(Err(BodyError::TooSlow { seconds: state.study_time().as_secs() }))?;
    answer(reception.end().await)
}

/// What the headers of a request decide before its body is read.
fn admit(state: &AppState, headers: &HeaderMap) -> Result<(), Problem> {
    negotiate::acceptable(headers, DICOM_JSON).or_else(|_| negotiate::acceptable(headers, "application/json")).map_err(|_| {
        Problem::from(negotiate::NotAcceptable { offered: DICOM_JSON })
    })?;
    state.accepts_work()?;
    body::plain(headers)?;
    body::announced(headers, state.study_bytes)?;
    // A place for one job: it is given back, as how many jobs the request makes is not known yet.
    state.store.reserve(0)?;
    Ok(())
}

/// Hands the files of a body to the reception, one after the other.
async fn read(state: &AppState, headers: &HeaderMap, body: Body, mut reception: Reception) -> Result<Reception, BodyError> {
    let content_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    let limit = state.limits.body_bytes as u64;
    let Some(boundary) = content_type.filter(|value| body::is_multipart(value)) else {
        reception.take(body::collect(body, limit).await?).await;
        return Ok(reception);
    };
    let boundary = body::boundary(boundary).ok_or(BodyError::NoBoundary)?;
    // Bytes given to the parser since it last gave something back: of headers it would keep any number.
    let pending = Arc::new(AtomicU64::new(0));
    let (seen, mut total, study_bytes) = (Arc::clone(&pending), 0, state.study_bytes);
    let chunks = body.into_data_stream().map(move |chunk| {
        let chunk = chunk.map_err(|_| BodyError::Interrupted)?;
        total += chunk.len() as u64;
        if total > study_bytes {
            return Err(BodyError::TooLarge { limit: study_bytes });
        }
        let before = seen.fetch_add(chunk.len() as u64, Ordering::Relaxed);
        if before > MOST_HEADER_BYTES {
            return Err(BodyError::Multipart { why: format!("more than {MOST_HEADER_BYTES} bytes that belong to no part, or to its headers") });
        }
        Ok(chunk)
    });
    let mut multipart = multer::Multipart::new(chunks, boundary);
    let mut parts = 0;
    while let Some(mut field) = multipart.next_field().await.map_err(malformed)? {
        pending.store(0, Ordering::Relaxed);
        parts += 1;
        if parts > state.limits.parts {
            return Err(BodyError::TooManyParts { limit: state.limits.parts });
        }
        let mut bytes = Vec::new();
        while let Some(chunk) = field.chunk().await.map_err(malformed)? {
            pending.store(0, Ordering::Relaxed);
            // One object too large refuses the request, as what is left of it could not be told from the next.
            if (bytes.len() + chunk.len()) as u64 > limit {
                return Err(BodyError::TooLarge { limit });
            }
            bytes.extend_from_slice(&chunk);
        }
        reception.take(Bytes::from(bytes)).await;
        pending.store(0, Ordering::Relaxed);
    }
    Ok(reception)
}

/// The error of the body's stream, or of its grammar.
fn malformed(error: multer::Error) -> BodyError {
    match error {
        multer::Error::StreamReadFailed(inner) => match inner.downcast::<BodyError>() {
            Ok(error) => *error,
            Err(_) => BodyError::Interrupted,
        },
        error => BodyError::Multipart { why: error.to_string() },
    }
}

/// PS3.18 table 10.5.3-1: 200 if all are stored, 202 if some are, 409 if none is; when it is only for want of room, come back later.
fn answer(received: Received) -> Result<Response, Problem> {
    let Received { outcomes, jobs } = received;
    if outcomes.is_empty() {
        return Err(Problem::new(StatusCode::BAD_REQUEST, "empty_body", "The request holds no DICOM files."));
    }
    let stored = outcomes.iter().filter(|outcome| outcome.result.is_ok()).count();
    if stored == 0 && let Some(full) = outcomes.iter().find_map(|outcome| outcome.result.as_ref().err()?.queue_full()) {
        return Err(full.into());
    }
    let status = match stored {
        0 => StatusCode::CONFLICT,
        some if some < outcomes.len() => StatusCode::ACCEPTED,
        _ => StatusCode::OK,
    };
    for outcome in &outcomes {
        if let Err(refusal) = &outcome.result {
            tracing::info!(status = format!("{:04X}", refusal.status()), "an instance was refused");
        }
    }
    let mut head = HeaderMap::new();
    head.insert(header::CONTENT_TYPE, HeaderValue::from_static(DICOM_JSON));
    for job in jobs.iter().take(MOST_LINKS) {
        let link = format!("</v1/reconstructions/{job}>; rel=\"related\"");
        head.extend(HeaderValue::from_str(&link).ok().map(|link| (header::LINK, link)));
    }
    let body = serde_json::to_vec(&StoreInstancesResponse::new(&outcomes)).unwrap_or_default();
    Ok((status, head, body).into_response())
}
