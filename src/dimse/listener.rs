//! Who is let in, how many at once, and how it stops.

use super::{
    association::{Association, Ending},
    negotiate, object,
    peer::{Broken, Peer, Stream},
    shown,
};
use crate::{
    access::{Audit, Deed},
    assembly::Assembler,
    intake::TransferSyntax,
    tls::Acceptor,
};
use dicom_ul::pdu::{AssociationRJ, AssociationRJResult, Pdu};
use std::{sync::Arc, time::Duration};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::{Mutex, Semaphore},
    task::{JoinHandle, JoinSet},
    time::{sleep, timeout},
};
use tokio_util::sync::CancellationToken;
use tracing::Instrument as _;
use uuid::Uuid;

/// Time for the request of an association, and before it for TLS (the ARTIM timer of PS3.8 9.1.5).
const REQUEST_TIME: Duration = Duration::from_secs(10);
/// Connections beside the associations: those that have not asked yet, or are told that they may not.
const OTHER_CONNECTIONS: usize = 64;
/// Pause when no connection could be accepted.
const SYSTEM_PAUSE: Duration = Duration::from_millis(100);

/// How associations are accepted.
#[derive(Clone)]
pub struct Settings {
    /// Calling AE titles that may associate; empty: any.
    pub callers: Vec<String>,
    /// Owner of the jobs that come.
    pub owner: String,
    /// Encodings in which objects are accepted.
    pub transfer_syntaxes: Vec<TransferSyntax>,
    /// Associations at once.
    pub associations: usize,
    /// Most bytes of one object.
    pub object_bytes: usize,
    /// Time for one object to arrive.
    pub object_time: Duration,
    /// Certificate and key, if it is encrypted.
    pub tls: Option<Arc<Acceptor>>,
}

/// What all associations share.
pub(super) struct Shared {
    pub(super) settings: Settings,
    pub(super) assembler: Assembler,
    pub(super) memory: object::Memory,
    pub(super) draining: CancellationToken,
    pub(super) closing: CancellationToken,
    audit: Option<Audit>,
    places: Semaphore,
}

/// The running listener. Dropping it ends all associations without a word.
#[derive(Debug)]
pub struct Listener {
    closing: CancellationToken,
    task: Mutex<Option<JoinHandle<()>>>,
}

/// Starts to accept associations on the current runtime. Once draining is cancelled they are rejected. What is stored or rejected is told to the audit log.
pub fn start(
    listener: TcpListener,
    settings: Settings,
    assembler: Assembler,
    audit: Option<Audit>,
    draining: CancellationToken,
) -> Listener {
    let closing = CancellationToken::new();
    let shared = Shared {
        memory: object::Memory::new(settings.object_bytes),
        places: Semaphore::new(settings.associations),
        closing: closing.clone(),
        settings,
        assembler,
        audit,
        draining,
    };
    let task = tokio::spawn(accept(listener, Arc::new(shared)));
    Listener { closing, task: Mutex::new(Some(task)) }
}

impl Listener {
    /// Accepts no more connections, ends the associations that wait for a message, and gives the objects under way so long.
    pub async fn stop(&self, patience: Duration) {
        self.closing.cancel();
        let Some(mut task) = self.task.lock().await.take() else { return };
        if timeout(patience, &mut task).await.is_err() {
            task.abort();
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        if let Some(task) = self.task.get_mut() {
            task.abort();
        }
    }
}

async fn accept(listener: TcpListener, shared: Arc<Shared>) {
    let mut connections = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(ended) = connections.join_next() => {
                if let Err(error) = ended {
                    tracing::error!(%error, "an association ended in a panic");
                    count("failed");
                }
                continue;
            }
            () = shared.closing.cancelled() => break,
        };
        match accepted {
            // Without a word: who opens so many connections does not read.
            Ok(_) if connections.len() >= shared.settings.associations + OTHER_CONNECTIONS => count("rejected"),
            Ok((stream, from)) => {
                let shared = Arc::clone(&shared);
                let id = Uuid::now_v7().to_string();
                let span = tracing::info_span!("association", request_id = %id);
                let asked = Deed::asked("A-ASSOCIATE", from.ip().to_canonical(), id);
                connections.spawn(async move { shared.connection(stream, asked).await }.instrument(span));
            }
            Err(error) => {
                tracing::warn!(%error, "no DICOM connection could be accepted");
                sleep(SYSTEM_PAUSE).await;
            }
        }
    }
    drop(listener);
    while connections.join_next().await.is_some() {}
}

