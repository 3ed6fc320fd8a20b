//! DICOM instances that wait for the rest of their study, and which job took them. What is stored is an excerpt that names nobody.

use super::{
    database::{Transaction, values},
    error::{StoreError, SubmitError},
    job::{Job, JobError},
    lease::milliseconds,
    numbers::failed,
    store::{Store, intact, parse_id, sha256},
};
use std::time::Duration;
use uuid::Uuid;

/// Has a job take an instance, with its excerpt or without.
const TAKE: &str = "UPDATE instances SET job_id = $1, data = CASE WHEN $2 = 1 THEN data END WHERE owner = $3 AND sop_instance_uid = $4";

/// A series of an owner.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Series {
    /// Whose it is.
    pub owner: String,
    /// Study Instance UID.
    pub study_uid: String,
    /// Series Instance UID.
    pub series_uid: String,
}

/// An instance to be stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewInstance {
    /// The series it belongs to.
    pub series: Series,
    /// SOP Class UID.
    pub class_uid: String,
    /// SOP Instance UID, unique for its owner.
    pub instance_uid: String,
    /// Which part of a study it is, as whoever assembles it wrote it down.
    pub holds: String,
    /// What makes it the same instance when it comes again, however it is encoded.
    pub identity: String,
    /// The excerpt.
    pub data: Vec<u8>,
    /// Its SHA-256 in lower-case hexadecimal.
    pub sha256: String,
}

impl NewInstance {
    /// With the SHA-256 of its excerpt, for which large ones take their time: not for a thread of the runtime.
    pub fn new(series: Series, class_uid: String, instance_uid: String, holds: String, identity: String, data: Vec<u8>) -> Self {
        Self { series, class_uid, instance_uid, holds, identity, sha256: sha256(&data), data }
    }
}

/// The instances that a new job is made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Members {
    /// It did not come by instances.
    None,
    /// One that is a study of its own and not stored yet. Its excerpt is not kept, as the job has the study.
    Whole(NewInstance),
    /// Some that were [filed](Store::file).
    Filed {
        /// SOP Instance UIDs.
        instance_uids: Vec<String>,
        /// Whether their excerpts are kept as long as the job, so that the study can be put together again when more of it comes.
        keep: bool,
    },
}

/// What became of an instance that waits for others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Filed {
    /// It is committed to disk.
    New,
    /// It was there already.
    Known,
    /// Another one of this UID is there.
    Conflict,
}

/// An instance whose excerpt is stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredInstance {
    /// SOP Instance UID.
    pub instance_uid: String,
    /// Which part of a study it is.
    pub holds: String,
    /// SHA-256 of the excerpt.
    pub sha256: String,
    /// Bytes of the excerpt.
    pub size: u64,
    /// The job that took it last, if one has.
    pub job: Option<Uuid>,
}

impl Store {
    /// Stores instances that wait for others, all or none. When this returns, they are committed to disk. Runs to its end even if the caller
    /// goes away.
    pub async fn file(&self, instances: Vec<NewInstance>) -> Result<Vec<Filed>, SubmitError> {
        let store = self.clone();
        tokio::spawn(async move { store.file_to_end(instances).await }).await.map_err(|_| StoreError::Interrupted)?
    }

    async fn file_to_end(&self, instances: Vec<NewInstance>) -> Result<Vec<Filed>, SubmitError> {
        let mut transaction = self.inner.database.begin().await?;
        transaction.fetch(&self.inner.database.render("{lock_queue}"), vec![]).await?;
        let mut filed = Vec::with_capacity(instances.len());
        for instance in instances {
            filed.push(match known(&mut transaction, &instance).await? {
                None => {
                    self.insert_instance(&mut transaction, instance, None).await?;
                    Filed::New
                }
                Some(Known { same: true, .. }) => Filed::Known,
                Some(Known { same: false, .. }) => Filed::Conflict,
            });
        }
        // What waits for its rest is bounded as what waits for a worker is.
        let row =
            transaction.fetch_one("SELECT CAST(COALESCE(SUM(size), 0) AS BIGINT) FROM instances WHERE job_id IS NULL", vec![]).await?;
        if row.map_or(Ok(0), |row| row.get::<i64>(0))? as u64 > self.inner.queue.limit().bytes {
            return Err(self.inner.queue.full().into());
        }
        transaction.commit().await?;
        Ok(filed)
    }

