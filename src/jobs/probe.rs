//! Whether the database can be written: what can only be read takes no job. A full disk, a replica that was made the one that answers, or a
//! standby that a synchronous commit waits for are seen only by writing, so something is written that changes nothing.

use super::{error::StoreError, store::Store};
use std::time::Duration;
use tokio::{sync::Mutex, time::Instant};

/// How long it is believed that the database can be written: a probe every few seconds from everyone who asks costs one commit.
const BELIEVED: Duration = Duration::from_secs(5);
/// How long it is believed that it cannot.
const DOUBTED: Duration = Duration::from_secs(1);
/// How long an answer, and the commit, may take, so that who asks with the usual patience of 3 s is answered.
const PATIENCE: Duration = Duration::from_secs(2);

/// What the database does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Probe {
    /// It answers, and commits.
    Writable,
    /// It answers, and does not commit.
    NotWritable,
    /// It does not answer.
    Silent,
}

/// When the database was written last, or could not be.
#[derive(Debug, Default)]
pub(super) struct LastProbe(Mutex<Option<(Instant, bool)>>);

impl Store {
    /// Whether the database answers now, and could be written in the last seconds.
    pub async fn probe(&self) -> Probe {
        match tokio::time::timeout(PATIENCE, self.ping()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                tracing::warn!(%error, "the store does not answer");
                return Probe::Silent;
            }
            // Whoever wants something of it waits for longer, as it may just be starting again.
            Err(_) => {
                tracing::warn!(seconds = PATIENCE.as_secs(), "the store does not answer within so long");
                return Probe::Silent;
            }
        }
        // Whoever asks meanwhile waits for the same answer.
        let mut last = self.inner.last_probe.0.lock().await;
        if let Some((at, writable)) = *last
            && at.elapsed() < if writable { BELIEVED } else { DOUBTED }
        {
            return if writable { Probe::Writable } else { Probe::NotWritable };
        }
        let written = tokio::time::timeout(PATIENCE, self.touch()).await;
        match &written {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the database cannot be written"),
            Err(_) => tracing::warn!(seconds = PATIENCE.as_secs(), "the database commits nothing within so long"),
        }
        let writable = matches!(written, Ok(Ok(())));
        *last = Some((Instant::now(), writable));
        if writable { Probe::Writable } else { Probe::NotWritable }
    }

    /// Commits something that changes nothing.
    async fn touch(&self) -> Result<(), StoreError> {
        let sql = if self.inner.database.is_shared() {
            // Not the row that another node is writing: one that is stopped there would hold up all others.
            "UPDATE schema_version AS stored SET version = stored.version
            FROM (SELECT ctid AS place FROM schema_version FOR UPDATE SKIP LOCKED) AS free WHERE stored.ctid = free.place"
        } else {
            // A number in the file's head that nobody uses. SQLite writes it even if it is the same, unlike a row.
            "PRAGMA user_version = 0"
        };
        self.inner.database.fetch(sql, vec![]).await.map(drop)
    }
}
