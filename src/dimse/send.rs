//! One object sent over a connection that is there (C-STORE as SCU, PS3.4 B.2).

use super::{
    APPLICATION_CONTEXT, EXPLICIT_LITTLE_ENDIAN, IMPLICIT_LITTLE_ENDIAN,
    command::{self, Command},
    is_ae_title, own_variables,
    peer::{Broken, Event, Peer, Stream},
};
use dicom_object::{FileMetaTable, InMemDicomObject};
use dicom_transfer_syntax_registry::entries;
use dicom_ul::pdu::{
    AssociationAC, AssociationRQ, PDataValueType, Pdu, PresentationContextProposed, PresentationContextResultReason, UserVariableItem,
};
use std::time::Duration;

/// Longest silence of the other side.
const ANSWER_TIME: Duration = Duration::from_secs(10);
/// Time to end the association once the object is there.
const RELEASE_TIME: Duration = Duration::from_secs(2);
/// Longest answer.
const MOST_COMMAND_BYTES: usize = 16 << 10;
/// Presentation context of the object as it is.
const AS_IT_IS: u8 = 1;
/// Presentation context of the encoding that everybody must take.
const IMPLICIT: u8 = 3;

/// The name of an application.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Title(String);

impl Title {
    /// Checks it.
    pub fn parse(text: &str) -> Option<Self> {
        is_ae_title(text).then(|| Self(text.to_owned()))
    }
}

/// Why an object is not known to have arrived.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// It is no object that can be sent.
    #[error("the object cannot be sent: {0}")]
    Object(String),
    /// The association was rejected.
    #[error("the association was rejected: {0}")]
    Rejected(String),
    /// The other side does not take such objects.
    #[error("the receiver takes no objects of this SOP class")]
    NotTaken,
    /// The object was answered with a failure.
    #[error("C-STORE status {0:04X}")]
    Status(u16),
    /// The association did not come to its end.
    #[error("{0}")]
    Broken(#[from] Broken),
}

/// Sends a Part-10 file in explicit VR little endian, and returns once the receiver says that it is stored: with success or with a warning.
pub async fn send<S>(stream: S, calling: &Title, called: &Title, file: &[u8]) -> Result<(), SendError>
where
    S: tokio::io::AsyncRead + tokio::io::AsyncWrite + Unpin + Send,
{
    let object = Outgoing::parse(file)?;
    let mut peer = Peer::new(stream);
    match exchange(&mut peer, calling, called, &object).await {
        Ok(status) => {
            release(peer).await;
            // Warnings: coercion, elements discarded, data set does not match.
            if status == command::SUCCESS || status & 0xF000 == 0xB000 { Ok(()) } else { Err(SendError::Status(status)) }
        }
        Err(SendError::Broken(broken)) => {
            peer.abort(&broken).await;
            Err(broken.into())
        }
        Err(SendError::NotTaken) => {
            release(peer).await;
            Err(SendError::NotTaken)
        }
        Err(error) => Err(error),
    }
}

/// An object, as its file has it.
struct Outgoing<'a> {
    class_uid: String,
    instance_uid: String,
    data_set: &'a [u8],
}

impl<'a> Outgoing<'a> {
    fn parse(file: &'a [u8]) -> Result<Self, SendError> {
        let unreadable = |why: &str| SendError::Object(why.to_owned());
        let rest = file.get(128..).ok_or_else(|| unreadable("it is no DICOM file"))?;
        let meta = FileMetaTable::from_reader(rest).map_err(|error| SendError::Object(error.to_string()))?;
        let plain = |uid: &str| uid.trim_matches([' ', '\0']).to_owned();
        if plain(&meta.transfer_syntax) != EXPLICIT_LITTLE_ENDIAN {
            return Err(unreadable("it is not in explicit VR little endian"));
        }
        // "DICM", then the element that holds the length of the others.
        let data_set = rest.get(4 + 12 + meta.information_group_length as usize..).ok_or_else(|| unreadable("it is cut off"))?;
        let class_uid = plain(&meta.media_storage_sop_class_uid);
        Ok(Self { class_uid, instance_uid: plain(&meta.media_storage_sop_instance_uid), data_set })
    }

