//! One association that was accepted: its messages, one after the other, each answered before the next is read.

use super::{
    VERIFICATION,
    command::{self, Command},
    listener::Shared,
    negotiate::Context,
    object::{NoRoom, Object},
    peer::{Broken, Event, Peer, Stream},
};
use crate::{
    access::Deed,
    assembly::{Received, Refusal, Way},
    jobs::SubmitError,
};
use dicom_ul::pdu::{PDataValueType, Pdu};
use jiff::Timestamp;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout_at};
use uuid::Uuid;

/// Longest silence of the other side.
const IDLE_TIME: Duration = Duration::from_secs(30);
/// Longest silence once the service stops: time for the next message to be told so.
const STOPPING_TIME: Duration = Duration::from_secs(2);
/// Longest command set. Those of C-STORE have some 200 bytes.
const MOST_COMMAND_BYTES: usize = 16 << 10;
/// How many times its limit an object is read and forgotten after it was refused, so that its sender learns the reason.
const FORGOTTEN_TIMES: u64 = 4;

/// How an association ended.
#[derive(Debug)]
pub(super) enum Ending {
    /// As the other side wished.
    Released,
    /// The other side aborted, or its connection was lost.
    Lost,
    /// This side ended it: the other was silent, or did what has no place.
    Failed(Broken),
    /// This side ended it as the service stops.
    Stopped,
}

/// What became of an object: the status, what is said about it, and the jobs that it made or had made before.
struct Stored {
    status: u16,
    comment: Option<String>,
    jobs: Vec<Uuid>,
}

impl Stored {
    fn refused(status: u16, comment: Option<String>) -> Self {
        Self { status, comment, jobs: Vec::new() }
    }
}

/// An association, and what it did so far.
pub(super) struct Association<'a, S> {
    shared: &'a Shared,
    peer: Peer<S>,
    contexts: Vec<Context>,
    /// Who asked for it, from where.
    asked: Deed,
    pub(super) stored: u64,
    pub(super) refused: u64,
}

impl<'a, S: Stream> Association<'a, S> {
    pub(super) fn new(shared: &'a Shared, peer: Peer<S>, contexts: Vec<Context>, asked: Deed) -> Self {
        Self { shared, peer, contexts, asked, stored: 0, refused: 0 }
    }

    /// Answers messages until the association ends; returns how it did, and how many objects it stored and had refused.
    pub(super) async fn run(mut self) -> (Ending, u64, u64) {
        let ended = self.messages().await;
        let (stored, refused) = (self.stored, self.refused);
        let ending = match ended {
            Ok(true) => {
                self.peer.close().await;
                Ending::Released
            }
            Ok(false) => {
                self.peer.abort(&Broken::Unsendable("the service stops")).await;
                Ending::Stopped
            }
            Err(Broken::Lost(_) | Broken::Aborted) => Ending::Lost,
            Err(broken) => {
                self.peer.abort(&broken).await;
                Ending::Failed(broken)
            }
        };
        (ending, stored, refused)
    }

    /// Returns whether the other side released the association; else the service stops.
    async fn messages(&mut self) -> Result<bool, Broken> {
        loop {
            let event = tokio::select! {
                event = self.peer.next(IDLE_TIME) => event?,
                () = self.shared.ended(STOPPING_TIME) => return Ok(false),
            };
            let Event::Value(first) = event else {
                self.peer.write(&Pdu::ReleaseRP).await?;
                return Ok(true);
            };
            if first.value_type != PDataValueType::Command {
                return Err(Broken::Unexpected("a data set without its command"));
            }
            let id = first.presentation_context_id;
            let (mut bytes, mut last) = (first.data, first.is_last);
            while !last {
                let (more, is_last) = self.part(id, PDataValueType::Command, IDLE_TIME).await?;
                if bytes.len() + more.len() > MOST_COMMAND_BYTES {
                    return Err(Broken::Unexpected("a command set of more than 16 KiB"));
                }
                bytes.extend_from_slice(&more);
                last = is_last;
            }
            let command = Command::parse(&bytes).ok_or(Broken::Unexpected("a command set that cannot be read"))?;
            self.message(id, &command).await?;
        }
    }

    /// The next part of the message under way.
    async fn part(&mut self, context: u8, value_type: PDataValueType, time: Duration) -> Result<(Vec<u8>, bool), Broken> {
        match self.peer.next(time).await? {
            Event::Value(value) if value.value_type == value_type && value.presentation_context_id == context => {
                Ok((value.data, value.is_last))
            }
            Event::Value(_) => Err(Broken::Unexpected("a part of another message")),
            Event::Release => Err(Broken::Unexpected("the wish to release in the middle of a message")),
        }
    }

    async fn message(&mut self, id: u8, command: &Command) -> Result<(), Broken> {
        let context = self.contexts.iter().find(|context| context.id == id).cloned();
        let context = context.ok_or(Broken::Unexpected("a message of a presentation context that was not accepted"))?;
        match command.field {
            command::C_STORE => return self.store(&context, command).await,
            command::C_CANCEL if !command.has_data => return Ok(()),
            response if response & command::RESPONSE != 0 => return Err(Broken::Unexpected("a response to nothing")),
            _ => {}
        }
        if command.has_data {
            self.forget(id).await?;
        }
        let known = command.field == command::C_ECHO && context.class_uid == VERIFICATION;
        let status = if known { command::SUCCESS } else { command::UNRECOGNIZED };
        self.respond(id, command, status, None).await
    }

