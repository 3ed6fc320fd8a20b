//! The body of a request with a study: read within limits of size and time, or refused and let in all the same.

use super::pace::{OwnTime, Pace, Paced};
use crate::access::OverLimit;
use axum::{
    body::{Body, BodyDataStream, Bytes},
    http::{HeaderMap, header},
};
use futures_util::{Stream, StreamExt};
use std::{
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
    time::Duration,
};

/// Most bytes of the part `parameters`: parsed JSON takes many times its text.
pub(super) const MOST_PARAMETER_BYTES: usize = 256 << 10;
/// Most characters of a header that are repeated to the client.
const SHOWN_CHARACTERS: usize = 40;
/// Time that a refused body gets to arrive.
const DISCARD_TIME: Duration = Duration::from_secs(10);
/// How many times the limit of bytes of a refused body are waited for.
const DISCARD_LIMITS: u64 = 4;

/// Why a body could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum BodyError {
    /// More bytes than are accepted.
    #[error(
        "The request has more than the {limit} bytes that are accepted. Compress the study (NIfTI .nii.gz) or send one series at a time."
    )]
    TooLarge {
        /// The limit.
        limit: u64,
    },
    /// The bytes came too slowly.
    #[error("The body did not arrive within {seconds} s: {received} bytes of it did. Send it again.")]
    TooSlow {
        /// Time allowed in s.
        seconds: u64,
        /// Bytes that came.
        received: u64,
    },
    /// The bytes stopped.
    #[error("No byte of the body came for {seconds} s. Send it again.")]
    Stalled {
        /// Time allowed in s.
        seconds: u64,
    },
    /// More bytes than the caller may send.
    #[error(transparent)]
    OverLimit(#[from] OverLimit),
    /// The connection broke.
    #[error("The body ended before it was complete. Send it again.")]
    Interrupted,
    /// Compressed on the way.
    #[error("The body has the Content-Encoding `{encoding}`, which is not read here. Send it as it is; NIfTI may be a .nii.gz file.")]
    Encoded {
        /// What the header says, shortened.
        encoding: String,
    },
    /// `Content-Length` is no number.
    #[error("The header Content-Length is not a number.")]
    ContentLength,
    /// Multipart without a usable boundary.
    #[error(
        "The Content-Type is multipart but names no boundary. Send `multipart/form-data; boundary=…` or `multipart/related; …; boundary=…`."
    )]
    NoBoundary,
    /// Multipart that does not follow its grammar.
    #[error("The multipart body is malformed: {why}. Check that the boundary in the Content-Type is the one in the body.")]
    Multipart {
        /// What the parser met.
        why: String,
    },
    /// The part `parameters` is no JSON.
    #[error("The part `parameters` is not JSON: {why}.")]
    ParametersNotJson {
        /// What the parser met.
        why: String,
    },
    /// A body of parameters is no JSON.
    #[error("The body is not JSON: {why}. Send the parameters as a JSON object, or no body.")]
    BodyNotJson {
        /// What the parser met.
        why: String,
    },
    /// The part `parameters` is larger than any parameters are.
    #[error("The part `parameters` has {bytes} bytes, more than the {limit} that parameters may have.")]
    ParametersTooLarge {
        /// Bytes sent.
        bytes: usize,
        /// The limit.
        limit: usize,
    },
    /// Parameters twice.
    #[error("The multipart body has more than one part `parameters`.")]
    SeveralParameters,
    /// More parts than a study can have.
    #[error("The multipart body has more than the {limit} parts that a study can have.")]
    TooManyParts {
        /// The limit.
        limit: usize,
    },
}

impl BodyError {
    /// Why a stream of bytes broke.
    pub(super) fn from_stream(error: &(dyn std::error::Error + 'static)) -> Self {
        let mut causes = std::iter::successors(Some(error), |error| error.source());
        causes.find_map(|cause| cause.downcast_ref::<OverLimit>()).map_or(Self::Interrupted, |over| Self::OverLimit(*over))
    }

    /// Whether it is not worth to wait for the rest.
    fn is_slow(&self) -> bool {
        matches!(self, Self::TooSlow { .. } | Self::Stalled { .. } | Self::Interrupted)
    }

    /// The stable code of the problem.
    pub(super) fn code(&self) -> &'static str {
        match self {
            Self::TooLarge { .. } | Self::ParametersTooLarge { .. } => "too_large",
            Self::TooSlow { .. } | Self::Stalled { .. } => "request_timeout",
            Self::OverLimit(over) => over.code(),
            Self::Interrupted => "incomplete_body",
            Self::Encoded { .. } => "unsupported_encoding",
            Self::ContentLength => "invalid_content_length",
            Self::NoBoundary | Self::Multipart { .. } => "malformed_multipart",
            Self::ParametersNotJson { .. } | Self::BodyNotJson { .. } | Self::SeveralParameters => "malformed_parameters",
            Self::TooManyParts { .. } => "too_many_parts",
        }
    }
}

