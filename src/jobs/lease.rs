//! The worker's side of the rows: claim, heartbeat, finish, give back, reap.
//!
//! Every statement names the attempt it belongs to. `attempts` only ever grows, so a worker whose lease was reaped finds no row to
//! change, however late it comes. What is given back uncharged therefore raises `max_attempts` instead of lowering `attempts`.

use super::{
    database::values,
    error::StoreError,
    job::{JobError, State},
    numbers::{Operation, failed, finished, timed, took},
    progress::Snapshot,
    queue::Load,
    store::{INPUT, Store, insert_blob, intact, parse_id, sha256},
    work::{Output, SUMMARY},
};
use std::{sync::Arc, time::Duration};
use uuid::Uuid;

/// Most waiting jobs that a claim counts. More than the processors of a machine make no difference to it.
pub(super) const MOST_COUNTED: u64 = 128;

/// Code of a job that was given up because every worker that took it was lost.
const WORKER_LOST: &str = "worker_lost";

/// A job held by a worker.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    /// The job.
    pub id: Uuid,
    /// The fencing token.
    pub attempt: i64,
    /// The parameters, as stored: JSON of [`crate::pipeline::parameters::Parameters`].
    pub parameters: String,
    /// From its acceptance to this claim.
    pub waited: Duration,
    /// Further jobs that can be claimed now, on whichever node; 128 at most.
    pub others_waiting: u64,
}

/// The answer to a heartbeat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heartbeat {
    /// The job is still held.
    Held {
        /// Whether it should stop.
        cancel: bool,
    },
    /// The job is no longer this attempt's; nothing it does counts.
    Lost,
}

/// How the work on a job ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// With these results.
    Succeeded(Arc<[Output]>),
    /// The same input would fail again.
    Failed(JobError),
    /// It stopped because it was asked to.
    Cancelled,
}

/// The answer to [`Store::finish`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finish {
    /// The job is now in this state. A success that comes after the request to cancel is `cancelled`.
    Done(State),
    /// The job is no longer this attempt's; nothing was stored.
    Lost,
}

/// A job taken from a lost worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reaped {
    /// The job.
    pub id: Uuid,
    /// `queued` again, `failed` after its last attempt, or `cancelled` if it had been asked to stop.
    pub state: State,
}

impl Store {
    /// Takes the job that waits longest among those of the highest priority, if any, and counts the attempt.
    pub async fn claim(&self, worker: &str) -> Result<Option<Claim>, StoreError> {
        let sql = "UPDATE jobs SET state = 'running', attempts = attempts + 1, lease_owner = $1, lease_until = {now} + $2,
                started_at = {now}, progress = 0, stage = NULL, gates_done = 0, version = version + 1
            WHERE state = 'queued' AND id = (
                SELECT id FROM jobs WHERE state = 'queued' AND run_after <= {now} ORDER BY priority DESC, id LIMIT 1 {skip_locked}
            )
            RETURNING id, attempts, parameters, input_bytes, started_at - created_at, (
                SELECT COUNT(*) FROM (
                    SELECT 1 FROM jobs AS others WHERE others.state = 'queued' AND others.run_after <= {now} AND others.id <> jobs.id LIMIT $3
                ) AS waiting
            ), {notify}";
        let values = values![worker, milliseconds(self.inner.settings.lease), MOST_COUNTED as i64];
        let Some(row) = timed(Operation::Claim, self.inner.database.fetch_one(sql, values)).await? else { return Ok(None) };
        self.inner.queue.left(row.get::<i64>(3)? as u64);
        let id = parse_id(&row.get::<String>(0)?)?;
        self.inner.watchers.announce(id);
        let waited = Duration::from_millis(row.get::<i64>(4)?.max(0) as u64);
        let others_waiting = row.get::<i64>(5)?.max(0) as u64;
        Ok(Some(Claim { id, attempt: row.get(1)?, parameters: row.get(2)?, waited, others_waiting }))
    }

    /// The stored study of a claimed job, encoded (see [`super::input`]); `None` if the job is no longer this attempt's. Whoever has it
    /// now may have finished it and deleted its input; where the job is still held, an absent input is damage.
    pub async fn input(&self, claim: &Claim) -> Result<Option<Vec<u8>>, StoreError> {
        let sql = "SELECT blobs.sha256, blobs.data FROM jobs LEFT JOIN blobs ON blobs.job_id = jobs.id AND blobs.name = $3
            WHERE jobs.id = $1 AND jobs.attempts = $2 AND jobs.state = 'running'";
        let read = self.inner.database.fetch_one(sql, values![claim.id, claim.attempt, INPUT]);
        let Some(row) = timed(Operation::Read, read).await? else { return Ok(None) };
        let (Some(sha256), Some(data)) = (row.get::<Option<String>>(0)?, row.get::<Option<Vec<u8>>>(1)?) else {
            return Err(StoreError::Damaged { what: format!("job {} has no input", claim.id) });
        };
        drop(row);
        intact(sha256, data, || format!("{INPUT} of job {}", claim.id)).await.map(Some)
    }

