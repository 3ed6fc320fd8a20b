//! Studies from DICOM instances, as a PACS sends them: in one request or many, a file for all, a file a gate or a file a slice.
//!
//! An instance that is a study by itself becomes a job at once. One that is a part is kept, on disk, until the parts of its series are
//! complete by their own numbers, or until none has come for a while; what cannot be put together then is a failed job that says why, and
//! is tried again when more of it comes. So everything that was accepted ends in a job.

mod parsers;
mod reception;
mod series;

pub use parsers::{NotParsed, Parsers};
pub use reception::{MOST_WAITING_BYTES, Outcome, Received, Reception, Refusal, Way};

use crate::{
    access::{Access, Audit},
    intake::{self, IntakeError},
    jobs::{NewJob, Store, StoreError},
    pipeline::parameters::Parameters,
};
use sha2::{Digest, Sha256};
use std::{sync::Arc, time::Duration};
use tokio::task::AbortHandle;

/// How often series that went quiet are looked for, at most.
const LOOKED_EVERY: Duration = Duration::from_secs(1);

/// What puts studies together. Clones share it.
#[derive(Clone)]
pub struct Assembler {
    store: Store,
    settings: Arc<Settings>,
    parsers: Parsers,
    access: Arc<Access>,
}

/// How studies are put together.
#[derive(Debug, Clone)]
pub struct Settings {
    /// What an instance, and a study, may be.
    pub limits: intake::Limits,
    /// A series that does not say how many parts it has is taken as it is when none has come for so long.
    pub quiet: Duration,
    /// Whether it is kept whom studies are of.
    pub keep_subject: bool,
    /// Who is told of the end of the jobs.
    pub callback_url: Option<String>,
}

/// Looks for series that went quiet, until dropped.
#[derive(Debug)]
pub struct Watch(AbortHandle);

impl Drop for Watch {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Assembler {
    /// Parsing is done by these, and `access` knows how many jobs of an owner may wait.
    pub fn new(store: Store, settings: Settings, parsers: Parsers, access: Arc<Access>) -> Self {
        Self { store, settings: Arc::new(settings), parsers, access }
    }

    /// Begins to receive instances of an owner of whom so many jobs may wait; only of one study, if that is said.
    pub fn reception(&self, (owner, most_queued): (&str, Option<u64>), way: Way, study_uid: Option<String>) -> Reception {
        Reception::new(self.clone(), (owner.to_owned(), most_queued), way, study_uid)
    }

    /// Likewise, where no caller has a limit of its own.
    pub fn reception_of(&self, owner: &str, way: Way) -> Reception {
        self.reception((owner, self.access.queued_jobs_of(owner)), way, None)
    }

    /// Starts looking for series that went quiet. What becomes of them is told to the audit log, if there is one: no request has it in its line.
    pub fn watch(&self, audit: Option<Audit>) -> Watch {
        let assembler = self.clone();
        let task = tokio::spawn(async move {
            let pause = (assembler.settings.quiet / 4).clamp(Duration::from_millis(20), LOOKED_EVERY);
            loop {
                tokio::time::sleep(pause).await;
                if let Err(error) = assembler.assemble_quiet(audit.as_ref()).await {
                    tracing::warn!(%error, "studies that wait for their rest could not be looked for");
                }
            }
        });
        Watch(task.abort_handle())
    }

    /// Runs a parser on a thread that may take its time.
    async fn parse<T: Send + 'static>(&self, parser: impl FnOnce(&Settings) -> T + Send + 'static) -> Result<T, StoreError> {
        let settings = Arc::clone(&self.settings);
        self.parsers.run(move || parser(&settings)).await.map_err(|_| StoreError::Interrupted)
    }

    /// A job for a study, with the parameters of a request that says nothing.
    fn new_job(
        &self,
        (owner, most_queued): (&str, Option<u64>),
        idempotency_key: Option<String>,
        received: intake::Received,
        request_hash: [u8; 32],
    ) -> NewJob {
        NewJob {
            owner: owner.to_owned(),
            most_queued,
            idempotency_key,
            request_hash,
            study: received.study,
            subject: received.subject,
            parameters: Parameters::clinical(),
            retention: None,
            keep_input: None,
            callback_url: self.settings.callback_url.clone(),
        }
    }
}

/// Reads the study that these files make.
fn read(files: &[impl AsRef<[u8]>], settings: &Settings) -> Result<intake::Received, IntakeError> {
    let part = |file| intake::Part { media_type: Some("application/dicom"), filename: None, bytes: file };
    let parts: Vec<_> = files.iter().map(|file| part(file.as_ref())).collect();
    let options = intake::Options { keep_subject: settings.keep_subject, ..intake::Options::default() };
    intake::read(&parts, &options, &settings.limits)
}

fn digest(parts: impl IntoIterator<Item = impl AsRef<[u8]>>) -> [u8; 32] {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.as_ref().len() as u64).to_le_bytes());
        hash.update(part);
    }
    hash.finalize().into()
}
