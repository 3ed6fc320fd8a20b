//! A submission taken apart: its files and its parameters, in parts or not.

use super::body::{BodyError, MOST_PARAMETER_BYTES};
use crate::parameters;
use axum::{body::Bytes, http::header};
use futures_util::{FutureExt, stream};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::convert::Infallible;

/// Most parts of a multipart body: one slice a file of the largest stack, and its parameters. Beyond it, headers cost more than content.
const MOST_PARTS: usize = 4097;
/// Longest boundary: Orthanc's have 73 characters where RFC 2046 allows 70.
const LONGEST_BOUNDARY: usize = 256;

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
