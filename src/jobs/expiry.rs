//! What is deleted because its time is over, and how its room on the disk comes back. Both go in small steps: SQLite has one connection, for
//! which everyone else waits meanwhile.

use super::{
    database::values,
    error::StoreError,
    store::{Store, parse_id},
};
use std::time::Duration;
use tokio::time::Instant;
use uuid::Uuid;

/// Jobs deleted by one statement. Ten eight-gate studies are some 20 MB (docs/operations.md has the time).
const JOBS_PER_STEP: i64 = 10;
/// Pages of 4 KiB given back by one statement: 1 MiB.
const PAGES_PER_STEP: i64 = 256;
/// Free pages that stay in the file, 16 MiB: room for the inputs that come and go, which would else be given back and taken again with every job.
const PAGES_KEPT_FREE: i64 = 4096;

impl Store {
    /// Deletes some of the jobs whose time is over, with all their data, longest over first; returns which. Those of which another node is just
    /// doing so are left to it. None for an hour after the clock was set forward.
    pub async fn expire(&self) -> Result<Vec<Uuid>, StoreError> {
        if self.inner.clock.holds_deletions() {
            return Ok(Vec::new());
        }
        let sql = "DELETE FROM jobs WHERE state IN ('succeeded', 'failed', 'cancelled') AND id IN (
                SELECT id FROM jobs WHERE expires_at <= {now} ORDER BY expires_at LIMIT $1 {skip_locked}
            )
            RETURNING id, owner, {notify}";
        let rows = self.inner.database.fetch(sql, values![JOBS_PER_STEP]).await?;
        let mut expired = Vec::with_capacity(rows.len());
        for row in &rows {
            let id = parse_id(&row.get::<String>(0)?)?;
            self.inner.watchers.announce_of(id, &row.get::<String>(1)?);
            expired.push(id);
        }
        metrics::counter!("ventricle_jobs_expired_total").increment(expired.len() as u64);
        Ok(expired)
    }

    /// Gives a step of the pages that deleted jobs left in SQLite's file back to the disk; returns whether there are more to give.
    /// PostgreSQL's autovacuum does likewise by itself.
    pub async fn shrink(&self) -> Result<bool, StoreError> {
        let database = &self.inner.database;
        if database.is_shared() {
            return Ok(false);
        }
        let row = database.fetch_one("SELECT freelist_count FROM pragma_freelist_count()", vec![]).await?;
        let spare = row.map_or(Ok(0), |row| row.get::<i64>(0))? - PAGES_KEPT_FREE;
        if spare <= 0 {
            return Ok(false);
        }
        // Each of its rows is one page given back: all of them must be fetched.
        database.fetch(&format!("PRAGMA incremental_vacuum({})", spare.min(PAGES_PER_STEP)), vec![]).await?;
        if spare > PAGES_PER_STEP {
            return Ok(true);
        }
        // The file is cut when the log is merged into it.
        database.fetch("PRAGMA wal_checkpoint(TRUNCATE)", vec![]).await?;
        Ok(false)
    }

    /// Deletes what is over and gives its room back, step by step, until nothing is left to do or the time is over.
    pub(super) async fn tidy(&self, patience: Duration) -> Result<(), StoreError> {
        let deadline = Instant::now() + patience;
        let mut expired = 0;
        while Instant::now() < deadline {
            let step = self.expire().await?.len();
            expired += step;
            if (step as i64) < JOBS_PER_STEP {
                break;
            }
        }
        if expired > 0 {
            tracing::info!(jobs = expired, "deleted what was to be kept no longer");
        }
        while Instant::now() < deadline && self.shrink().await? {}
        Ok(())
    }
}