    /// The job that has the instances already: the very same whole study was submitted before, or another node was first to put these parts
    /// together.
    pub(super) async fn taken(&self, transaction: &mut Transaction, owner: &str, members: &Members) -> Result<Option<Uuid>, SubmitError> {
        match members {
            Members::None => Ok(None),
            Members::Whole(instance) => match known(transaction, instance).await? {
                None => Ok(None),
                Some(Known { same: true, job: Some(job) }) => Ok(Some(job)),
                Some(_) => Err(SubmitError::InstanceConflict),
            },
            Members::Filed { instance_uids, .. } => {
                let mut taken = None;
                for uid in instance_uids {
                    let sql = "SELECT job_id FROM instances WHERE owner = $1 AND sop_instance_uid = $2";
                    let row = transaction.fetch_one(sql, values![owner, uid.as_str()]).await?.ok_or(SubmitError::InstancesGone)?;
                    match row.get::<Option<String>>(0)? {
                        Some(job) => taken = Some(parse_id(&job)?),
                        // One that waits is enough for a new job.
                        None => return Ok(None),
                    }
                }
                Ok(taken)
            }
        }
    }

    /// Notes by which new job instances were taken.
    pub(super) async fn take(&self, transaction: &mut Transaction, owner: &str, members: Members, job: Uuid) -> Result<(), SubmitError> {
        match members {
            Members::None => Ok(()),
            Members::Whole(instance) => Ok(self.insert_instance(transaction, instance, Some(job)).await?),
            Members::Filed { instance_uids, keep } => {
                for uid in instance_uids {
                    if transaction.execute(TAKE, values![job, i64::from(keep), owner, uid]).await? == 0 {
                        return Err(SubmitError::InstancesGone);
                    }
                }
                Ok(())
            }
        }
    }

    /// Notes that instances belong to a job that was made of the same ones before, as far as they wait: they were deleted with a later job and
    /// came again.
    pub(super) async fn rejoin(&self, transaction: &mut Transaction, owner: &str, members: &Members, job: Uuid) -> Result<(), StoreError> {
        let Members::Filed { instance_uids, keep } = members else { return Ok(()) };
        let sql = format!("{TAKE} AND job_id IS NULL");
        for uid in instance_uids {
            transaction.execute(&sql, values![job, i64::from(*keep), owner, uid.as_str()]).await?;
        }
        Ok(())
    }

