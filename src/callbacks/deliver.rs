//! Who claims deliveries, sends them and settles them: one task a node, with a bounded number of requests under way. Which node delivers
//! what does not matter.

use super::{
    results::{ResultError, Results},
    schedule::Schedule,
    send::{Answer, Message, SendError, Sender, WHOLE_TIME},
    signature::Signer,
};
use crate::jobs::{DeliveryClaim, DeliveryKind, Job, Settled, Store};
use std::{
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};
use tokio::{
    sync::Mutex,
    task::{JoinHandle, JoinSet},
    time::{sleep, timeout},
};
use tokio_util::sync::CancellationToken;

/// Time that giving back may take at the end.
const GIVE_BACK_TIME: Duration = Duration::from_secs(2);
/// Longest reason that is stored.
const LONGEST_REASON: usize = 200;

/// Makes the body that tells of a job's end.
pub type Body = Arc<dyn Fn(&Job) -> Vec<u8> + Send + Sync>;

/// Everything about delivering that can be chosen.
#[derive(Clone)]
pub struct DeliverySettings {
    /// What connects.
    pub sender: Sender,
    /// What tells of jobs' ends: signer and body. Without it, other nodes do.
    pub callbacks: Option<(Signer, Body)>,
    /// What sends results. Without it, other nodes do.
    pub results: Option<Results>,
    /// When it is tried again.
    pub schedule: Schedule,
    /// How long a delivery is this node's: longer than an attempt takes.
    pub lease: Duration,
    /// How often deliveries that are due are looked for.
    pub poll: Duration,
    /// Requests under way at once.
    pub at_once: usize,
}

impl DeliverySettings {
    /// The usual ones.
    pub fn new(sender: Sender, callbacks: Option<(Signer, Body)>, results: Option<Results>) -> Self {
        Self {
            sender,
            callbacks,
            results,
            schedule: Schedule::default(),
            // The time of an attempt and as much again for a database that answers late.
            lease: WHOLE_TIME * 2,
            poll: Duration::from_secs(1),
            // Few enough that nobody's service is flooded; eight receivers that never answer still leave one delivery every 2 s.
            at_once: 8,
        }
    }
}

impl DeliverySettings {
    /// What this node delivers.
    fn kinds(&self) -> Vec<DeliveryKind> {
        let callbacks = self.callbacks.is_some().then_some(DeliveryKind::Callback);
        callbacks.into_iter().chain(self.results.is_some().then_some(DeliveryKind::Result)).collect()
    }
}

/// The running task. Dropping it stops it without waiting; what it held is taken up again when its lease is over.
#[derive(Debug)]
pub struct Deliveries {
    stopping: CancellationToken,
    giving_back: CancellationToken,
    task: Mutex<Option<JoinHandle<()>>>,
}

/// Starts to deliver on the current runtime.
pub fn start(store: Store, settings: DeliverySettings) -> Deliveries {
    let (stopping, giving_back) = (CancellationToken::new(), CancellationToken::new());
    let courier = Arc::new(Courier { store, settings, giving_back: giving_back.clone() });
    let task = tokio::spawn(run(courier, stopping.clone()));
    Deliveries { stopping, giving_back, task: Mutex::new(Some(task)) }
}

impl Deliveries {
    /// Claims nothing more, waits for what is under way at most so long, then gives it back: any node may try it at once.
    pub async fn stop(&self, patience: Duration) {
        self.stopping.cancel();
        let Some(mut task) = self.task.lock().await.take() else { return };
        if timeout(patience, &mut task).await.is_err() {
            self.giving_back.cancel();
            if timeout(GIVE_BACK_TIME, &mut task).await.is_err() {
                task.abort();
            }
        }
    }
}

impl Drop for Deliveries {
    fn drop(&mut self) {
        if let Some(task) = self.task.get_mut() {
            task.abort();
        }
    }
}

struct Courier {
    store: Store,
    settings: DeliverySettings,
    giving_back: CancellationToken,
}

/// Delivers until told to stop, then ends what is under way.
async fn run(courier: Arc<Courier>, stopping: CancellationToken) {
    let (mut under_way, kinds) = (JoinSet::new(), courier.settings.kinds());
    while !stopping.is_cancelled() {
        while under_way.len() < courier.settings.at_once && !stopping.is_cancelled() {
            match courier.store.claim_delivery(&kinds, courier.settings.lease).await {
                Ok(Some(claim)) => {
                    let courier = Arc::clone(&courier);
                    under_way.spawn(async move { courier.deliver(claim).await });
                }
                Ok(None) => break,
                Err(error) => {
                    tracing::warn!(%error, "nothing to be delivered could be claimed");
                    break;
                }
            }
        }
        tokio::select! {
            () = stopping.cancelled() => {}
            Some(ended) = under_way.join_next() => report_panic(ended),
            () = sleep(courier.settings.poll) => {}
        }
    }
    while let Some(ended) = under_way.join_next().await {
        report_panic(ended);
    }
}