/// Counts a connection by how it ended.
fn count(outcome: &'static str) {
    metrics::counter!("ventricle_dimse_associations_total", "outcome" => outcome).increment(1);
}

impl Shared {
    async fn connection(&self, stream: TcpStream, asked: Deed) {
        // Answers are small and waited for.
        let _ = stream.set_nodelay(true);
        let Some(tls) = &self.settings.tls else { return self.serve(stream, asked).await };
        match timeout(REQUEST_TIME, tls.accept(stream)).await {
            Ok(Ok(stream)) => self.serve(stream, asked).await,
            Ok(Err(_)) | Err(_) => count("failed"),
        }
    }

    async fn serve(&self, stream: impl Stream, mut asked: Deed) {
        let mut peer = Peer::new(stream);
        let request = tokio::select! {
            request = peer.request(REQUEST_TIME) => request,
            () = self.closing.cancelled() => return count("stopped"),
        };
        let request = match request {
            Ok(request) => request,
            Err(Broken::Lost(_) | Broken::Aborted) => return count("lost"),
            Err(broken) => {
                tracing::info!(reason = %broken, "a DICOM connection asked for no association");
                count("failed");
                return peer.abort(&broken).await;
            }
        };
        let caller = shown(&request.calling_ae_title);
        asked.who = Some(caller.clone());
        let judged = if self.draining.is_cancelled() {
            Err(negotiate::stopping())
        } else {
            negotiate::judge(&request, &self.settings.callers, &self.settings.transfer_syntaxes)
        };
        let (accepted, _place) =
            match judged.and_then(|accepted| Ok((accepted, self.places.try_acquire().map_err(|_| negotiate::no_room())?))) {
                Ok(accepted) => accepted,
                Err(rejection) => return self.reject(peer, rejection, asked).await,
            };
        peer.limit(accepted.most_bytes);
        if peer.write(&Pdu::AssociationAC(accepted.answer)).await.is_err() {
            return count("lost");
        }
        let (ending, stored, refused) = Association::new(self, peer, accepted.contexts, asked).run().await;
        match ending {
            Ending::Released => {
                tracing::info!(caller, stored, refused, "a DICOM association was released");
                count("released");
            }
            Ending::Lost => {
                tracing::info!(caller, stored, refused, "a DICOM association was lost");
                count("lost");
            }
            Ending::Stopped => {
                tracing::info!(caller, stored, refused, "a DICOM association was ended, as the service stops");
                count("stopped");
            }
            Ending::Failed(reason) => {
                tracing::warn!(caller, stored, refused, %reason, "a DICOM association was aborted");
                count("failed");
            }
        }
    }

    async fn reject<S: Stream>(&self, mut peer: Peer<S>, rejection: AssociationRJ, asked: Deed) {
        tracing::info!(caller = asked.who, reason = %rejection.source, "a DICOM association was rejected");
        count("rejected");
        // PS3.8 table 9-21.
        let status = match rejection.result {
            AssociationRJResult::Permanent => 1,
            AssociationRJResult::Transient => 2,
        };
        self.tell(Deed { status: Some(status), refused: Some(rejection.source.to_string()), ..asked }).await;
        if peer.write(&Pdu::AssociationRJ(rejection)).await.is_ok() {
            peer.close().await;
        }
    }

    /// Tells the audit log, if there is one.
    pub(super) async fn tell(&self, deed: Deed) {
        if let Some(audit) = &self.audit {
            audit.tell(deed).await;
        }
    }
}