    /// C-STORE: receives the object, stores it and tells the audit log, and answers only then.
    async fn store(&mut self, context: &Context, request: &Command) -> Result<(), Broken> {
        if !request.has_data {
            return Err(Broken::Unexpected("C-STORE without a data set"));
        }
        let at = Timestamp::now();
        let Stored { status, comment, jobs } = match self.admit(context, request) {
            Err((status, comment)) => {
                self.forget(context.id).await?;
                Stored::refused(status, Some(comment.to_owned()))
            }
            Ok(object) => match self.receive(context.id, Some(object)).await? {
                Ok(Some(object)) => self.commit(object).await,
                Ok(None) => Stored::refused(command::OUT_OF_RESOURCES, None),
                Err(no_room) => Stored::refused(command::OUT_OF_RESOURCES, Some(no_room.to_string())),
            },
        };
        let refused = (status != command::SUCCESS).then(|| format!("{status:04X}"));
        if refused.is_none() {
            self.stored += 1;
        } else {
            self.refused += 1;
        }
        let owner = Some(self.shared.settings.owner.clone());
        let deed = Deed { at, what: "C-STORE".to_owned(), status: Some(status), owner, jobs, refused, ..self.asked.clone() };
        self.shared.tell(deed).await;
        metrics::counter!("ventricle_dimse_objects_total", "status" => format!("{status:04X}")).increment(1);
        self.respond(context.id, request, status, comment.as_deref()).await
    }

    /// What the request alone decides.
    fn admit(&self, context: &Context, request: &Command) -> Result<Object, (u16, &'static str)> {
        if context.class_uid == VERIFICATION || request.class_uid != context.class_uid {
            return Err((command::CLASS_NOT_SUPPORTED, "The SOP class is not that of the presentation context."));
        }
        if request.instance_uid.is_empty() {
            return Err((command::INVALID_INSTANCE, "The Affected SOP Instance UID is no UID."));
        }
        if self.shared.draining.is_cancelled() {
            return Err((command::OUT_OF_RESOURCES, "The service is stopping. Try again later."));
        }
        Object::new(&self.shared.memory, request, context).ok_or((command::INVALID_INSTANCE, "The UIDs cannot be written to a file."))
    }

    /// Receives a data set that nobody wants.
    async fn forget(&mut self, context: u8) -> Result<(), Broken> {
        self.receive(context, None).await.map(drop)
    }

    /// Receives a data set into the object, or forgets it. What is too large for the object is forgotten too; what has no end ends the
    /// association.
    async fn receive(&mut self, context: u8, mut object: Option<Object>) -> Result<Result<Option<Object>, NoRoom>, Broken> {
        let time = self.shared.settings.object_time;
        let (end, most) = (Instant::now() + time, self.shared.settings.object_bytes as u64 * FORGOTTEN_TIMES);
        let receiving = async {
            let (mut received, mut refusal) = (0, None);
            loop {
                let (data, is_last) = self.part(context, PDataValueType::Data, IDLE_TIME).await?;
                received += data.len() as u64;
                if received > most {
                    return Err(Broken::Unexpected("an object of several times the size that is accepted"));
                }
                if let Some(growing) = &mut object
                    && let Err(no_room) = growing.add(&data).await
                {
                    (object, refusal) = (None, Some(no_room));
                }
                if is_last {
                    return Ok(refusal.map_or(Ok(object), Err));
                }
            }
        };
        timeout_at(end, receiving).await.unwrap_or(Err(Broken::Time(time)))
    }

    /// Stores what was received.
    async fn commit(&self, object: Object) -> Stored {
        let mut reception = self.shared.assembler.reception_of(&self.shared.settings.owner, Way::Dimse);
        reception.take(object.whole()).await;
        let Received { outcomes, jobs } = reception.end().await;
        match outcomes.into_iter().next().map(|outcome| outcome.result) {
            Some(Ok(())) => Stored { status: command::SUCCESS, comment: None, jobs },
            Some(Err(refusal)) => Stored::refused(refusal.status(), Some(comment(&refusal))),
            None => Stored::refused(command::OUT_OF_RESOURCES, None),
        }
    }

    async fn respond(&mut self, context: u8, request: &Command, status: u16, comment: Option<&str>) -> Result<(), Broken> {
        self.peer.write_data(context, PDataValueType::Command, &request.response(status, comment)).await
    }
}

impl Shared {
    /// Returns when an association that waits for its next message is to end: at once where the listener closes, after a while where it drains.
    async fn ended(&self, patience: Duration) {
        let drained = async {
            self.draining.cancelled().await;
            sleep(patience).await;
        };
        tokio::select! {
            () = self.closing.cancelled() => {}
            () = drained => {}
        }
    }
}

/// What the sender is told. Of a store that fails it learns no more than that.
fn comment(refusal: &Refusal) -> String {
    match refusal {
        Refusal::Submit(SubmitError::Store(error)) => {
            tracing::warn!(%error, "an object could not be stored");
            "The service cannot store now. Try again later.".to_owned()
        }
        refusal => refusal.to_string(),
    }
}
