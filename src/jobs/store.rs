//! The rows of the jobs and their data, as callers see them: read, list, delete. Acceptance is in `submit.rs`, the worker's side in
//! `lease.rs`.

use super::{
    clock::Clock,
    database::{Database, Row, Transaction, values},
    error::{QueueFull, StoreError},
    feed::News,
    job::{Blob, Counts, Deletion, Job, KeptInput, ListQuery, Page, State},
    listen,
    numbers::{Operation, finished, timed},
    probe::LastProbe,
    progress::Progress,
    queue::{Load, Queue, Reservation},
    schema,
    settings::{Backend, StoreSettings},
    watch::Watchers,
};
use crate::{subject::Subject, traces::Origins};
use jiff::Timestamp;
use sha2::{Digest, Sha256};
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError},
    time::Duration,
};
use tokio::{
    sync::{Notify, broadcast},
    task::AbortHandle,
    time::Instant,
};
use tracing::Instrument as _;
use uuid::Uuid;

/// Name of the blob that holds the study.
pub(super) const INPUT: &str = "input";
/// Name of the blob that says whom the study is of.
pub(super) const SUBJECT: &str = "subject";

/// What every read of a job selects. The place in the queue is counted only where there is one.
const SELECT: &str = "
    SELECT id, owner, state, progress, stage, gates_done, gates_total, attempts, version, created_at, started_at, finished_at, expires_at, error,
        study_instance_uid, cancel_requested, summary, {now} AS read_at,
        EXISTS (SELECT 1 FROM blobs WHERE blobs.job_id = jobs.id AND blobs.name = 'input') AS input_kept,
        CASE WHEN state = 'queued' THEN (
            SELECT COUNT(*) FROM jobs AS ahead
            WHERE ahead.state = 'queued'
                AND (ahead.priority > jobs.priority OR (ahead.priority = jobs.priority AND ahead.id <= jobs.id))
        ) END AS queue_position
    FROM jobs";

/// The store of one process. Clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    pub(super) inner: Arc<Inner>,
}

#[derive(Debug)]
pub(super) struct Inner {
    pub(super) database: Database,
    pub(super) settings: StoreSettings,
    pub(super) queue: Arc<Queue>,
    pub(super) watchers: Watchers,
    /// Who tells those that listen to all jobs, once somebody does.
    pub(super) feed: OnceLock<broadcast::Sender<News>>,
    /// Told when a job may be claimed.
    pub(super) work_ready: Notify,
    /// What the workers of this process hold.
    running: Mutex<HashMap<Uuid, Arc<Progress>>>,
    /// Which requests of this process submitted which jobs, where requests are traced.
    pub(super) origins: Origins,
    /// Who hears what other nodes tell.
    listener: OnceLock<AbortHandle>,
    pub(super) last_probe: LastProbe,
    pub(super) clock: Clock,
    counting: tokio::sync::Mutex<()>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.stop_listening();
    }
}

impl Inner {
    fn stop_listening(&self) {
        if let Some(listener) = self.listener.get() {
            listener.abort();
        }
    }
}