/// The bytes a request announces: its `Content-Length`, or the limit when it comes in chunks.
pub(super) fn announced(headers: &HeaderMap, limit: u64) -> Result<u64, BodyError> {
    let Some(length) = headers.get(header::CONTENT_LENGTH) else { return Ok(limit) };
    let length: u64 = length.to_str().ok().and_then(|text| text.parse().ok()).ok_or(BodyError::ContentLength)?;
    if length > limit { Err(BodyError::TooLarge { limit }) } else { Ok(length) }
}

/// Refuses a body that was compressed on the way: what is signed, hashed and limited are the bytes that arrive.
pub(super) fn plain(headers: &HeaderMap) -> Result<(), BodyError> {
    let codings = headers.get_all(header::CONTENT_ENCODING).iter().map(|value| String::from_utf8_lossy(value.as_bytes()));
    match codings.into_iter().find(|coding| !coding.trim().is_empty() && !coding.trim().eq_ignore_ascii_case("identity")) {
        Some(coding) => Err(BodyError::Encoded { encoding: coding.chars().take(SHOWN_CHARACTERS).collect() }),
        None => Ok(()),
    }
}

/// Lets a refused body arrive and forgets it. Most clients send all before they listen; a connection that is closed over bytes nobody read is
/// reset, and the refusal lost with it. Those that ask with `Expect: 100-continue` wait for the answer and send nothing.
pub(super) async fn discard(headers: &HeaderMap, body: Body, limit: u64) {
    if !headers.contains_key(header::EXPECT) {
        discard_rest(&mut body.into_data_stream(), limit).await;
    }
}

async fn discard_rest(chunks: &mut (impl Stream<Item = Result<Bytes, axum::Error>> + Unpin), limit: u64) {
    let arrival = async {
        let mut left = limit.saturating_mul(DISCARD_LIMITS);
        while let Some(Ok(chunk)) = chunks.next().await
            && left > 0
        {
            left = left.saturating_sub(chunk.len() as u64);
        }
    };
    // Over time or not: the refusal is the same.
    let _ = tokio::time::timeout(DISCARD_TIME, arrival).await;
}

/// A body that may be refused in the middle, by whom it was given on to: what is left of it can be let in all the same. Clones are of the same one.
#[derive(Clone)]
pub(super) struct Arriving(Arc<Mutex<Begun>>);

struct Begun {
    chunks: BodyDataStream,
    /// Whether its sender knows that it is read.
    asked_for: bool,
}

impl Arriving {
    pub(super) fn new(body: Body) -> Self {
        Self(Arc::new(Mutex::new(Begun { chunks: body.into_data_stream(), asked_for: false })))
    }

    fn begun(&self) -> MutexGuard<'_, Begun> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// As [`discard`], unless it was refused for coming too slowly.
    pub(super) async fn discard(mut self, headers: &HeaderMap, refusal: &BodyError, limit: u64) {
        let sent = self.begun().asked_for || !headers.contains_key(header::EXPECT);
        if sent && !refusal.is_slow() {
            discard_rest(&mut self, limit).await;
        }
    }
}

impl Stream for Arriving {
    type Item = Result<Bytes, axum::Error>;

    fn poll_next(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let mut begun = self.begun();
        begun.asked_for = true;
        begun.chunks.poll_next_unpin(context)
    }
}

/// Reads a whole body of at most `limit` bytes.
pub(super) async fn read(headers: &HeaderMap, body: Body, limit: u64, pace: Pace) -> Result<Bytes, BodyError> {
    let body = Arriving::new(body);
    let read = collect(Paced::new(body.clone(), pace, OwnTime::default()), limit).await;
    if let Err(refusal) = &read {
        body.discard(headers, refusal, limit).await;
    }
    read
}

/// All chunks as one.
pub(super) async fn collect(mut chunks: impl Stream<Item = Result<Bytes, BodyError>> + Unpin, limit: u64) -> Result<Bytes, BodyError> {
    let mut bytes = Vec::new();
    while let Some(chunk) = chunks.next().await {
        let chunk = chunk?;
        if (bytes.len() + chunk.len()) as u64 > limit {
            return Err(BodyError::TooLarge { limit });
        }
        bytes.extend_from_slice(&chunk);
    }
    Ok(bytes.into())
}
