//! How one result is sent, and what counts as received.

use super::{
    destination::{Destination, DestinationError},
    send::{Answer, Message, SendError, Sender, WHOLE_TIME},
};
use crate::{
    dimse::{self, Title},
    jobs::Store,
};
use dicom_object::FileMetaTable;
use futures_util::future::BoxFuture;
use hyper::body::Bytes;
use serde_json::Value;
use std::{sync::Arc, time::Duration};
use tokio::time::timeout;
use uuid::Uuid;

/// Most bytes of an answer of STOW-RS: a result is one instance.
const MOST_ANSWER_BYTES: usize = 64 << 10;
/// Ends the one part of the body. Long and odd enough that no document holds it.
const BOUNDARY: &str = "ventricle-b1f0c7a2e94d4a6b8d55";
/// Referenced SOP Sequence: what was stored (PS3.18 table 10.5.3-2).
const STORED: &str = "00081199";
/// Referenced SOP Instance UID.
const INSTANCE: &str = "00081155";

/// Makes the document that is sent of a job: a DICOM file in explicit VR little endian. The reason why not goes into the table.
pub type Document = Arc<dyn Fn(Store, Uuid) -> BoxFuture<'static, Result<Vec<u8>, String>> + Send + Sync>;

/// How results are sent.
#[derive(Clone)]
pub struct Results {
    /// What makes them.
    pub document: Document,
    /// Our own AE title.
    pub calling: Title,
    /// The header Authorization of STOW-RS, and the URL that it is for: results that wait since the receiver was another one go without.
    pub authorization: Option<(String, String)>,
}

/// Why a result is not known to have arrived. Nothing here holds the URL's path or query.
#[derive(Debug, thiserror::Error)]
pub(super) enum ResultError {
    #[error("the document cannot be made: {0}")]
    Document(String),
    #[error("the destination {0}")]
    Destination(#[from] DestinationError),
    #[error("{0}")]
    Send(#[from] SendError),
    #[error("{0}")]
    Store(#[from] dimse::SendError),
    #[error("status {0}")]
    Status(u16, Option<Duration>),
    #[error("status {0}, but the answer does not name the instance as stored")]
    NotStored(u16),
}

impl ResultError {
    /// Whether the rules forbade it, rather than the network or the receiver.
    pub(super) fn is_refusal(&self) -> bool {
        match self {
            Self::Destination(_) => true,
            Self::Send(error) => error.is_refusal(),
            _ => false,
        }
    }

    /// When the receiver wants to be asked again.
    pub(super) fn retry_after(&self) -> Option<Duration> {
        if let Self::Status(_, after) = self { *after } else { None }
    }
}

impl Results {
    fn authorization_for(&self, url: &str) -> Option<&str> {
        self.authorization.as_ref().filter(|(own, _)| own == url).map(|(_, value)| value.as_str())
    }

    /// Sends the result of a job once.
    pub(super) async fn send(&self, sender: &Sender, store: &Store, job: Uuid, url: &str) -> Result<(), ResultError> {
        let destination = Destination::parse(url, sender.allowed())?;
        let document = (self.document)(store.clone(), job).await.map_err(ResultError::Document)?;
        match destination {
            Destination::Stow(_) => stow(sender, url, &document, self.authorization_for(url)).await,
            Destination::Store { called, target } => {
                let sending = async {
                    let stream = sender.connect(&target).await?;
                    Ok(dimse::send(stream, &self.calling, &called, &document).await?)
                };
                timeout(WHOLE_TIME, sending).await.unwrap_or(Err(SendError::Time(WHOLE_TIME).into()))
            }
        }
    }
}

async fn stow(sender: &Sender, url: &str, document: &[u8], authorization: Option<&str>) -> Result<(), ResultError> {
    let instance = instance(document).ok_or_else(|| ResultError::Document("it has no SOP Instance UID".to_owned()))?;
    let head = format!("--{BOUNDARY}\r\nContent-Type: application/dicom\r\nContent-Length: {}\r\n\r\n", document.len());
    let body = [head.as_bytes(), document, format!("\r\n--{BOUNDARY}--\r\n").as_bytes()].concat();
    let mut headers = vec![("accept", "application/dicom+json".to_owned())];
    headers.extend(authorization.map(|value| ("authorization", value.to_owned())));
    let message = Message {
        media_type: &format!("multipart/related; type=\"application/dicom\"; boundary={BOUNDARY}"),
        headers: &headers,
        body,
        answer_bytes: MOST_ANSWER_BYTES,
    };
    let Answer { status, retry_after, body } = sender.post(url, message).await?;
    match status {
        200..=299 if stores(&body, &instance) => Ok(()),
        200..=299 => Err(ResultError::NotStored(status)),
        _ => Err(ResultError::Status(status, retry_after)),
    }
}

/// Media Storage SOP Instance UID of a file.
fn instance(document: &[u8]) -> Option<String> {
    let meta = FileMetaTable::from_reader(document.get(128..)?).ok()?;
    Some(meta.media_storage_sop_instance_uid.trim_matches([' ', '\0']).to_owned())
}

/// Whether an answer says that this instance is stored. Some receivers put their one answer into a list.
fn stores(answer: &Bytes, instance: &str) -> bool {
    let Ok(answer) = serde_json::from_slice::<Value>(answer) else { return false };
    let answer = answer.get(0).unwrap_or(&answer);
    let stored = answer[STORED]["Value"].as_array();
    stored.is_some_and(|stored| stored.iter().any(|item| item[INSTANCE]["Value"][0].as_str() == Some(instance)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_answer_that_names_the_instance_as_stored_counts() {
        let says = |answer: &str| stores(&Bytes::copy_from_slice(answer.as_bytes()), "1.2.3");
        let stored = r#"{"00081199":{"vr":"SQ","Value":[{"00081155":{"vr":"UI","Value":["1.2.3"]}}]}}"#;
        assert!(says(stored) && says(&format!("[{stored}]")));
        assert!(!says(&stored.replace("1.2.3", "1.2.4")) && !says(&stored.replace("00081199", "00081198")));
        for nothing in ["", "{}", "[]", "null", "<xml/>", r#"{"00081199":{"vr":"SQ"}}"#, r#"{"00081199":[1]}"#] {
            assert!(!says(nothing), "{nothing}");
        }
    }
}