    /// The data set in implicit VR little endian.
    fn implicit(&self) -> Result<Vec<u8>, SendError> {
        let failed = |error: &dyn std::fmt::Display| SendError::Object(error.to_string());
        let (explicit, implicit) = (entries::EXPLICIT_VR_LITTLE_ENDIAN.erased(), entries::IMPLICIT_VR_LITTLE_ENDIAN.erased());
        let object = InMemDicomObject::read_dataset_with_ts(self.data_set, &explicit).map_err(|error| failed(&error))?;
        let mut bytes = Vec::new();
        object.write_dataset_with_ts(&mut bytes, &implicit).map_err(|error| failed(&error))?;
        Ok(bytes)
    }

    fn context(&self, id: u8, transfer_syntax: &str) -> PresentationContextProposed {
        PresentationContextProposed { id, abstract_syntax: self.class_uid.clone(), transfer_syntaxes: vec![transfer_syntax.to_owned()] }
    }
}

/// Associates, sends and reads the status.
async fn exchange<S: Stream>(peer: &mut Peer<S>, calling: &Title, called: &Title, object: &Outgoing<'_>) -> Result<u16, SendError> {
    let request = AssociationRQ {
        protocol_version: 1,
        calling_ae_title: calling.0.clone(),
        called_ae_title: called.0.clone(),
        application_context_name: APPLICATION_CONTEXT.to_owned(),
        presentation_contexts: vec![object.context(AS_IT_IS, EXPLICIT_LITTLE_ENDIAN), object.context(IMPLICIT, IMPLICIT_LITTLE_ENDIAN)],
        user_variables: own_variables(),
    };
    peer.write(&Pdu::AssociationRQ(request)).await?;
    let accepted = match peer.answer(ANSWER_TIME).await? {
        Ok(accepted) => accepted,
        Err(rejected) => return Err(SendError::Rejected(rejected.source.to_string())),
    };
    let most_bytes = accepted.user_variables.iter().find_map(|variable| match variable {
        UserVariableItem::MaxLength(bytes) => Some(*bytes),
        _ => None,
    });
    peer.limit(most_bytes.unwrap_or(0));
    let command = Command::store(1, &object.class_uid, &object.instance_uid);
    let context = if takes(&accepted, AS_IT_IS) {
        peer.write_data(AS_IT_IS, PDataValueType::Command, &command).await?;
        peer.write_data(AS_IT_IS, PDataValueType::Data, object.data_set).await?;
        AS_IT_IS
    } else if takes(&accepted, IMPLICIT) {
        let data_set = object.implicit()?;
        peer.write_data(IMPLICIT, PDataValueType::Command, &command).await?;
        peer.write_data(IMPLICIT, PDataValueType::Data, &data_set).await?;
        IMPLICIT
    } else {
        return Err(SendError::NotTaken);
    };
    Ok(response(peer, context).await?)
}

/// Whether a presentation context was accepted.
fn takes(accepted: &AssociationAC, id: u8) -> bool {
    let result = accepted.presentation_contexts.iter().find(|result| result.id == id);
    result.is_some_and(|result| result.reason == PresentationContextResultReason::Acceptance)
}

/// The status of the one message that was sent.
async fn response<S: Stream>(peer: &mut Peer<S>, context: u8) -> Result<u16, Broken> {
    let mut bytes = Vec::new();
    loop {
        let Event::Value(value) = peer.next(ANSWER_TIME).await? else {
            return Err(Broken::Unexpected("the wish to release before the answer"));
        };
        if value.value_type != PDataValueType::Command || value.presentation_context_id != context {
            return Err(Broken::Unexpected("something else than the answer"));
        }
        bytes.extend_from_slice(&value.data);
        if bytes.len() > MOST_COMMAND_BYTES {
            return Err(Broken::Unexpected("an answer of more than 16 KiB"));
        }
        if value.is_last {
            break;
        }
    }
    let answer = Command::parse(&bytes).ok_or(Broken::Unexpected("an answer that cannot be read"))?;
    if answer.field != command::C_STORE | command::RESPONSE || answer.has_data {
        return Err(Broken::Unexpected("another answer than that of C-STORE"));
    }
    Ok(answer.status)
}

/// Ends the association. The object is there, or is known not to be: how this goes does not matter any more.
async fn release<S: Stream>(mut peer: Peer<S>) {
    if peer.write(&Pdu::ReleaseRQ).await.is_ok() {
        let _ = peer.released(RELEASE_TIME).await;
    }
    peer.close().await;
}