    /// Renews the lease and, if there is news, stores the progress; returns whether the job should stop.
    pub async fn heartbeat(&self, claim: &Claim, news: Option<&Snapshot>) -> Result<Heartbeat, StoreError> {
        let sql = "UPDATE jobs SET lease_until = {now} + $3, progress = COALESCE($4, progress), stage = COALESCE($5, stage),
                gates_done = COALESCE($6, gates_done), version = version + $7
            WHERE id = $1 AND attempts = $2 AND state = 'running'
            RETURNING cancel_requested, CASE WHEN $7 > 0 THEN {notify} END";
        let values = values![
            claim.id,
            claim.attempt,
            milliseconds(self.inner.settings.lease),
            news.map(|news| news.fraction),
            news.and_then(|news| news.stage).map(|stage| stage.name().to_owned()),
            news.map(|news| news.gates_done as i64),
            i64::from(news.is_some()),
        ];
        let renewed = timed(Operation::Heartbeat, self.inner.database.fetch_one(sql, values)).await?;
        let Some(row) = renewed else { return Ok(Heartbeat::Lost) };
        if news.is_some() {
            self.inner.watchers.announce(claim.id);
        }
        Ok(Heartbeat::Held { cancel: row.get(0)? })
    }

    /// Stores the final state and, with it, the results.
    pub async fn finish(&self, claim: &Claim, outcome: Outcome, last: &Snapshot) -> Result<Finish, StoreError> {
        timed(Operation::Finish, self.finish_untimed(claim, outcome, last)).await
    }

    async fn finish_untimed(&self, claim: &Claim, outcome: Outcome, last: &Snapshot) -> Result<Finish, StoreError> {
        let (wanted, outputs, error) = match outcome {
            Outcome::Succeeded(outputs) => (State::Succeeded, outputs, None),
            Outcome::Failed(error) => (State::Failed, Arc::default(), Some(error)),
            Outcome::Cancelled => (State::Cancelled, Arc::default(), None),
        };
        let code = error.as_ref().map(|error| error.code.clone());
        let error = error.map(|error| serde_json::to_string(&error)).transpose().unwrap_or_default();
        let summary = outputs.iter().find(|output| output.name == SUMMARY);
        let summary = summary.map(|output| String::from_utf8_lossy(&output.data).into_owned());
        let hashed = Arc::clone(&outputs);
        let hashes = tokio::task::spawn_blocking(move || hashed.iter().map(|output| sha256(&output.data)).collect::<Vec<_>>())
            .await
            .map_err(|_| StoreError::Interrupted)?;
        let sql = self.inner.database.render(
            "UPDATE jobs SET state = CASE WHEN cancel_requested THEN 'cancelled' ELSE $3 END,
                error = CASE WHEN cancel_requested THEN NULL ELSE $4 END, summary = CASE WHEN NOT cancel_requested THEN $7 END,
                progress = CASE WHEN $3 = 'succeeded' AND NOT cancel_requested THEN 1 ELSE $5 END, gates_done = $6,
                stage = NULL, lease_owner = NULL, lease_until = NULL, finished_at = {now}, version = version + 1
            WHERE id = $1 AND attempts = $2 AND state = 'running'
            RETURNING state, finished_at - started_at, {notify}",
        );
        let mut transaction = self.inner.database.begin().await?;
        let values = values![claim.id, claim.attempt, wanted.name(), error, last.fraction, last.gates_done as i64, summary];
        let Some(row) = transaction.fetch_one(&sql, values).await? else { return Ok(Finish::Lost) };
        let state = State::from_name(&row.get::<String>(0)?).unwrap_or(wanted);
        let duration_s = row.get::<i64>(1)?.max(0) as f64 / 1e3;
        if state == State::Succeeded {
            for (output, sha256) in outputs.iter().zip(hashes).filter(|(output, _)| output.name != SUMMARY) {
                insert_blob(&mut transaction, claim.id, &output.name, output.media_type, sha256, output.data.clone()).await?;
            }
        }
        self.end(&mut transaction, claim.id).await?;
        transaction.commit().await?;
        self.inner.watchers.announce(claim.id);
        match code.filter(|_| state == State::Failed) {
            Some(code) => failed(&code),
            None => finished(state),
        }
        if state == State::Succeeded {
            self.inner.queue.measured(duration_s);
        }
        took(state, &claim.parameters, duration_s);
        Ok(Finish::Done(state))
    }

