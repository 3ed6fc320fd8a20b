//! The instances of one request or association: each is looked at as it comes, committed to disk, and answered for.

use super::{Assembler, Settings, digest, read};
use crate::{
    intake::{self, Holds, Instance, IntakeError},
    jobs::{Filed, Members, NewInstance, Series, StoreError, SubmitError, Submitted},
    study::Study,
};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeSet;
use uuid::Uuid;

/// Excerpts held in memory until they are committed together.
const BATCH_BYTES: usize = 16 << 20;
/// Most bytes of excerpts that one request or association holds beside the object that it is receiving.
pub const MOST_WAITING_BYTES: u64 = BATCH_BYTES as u64;

/// How instances come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// By STOW-RS.
    Stow,
    /// By C-STORE.
    Dimse,
}

impl Way {
    /// Counts an instance by what became of it.
    fn count(self, outcome: &'static str) {
        let way = match self {
            Self::Stow => "stow",
            Self::Dimse => "dimse",
        };
        metrics::counter!("ventricle_instances_received_total", "way" => way, "outcome" => outcome).increment(1);
    }
}

/// What became of one instance.
#[derive(Debug)]
pub struct Outcome {
    /// SOP Class UID, if it could be read.
    pub class_uid: Option<String>,
    /// SOP Instance UID, if it could be read.
    pub instance_uid: Option<String>,
    /// Whether it is committed to disk.
    pub result: Result<(), Refusal>,
}

/// Why an instance was not taken.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    /// It is nothing that can be reconstructed.
    #[error("{0}")]
    Intake(#[from] IntakeError),
    /// It belongs to another study than the request says.
    #[error("the instance belongs to another study than the one in the address of the request")]
    OtherStudy,
    /// It could not be stored.
    #[error("{0}")]
    Submit(#[from] SubmitError),
}

impl From<StoreError> for Refusal {
    fn from(error: StoreError) -> Self {
        Self::Submit(error.into())
    }
}

impl Refusal {
    /// Status of C-STORE (PS3.4 table B.2-1, PS3.7 annex C) and Failure Reason of STOW-RS (PS3.18 table I.2-2).
    pub fn status(&self) -> u16 {
        match self {
            Self::Intake(error) => match innermost(error) {
                IntakeError::NotNuclearMedicine { .. } => 0x0122,
                IntakeError::UnsupportedTransferSyntax { .. } => 0xC122,
                IntakeError::DecoderUnavailable { .. } => 0xA700,
                IntakeError::Projections { .. } | IntakeError::NotTomographic { .. } => 0xA900,
                _ => 0xC000,
            },
            Self::OtherStudy => 0xA900,
            Self::Submit(SubmitError::InstanceConflict | SubmitError::KeyReused) => 0x0110,
            Self::Submit(
                SubmitError::QueueFull(_)
                | SubmitError::OwnerFull(_)
                | SubmitError::TooLarge { .. }
                | SubmitError::InstancesGone
                | SubmitError::Store(_),
            ) => 0xA700,
        }
    }

    /// What it is counted as.
    fn outcome(&self) -> &'static str {
        match self.status() {
            0x0110 => "conflict",
            0xA700 => "unavailable",
            _ => "refused",
        }
    }

    /// Which room was missing, if it was only that: there may be some later.
    pub fn no_room(&self) -> Option<SubmitError> {
        match self {
            Self::Submit(SubmitError::QueueFull(full)) => Some((*full).into()),
            Self::Submit(SubmitError::OwnerFull(full)) => Some((*full).into()),
            _ => None,
        }
    }
}

fn innermost(error: &IntakeError) -> &IntakeError {
    if let IntakeError::InFile { source, .. } = error { innermost(source) } else { error }
}

/// What became of all of them.
#[derive(Debug)]
pub struct Received {
    /// In the order they came.
    pub outcomes: Vec<Outcome>,
    /// The jobs that they made, or had made before.
    pub jobs: Vec<Uuid>,
}

/// Receives instances one after the other.
pub struct Reception {
    assembler: Assembler,
    /// Whose they are, and how many of its jobs may wait.
    owner: String,
    most_queued: Option<u64>,
    way: Way,
    study_uid: Option<String>,
    outcomes: Vec<Outcome>,
    jobs: Vec<Uuid>,
    /// Parts that are not committed yet, each with the place of its outcome.
    waiting: Vec<(usize, NewInstance)>,
    waiting_bytes: usize,
    series: BTreeSet<Series>,
}

/// SOP Class UID and SOP Instance UID, if they could be read.
type Names = (Option<String>, Option<String>);

/// An instance that was looked at, with its study if it is one.
struct Examined {
    instance: NewInstance,
    study: Option<intake::Received>,
}

impl Reception {
    pub(super) fn new(assembler: Assembler, (owner, most_queued): (String, Option<u64>), way: Way, study_uid: Option<String>) -> Self {
        Self {
            assembler,
            owner,
            most_queued,
            way,
            study_uid,
            outcomes: Vec::new(),
            jobs: Vec::new(),
            waiting: Vec::new(),
            waiting_bytes: 0,
            series: BTreeSet::new(),
        }
    }