impl Store {
    /// Opens the store, makes or upgrades its tables and, on SQLite, puts what was running when the last process ended back into the
    /// queue (that no other process has the directory is certain).
    pub async fn open(settings: StoreSettings) -> Result<Self, StoreError> {
        let database = match &settings.backend {
            Backend::Sqlite { directory } => Database::sqlite(directory, settings.directory_wait).await?,
            Backend::Postgres { url } => Database::postgres(url, settings.connections, settings.lease).await?,
        };
        schema::upgrade(&database).await?;
        let limit = Load { jobs: settings.max_queued_jobs, bytes: settings.max_queued_bytes };
        let queue = Arc::new(Queue::new(limit, Load::default(), recent_durations_s(&database).await?));
        let inner = Inner {
            database,
            settings,
            queue,
            watchers: Watchers::default(),
            feed: OnceLock::new(),
            work_ready: Notify::new(),
            running: Mutex::default(),
            origins: Origins::default(),
            listener: OnceLock::new(),
            last_probe: LastProbe::default(),
            clock: Clock::default(),
            counting: tokio::sync::Mutex::default(),
        };
        let store = Self { inner: Arc::new(inner) };
        if !store.inner.database.is_shared() {
            let reaped = store.reap_all().await?;
            if !reaped.is_empty() {
                tracing::info!(jobs = reaped.len(), "continuing what was running when the last process ended");
            }
        }
        let counts = store.counts().await?;
        store.inner.queue.counted(Load { jobs: counts.queued, bytes: counts.queued_bytes });
        store.inner.queue.served_in_all(counts.running);
        if let (Backend::Postgres { url }, true) = (&store.inner.settings.backend, store.inner.settings.listen) {
            let listener = tokio::spawn(listen::run(Arc::downgrade(&store.inner), url.clone()));
            store.inner.listener.get_or_init(|| listener.abort_handle());
        }
        Ok(store)
    }

    /// Closes the database. Later operations of all clones fail.
    pub async fn close(&self) {
        self.inner.stop_listening();
        self.inner.database.close().await;
    }

    /// A place in the queue for a job of so many bytes, to be taken before its body is read.
    pub fn reserve(&self, bytes: u64) -> Result<Reservation, QueueFull> {
        self.inner.queue.reserve(bytes)
    }

    /// A job.
    pub async fn get(&self, id: Uuid) -> Result<Option<Job>, StoreError> {
        let sql = format!("{SELECT} WHERE id = $1");
        timed(Operation::Read, self.inner.database.fetch_one(&sql, values![id])).await?.map(|row| self.job(&row)).transpose()
    }

    /// Whose a job is.
    pub async fn owner(&self, id: Uuid) -> Result<Option<String>, StoreError> {
        let row = self.inner.database.fetch_one("SELECT owner FROM jobs WHERE id = $1", values![id]).await?;
        row.map(|row| row.get(0)).transpose()
    }

    /// A job that is known to be there.
    pub(super) async fn get_in(&self, transaction: &mut Transaction, id: Uuid) -> Result<Job, StoreError> {
        let sql = self.inner.database.render(&format!("{SELECT} WHERE id = $1"));
        match transaction.fetch_one(&sql, values![id]).await? {
            Some(row) => self.job(&row),
            None => Err(StoreError::Damaged { what: format!("job {id} is not where it was") }),
        }
    }

    /// Jobs, newest first.
    pub async fn list(&self, query: ListQuery) -> Result<Page, StoreError> {
        let limit = match query.limit {
            0 => ListQuery::DEFAULT_LIMIT,
            limit => limit.min(ListQuery::LARGEST_LIMIT),
        } as usize;
        let sql = format!(
            "{SELECT} WHERE ($1 IS NULL OR state = $1) AND ($2 IS NULL OR study_instance_uid = $2) AND ($3 IS NULL OR id < $3)
                AND ($4 IS NULL OR owner = $4)
            ORDER BY id DESC LIMIT $5"
        );
        let state = query.state.map(|state| state.name().to_owned());
        let cursor = query.cursor.map(|id| id.to_string());
        let values = values![state, query.study_instance_uid, cursor, query.owner, limit as i64 + 1];
        let rows = timed(Operation::Read, self.inner.database.fetch(&sql, values)).await?;
        let mut jobs = rows.iter().map(|row| self.job(row)).collect::<Result<Vec<_>, _>>()?;
        let more = jobs.len() > limit;
        jobs.truncate(limit);
        Ok(Page { next_cursor: jobs.last().filter(|_| more).map(|job| job.id), jobs })
    }

