//! What a caller sees of a job.

use super::store::sha256;
use crate::{pipeline::parameters::Parameters, report::Summary, study::Study, subject::Subject};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

/// Where a job is in its life. The last three are final.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Accepted and waiting for a worker.
    Queued,
    /// Held by a worker.
    Running,
    /// Finished, with all its results.
    Succeeded,
    /// Finished without results; [`Job::error`] says why.
    Failed,
    /// Stopped on request.
    Cancelled,
}

impl State {
    /// All states.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// The name used in JSON, SQL and metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// The state of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }

    /// Whether nothing more will happen to the job, except its deletion.
    pub fn is_final(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// Why a job failed: a stable code and a sentence for the user.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobError {
    /// Stable `snake_case` code: one of [`crate::pipeline::PipelineError::code`], `export_failed`, `worker_lost` or `internal_error`.
    pub code: String,
    /// One or two sentences without internal text.
    pub message: String,
}

/// A job as it was when it was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// UUID version 7: ids of later jobs sort after those of earlier ones.
    pub id: Uuid,
    /// Whose it is.
    pub owner: String,
    /// Where the job is in its life.
    pub state: State,
    /// Part of the work done, 0 to 1. 1 when succeeded; where it stopped when failed or cancelled.
    pub progress: f64,
    /// What is being computed (see [`crate::pipeline::monitor::Stage::name`]), while running.
    pub stage: Option<String>,
    /// Gates finished.
    pub gates_done: u64,
    /// Gates of the study.
    pub gates_total: u64,
    /// Place in the queue, from 1; only while queued.
    pub queue_position: Option<u64>,
    /// Estimated time to the end in s, from the measured rate; absent when finished and while nothing was measured yet.
    pub eta_seconds: Option<f64>,
    /// How often a worker has claimed the job.
    pub attempt: u32,
    /// Grows with every change a caller can see, except those of `queue_position` and `eta_seconds`.
    pub version: i64,
    /// When the job was accepted.
    pub created_at: Timestamp,
    /// When the latest attempt began.
    pub started_at: Option<Timestamp>,
    /// When the job reached its final state.
    pub finished_at: Option<Timestamp>,
    /// When the job is deleted with all its data; absent while it is not finished, and where it is kept until someone deletes it.
    pub expires_at: Option<Timestamp>,
    /// Why the job failed.
    pub error: Option<JobError>,
    /// DICOM Study Instance UID of the input, if it had one.
    pub study_instance_uid: Option<String>,
    /// Whether the job was asked to stop (it is still `running` until its worker has).
    pub cancel_requested: bool,
    /// Whether its input is there: until its end, and after it where it is kept.
    pub input_kept: bool,
    /// What a list tells of its result; absent unless it succeeded, and in jobs of versions before this was stored.
    pub summary: Option<Summary>,
}

/// The one owner of all jobs, as long as the service asks nobody for a key.
pub const ANONYMOUS: &str = "anonymous";

/// What is submitted.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Who submits; idempotency keys of different owners do not meet.
    pub owner: String,
    /// It is refused where already so many jobs of the owner wait.
    pub most_queued: Option<u64>,
    /// The client's key: the same key and request gives the same job.
    pub idempotency_key: Option<String>,
    /// SHA-256 of the request, to tell a retry from another request under the same key.
    pub request_hash: [u8; 32],
    /// The study, already parsed and checked.
    pub study: Study,
    /// Whom it is of, if that is kept.
    pub subject: Option<Subject>,
    /// The resolved parameters.
    pub parameters: Parameters,
    /// How long the job is kept after its end, if not as long as others ([`super::StoreSettings::retention`]).
    pub retention: Option<std::time::Duration>,
    /// Who is told of its end.
    pub callback_url: Option<String>,
    /// Whether the input is kept after the job's end, if not as that of others ([`super::StoreSettings::keep_input`]).
    pub keep_input: Option<bool>,
}

/// The input of a job that is there, with what another job on it takes over.
#[derive(Debug, Clone)]
pub struct KeptInput {
    /// The study, encoded (see [`super::input`]).
    pub study: Vec<u8>,
    /// Whom it is of, if that is kept.
    pub subject: Option<Subject>,
    /// What the job's request said of keeping it.
    pub keep_input: Option<bool>,
}

/// The answer to a submission.
#[derive(Debug, Clone, PartialEq)]
pub enum Submitted {
    /// A new job, committed to disk.
    Created(Job),
    /// The job an earlier submission of the same owner, key and request made.
    Existing(Job),
}

impl Submitted {
    /// The job, new or not.
    pub fn job(&self) -> &Job {
        match self {
            Self::Created(job) | Self::Existing(job) => job,
        }
    }
}

/// Which jobs to list.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ListQuery {
    /// Only jobs in this state.
    pub state: Option<State>,
    /// Only jobs of this study.
    pub study_instance_uid: Option<String>,
    /// Only jobs of this owner.
    pub owner: Option<String>,
    /// At most so many; 0 means [`ListQuery::DEFAULT_LIMIT`], more than [`ListQuery::LARGEST_LIMIT`] means that.
    pub limit: u32,
    /// [`Page::next_cursor`] of the page before.
    pub cursor: Option<Uuid>,
}

impl ListQuery {
    /// Jobs on a page when the caller does not say.
    pub const DEFAULT_LIMIT: u32 = 50;
    /// Most jobs on a page.
    pub const LARGEST_LIMIT: u32 = 500;
}

/// Jobs, newest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Page {
    /// The jobs.
    pub jobs: Vec<Job>,
    /// The cursor of the next page, if there are more jobs.
    pub next_cursor: Option<Uuid>,
}

/// What became of a request to delete a job.
#[derive(Debug, Clone, PartialEq)]
pub enum Deletion {
    /// The job was running and has been told to stop; it will be `cancelled` when its worker has.
    Cancelling(Job),
    /// The job was queued and is now `cancelled`.
    Cancelled(Job),
    /// The job was finished; it and all its data are gone.
    Deleted,
    /// There is no such job.
    NotFound,
}

/// A stored result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Blob {
    /// Media type of the data.
    pub media_type: String,
    /// SHA-256 of the data in lower-case hexadecimal, verified when read.
    pub sha256: String,
    /// The data.
    pub data: Vec<u8>,
}

impl Blob {
    /// A result that is made when it is asked for.
    pub fn new(media_type: &str, data: Vec<u8>) -> Self {
        Self { media_type: media_type.to_owned(), sha256: sha256(&data), data }
    }
}

/// How full the store is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Counts {
    /// Jobs waiting for a worker.
    pub queued: u64,
    /// Their inputs in bytes.
    pub queued_bytes: u64,
    /// Jobs held by workers, on all nodes.
    pub running: u64,
    /// How long the oldest queued job has waited, in s.
    pub oldest_queued_s: Option<f64>,
    /// Reservations of this process whose submission is still under way.
    pub reserved: u64,
    /// Most jobs that may be queued.
    pub max_queued_jobs: u64,
    /// Most bytes of input that may be queued.
    pub max_queued_bytes: u64,
}
