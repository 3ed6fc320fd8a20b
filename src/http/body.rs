//! The body of a submission: read within limits of size and time, and taken apart when it is multipart.

use super::pace::{OwnTime, Pace, Paced};
use crate::{access::OverLimit, parameters};
use axum::{
    body::{Body, BodyDataStream, Bytes},
    http::{HeaderMap, header},
};
use futures_util::{FutureExt, Stream, StreamExt, stream};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::{
    convert::Infallible,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
    time::Duration,
};

/// Most parts of a multipart body: one slice a file of the largest stack, and its parameters. Beyond it, headers cost more than content.
const MOST_PARTS: usize = 4097;
/// Most bytes of the part `parameters`: parsed JSON takes many times its text.
pub(super) const MOST_PARAMETER_BYTES: usize = 256 << 10;
/// Most characters of a header that are repeated to the client.
const SHOWN_CHARACTERS: usize = 40;
/// Time that a refused body gets to arrive.
const DISCARD_TIME: Duration = Duration::from_secs(10);
/// How many times the limit of bytes of a refused body are waited for.
const DISCARD_LIMITS: u64 = 4;
/// Longest boundary: Orthanc's have 73 characters where RFC 2046 allows 70.
const LONGEST_BOUNDARY: usize = 256;

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

/// One file of a submission.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct File {
    /// Declared media type, without its parameters.
    pub media_type: Option<String>,
    /// Declared name.
    pub filename: Option<String>,
    /// Content.
    pub bytes: Bytes,
}

/// A submission taken apart: its files and the part `parameters`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Upload {
    /// The files, in the order sent.
    pub files: Vec<File>,
    /// The part `parameters` of a multipart body.
    pub parameters: Option<Value>,
}

impl Upload {
    /// Takes a body apart by its `Content-Type`. What is not multipart is one file.
    pub(super) fn new(content_type: Option<&str>, bytes: Bytes) -> Result<Self, BodyError> {
        let media_type = content_type.map(essence).filter(|essence| !essence.is_empty());
        match content_type {
            Some(content_type) if is_multipart(content_type) => {
                let boundary = boundary(content_type).ok_or(BodyError::NoBoundary)?;
                let malformed = BodyError::Multipart { why: "it never ends".into() };
                // The one chunk is there, so the parser never waits.
                parts(boundary, bytes).now_or_never().unwrap_or(Err(malformed))
            }
            _ => Ok(Self { files: vec![File { media_type, filename: None, bytes }], parameters: None }),
        }
    }

    /// SHA-256 of what the request says, to tell a retry from another request: files, parameters and query, each with its length. The
    /// boundary of a multipart body is not in it, since clients choose another one for each attempt.
    pub(super) fn hash(&self, query: &[(String, String)]) -> [u8; 32] {
        let mut hash = Sha256::new();
        let mut add = |bytes: &[u8]| {
            hash.update((bytes.len() as u64).to_le_bytes());
            hash.update(bytes);
        };
        for (key, value) in query {
            add(key.as_bytes());
            add(value.as_bytes());
        }
        add(self.parameters.as_ref().map(Value::to_string).unwrap_or_default().as_bytes());
        for file in &self.files {
            add(file.media_type.as_deref().unwrap_or_default().as_bytes());
            add(&file.bytes);
        }
        hash.finalize().into()
    }
}

async fn parts(boundary: String, bytes: Bytes) -> Result<Upload, BodyError> {
    let malformed = |error: multer::Error| BodyError::Multipart { why: error.to_string() };
    let mut multipart = multer::Multipart::new(stream::once(async move { Ok::<_, Infallible>(bytes) }), boundary);
    let mut upload = Upload { files: Vec::new(), parameters: None };
    while let Some(field) = multipart.next_field().await.map_err(malformed)? {
        let is_parameters = field.name() == Some("parameters");
        let filename = field.file_name().map(str::to_owned);
        let media_type = field.headers().get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).map(essence);
        let bytes = field.bytes().await.map_err(malformed)?;
        if is_parameters {
            if bytes.len() > MOST_PARAMETER_BYTES {
                return Err(BodyError::ParametersTooLarge { bytes: bytes.len(), limit: MOST_PARAMETER_BYTES });
            }
            let value = serde_json::from_slice(&bytes).map_err(|error| BodyError::ParametersNotJson { why: error.to_string() })?;
            if upload.parameters.replace(value).is_some() {
                return Err(BodyError::SeveralParameters);
            }
        } else if upload.files.len() == MOST_PARTS {
            return Err(BodyError::TooManyParts { limit: MOST_PARTS });
        } else {
            upload.files.push(File { media_type, filename, bytes });
        }
    }
    Ok(upload)
}

/// Whether a body of this `Content-Type` has parts.
pub(super) fn is_multipart(content_type: &str) -> bool {
    essence(content_type).starts_with("multipart/")
}