    /// Cancels a job that is not finished, deletes one that is, with all its data. Runs to its end even if the caller goes away.
    pub async fn delete(&self, id: Uuid) -> Result<Deletion, StoreError> {
        let store = self.clone();
        tokio::spawn(async move { store.delete_to_end(id).await }.in_current_span()).await.map_err(|_| StoreError::Interrupted)?
    }

    async fn delete_to_end(&self, id: Uuid) -> Result<Deletion, StoreError> {
        let database = &self.inner.database;
        let mut transaction = database.begin().await?;
        // Each statement acts in one state only, so that a worker claiming or finishing the job meanwhile cannot make two of them act.
        let cancel = "UPDATE jobs SET state = 'cancelled', cancel_requested = TRUE, finished_at = {now}, version = version + 1
            WHERE id = $1 AND state = 'queued' RETURNING input_bytes, {notify}";
        if let Some(row) = transaction.fetch_one(&database.render(cancel), values![id]).await? {
            let bytes = row.get::<i64>(0)?;
            self.end(&mut transaction, id).await?;
            let job = self.get_in(&mut transaction, id).await?;
            transaction.commit().await?;
            self.inner.queue.left(bytes as u64);
            self.inner.watchers.announce(id);
            finished(State::Cancelled);
            return Ok(Deletion::Cancelled(job));
        }
        let request = "UPDATE jobs SET cancel_requested = TRUE, version = CASE WHEN cancel_requested THEN version ELSE version + 1 END
            WHERE id = $1 AND state = 'running' RETURNING {notify}";
        if transaction.fetch_one(&database.render(request), values![id]).await?.is_some() {
            let job = self.get_in(&mut transaction, id).await?;
            transaction.commit().await?;
            if let Some(progress) = self.running().get(&id) {
                progress.cancel();
            }
            self.inner.watchers.announce(id);
            return Ok(Deletion::Cancelling(job));
        }
        let delete = "DELETE FROM jobs WHERE id = $1 AND state IN ('succeeded', 'failed', 'cancelled') RETURNING owner, {notify}";
        let deleted = transaction.fetch_one(&database.render(delete), values![id]).await?;
        let owner = deleted.map(|row| row.get::<String>(0)).transpose()?;
        transaction.commit().await?;
        let Some(owner) = owner else { return Ok(Deletion::NotFound) };
        self.inner.watchers.announce_of(id, &owner);
        Ok(Deletion::Deleted)
    }

    /// A result of a job by name: `report`, `surfaces.glb`, `gates/{n}/endocardial.glb`, `gates/{n}/epicardial.glb`,
    /// `gates/{n}/wall.vtu` (n from 1).
    pub async fn blob(&self, id: Uuid, name: &str) -> Result<Option<Blob>, StoreError> {
        let sql = "SELECT media_type, sha256, data FROM blobs WHERE job_id = $1 AND name = $2";
        let Some(row) = timed(Operation::Read, self.inner.database.fetch_one(sql, values![id, name])).await? else { return Ok(None) };
        let (media_type, sha256, data) = (row.get(0)?, row.get::<String>(1)?, row.get(2)?);
        drop(row);
        let data = intact(sha256.clone(), data, || format!("{name} of job {id}")).await?;
        Ok(Some(Blob { media_type, sha256, data }))
    }

    /// Whom a job's study is of, if that was kept.
    pub async fn subject(&self, id: Uuid) -> Result<Option<Subject>, StoreError> {
        let Some(blob) = self.blob(id, SUBJECT).await? else { return Ok(None) };
        Subject::decode(&blob.data).map(Some).map_err(|error| StoreError::Damaged { what: format!("subject of job {id}: {error}") })
    }