    /// Puts a job back into the queue as if it had never been claimed, except that `attempt` stays counted for fencing. Returns whether
    /// it was still held. A job that was asked to stop is `cancelled` instead.
    pub async fn give_back(&self, claim: &Claim) -> Result<bool, StoreError> {
        let filter = "id = $2 AND attempts = $3";
        let reaped = self.take_back(filter, values![claim.id, claim.attempt], 1, Duration::ZERO).await?;
        Ok(!reaped.is_empty())
    }

    /// Takes back the jobs whose lease is over.
    pub async fn reap(&self) -> Result<Vec<Reaped>, StoreError> {
        self.take_back("lease_until < {now}", vec![], 0, self.inner.settings.retry_pause).await
    }

    /// Takes back the jobs whose lease was over at this time of the database's clock, in ms since 1970, but for those that workers of this
    /// process hold: they are there, and renew it as soon as they can.
    pub(super) async fn reap_lost(&self, now_ms: i64) -> Result<Vec<Reaped>, StoreError> {
        let mut values = values![now_ms];
        values.extend(self.running().keys().map(|id| id.to_string().into()));
        let held: Vec<String> = (3..values.len() + 2).map(|number| format!("${number}")).collect();
        let filter = match held[..] {
            [] => "lease_until < $2".to_owned(),
            _ => format!("lease_until < $2 AND id NOT IN ({})", held.join(", ")),
        };
        self.take_back(&filter, values, 0, self.inner.settings.retry_pause).await
    }

    /// Takes back all running jobs: no worker can hold any.
    pub(super) async fn reap_all(&self) -> Result<Vec<Reaped>, StoreError> {
        self.take_back("TRUE", vec![], 0, self.inner.settings.retry_pause).await
    }

    /// Takes running jobs back from their workers, with `credit` more attempts to come.
    async fn take_back(
        &self,
        filter: &str,
        filter_values: Vec<super::database::Value>,
        credit: i64,
        pause: Duration,
    ) -> Result<Vec<Reaped>, StoreError> {
        let database = &self.inner.database;
        let lost = JobError {
            code: WORKER_LOST.into(),
            message: "Every worker that took the job was lost before it finished. The input may need more memory than the service has."
                .into(),
        };
        let lost = serde_json::to_string(&lost).unwrap_or_default();
        let sql = format!(
            "UPDATE jobs SET max_attempts = max_attempts + {credit},
                state = CASE WHEN cancel_requested THEN 'cancelled' WHEN attempts < max_attempts + {credit} THEN 'queued' ELSE 'failed' END,
                error = CASE WHEN NOT cancel_requested AND attempts >= max_attempts + {credit} THEN $1 END,
                finished_at = CASE WHEN cancel_requested OR attempts >= max_attempts + {credit} THEN {{now}} END,
                run_after = {{now}} + {} * attempts, lease_owner = NULL, lease_until = NULL, stage = NULL, version = version + 1
            WHERE state = 'running' AND {filter}
            RETURNING id, state, input_bytes, {{notify}}",
            milliseconds(pause)
        );
        let mut values = values![lost];
        values.extend(filter_values);
        let mut transaction = database.begin().await?;
        let rows = transaction.fetch(&database.render(&sql), values).await?;
        let mut reaped = Vec::with_capacity(rows.len());
        let mut queued = Load::default();
        for row in &rows {
            let id = parse_id(&row.get::<String>(0)?)?;
            let state =
                State::from_name(&row.get::<String>(1)?).ok_or_else(|| StoreError::Damaged { what: format!("state of job {id}") })?;
            if state.is_final() {
                self.end(&mut transaction, id).await?;
            } else {
                queued.jobs += 1;
                queued.bytes += row.get::<i64>(2)? as u64;
            }
            reaped.push(Reaped { id, state });
        }
        transaction.commit().await?;
        self.inner.queue.entered(queued);
        for reaped in &reaped {
            self.inner.watchers.announce(reaped.id);
            match reaped.state {
                State::Failed => failed(WORKER_LOST),
                state if state.is_final() => finished(state),
                _ => {}
            }
        }
        (0..queued.jobs).for_each(|_| self.inner.work_ready.notify_one());
        Ok(reaped)
    }
}

pub(super) fn milliseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_millis()).unwrap_or(i64::MAX / 2)
}