    async fn insert_instance(&self, transaction: &mut Transaction, instance: NewInstance, job: Option<Uuid>) -> Result<(), StoreError> {
        let NewInstance { series, class_uid, instance_uid, holds, identity, data, sha256 } = instance;
        let size = data.len() as i64;
        let fields = values![series.owner, instance_uid, class_uid, series.study_uid, series.series_uid, holds, sha256, size, identity];
        let (job, data) = match job {
            Some(job) => (Some(job.to_string()), None),
            None => (None, Some(data)),
        };
        let sql = self.inner.database.render(
            "INSERT INTO instances (owner, sop_instance_uid, sop_class_uid, study_instance_uid, series_instance_uid, holds, sha256, size,
                identity, job_id, data, received_at)
            VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, {now})",
        );
        transaction.execute(&sql, fields.into_iter().chain(values![job, data]).collect()).await.map(drop)
    }

    /// The instances of a series whose excerpts are there, by UID.
    pub async fn series(&self, series: &Series) -> Result<Vec<StoredInstance>, StoreError> {
        let sql = "SELECT sop_instance_uid, holds, sha256, size, job_id FROM instances
            WHERE owner = $1 AND study_instance_uid = $2 AND series_instance_uid = $3 AND data IS NOT NULL ORDER BY sop_instance_uid";
        let values = values![series.owner.as_str(), series.study_uid.as_str(), series.series_uid.as_str()];
        let rows = self.inner.database.fetch(sql, values).await?;
        rows.iter()
            .map(|row| {
                let job = row.get::<Option<String>>(4)?.map(|id| parse_id(&id)).transpose()?;
                let size = row.get::<i64>(3)? as u64;
                Ok(StoredInstance { instance_uid: row.get(0)?, holds: row.get(1)?, sha256: row.get(2)?, size, job })
            })
            .collect()
    }

    /// Some of the series of which an instance waits and none came for so long, longest waiting first, without the first so many.
    pub async fn quiet_series(&self, quiet: Duration, but: usize) -> Result<Vec<Series>, StoreError> {
        let sql = "SELECT owner, study_instance_uid, series_instance_uid FROM instances WHERE job_id IS NULL
            GROUP BY owner, study_instance_uid, series_instance_uid HAVING MAX(received_at) <= {now} - $1
            ORDER BY MAX(received_at), owner, study_instance_uid, series_instance_uid LIMIT 16 OFFSET $2";
        let rows = self.inner.database.fetch(sql, values![milliseconds(quiet), but as i64]).await?;
        rows.iter().map(|row| Ok(Series { owner: row.get(0)?, study_uid: row.get(1)?, series_uid: row.get(2)? })).collect()
    }

    /// Tells the metrics what waits for the rest of its study.
    pub async fn publish_waiting(&self) -> Result<(), StoreError> {
        let sql = "SELECT COUNT(*), CAST(COALESCE(SUM(bytes), 0) AS BIGINT), {now} - MIN(latest) FROM (
                SELECT SUM(size) AS bytes, MAX(received_at) AS latest FROM instances WHERE job_id IS NULL
                GROUP BY owner, study_instance_uid, series_instance_uid
            ) AS waiting";
        let Some(row) = self.inner.database.fetch_one(sql, vec![]).await? else { return Ok(()) };
        metrics::gauge!("ventricle_series_waiting").set(row.get::<i64>(0)? as f64);
        metrics::gauge!("ventricle_series_waiting_bytes").set(row.get::<i64>(1)? as f64);
        let quiet_s = row.get::<Option<i64>>(2)?.map_or(0.0, |ms| ms.max(0) as f64 / 1e3);
        metrics::gauge!("ventricle_series_quiet_seconds").set(quiet_s);
        Ok(())
    }

    /// The excerpt of an instance; `None` if it is not there any more.
    pub async fn excerpt(&self, owner: &str, instance_uid: &str) -> Result<Option<Vec<u8>>, StoreError> {
        let sql = "SELECT data, sha256 FROM instances WHERE owner = $1 AND sop_instance_uid = $2 AND data IS NOT NULL";
        let Some(row) = self.inner.database.fetch_one(sql, values![owner, instance_uid]).await? else { return Ok(None) };
        let (data, sha256) = (row.get(0)?, row.get(1)?);
        drop(row);
        intact(sha256, data, || "an instance".to_owned()).await.map(Some)
    }

    /// A job that failed before it began, since the instances that came make no study. It keeps their excerpts, for when more of them come.
    /// The same instances fail once, and none of them if another job has them all meanwhile: then there is no new job. Key and hash are those
    /// that a job of these instances has, so that they are the same submission if they are put together again.
    pub async fn fail_assembly(
        &self,
        series: &Series,
        (key, request_hash): (&str, [u8; 32]),
        instance_uids: Vec<String>,
        error: &JobError,
        callback_url: Option<String>,
    ) -> Result<Option<Job>, SubmitError> {
        let code = &error.code;
        let error = serde_json::to_string(error).map_err(|error| StoreError::Damaged { what: error.to_string() })?;
        let id = Uuid::now_v7();
        let members = Members::Filed { instance_uids, keep: true };
        let mut transaction = self.inner.database.begin().await?;
        // Whoever else puts this series together waits here.
        transaction.fetch(&self.inner.database.render("{lock_queue}"), vec![]).await?;
        if self.taken(&mut transaction, &series.owner, &members).await?.is_some() {
            return Ok(None);
        }
        let sql = self.inner.database.render(
            "INSERT INTO jobs (id, owner, idempotency_key, request_hash, kind, parameters, study_instance_uid, input_bytes, state,
                max_attempts, run_after, gates_total, created_at, finished_at, error, callback_url)
            VALUES ($1, $2, $3, $4, 'reconstruction', '{}', $5, 0, 'failed', 0, {now}, 0, {now}, {now}, $6, $7)
            ON CONFLICT (owner, idempotency_key) DO NOTHING RETURNING {notify}",
        );
        let fields = values![id, series.owner.as_str(), key, request_hash.to_vec(), series.study_uid.as_str(), error, callback_url];
        if transaction.fetch_one(&sql, fields).await?.is_none() {
            let sql = "SELECT id FROM jobs WHERE owner = $1 AND idempotency_key = $2";
            if let Some(row) = transaction.fetch_one(sql, values![series.owner.as_str(), key]).await? {
                self.rejoin(&mut transaction, &series.owner, &members, parse_id(&row.get::<String>(0)?)?).await?;
                transaction.commit().await?;
            }
            return Ok(None);
        }
        self.take(&mut transaction, &series.owner, members, id).await?;
        self.end(&mut transaction, id).await?;
        let job = self.get_in(&mut transaction, id).await?;
        transaction.commit().await?;
        self.inner.watchers.announce(id);
        failed(code);
        Ok(Some(job))
    }
}

/// An instance of this UID that is stored.
struct Known {
    same: bool,
    job: Option<Uuid>,
}

async fn known(transaction: &mut Transaction, instance: &NewInstance) -> Result<Option<Known>, StoreError> {
    let sql = "SELECT COALESCE(identity, sha256), job_id FROM instances WHERE owner = $1 AND sop_instance_uid = $2";
    let Some(row) = transaction.fetch_one(sql, values![instance.series.owner.as_str(), instance.instance_uid.as_str()]).await? else {
        return Ok(None);
    };
    let job = row.get::<Option<String>>(1)?.map(|id| parse_id(&id)).transpose()?;
    let stored = row.get::<String>(0)?;
    // Version 4 compared the excerpts' bytes.
    Ok(Some(Known { same: stored == instance.identity || stored == instance.sha256, job }))
}
