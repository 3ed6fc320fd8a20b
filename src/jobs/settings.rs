//! What can be chosen about a store, and about those who work on its jobs.

use super::{
    threads::Threads,
    work::{Work, reconstruct_and_export},
};
use crate::traces::Traces;
use std::{path::PathBuf, sync::Arc, time::Duration};

/// Where jobs are kept.
#[derive(Clone, PartialEq, Eq)]
pub enum Backend {
    /// An embedded database in this directory, made if it is not there. One process only.
    Sqlite {
        /// The data directory.
        directory: PathBuf,
    },
    /// A PostgreSQL database any number of nodes share.
    Postgres {
        /// `postgres://user:password@host/database`.
        url: String,
    },
}

impl std::fmt::Debug for Backend {
    /// Without the URL, which may hold a password.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sqlite { directory } => formatter.debug_struct("Sqlite").field("directory", directory).finish(),
            Self::Postgres { .. } => formatter.debug_struct("Postgres").finish_non_exhaustive(),
        }
    }
}

/// Everything about a store that can be chosen.
#[derive(Debug, Clone)]
pub struct StoreSettings {
    /// Where jobs are kept.
    pub backend: Backend,
    /// Most jobs waiting for a worker.
    pub max_queued_jobs: u64,
    /// Most bytes of input waiting for a worker.
    pub max_queued_bytes: u64,
    /// Claims of a job before it is given up as `worker_lost`.
    pub max_attempts: u32,
    /// How long a worker may hold a job without a heartbeat.
    pub lease: Duration,
    /// Pause before a job whose worker was lost is tried again, times the attempts so far: others come first, should it be the job that kills
    /// workers, and a service that is killed again and again does not lose the same job each time.
    pub retry_pause: Duration,
    /// Whether the input of a finished job is kept if the job does not say.
    pub keep_input: bool,
    /// How long a finished job and its results are kept if the job does not say; `None`: until they are deleted.
    pub retention: Option<Duration>,
    /// Where the result of every job that succeeds is sent, if anywhere.
    pub results_to: Option<String>,
    /// How long to wait for another process to leave the data directory.
    pub directory_wait: Duration,
    /// How often changes made by other processes are looked for while waiting.
    pub poll: Duration,
    /// Whether to hear of other nodes' changes by `LISTEN` (PostgreSQL), so that they are known at once instead of at the next poll.
    pub listen: bool,
    /// Connections to PostgreSQL besides the listening one (SQLite has one).
    pub connections: u32,
}

impl Default for StoreSettings {
    /// An embedded database in `./data`.
    fn default() -> Self {
        Self {
            backend: Backend::Sqlite { directory: PathBuf::from("data") },
            // A thousand eight-gate studies are an hour of work for two cores and 1.6 GB of input.
            max_queued_jobs: 1000,
            max_queued_bytes: 4 << 30,
            max_attempts: 3,
            // Six heartbeats: one late answer of a busy disk costs no job.
            lease: Duration::from_secs(30),
            // 4 and 8 s: three losses within the seconds that a service needs to come up again are not the job's doing.
            retry_pause: Duration::from_secs(4),
            keep_input: false,
            retention: None,
            results_to: None,
            // A service manager may start the next process while the last one still closes its files.
            directory_wait: Duration::from_secs(5),
            poll: Duration::from_secs(1),
            listen: true,
            connections: 10,
        }
    }
}

/// Everything about the workers that can be chosen.
#[derive(Clone)]
pub struct WorkerSettings {
    /// Jobs worked on at once.
    pub workers: usize,
    /// Who decides on how many threads a job is computed.
    pub threads: Threads,
    /// Name of this node in the leases, for people who read the table.
    pub node: String,
    /// How often a lease is renewed.
    pub heartbeat: Duration,
    /// How often progress is written at most.
    pub progress_interval: Duration,
    /// How often a free worker looks for jobs it was not told of.
    pub poll: Duration,
    /// What is done with a job.
    pub work: Work,
    /// Who is told what each took.
    pub traces: Traces,
}

impl Default for WorkerSettings {
    /// One worker with all processors.
    fn default() -> Self {
        Self {
            workers: 1,
            threads: Threads::ByLoad(std::thread::available_parallelism().map_or(1, std::num::NonZero::get)),
            node: "local".to_owned(),
            heartbeat: Duration::from_secs(5),
            progress_interval: Duration::from_millis(250),
            poll: Duration::from_secs(1),
            work: Arc::new(reconstruct_and_export),
            traces: Traces::default(),
        }
    }
}