    /// The input of a job, as long as it is there.
    pub async fn kept_input(&self, id: Uuid) -> Result<Option<KeptInput>, StoreError> {
        let sql = "SELECT keep_input FROM jobs WHERE id = $1";
        let Some(row) = self.inner.database.fetch_one(sql, values![id]).await? else { return Ok(None) };
        let keep_input = row.get(0)?;
        drop(row);
        let subject = self.subject(id).await?;
        // Last: where it is there, the job is as it was read.
        let Some(study) = self.blob(id, INPUT).await? else { return Ok(None) };
        Ok(Some(KeptInput { study: study.data, subject, keep_input }))
    }

    /// Waits until the job's version differs from `seen_version`, the job is in a final state, or the time is over, whichever is
    /// first, and returns the job as it then is; `None` if there is no such job (any more).
    pub async fn wait_for_change(&self, id: Uuid, seen_version: i64, timeout: Duration) -> Result<Option<Job>, StoreError> {
        let deadline = Instant::now() + timeout;
        let mut watcher = self.inner.watchers.watch(id);
        loop {
            let job = self.get(id).await?;
            let waiting = job.as_ref().is_some_and(|job| job.version == seen_version && !job.state.is_final());
            if !waiting || Instant::now() >= deadline {
                return Ok(job);
            }
            let next_look = deadline.min(Instant::now() + self.inner.settings.poll);
            tokio::select! {
                () = watcher.changed() => {}
                () = tokio::time::sleep_until(next_look) => {}
            }
        }
    }

    /// How full the store is.
    pub async fn counts(&self) -> Result<Counts, StoreError> {
        let sql = "SELECT COUNT(*), CAST(COALESCE(SUM(input_bytes), 0) AS BIGINT), {now} - MIN(created_at),
            (SELECT COUNT(*) FROM jobs WHERE state = 'running') FROM jobs WHERE state = 'queued'";
        let (limit, reserved) = (self.inner.queue.limit(), self.inner.queue.reserved());
        let mut counts =
            Counts { reserved: reserved.jobs, max_queued_jobs: limit.jobs, max_queued_bytes: limit.bytes, ..Counts::default() };
        if let Some(row) = self.inner.database.fetch_one(sql, vec![]).await? {
            counts.queued = row.get::<i64>(0)? as u64;
            counts.queued_bytes = row.get::<i64>(1)? as u64;
            counts.oldest_queued_s = row.get::<Option<i64>>(2)?.map(|ms| ms.max(0) as f64 / 1e3);
            counts.running = row.get::<i64>(3)? as u64;
        }
        Ok(counts)
    }

    /// Whether the database answers.
    pub async fn ping(&self) -> Result<(), StoreError> {
        self.inner.database.fetch_one("SELECT version FROM schema_version", vec![]).await.map(drop)
    }

    /// Tells the metrics what the rows say and, where other processes change them too, the queue: what waits and how fast it moves.
    pub async fn publish_counts(&self) -> Result<(), StoreError> {
        // One after the other: what was counted before must not be told after.
        let _alone = self.inner.counting.lock().await;
        let counts = self.counts().await?;
        if self.inner.database.is_shared() {
            self.inner.queue.counted(Load { jobs: counts.queued, bytes: counts.queued_bytes });
            self.inner.queue.served_in_all(counts.running);
            self.inner.queue.measured_in_all(recent_durations_s(&self.inner.database).await?);
        }
        metrics::gauge!("ventricle_jobs_running").set(counts.running as f64);
        metrics::gauge!("ventricle_queue_oldest_seconds").set(counts.oldest_queued_s.unwrap_or(0.0));
        Ok(())
    }