fn report_panic(ended: Result<(), tokio::task::JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "a delivery ended in a panic; its lease will lapse");
    }
}

impl Courier {
    /// One attempt and what becomes of it.
    async fn deliver(&self, claim: DeliveryClaim) {
        let settled = tokio::select! {
            biased;
            settled = self.attempt(&claim) => settled,
            () = self.giving_back.cancelled() => Some(Settled::GivenBack),
        };
        let Some(settled) = settled else { return };
        match self.store.settle_delivery(&claim, &settled).await {
            Ok(true) => {}
            Ok(false) => {
                tracing::warn!(delivery = %claim.id, "a delivery was no longer this node's: its lease was over, or its job is deleted");
            }
            Err(error) => tracing::warn!(%error, delivery = %claim.id, "the end of a delivery could not be stored; its lease will lapse"),
        }
    }

    /// Sends; returns what became of it, or `None` where there is nothing to settle.
    async fn attempt(&self, claim: &DeliveryClaim) -> Option<Settled> {
        let failure = match claim.kind {
            DeliveryKind::Callback => self.tell(claim).await?,
            DeliveryKind::Result => {
                let sent = self.settings.results.as_ref()?.send(&self.settings.sender, &self.store, claim.job, &claim.url).await;
                sent.err().as_ref().map(Failure::from)
            }
        };
        Some(self.judge(claim, failure))
    }

    /// Tells of a job's end; returns why that failed, if it did.
    async fn tell(&self, claim: &DeliveryClaim) -> Option<Option<Failure>> {
        let (signer, body) = self.settings.callbacks.as_ref()?;
        let job = match self.store.get(claim.job).await {
            Ok(job) => job?, // deleted with its deliveries
            Err(error) => {
                tracing::warn!(%error, delivery = %claim.id, "the job of a callback could not be read; its lease will lapse");
                return None;
            }
        };
        let body = body(&job);
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let headers = [("ventricle-delivery", claim.id.to_string()), ("ventricle-signature", signer.sign(now_s, &body))];
        let message = Message { media_type: "application/json", headers: &headers, body, answer_bytes: 0 };
        Some(match self.settings.sender.post(&claim.url, message).await {
            Ok(Answer { status: 200..=299, .. }) => None,
            Ok(Answer { status, retry_after, .. }) => {
                Some(Failure { wanted: retry_after, why: format!("status {status}"), refused: false })
            }
            Err(error) => Some(Failure::from(&error)),
        })
    }

    fn judge(&self, claim: &DeliveryClaim, failure: Option<Failure>) -> Settled {
        let (delivery, job, attempt, kind) = (claim.id, claim.job, claim.attempt, claim.kind.name());
        let Some(Failure { wanted, why, refused }) = failure else {
            tracing::info!(%delivery, %job, kind, attempt, "delivered");
            count(claim.kind, "delivered");
            return Settled::Delivered;
        };
        let Some(after) = self.settings.schedule.pause(delivery, attempt, wanted) else {
            tracing::error!(%delivery, %job, kind, attempt, why, "delivery given up");
            count(claim.kind, "given_up");
            return Settled::GivenUp { why };
        };
        tracing::warn!(%delivery, %job, kind, attempt, why, again_in_s = after.as_secs(), "not delivered");
        count(claim.kind, if refused { "refused" } else { "failed" });
        Settled::Again { after, why }
    }
}

/// Why an attempt failed.
struct Failure {
    /// When the receiver wants to be asked again.
    wanted: Option<Duration>,
    why: String,
    /// Whether the rules forbade it.
    refused: bool,
}

impl From<&SendError> for Failure {
    fn from(error: &SendError) -> Self {
        Self { wanted: None, why: short(error), refused: error.is_refusal() }
    }
}

impl From<&ResultError> for Failure {
    fn from(error: &ResultError) -> Self {
        Self { wanted: error.retry_after(), why: short(error), refused: error.is_refusal() }
    }
}

fn short(error: &impl std::fmt::Display) -> String {
    error.to_string().chars().take(LONGEST_REASON).collect()
}

/// Counts an attempt by how it ended.
fn count(kind: DeliveryKind, outcome: &'static str) {
    match kind {
        DeliveryKind::Callback => metrics::counter!("ventricle_callbacks_total", "outcome" => outcome).increment(1),
        DeliveryKind::Result => metrics::counter!("ventricle_results_sent_total", "outcome" => outcome).increment(1),
    }
}
