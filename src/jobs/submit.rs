//! How a job is accepted: its row and its input in one transaction, within the limits, once for each key.

use super::{
    database::{Row, Transaction, values},
    ending::kept_ms,
    error::{OwnerFull, StoreError, SubmitError},
    inbox::Members,
    input,
    job::{NewJob, Submitted},
    numbers::{Operation, timed},
    queue::{Load, Reservation},
    store::{INPUT, SUBJECT, Store, insert_blob, parse_id, sha256},
};
use crate::traces::current;
use tracing::Instrument as _;
use uuid::Uuid;

/// Jobs of an owner that wait.
const QUEUED_OF: &str = "SELECT COUNT(*) FROM jobs WHERE owner = $1 AND state = 'queued'";

impl Store {
    /// Whether an owner may have another job where so many may wait, to be known before a body is read. [`submit`](Self::submit) looks again.
    pub async fn admits(&self, owner: &str, most_queued: u64) -> Result<(), SubmitError> {
        let row = self.inner.database.fetch_one(QUEUED_OF, values![owner]).await?;
        self.within(row, most_queued)
    }

    fn within(&self, row: Option<Row>, most_queued: u64) -> Result<(), SubmitError> {
        let waiting = row.map_or(Ok(0), |row| row.get::<i64>(0))? as u64;
        if waiting < most_queued {
            return Ok(());
        }
        Err(OwnerFull { waiting, retry_after_s: self.inner.queue.full().retry_after_s }.into())
    }

    /// Stores a job. When this returns, the job is committed to disk. Runs to its end even if the caller goes away.
    pub async fn submit(&self, reservation: Reservation, new: NewJob) -> Result<Submitted, SubmitError> {
        self.submit_assembled(reservation, new, Members::None).await
    }

    /// Likewise, and notes in the same transaction that the job took these instances. Where a job has all of them already, it gives that one.
    pub async fn submit_assembled(&self, reservation: Reservation, new: NewJob, members: Members) -> Result<Submitted, SubmitError> {
        let store = self.clone();
        let submit = async move { timed(Operation::Submit, store.submit_to_end(reservation, new, members)).await };
        // A task of its own is part of nothing unless it is told.
        let submit = current().scope(submit);
        tokio::spawn(submit.in_current_span()).await.map_err(|_| StoreError::Interrupted)?
    }

    async fn submit_to_end(&self, mut reservation: Reservation, new: NewJob, members: Members) -> Result<Submitted, SubmitError> {
        let (owner, key, hash, most_queued) = (new.owner.clone(), new.idempotency_key.clone(), new.request_hash, new.most_queued);
        let row = tokio::task::spawn_blocking(move || NewRow::prepare(new)).await.map_err(|_| StoreError::Interrupted)??;
        let (id, bytes) = (row.id, row.input.len() as u64);
        let mut transaction = self.inner.database.begin().await?;
        // Where processes share the database, submissions go one by one: the limits are exact.
        transaction.fetch(&self.inner.database.render("{lock_queue}"), vec![]).await?;
        if let Some(key) = &key
            && let Some(existing) = existing(&mut transaction, &owner, key, &hash).await?
        {
            let job = self.get_in(&mut transaction, existing).await?;
            self.rejoin(&mut transaction, &owner, &members, existing).await?;
            transaction.commit().await?;
            return Ok(Submitted::Existing(job));
        }
        if let Some(existing) = self.taken(&mut transaction, &owner, &members).await? {
            return Ok(Submitted::Existing(self.get_in(&mut transaction, existing).await?));
        }
        if bytes > self.inner.queue.limit().bytes {
            return Err(SubmitError::TooLarge { bytes, limit: self.inner.queue.limit().bytes });
        }
        reservation.resize(bytes)?;
        let queued = queued(&mut transaction).await?;
        if !self.inner.queue.within_limit(Load { jobs: queued.jobs + 1, bytes: queued.bytes.saturating_add(bytes) }) {
            return Err(self.inner.queue.full().into());
        }
        if let Some(most) = most_queued {
            let row = transaction.fetch_one(QUEUED_OF, values![owner.as_str()]).await?;
            self.within(row, most)?;
        }
        row.insert(self, &mut transaction).await?;
        self.take(&mut transaction, &owner, members, id).await?;
        let job = self.get_in(&mut transaction, id).await?;
        let traced = current();
        // Before any worker can see the job.
        if let Some(origin) = traced.origin() {
            self.inner.origins.remember(id, origin);
        }
        transaction.commit().await?;
        traced.accepted(id);
        reservation.into_queued(bytes);
        self.inner.work_ready.notify_one();
        self.inner.watchers.announce(id);
        metrics::counter!("ventricle_jobs_submitted_total").increment(1);
        // Inside of the request that made it, if one did: its id and the job's stand in one line.
        tracing::info!(job_id = %id, "job accepted");
        Ok(Submitted::Created(job))
    }
}

