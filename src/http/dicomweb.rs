//! STOW-RS (PS3.18 §10.5): DICOM instances as a PACS sends them.
//!
//! A request may hold a whole study with hundreds of megabytes of objects that are none of ours, so it is read as a stream: each part is
//! looked at when it is there, and what is not needed is forgotten. The answer names every instance that is committed to disk, since that is
//! what PACS check.

use super::{
    AppState,
    access::{About, Calling},
    body::{self, Arriving, BodyError},
    extract::StudyUid,
    layers::Told,
    multipart, negotiate,
    pace::{OwnTime, Pace, Paced},
    problem::Problem,
    stored::StoreInstancesResponse,
    uploads::Room,
    views::Binary,
};
use crate::assembly::{MOST_WAITING_BYTES, Received, Reception, Way};
use axum::{
    Extension,
    body::{Body, Bytes},
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use futures_util::{Stream, StreamExt, stream};
use std::{
    sync::{
        Arc,
        atomic::{AtomicU32, AtomicU64, Ordering},
    },
    task::Poll,
    time::Instant,
};

/// Media type of DICOM as JSON (PS3.18 annex F).
const DICOM_JSON: &str = "application/dicom+json";
/// Bytes of a multipart body that its parser may hold: headers, and content it has not given back yet.
const MOST_HELD_BYTES: u64 = 1 << 20;
/// How often the parser may ask for more while it holds that much: once to look at what it has.
const MOST_STALLS: u32 = 4;
/// Bytes of a part that are neither headers nor content: boundary, hyphens and line ends.
const MOST_SEPARATION: usize = 256 + 16;
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
pub(super) async fn store(State(state): State<AppState>, calling: Calling, headers: HeaderMap, body: Body) -> Result<Response, Problem> {
    receive(&state, &calling, None, &headers, body).await
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
    calling: Calling,
    StudyUid(study_uid): StudyUid,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    receive(&state, &calling, Some(study_uid), &headers, body).await
}

async fn receive(
    state: &AppState,
    calling: &Calling,
    study_uid: Option<String>,
    headers: &HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let room = match admit(state, calling, headers).await {
        Ok(room) => room,
        Err(refusal) => {
            body::discard(headers, body, state.study_bytes).await;
            return Err(refusal);
        }
    };
    let reception = state.assembler().reception((&calling.0.owner, calling.0.queued_jobs()), Way::Stow, study_uid);
    let body = Arriving::new(body);
    match read(state, headers, body.clone(), reception).await {
        Ok(reception) => answer(reception.end().await),
        Err(refusal) => {
            drop(room);
            body.discard(headers, &refusal, state.study_bytes).await;
            Err(refusal.into())
        }
    }
}

/// What the headers of a request decide before its body is read: whether it is, and its room in the memory.
async fn admit(state: &AppState, calling: &Calling, headers: &HeaderMap) -> Result<Room, Problem> {
    negotiate::acceptable(headers, DICOM_JSON)
        .or_else(|_| negotiate::acceptable(headers, "application/json"))
        .map_err(|_| Problem::from(negotiate::NotAcceptable { offered: DICOM_JSON }))?;
    state.accepts_work()?;
    body::plain(headers)?;
    let announced = body::announced(headers, state.study_bytes)?;
    // A place for one job: it is given back, as how many jobs the request makes is not known yet.
    state.store.reserve(0)?;
    // One object, what the parser holds before it, and the excerpts that are not committed yet.
    let held = state.limits.body_bytes as u64 + MOST_HELD_BYTES + MOST_WAITING_BYTES;
    Ok(state.uploads.room(calling.0.sees_only(), announced.min(held)).await?)
}

/// Hands the files of a body to the reception, one after the other.
async fn read(state: &AppState, headers: &HeaderMap, body: Arriving, mut reception: Reception) -> Result<Reception, BodyError> {
    let content_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    let limit = state.limits.body_bytes as u64;
    // It may hold many objects, each as large as a body may be.
    let (pace, own_time) = (Pace { longer_by_bytes: limit, ..state.pace }, OwnTime::default());
    let body = Paced::new(body, pace, own_time.clone());
    let Some(boundary) = content_type.filter(|value| multipart::is_multipart(value)) else {
        reception.take(body::collect(body, limit).await?).await;
        return Ok(reception);
    };
    let boundary = multipart::boundary(boundary).ok_or(BodyError::NoBoundary)?;
    let flow = Arc::new(Flow::default());
    let mut multipart = multer::Multipart::new(metered(body, Arc::clone(&flow), state.study_bytes), boundary);
    let mut parts = 0;
    while let Some(mut field) = multipart.next_field().await.map_err(malformed)? {
        flow.used(field.headers().iter().map(|(name, value)| name.as_str().len() + value.len() + 4).sum::<usize>() + MOST_SEPARATION);
        parts += 1;
        if parts > state.limits.parts {
            return Err(BodyError::TooManyParts { limit: state.limits.parts });
        }
        let mut bytes = Vec::new();
        while let Some(chunk) = field.chunk().await.map_err(malformed)? {
            flow.used(chunk.len());
            // One object too large refuses the request, as what is left of it could not be told from the next.
            if (bytes.len() + chunk.len()) as u64 > limit {
                return Err(BodyError::TooLarge { limit });
            }
            bytes.extend_from_slice(&chunk);
        }
        let began = Instant::now();
        reception.take(Bytes::from(bytes)).await;
        own_time.add(began.elapsed());
    }
    Ok(reception)
}

/// What the multipart parser was given and has given back. It takes all that is there to be taken before it looks at it, so what it is given
/// is held back.
#[derive(Debug, Default)]
struct Flow {
    held: AtomicU64,
    stalls: AtomicU32,
}

impl Flow {
    /// So many bytes came out of the parser.
    fn used(&self, bytes: usize) {
        let left = self.held.load(Ordering::Relaxed).saturating_sub(bytes as u64);
        self.held.store(left, Ordering::Relaxed);
        self.stalls.store(0, Ordering::Relaxed);
    }
}

/// The chunks of a body, of at most so many bytes in all, no faster than the parser gives them back.
fn metered(mut chunks: Paced<Arriving>, flow: Arc<Flow>, limit: u64) -> impl Stream<Item = Result<Bytes, BodyError>> + Send {
    let mut total = 0;
    stream::poll_fn(move |context| {
        if flow.held.load(Ordering::Relaxed) > MOST_HELD_BYTES {
            if flow.stalls.fetch_add(1, Ordering::Relaxed) < MOST_STALLS {
                context.waker().wake_by_ref();
                return Poll::Pending;
            }
            let why = format!("more than {MOST_HELD_BYTES} bytes that belong to no part, or to the headers of one");
            return Poll::Ready(Some(Err(BodyError::Multipart { why })));
        }
        chunks.poll_next_unpin(context).map(|next| {
            next.map(|chunk| {
                let chunk = chunk?;
                total += chunk.len() as u64;
                flow.held.fetch_add(chunk.len() as u64, Ordering::Relaxed);
                if total > limit { Err(BodyError::TooLarge { limit }) } else { Ok(chunk) }
            })
        })
    })
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
    if stored == 0
        && let Some(full) = outcomes.iter().find_map(|outcome| outcome.result.as_ref().err()?.no_room())
    {
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
    Ok((status, head, Extension(Told), Extension(About(jobs.into())), body).into_response())
}