    /// Takes one instance. What is a study by itself is a job when this returns; a part is committed with others, at the latest by
    /// [`end`](Self::end).
    pub async fn take(&mut self, bytes: impl AsRef<[u8]> + Send + 'static) {
        let owner = self.owner.clone();
        let examined = self.assembler.parse(move |settings| examine(bytes.as_ref(), owner, settings)).await;
        let Examined { instance, study } = match examined {
            Ok(Ok(examined)) => examined,
            Ok(Err(refused)) => return self.settle((refused.class_uid, refused.instance_uid), Err((*refused.error).into())),
            Err(error) => return self.settle((None, None), Err(error.into())),
        };
        let names = (Some(instance.class_uid.clone()), Some(instance.instance_uid.clone()));
        if self.study_uid.as_ref().is_some_and(|wanted| *wanted != instance.series.study_uid) {
            return self.settle(names, Err(Refusal::OtherStudy));
        }
        if let Some(study) = study {
            let submitted = self.submit(study, instance).await;
            return self.settle(names, submitted);
        }
        self.waiting_bytes += instance.data.len();
        self.waiting.push((self.outcomes.len(), instance));
        self.answer(names, Ok(()));
        if self.waiting_bytes >= BATCH_BYTES {
            self.commit().await;
        }
    }

    /// Commits what is left, makes jobs of the series that are complete, and says what became of every instance.
    pub async fn end(mut self) -> Received {
        self.commit().await;
        for series in std::mem::take(&mut self.series) {
            match self.assembler.assemble_if_complete(&series).await {
                Ok(job) => self.jobs.extend(job),
                // The instances are safe: they are looked at again when they are quiet.
                Err(error) => tracing::warn!(%error, "a study could not be put together yet"),
            }
        }
        Received { outcomes: self.outcomes, jobs: self.jobs }
    }

    fn answer(&mut self, (class_uid, instance_uid): Names, result: Result<(), Refusal>) {
        self.outcomes.push(Outcome { class_uid, instance_uid, result });
    }

    /// Answers for an instance of which it is known what it is counted as.
    fn settle(&mut self, names: Names, result: Result<&'static str, Refusal>) {
        self.way.count(match &result {
            Ok(outcome) => outcome,
            Err(refusal) => refusal.outcome(),
        });
        self.answer(names, result.map(drop));
    }

    async fn submit(&mut self, study: intake::Received, instance: NewInstance) -> Result<&'static str, Refusal> {
        let store = &self.assembler.store;
        let reservation = store.reserve(instance.data.len() as u64).map_err(SubmitError::from)?;
        let new = self.assembler.new_job((&self.owner, self.most_queued), None, study, digest([&instance.identity]));
        let submitted = store.submit_assembled(reservation, new, Members::Whole(instance)).await?;
        self.jobs.push(submitted.job().id);
        Ok(if matches!(submitted, Submitted::Created(_)) { "study" } else { "known" })
    }

    async fn commit(&mut self) {
        let (places, instances): (Vec<usize>, Vec<NewInstance>) = std::mem::take(&mut self.waiting).into_iter().unzip();
        self.waiting_bytes = 0;
        if instances.is_empty() {
            return;
        }
        let series: Vec<Series> = instances.iter().map(|instance| instance.series.clone()).collect();
        match self.assembler.store.file(instances).await {
            Ok(filed) => {
                for ((place, series), filed) in places.into_iter().zip(series).zip(filed) {
                    if filed == Filed::Conflict {
                        self.refuse(place, SubmitError::InstanceConflict.into());
                    } else {
                        self.way.count(if filed == Filed::New { "part" } else { "known" });
                        self.series.insert(series);
                    }
                }
            }
            Err(error) => {
                tracing::warn!(%error, "instances could not be stored");
                for place in places {
                    self.refuse(place, again(&error));
                }
            }
        }
    }

    /// Takes back the answer to a part that could not be committed.
    fn refuse(&mut self, place: usize, refusal: Refusal) {
        self.way.count(refusal.outcome());
        self.outcomes[place].result = Err(refusal);
    }
}

/// The same failure, for each of those it concerns.
fn again(error: &SubmitError) -> Refusal {
    match error {
        SubmitError::QueueFull(full) => SubmitError::QueueFull(*full).into(),
        _ => StoreError::Interrupted.into(),
    }
}

fn examine(bytes: &[u8], owner: String, settings: &Settings) -> Result<Examined, intake::Refused> {
    let instance = intake::examine(bytes, settings.keep_subject, &settings.limits)?;
    let study = if instance.holds == Holds::Study {
        let refused = |error| intake::Refused {
            class_uid: Some(instance.class_uid.clone()),
            instance_uid: Some(instance.instance_uid.clone()),
            error: Box::new(error),
        };
        Some(read(&[bytes], settings).map_err(refused)?)
    } else {
        None
    };
    let Instance { class_uid, instance_uid, study_uid, series_uid, holds, identity, excerpt } = instance;
    let identity = hex::encode(match &study {
        Some(received) => whole(identity, &received.study),
        None => identity,
    });
    let holds = serde_json::to_string(&holds).unwrap_or_default();
    let series = Series { owner, study_uid, series_uid };
    Ok(Examined { instance: NewInstance::new(series, class_uid, instance_uid, holds, identity, excerpt), study })
}

/// What an instance that is a study says, and its counts.
fn whole(identity: [u8; 32], study: &Study) -> [u8; 32] {
    let mut hash = Sha256::new_with_prefix(identity);
    for count in study.gates.iter().flat_map(|gate| &gate.volume.counts) {
        hash.update(count.to_le_bytes());
    }
    hash.finalize().into()
}
