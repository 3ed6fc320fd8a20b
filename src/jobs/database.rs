//! One SQL text on two engines.
//!
//! Statements are written once, with `$1`-style placeholders, and may hold five named fragments where the engines differ:
//! `{now}` (the database's clock in ms since 1970), `{skip_locked}`, `{bytes}` (the type of binary columns), `{lock_queue}` and `{notify}`
//! (the last thing a statement that changes a job returns: tells the other nodes when it is committed, see `listen.rs`). An enum over two
//! pools rather than `sqlx::Any`: `Any` cannot begin a transaction with `BEGIN IMMEDIATE`, knows no `LISTEN`, and decodes by the value
//! found instead of the type asked for. Generic code over `sqlx::Database` needs some twenty bounds on each function.
//!
//! On PostgreSQL every statement is unnamed and inside a transaction: a connection pooler may give each of them another connection
//! of the server, where a name is unknown or somebody else's.

use super::{embedded::Embedded, error::StoreError};
use sqlx::{
    AssertSqlSafe, Decode, Pool, Postgres, Row as _, Sqlite, Type,
    postgres::{PgPoolOptions, PgRow},
    sqlite::SqliteRow,
};
use std::{path::Path, time::Duration};

/// How long a statement may wait for a free connection.
pub(super) const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(30);
/// Key of the PostgreSQL advisory locks: "vent" and a number of what is locked.
const ADVISORY_KEY: i64 = 0x7665_6e74_0000_0000;
/// The channel on which the nodes of one schema tell each other of changes, as an expression of PostgreSQL. Channels belong to a database;
/// the schema's number keeps apart those who share it, and fits into the 63 bytes a channel's name may have, whatever the schema is called.
pub(super) const CHANNEL: &str = "'ventricle_' || CAST(CAST(quote_ident(current_schema()) AS regnamespace) AS oid)";
/// What is told of a changed row: what kind of change it is, by the state the job is now in, which job, and whose.
const NEWS: &str = "CASE WHEN state = 'queued' THEN 'queued' WHEN state = 'running' AND cancel_requested THEN 'cancel' ELSE 'changed' END
    || ' ' || id || ' ' || owner";

/// The database behind a store.
#[derive(Debug, Clone)]
pub(super) enum Database {
    Sqlite(Embedded),
    Postgres(Pool<Postgres>),
}