    /// What the workers of this process hold.
    pub(super) fn running(&self) -> MutexGuard<'_, HashMap<Uuid, Arc<Progress>>> {
        self.inner.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A job from a row of [`SELECT`].
    fn job(&self, row: &Row) -> Result<Job, StoreError> {
        let id = parse_id(&row.named::<String>("id")?)?;
        let damaged = |what: &str| StoreError::Damaged { what: format!("{what} of job {id}") };
        let time = |column: &str| {
            let ms = row.named::<Option<i64>>(column)?;
            ms.map(|ms| Timestamp::from_millisecond(ms).map_err(|_| damaged(column))).transpose()
        };
        let state = State::from_name(&row.named::<String>("state")?).ok_or_else(|| damaged("state"))?;
        let progress = row.named::<f64>("progress")?;
        let queue_position = row.named::<Option<i64>>("queue_position")?.map(|position| position as u64);
        let read_at = time("read_at")?;
        let started_at = time("started_at")?;
        let elapsed_s = read_at.zip(started_at).map_or(0.0, |(now, start)| now.duration_since(start).as_secs_f64().max(0.0));
        let eta_seconds = match state {
            State::Queued => queue_position.and_then(|position| self.inner.queue.eta_queued_s(position)),
            State::Running => self.inner.queue.eta_running_s(elapsed_s, progress),
            State::Succeeded | State::Failed | State::Cancelled => None,
        };
        let error = row.named::<Option<String>>("error")?;
        let summary = row.named::<Option<String>>("summary")?;
        Ok(Job {
            id,
            owner: row.named("owner")?,
            state,
            progress,
            stage: row.named("stage")?,
            gates_done: row.named::<i64>("gates_done")? as u64,
            gates_total: row.named::<i64>("gates_total")? as u64,
            queue_position,
            eta_seconds,
            attempt: row.named::<i64>("attempts")? as u32,
            version: row.named("version")?,
            created_at: time("created_at")?.ok_or_else(|| damaged("created_at"))?,
            started_at,
            finished_at: time("finished_at")?,
            expires_at: time("expires_at")?,
            error: error.map(|text| serde_json::from_str(&text)).transpose().map_err(|_| damaged("error"))?,
            study_instance_uid: row.named("study_instance_uid")?,
            cancel_requested: row.named("cancel_requested")?,
            input_kept: row.named("input_kept")?,
            summary: summary.map(|text| serde_json::from_str(&text)).transpose().map_err(|_| damaged("summary"))?,
        })
    }
}

/// Stores one blob of a job.
pub(super) async fn insert_blob(
    transaction: &mut Transaction,
    job_id: Uuid,
    name: &str,
    media_type: &str,
    sha256: String,
    data: Vec<u8>,
) -> Result<(), StoreError> {
    let sql = "INSERT INTO blobs (job_id, name, media_type, sha256, size, data) VALUES ($1, $2, $3, $4, $5, $6)";
    transaction.execute(sql, values![job_id, name, media_type, sha256, data.len() as i64, data]).await.map(drop)
}

/// Data if they are what was stored; else it is said what is not.
pub(super) async fn intact(stored_sha256: String, data: Vec<u8>, what: impl FnOnce() -> String) -> Result<Vec<u8>, StoreError> {
    let data = tokio::task::spawn_blocking(move || (sha256(&data) == stored_sha256).then_some(data));
    let damaged = || StoreError::Damaged { what: format!("{} does not match its SHA-256", what()) };
    data.await.map_err(|_| StoreError::Interrupted)?.ok_or_else(damaged)
}

/// Durations in s of the jobs that succeeded last, on whichever node, latest first.
async fn recent_durations_s(database: &Database) -> Result<Vec<f64>, StoreError> {
    let sql = "SELECT finished_at - started_at FROM jobs WHERE state = 'succeeded' AND started_at IS NOT NULL ORDER BY id DESC LIMIT 32";
    database.fetch(sql, vec![]).await?.iter().map(|row| Ok(row.get::<i64>(0)?.max(0) as f64 / 1e3)).collect()
}

pub(super) fn parse_id(text: &str) -> Result<Uuid, StoreError> {
    Uuid::parse_str(text).map_err(|_| StoreError::Damaged { what: format!("job id {text:?}") })
}

/// SHA-256 in lower-case hexadecimal.
pub(super) fn sha256(data: &[u8]) -> String {
    hex::encode(Sha256::digest(data))
}
