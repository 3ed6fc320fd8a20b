//! The tables, made and upgraded step by step.

use super::{
    database::{Database, values},
    error::StoreError,
};

/// The steps from nothing to the present schema; step `n` makes version `n + 1`. Released steps are never changed.
const STEPS: [&str; 6] = [
    include_str!("schema.sql"),
    include_str!("schema-2.sql"),
    include_str!("schema-3.sql"),
    include_str!("schema-4.sql"),
    include_str!("schema-5.sql"),
    include_str!("schema-6.sql"),
];

/// What PostgreSQL alone needs at each step.
const POSTGRES_STEPS: [&str; 6] = [
    // Blobs are compressed formats or noise, so trying to compress them costs time only.
    "ALTER TABLE blobs ALTER COLUMN data SET STORAGE EXTERNAL",
    // Where inputs come and go, a fifth of all results (the default) is much to leave dead. A thirtieth is at most a day's, with results of a month.
    "ALTER TABLE blobs SET (autovacuum_vacuum_scale_factor = 0.03, toast.autovacuum_vacuum_scale_factor = 0.03)",
    "ALTER TABLE instances ALTER COLUMN data SET STORAGE EXTERNAL",
    "",
    "",
    "",
];

/// Brings the database to the present schema; does nothing if it is there.
pub(super) async fn upgrade(database: &Database) -> Result<(), StoreError> {
    let known = STEPS.len() as i64;
    let mut transaction = database.begin_schema().await?;
    transaction.execute_script("CREATE TABLE IF NOT EXISTS schema_version (version BIGINT NOT NULL)").await?;
    let row = transaction.fetch_one("SELECT version FROM schema_version", vec![]).await?;
    let found = row.map(|row| row.get::<i64>(0)).transpose()?.unwrap_or(0);
    if found > known {
        return Err(StoreError::SchemaTooNew { found, known });
    }
    for (step, postgres) in STEPS.into_iter().zip(POSTGRES_STEPS).skip(usize::try_from(found).unwrap_or(0)) {
        transaction.execute_script(&database.render(step)).await?;
        if database.is_shared() {
            transaction.execute_script(postgres).await?;
        }
    }
    transaction.execute("DELETE FROM schema_version", vec![]).await?;
    transaction.execute("INSERT INTO schema_version (version) VALUES ($1)", values![known]).await?;
    transaction.commit().await
}