/// A transaction; dropped without [`Transaction::commit`] it is rolled back.
pub(super) enum Transaction {
    Sqlite(sqlx::Transaction<'static, Sqlite>),
    Postgres(sqlx::Transaction<'static, Postgres>),
}

/// A row of either engine.
pub(super) enum Row {
    Sqlite(SqliteRow),
    Postgres(PgRow),
}

/// A value bound to a placeholder.
#[derive(Debug, Clone)]
pub(super) enum Value {
    Integer(i64),
    OptionalInteger(Option<i64>),
    Real(f64),
    OptionalReal(Option<f64>),
    Text(String),
    OptionalText(Option<String>),
    Bytes(Vec<u8>),
    OptionalBytes(Option<Vec<u8>>),
    OptionalBoolean(Option<bool>),
}

/// A type both engines can read from a column.
pub(super) trait Column: Type<Sqlite> + for<'r> Decode<'r, Sqlite> + Type<Postgres> + for<'r> Decode<'r, Postgres> {}

impl<T> Column for T where T: Type<Sqlite> + for<'r> Decode<'r, Sqlite> + Type<Postgres> + for<'r> Decode<'r, Postgres> {}

/// A query with its values bound, for whichever engine the context asks for.
macro_rules! bound {
    ($sql:expr, $values:expr) => {{
        let mut query = sqlx::query(AssertSqlSafe($sql));
        for value in $values {
            query = match value {
                Value::Integer(value) => query.bind(value),
                Value::OptionalInteger(value) => query.bind(value),
                Value::Real(value) => query.bind(value),
                Value::OptionalReal(value) => query.bind(value),
                Value::Text(value) => query.bind(value),
                Value::OptionalText(value) => query.bind(value),
                Value::Bytes(value) => query.bind(value),
                Value::OptionalBytes(value) => query.bind(value),
                Value::OptionalBoolean(value) => query.bind(value),
            };
        }
        query
    }};
}

/// The values of a statement in the order of its placeholders.
macro_rules! values {
    ($($value:expr),* $(,)?) => { vec![$($crate::jobs::database::Value::from($value)),*] };
}
pub(super) use values;

impl Database {
    /// Opens the database of a data directory, for this process alone. Fails with [`StoreError::DirectoryInUse`] when another
    /// process has it and keeps it longer than `wait`.
    pub(super) async fn sqlite(directory: &Path, wait: Duration) -> Result<Self, StoreError> {
        Embedded::open(directory, wait).await.map(Self::Sqlite)
    }

    /// Connects to a PostgreSQL database. A node that stops for `patience` in the middle of a transaction loses its connection, and with
    /// it the locks that all others would wait for.
    pub(super) async fn postgres(url: &str, connections: u32, patience: Duration) -> Result<Self, StoreError> {
        // A setting of the session rather than a parameter of the connection, which poolers refuse.
        let set = format!("SET idle_in_transaction_session_timeout = {}", patience.as_millis().clamp(1, i32::MAX as u128));
        let pool = PgPoolOptions::new()
            .max_connections(connections)
            .acquire_timeout(ACQUIRE_TIMEOUT)
            .after_connect(move |connection, _| {
                let set = AssertSqlSafe(set.clone());
                Box::pin(async move { sqlx::raw_sql(set).execute(connection).await.map(drop) })
            })
            .connect(url)
            .await
            .map_err(|error| match error {
                sqlx::Error::PoolTimedOut => StoreError::NoConnection { seconds: ACQUIRE_TIMEOUT.as_secs() },
                error => error.into(),
            })?;
        Ok(Self::Postgres(pool))
    }

    /// Whether several processes may share the database.
    pub(super) fn is_shared(&self) -> bool {
        matches!(self, Self::Postgres(_))
    }

    /// The statement in this engine's words.
    pub(super) fn render(&self, sql: &str) -> String {
        let lock_queue = format!("SELECT pg_advisory_xact_lock({})", ADVISORY_KEY + 1);
        let notify = format!("pg_notify({CHANNEL}, {NEWS})");
        let fragments: [(&str, &str); 5] = match self {
            Self::Sqlite(_) => [
                ("{now}", "CAST(ROUND(unixepoch('subsec') * 1000) AS BIGINT)"),
                ("{skip_locked}", ""),
                ("{bytes}", "BLOB"),
                // A transaction of SQLite is alone from its BEGIN IMMEDIATE.
                ("{lock_queue}", "SELECT 1"),
                // There are no other nodes.
                ("{notify}", "NULL"),
            ],
            Self::Postgres(_) => [
                ("{now}", "CAST(ROUND(EXTRACT(EPOCH FROM clock_timestamp()) * 1000) AS BIGINT)"),
                ("{skip_locked}", "FOR UPDATE SKIP LOCKED"),
                ("{bytes}", "BYTEA"),
                ("{lock_queue}", &lock_queue),
                ("{notify}", &notify),
            ],
        };
        fragments.into_iter().fold(sql.to_owned(), |sql, (name, text)| sql.replace(name, text))
    }

    /// Begins a transaction that may write.
    pub(super) async fn begin(&self) -> Result<Transaction, StoreError> {
        Ok(match self {
            Self::Sqlite(embedded) => Transaction::Sqlite(embedded.begin().await?),
            Self::Postgres(pool) => Transaction::Postgres(pool.begin().await?),
        })
    }

    /// Begins a transaction that no other process changes the schema during.
    pub(super) async fn begin_schema(&self) -> Result<Transaction, StoreError> {
        let mut transaction = self.begin().await?;
        if self.is_shared() {
            transaction.execute(&format!("SELECT pg_advisory_xact_lock({ADVISORY_KEY})"), vec![]).await?;
        }
        Ok(transaction)
    }

    /// Runs one statement by itself; returns the rows it gives.
    pub(super) async fn fetch(&self, sql: &str, values: Vec<Value>) -> Result<Vec<Row>, StoreError> {
        let sql = self.render(sql);
        match self {
            Self::Sqlite(embedded) => {
                // A statement that reads says so with its first word.
                let pool = if sql.trim_start().starts_with("SELECT") { &embedded.readers } else { &embedded.writer };
                Ok(bound!(sql, values).fetch_all(pool).await?.into_iter().map(Row::Sqlite).collect())
            }
            Self::Postgres(_) => {
                let mut transaction = self.begin().await?;
                let rows = transaction.fetch(&sql, values).await?;
                transaction.commit().await?;
                Ok(rows)
            }
        }
    }

    /// Runs one statement by itself; returns the first row it gives.
    pub(super) async fn fetch_one(&self, sql: &str, values: Vec<Value>) -> Result<Option<Row>, StoreError> {
        Ok(self.fetch(sql, values).await?.into_iter().next())
    }

    /// Ends all connections.
    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite(embedded) => embedded.close().await,
            Self::Postgres(pool) => pool.close().await,
        }
    }
}