/// A media type without its parameters, in lower case.
fn essence(content_type: &str) -> String {
    content_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// The boundary of a multipart `Content-Type`, quoted or not and longer than the grammar allows: PACS send such.
pub(super) fn boundary(content_type: &str) -> Option<String> {
    let mut rest = content_type.split_once(';')?.1;
    loop {
        let (name, value) = rest.trim_start().split_once('=')?;
        let (value, after) = match value.trim_start().strip_prefix('"') {
            Some(quoted) => {
                let (value, after) = quoted.split_once('"')?;
                (value, after.split_once(';').map_or("", |(_, after)| after))
            }
            None => value.split_once(';').unwrap_or((value, "")),
        };
        if name.trim().eq_ignore_ascii_case("boundary") {
            let value = value.trim();
            let usable = !value.is_empty() && value.len() <= LONGEST_BOUNDARY && value.bytes().all(|byte| (0x20..0x7f).contains(&byte));
            return usable.then(|| value.to_owned());
        }
        rest = after;
    }
}

/// Parameters of part and body and query in one: what stands nearer to the request wins, the query before the part before the body.
pub(super) fn merged_parameters(body: Option<Value>, part: Option<Value>, query: Value) -> Value {
    let mut merged = body.unwrap_or(Value::Object(serde_json::Map::new()));
    for over in part.into_iter().chain([query]).filter(|over| over.as_object().is_none_or(|fields| !fields.is_empty())) {
        parameters::merge(&mut merged, over);
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    #[test]
    fn boundaries_are_read_as_clients_write_them() {
        let long = "a".repeat(73);
        for (sent, expected) in [
            (format!("multipart/related; type=\"application/dicom\"; boundary={long}"), Some(long.as_str())),
            ("multipart/related; type=\"a;boundary=no\"; BOUNDARY=\"yes; really\"".into(), Some("yes; really")),
            ("multipart/form-data;boundary=x ; charset=utf-8".into(), Some("x")),
            ("multipart/form-data".into(), None),
            ("multipart/form-data; boundary=".into(), None),
            ("multipart/form-data; boundary=\"".into(), None),
            (format!("multipart/form-data; boundary={}", "b".repeat(300)), None),
        ] {
            assert_eq!(boundary(&sent).as_deref(), expected, "{sent}");
        }
    }

    #[test]
    fn multipart_survives_a_leading_crlf_and_a_missing_end() {
        let body = "\r\n--x\r\nContent-Type: application/dicom\r\nContent-Length: 4\r\n\r\nDICM\r\n--x\r\nContent-Disposition: form-data; \
                    name=\"parameters\"\r\n\r\n{\"preset\":\"paper\"}\r\n--x--";
        let upload = Upload::new(Some("multipart/related; boundary=x"), body.into()).unwrap();
        assert_eq!(upload.files, [File { media_type: Some("application/dicom".into()), filename: None, bytes: "DICM".into() }]);
        assert_eq!(upload.parameters, Some(json!({"preset": "paper"})));
    }

    #[test]
    fn malformed_multipart_is_refused() {
        for body in ["", "no boundary here", "--x\r\nContent-Type: text/plain\r\n\r\ncut", "--x\r\nbad header\r\n\r\nx\r\n--x--"] {
            let error = Upload::new(Some("multipart/form-data; boundary=x"), body.into()).unwrap_err();
            assert_eq!(error.code(), "malformed_multipart", "{body:?}: {error}");
        }
    }

    #[test]
    fn the_hash_knows_content_and_query_but_not_the_boundary() {
        let upload = |boundary: &str, content: &str| {
            let body = format!("--{boundary}\r\nContent-Type: a/b\r\n\r\n{content}\r\n--{boundary}--\r\n");
            Upload::new(Some(&format!("multipart/related; boundary={boundary}")), body.into()).unwrap()
        };
        let query = [("preset".to_owned(), "paper".to_owned())];
        assert_eq!(upload("x", "one").hash(&query), upload("yy", "one").hash(&query));
        assert_ne!(upload("x", "one").hash(&query), upload("x", "two").hash(&query));
        assert_ne!(upload("x", "one").hash(&query), upload("x", "one").hash(&[]));
    }

    #[test]
    fn the_query_wins_over_the_part_and_the_part_over_the_body() {
        let merged = merged_parameters(Some(json!({"a": 1, "b": 1, "c": 1})), Some(json!({"b": 2, "c": 2})), json!({"c": 3}));
        assert_eq!(merged, json!({"a": 1, "b": 2, "c": 3}));
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_parser_panic(content_type in ".{0,80}", body in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = Upload::new(Some(&content_type), body.clone().into());
            let _ = Upload::new(Some("multipart/form-data; boundary=-"), body.into());
        }
    }
}
