//! The parts of a series, put together when all are there or when no more seem to come.

use super::{Assembler, digest, read};
use crate::{
    access::{Audit, Deed},
    intake::{Holds, IntakeError, Nature, Received, sentence},
    jobs::{JobError, Members, Series, StoreError, StoredInstance, SubmitError, Submitted},
};
use uuid::Uuid;

/// Pages of series that went quiet which are gone through at one time.
const MOST_PAGES: usize = 64;

/// The idempotency key of the parts of a series. No client can send it: it is not of ASCII.
fn key(identity: [u8; 32]) -> String {
    format!("§ dicom series {}", hex::encode(identity))
}

/// The job of a series.
struct Assembled {
    job: Uuid,
    /// Whether it was made now, and by this process.
    new: bool,
    /// Why the series makes no study, if it makes none: the code with which the job failed.
    failed: Option<String>,
}

/// Why a series is not put together now.
#[derive(Debug, thiserror::Error)]
pub(super) enum AssemblyError {
    #[error(transparent)]
    Submit(#[from] SubmitError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("{0}")]
    Unavailable(IntakeError),
}

impl Assembler {
    /// Makes a job of a series if its parts say that all of them are there.
    pub(super) async fn assemble_if_complete(&self, series: &Series) -> Result<Option<Uuid>, AssemblyError> {
        let parts = self.store.series(series).await?;
        if parts.iter().all(|part| part.job.is_some()) || !complete(&parts) {
            return Ok(None);
        }
        Ok(self.assemble(series, &parts, false).await?.map(|assembled| assembled.job))
    }

    /// Makes jobs of the series that went quiet.
    pub(super) async fn assemble_quiet(&self, audit: Option<&Audit>) -> Result<(), AssemblyError> {
        // Those that cannot be put together stay in front.
        let mut left = 0;
        for _ in 0..MOST_PAGES {
            let quiet = self.store.quiet_series(self.settings.quiet, left).await?;
            if quiet.is_empty() {
                break;
            }
            for series in quiet {
                let parts = self.store.series(&series).await?;
                match self.assemble_unasked(series, &parts, audit).await {
                    Ok(()) => {}
                    // It waits on disk until there is room.
                    Err(AssemblyError::Submit(SubmitError::QueueFull(_))) => return Ok(()),
                    Err(AssemblyError::Submit(SubmitError::OwnerFull(_))) => left += 1,
                    Err(AssemblyError::Submit(SubmitError::Store(error)) | AssemblyError::Store(error)) if error.is_passing() => {
                        return Err(error.into());
                    }
                    // What is wrong with one holds up no other.
                    Err(error) => {
                        tracing::warn!(%error, "a study could not be put together yet");
                        left += 1;
                    }
                }
            }
        }
        Ok(())
    }

    /// Makes a job of a series as it is, and tells the audit log, as no request does.
    async fn assemble_unasked(&self, series: Series, parts: &[StoredInstance], audit: Option<&Audit>) -> Result<(), AssemblyError> {
        let assembled = self.assemble(&series, parts, !complete(parts)).await?;
        if let (Some(Assembled { job, new: true, failed }), Some(audit)) = (assembled, audit) {
            audit.tell(Deed { owner: Some(series.owner), jobs: vec![job], refused: failed, ..Deed::now("assembly") }).await;
        }
        Ok(())
    }

    async fn assemble(&self, series: &Series, parts: &[StoredInstance], keep: bool) -> Result<Option<Assembled>, AssemblyError> {
        let identity = digest(parts.iter().flat_map(|part| [&part.instance_uid, &part.sha256]));
        let key = key(identity);
        let instance_uids: Vec<String> = parts.iter().map(|part| part.instance_uid.clone()).collect();
        // Its bytes are known, and judged, when it is stored.
        let reservation = self.store.reserve(0).map_err(SubmitError::from)?;
        let most_queued = self.access.queued_jobs_of(&series.owner);
        if let Some(most) = most_queued {
            // Before it is read: it may wait for long.
            self.store.admits(&series.owner, most).await?;
        }
        let error = match self.read_series(series, parts).await? {
            Ok(study) => {
                let new = self.new_job((&series.owner, most_queued), Some(key.clone()), study, identity);
                let members = Members::Filed { instance_uids: instance_uids.clone(), keep };
                match self.store.submit_assembled(reservation, new, members).await {
                    // It would wait for room for ever.
                    Err(error @ SubmitError::TooLarge { .. }) => JobError { code: "too_large".to_owned(), message: error.to_string() },
                    submitted => {
                        let submitted = submitted?;
                        let new = matches!(submitted, Submitted::Created(_));
                        return Ok(Some(Assembled { job: submitted.job().id, new, failed: None }));
                    }
                }
            }
            // Not the study's fault: it waits.
            Err(error) if error.nature() == Nature::Unavailable => return Err(AssemblyError::Unavailable(error)),
            Err(error) => JobError { code: error.code().to_owned(), message: sentence(&error.to_string()) },
        };
        tracing::info!(code = error.code, "the instances of a series make no study");
        let failed = self.store.fail_assembly(series, (&key, identity), instance_uids, &error, self.settings.callback_url.clone()).await?;
        Ok(failed.map(|job| Assembled { job: job.id, new: true, failed: Some(error.code) }))
    }

    async fn read_series(&self, series: &Series, parts: &[StoredInstance]) -> Result<Result<Received, IntakeError>, AssemblyError> {
        let limit = self.settings.limits.body_bytes;
        let bytes: u64 = parts.iter().map(|part| part.size).sum();
        if bytes > limit as u64 {
            return Ok(Err(IntakeError::TooLarge { what: "the series", bytes: Some(bytes as usize), limit }));
        }
        let mut files = Vec::with_capacity(parts.len());
        for part in parts {
            // A job has it, or it was deleted, since the parts were listed.
            files.push(self.store.excerpt(&series.owner, &part.instance_uid).await?.ok_or(SubmitError::InstancesGone)?);
        }
        Ok(self.parse(move |settings| read(&files, settings)).await?)
    }
}

fn complete(parts: &[StoredInstance]) -> bool {
    let holds: Option<Vec<Holds>> = parts.iter().map(|part| serde_json::from_str(&part.holds).ok()).collect();
    holds.is_some_and(|holds| Holds::complete(&holds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_client_can_take_the_key_of_a_series() {
        // What a client sends is visible ASCII (`http::reconstructions`).
        assert!(!key([7; 32]).is_ascii());
        assert_ne!(key([7; 32]), key([8; 32]));
    }
}