impl Transaction {
    /// Runs a statement in this transaction; returns how many rows it changed. The text must hold no fragments.
    pub(super) async fn execute(&mut self, sql: &str, values: Vec<Value>) -> Result<u64, StoreError> {
        let sql = sql.to_owned();
        Ok(match self {
            Self::Sqlite(transaction) => bound!(sql, values).execute(&mut **transaction).await?.rows_affected(),
            Self::Postgres(transaction) => bound!(sql, values).persistent(false).execute(&mut **transaction).await?.rows_affected(),
        })
    }

    /// Runs a statement in this transaction; returns the rows it gives. The text must hold no fragments.
    pub(super) async fn fetch(&mut self, sql: &str, values: Vec<Value>) -> Result<Vec<Row>, StoreError> {
        let sql = sql.to_owned();
        Ok(match self {
            Self::Sqlite(transaction) => bound!(sql, values).fetch_all(&mut **transaction).await?.into_iter().map(Row::Sqlite).collect(),
            Self::Postgres(transaction) => {
                let rows = bound!(sql, values).persistent(false).fetch_all(&mut **transaction).await?;
                rows.into_iter().map(Row::Postgres).collect()
            }
        })
    }

    /// Runs a statement in this transaction; returns the first row it gives.
    pub(super) async fn fetch_one(&mut self, sql: &str, values: Vec<Value>) -> Result<Option<Row>, StoreError> {
        Ok(self.fetch(sql, values).await?.into_iter().next())
    }

    /// Runs several statements without values.
    pub(super) async fn execute_script(&mut self, sql: &str) -> Result<(), StoreError> {
        let sql = AssertSqlSafe(sql.to_owned());
        match self {
            Self::Sqlite(transaction) => sqlx::raw_sql(sql).execute(&mut **transaction).await.map(drop)?,
            Self::Postgres(transaction) => sqlx::raw_sql(sql).execute(&mut **transaction).await.map(drop)?,
        }
        Ok(())
    }

    /// Makes what the transaction did durable.
    pub(super) async fn commit(self) -> Result<(), StoreError> {
        match self {
            Self::Sqlite(transaction) => transaction.commit().await?,
            Self::Postgres(transaction) => transaction.commit().await?,
        }
        Ok(())
    }
}

impl Row {
    /// The value of a column, counted from 0.
    pub(super) fn get<T: Column>(&self, column: usize) -> Result<T, StoreError> {
        Ok(match self {
            Self::Sqlite(row) => row.try_get(column)?,
            Self::Postgres(row) => row.try_get(column)?,
        })
    }

    /// The value of a column by name.
    pub(super) fn named<T: Column>(&self, column: &str) -> Result<T, StoreError> {
        Ok(match self {
            Self::Sqlite(row) => row.try_get(column)?,
            Self::Postgres(row) => row.try_get(column)?,
        })
    }
}

macro_rules! value_from {
    ($($type:ty => $variant:ident),* $(,)?) => {
        $(impl From<$type> for Value {
            fn from(value: $type) -> Self {
                Self::$variant(value)
            }
        })*
    };
}

value_from! {
    i64 => Integer,
    Option<i64> => OptionalInteger,
    f64 => Real,
    Option<f64> => OptionalReal,
    String => Text,
    Option<String> => OptionalText,
    Vec<u8> => Bytes,
    Option<Vec<u8>> => OptionalBytes,
    Option<bool> => OptionalBoolean,
}

impl From<&str> for Value {
    fn from(value: &str) -> Self {
        Self::Text(value.to_owned())
    }
}

impl From<uuid::Uuid> for Value {
    fn from(value: uuid::Uuid) -> Self {
        Self::Text(value.to_string())
    }
}
