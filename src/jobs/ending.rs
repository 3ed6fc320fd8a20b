//! What follows when a job reaches its final state, in the same transaction: its input goes, and whom it is of if there is no result, its time
//! to be kept begins, whoever asked for it will be told, and its result will be sent where results go.

use super::{
    database::{Transaction, values},
    deliveries::DeliveryKind,
    error::StoreError,
    store::{INPUT, SUBJECT, Store},
};
use std::time::Duration;
use uuid::Uuid;

/// A thousand years in ms: more than anyone asks for, and the sum with any date is a date.
const LONGEST_KEPT_MS: i64 = 1000 * 365 * 24 * 3600 * 1000;

impl Store {
    /// To be called in every transaction that ends a job.
    pub(super) async fn end(&self, transaction: &mut Transaction, id: Uuid) -> Result<(), StoreError> {
        let kept = Some(self.inner.settings.keep_input);
        let input = "DELETE FROM blobs WHERE job_id = $1 AND name = $2
            AND EXISTS (SELECT 1 FROM jobs WHERE jobs.id = $1 AND NOT COALESCE(jobs.keep_input, $3))";
        transaction.execute(input, values![id, INPUT, kept]).await?;
        // Without results there is nothing to file.
        let needless = "DELETE FROM blobs WHERE job_id = $1 AND name = $2
            AND EXISTS (SELECT 1 FROM jobs WHERE jobs.id = $1 AND jobs.state <> 'succeeded')";
        transaction.execute(needless, values![id, SUBJECT]).await?;
        let kept_ms = self.inner.settings.retention.map(kept_ms);
        let expires = "UPDATE jobs SET expires_at = finished_at + COALESCE(retention_ms, $2) WHERE id = $1";
        transaction.execute(expires, values![id, kept_ms]).await?;
        let sql = self.inner.database.render(
            "INSERT INTO deliveries (id, job_id, url, state, run_after, created_at)
            SELECT $2, id, callback_url, 'pending', {now}, {now} FROM jobs WHERE id = $1 AND callback_url IS NOT NULL",
        );
        transaction.execute(&sql, values![id, Uuid::now_v7()]).await?;
        let Some(results_to) = &self.inner.settings.results_to else { return Ok(()) };
        let sql = self.inner.database.render(
            "INSERT INTO deliveries (id, job_id, url, kind, state, run_after, created_at)
            SELECT $2, id, $3, $4, 'pending', {now}, {now} FROM jobs WHERE id = $1 AND state = 'succeeded'",
        );
        transaction.execute(&sql, values![id, Uuid::now_v7(), results_to.as_str(), DeliveryKind::Result.name()]).await.map(drop)
    }
}

/// A time to be kept as the rows have it.
pub(super) fn kept_ms(retention: Duration) -> i64 {
    i64::try_from(retention.as_millis()).map_or(LONGEST_KEPT_MS, |ms| ms.min(LONGEST_KEPT_MS))
}