/// A job about to be inserted.
struct NewRow {
    id: Uuid,
    new: NewJob,
    parameters: String,
    input: Vec<u8>,
    sha256: String,
}

impl NewRow {
    fn prepare(new: NewJob) -> Result<Self, StoreError> {
        let damaged = |error: &dyn std::fmt::Display| StoreError::Damaged { what: format!("a study cannot be stored: {error}") };
        let input = input::encode(&new.study).map_err(|error| damaged(&error))?;
        let parameters = serde_json::to_string(&new.parameters).map_err(|error| damaged(&error))?;
        let sha256 = sha256(&input);
        Ok(Self { id: Uuid::now_v7(), new, parameters, input, sha256 })
    }

    async fn insert(mut self, store: &Store, transaction: &mut Transaction) -> Result<(), StoreError> {
        let sql = store.inner.database.render(
            "INSERT INTO jobs (id, owner, idempotency_key, request_hash, kind, parameters, study_instance_uid, input_bytes, state,
                max_attempts, run_after, gates_total, created_at, retention_ms, callback_url, keep_input)
            VALUES ($1, $2, $3, $4, 'reconstruction', $5, $6, $7, 'queued', $8, {now}, $9, {now}, $10, $11, $12)
            RETURNING {notify}",
        );
        let size = self.input.len() as i64;
        let values = values![
            self.id,
            self.new.owner,
            self.new.idempotency_key,
            self.new.request_hash.to_vec(),
            self.parameters,
            self.new.study.acquisition.study_instance_uid,
            size,
            i64::from(store.inner.settings.max_attempts),
            self.new.study.gates.len() as i64,
            self.new.retention.map(kept_ms),
            self.new.callback_url,
            self.new.keep_input,
        ];
        transaction.fetch(&sql, values).await?;
        insert_blob(transaction, self.id, INPUT, input::MEDIA_TYPE, self.sha256, self.input).await?;
        if let Some(subject) = self.new.subject.take() {
            let subject = subject.encode();
            insert_blob(transaction, self.id, SUBJECT, "application/json", sha256(&subject), subject).await?;
        }
        Ok(())
    }
}

/// The job an owner made under a key, if the request was the same.
async fn existing(transaction: &mut Transaction, owner: &str, key: &str, hash: &[u8; 32]) -> Result<Option<Uuid>, SubmitError> {
    let sql = "SELECT id, request_hash FROM jobs WHERE owner = $1 AND idempotency_key = $2";
    let Some(row) = transaction.fetch_one(sql, values![owner, key]).await? else { return Ok(None) };
    if row.get::<Vec<u8>>(1)? != hash {
        return Err(SubmitError::KeyReused);
    }
    Ok(Some(parse_id(&row.get::<String>(0)?)?))
}

/// What is queued, by the rows.
async fn queued(transaction: &mut Transaction) -> Result<Load, StoreError> {
    let sql = "SELECT COUNT(*), CAST(COALESCE(SUM(input_bytes), 0) AS BIGINT) FROM jobs WHERE state = 'queued'";
    let row = transaction.fetch_one(sql, vec![]).await?;
    row.map_or(Ok(Load::default()), |row| Ok(Load { jobs: row.get::<i64>(0)? as u64, bytes: row.get::<i64>(1)? as u64 }))
}
