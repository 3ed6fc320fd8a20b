//! The rows of the jobs and their data, as callers see them: submit, read, list, delete. The worker's side is in `lease.rs`.

use super::{
    error::{QueueFull, StoreError, SubmitError},
    job::{Blob, Counts, Deletion, Job, ListQuery, NewJob, Page, Submitted},
    queue::Reservation,
};
use std::{path::PathBuf, time::Duration};
use uuid::Uuid;

/// Where jobs are kept.
#[derive(Debug, Clone, PartialEq, Eq)]
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
    /// Whether the input of a finished job is kept.
    pub keep_input: bool,
    /// How long to wait for another process to leave the data directory.
    pub directory_wait: Duration,
    /// How often changes made by other processes are looked for while waiting.
    pub poll: Duration,
    /// Connections to PostgreSQL (SQLite has one).
    pub connections: u32,
}

/// The store of one process. Clones share it.
#[derive(Debug, Clone)]
pub struct Store {}

impl Store {
    /// Opens the store, makes or upgrades its tables and, on SQLite, puts what was running when the last process ended back into the
    /// queue (that no other process has the directory is certain).
    pub async fn open(settings: StoreSettings) -> Result<Self, StoreError> {
        todo!("{settings:?}")
    }

    /// Closes the database. Later operations of all clones fail.
    pub async fn close(&self) {
        todo!()
    }

    /// A place in the queue for a job of so many bytes, to be taken before its body is read.
    pub fn reserve(&self, bytes: u64) -> Result<Reservation, QueueFull> {
        todo!("{bytes}")
    }

    /// Stores a job. When this returns, the job is committed to disk. Runs to its end even if the caller goes away.
    pub async fn submit(&self, reservation: Reservation, new: NewJob) -> Result<Submitted, SubmitError> {
        todo!("{reservation:?} {new:?}")
    }

    /// A job.
    pub async fn get(&self, id: Uuid) -> Result<Option<Job>, StoreError> {
        todo!("{id}")
    }

    /// Jobs, newest first.
    pub async fn list(&self, query: ListQuery) -> Result<Page, StoreError> {
        todo!("{query:?}")
    }

    /// Cancels a job that is not finished, deletes one that is, with all its data. Runs to its end even if the caller goes away.
    pub async fn delete(&self, id: Uuid) -> Result<Deletion, StoreError> {
        todo!("{id}")
    }

    /// A result of a job by name: `report`, `surfaces.glb`, `gates/{n}/endocardial.glb`, `gates/{n}/epicardial.glb` (n from 1).
    pub async fn blob(&self, id: Uuid, name: &str) -> Result<Option<Blob>, StoreError> {
        todo!("{id}{name}")
    }

    /// Waits until the job's version differs from `seen_version`, the job is in a final state, or the time is over, whichever is
    /// first, and returns the job as it then is; `None` if there is no such job (any more).
    pub async fn wait_for_change(&self, id: Uuid, seen_version: i64, timeout: Duration) -> Result<Option<Job>, StoreError> {
        todo!("{id}{seen_version}{timeout:?}")
    }

    /// How full the store is.
    pub async fn counts(&self) -> Result<Counts, StoreError> {
        todo!()
    }

    /// Whether the database answers.
    pub async fn ping(&self) -> Result<(), StoreError> {
        todo!()
    }
}
