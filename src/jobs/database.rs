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

use super::error::StoreError;
use sqlx::{
    AssertSqlSafe, Decode, Pool, Postgres, Row as _, Sqlite, Type,
    postgres::{PgPoolOptions, PgRow},
    sqlite::{
        SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqliteLockingMode, SqlitePoolOptions, SqliteRow, SqliteSynchronous,
    },
};
use std::{
    fs::{File, TryLockError},
    io,
    path::Path,
    sync::Arc,
    time::Duration,
};

/// The database file inside the data directory.
const FILE_NAME: &str = "ventricle.sqlite";
/// The file that is locked while a process has the data directory. Not the database's own: closing any handle of that would give up SQLite's locks.
const LOCK_NAME: &str = "ventricle.lock";
/// Connections that read, beside the one that writes: looking at a job does not wait until megabytes of another one are synchronised to disk.
const READERS: u32 = 2;
/// The least SQLite the store is proven on: it repairs a rare corruption when a write-ahead log is reset.
const LEAST_SQLITE: (&str, [u32; 3]) = ("3.51.3", [3, 51, 3]);
/// The write-ahead log is cut back to this size in bytes after a checkpoint, so that one burst of results does not keep its disk.
const WAL_LIMIT_BYTES: &str = "67108864";
/// How long a statement may wait for a free connection.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(30);
/// Pause between attempts to get the lock of the data directory.
const LOCK_PAUSE: Duration = Duration::from_millis(100);
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

/// The database of a data directory that this process has for itself.
#[derive(Debug, Clone)]
pub(super) struct Embedded {
    /// One connection: SQLite has one writer at a time.
    writer: Pool<Sqlite>,
    readers: Pool<Sqlite>,
    /// Locked until it is closed.
    lock: Arc<File>,
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
        std::fs::create_dir_all(directory).map_err(|source| StoreError::Directory { directory: directory.to_path_buf(), source })?;
        let refused = |source: io::Error| StoreError::Directory { directory: directory.to_path_buf(), source };
        let lock = File::options().create(true).truncate(false).write(true).open(directory.join(LOCK_NAME)).map_err(refused)?;
        let options = SqliteConnectOptions::new()
            .filename(directory.join(FILE_NAME))
            .create_if_missing(true)
            .locking_mode(SqliteLockingMode::Normal)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .auto_vacuum(SqliteAutoVacuum::Incremental)
            .foreign_keys(true)
            // What is deleted is overwritten: a name must not outlast its job in a free page.
            .pragma("secure_delete", "ON")
            .pragma("journal_size_limit", WAL_LIMIT_BYTES)
            .busy_timeout(LOCK_PAUSE);
        let deadline = tokio::time::Instant::now() + wait;
        let writer = loop {
            let in_use = match lock.try_lock() {
                Ok(()) => match connect_writer(&options).await {
                    Ok(writer) => break writer,
                    // A program that looks at the file, or a version before this one, which locks the file itself.
                    Err(error) if is_locked(&error) => true,
                    Err(error) => return Err(refused(io::Error::other(error))),
                },
                Err(TryLockError::WouldBlock) => true,
                Err(TryLockError::Error(error)) => return Err(refused(error)),
            };
            if in_use && tokio::time::Instant::now() >= deadline {
                return Err(StoreError::DirectoryInUse { directory: directory.to_path_buf() });
            }
            tokio::time::sleep(LOCK_PAUSE).await;
        };
        let readers = connections(READERS).connect_lazy_with(options.pragma("query_only", "ON"));
        let embedded = Embedded { writer, readers, lock: Arc::new(lock) };
        embedded.check().await?;
        Ok(Self::Sqlite(embedded))
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
            Self::Sqlite(embedded) => Transaction::Sqlite(begin_writing(&embedded.writer).await?),
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

impl Embedded {
    /// That the linked SQLite is recent enough and took the settings durability rests on.
    async fn check(&self) -> Result<(), StoreError> {
        let found = self.text("SELECT sqlite_version()").await?;
        let (required, least) = LEAST_SQLITE;
        if version(&found).is_none_or(|version| version < least) {
            return Err(StoreError::SqliteTooOld { found, required });
        }
        for (setting, sql, wanted) in [
            ("journal_mode = wal", "SELECT journal_mode FROM pragma_journal_mode()", "wal"),
            ("synchronous = full", "SELECT CAST(synchronous AS TEXT) FROM pragma_synchronous()", "2"),
            ("secure_delete = on", "SELECT CAST(secure_delete AS TEXT) FROM pragma_secure_delete()", "1"),
            ("foreign_keys = on", "SELECT CAST(foreign_keys AS TEXT) FROM pragma_foreign_keys()", "1"),
        ] {
            let found = self.text(sql).await?;
            if found != wanted {
                return Err(StoreError::Setting { setting, found });
            }
        }
        Ok(())
    }

    /// The one text a query of the connection that writes gives.
    async fn text(&self, sql: &'static str) -> Result<String, StoreError> {
        Ok(sqlx::query_scalar(sql).fetch_one(&self.writer).await?)
    }

    async fn close(&self) {
        self.readers.close().await;
        // Last, as it merges the log into the file.
        self.writer.close().await;
        if let Err(error) = self.lock.unlock() {
            tracing::warn!(%error, "the data directory stays locked until this process ends");
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

/// Connections to an embedded database: nothing ends them from outside, so they are neither replaced nor tried before they are used.
fn connections(most: u32) -> SqlitePoolOptions {
    let options = SqlitePoolOptions::new().max_connections(most).idle_timeout(None).max_lifetime(None);
    options.acquire_timeout(ACQUIRE_TIMEOUT).test_before_acquire(false)
}

/// Makes the connection that writes, and the file where there is none; fails where someone else has it.
async fn connect_writer(options: &SqliteConnectOptions) -> Result<Pool<Sqlite>, sqlx::Error> {
    let pool = connections(1).connect_lazy_with(options.clone());
    let tried = async { sqlx::raw_sql("BEGIN EXCLUSIVE; COMMIT").execute(&mut *pool.acquire().await?).await };
    match tried.await {
        Ok(_) => Ok(pool),
        Err(error) => {
            pool.close().await;
            Err(error)
        }
    }
}

/// Begins a transaction on the connection that writes.
///
/// SQLite ends one by itself that meets the end of the disk or an error of it (<https://www.sqlite.org/lang_transaction.html>, 3.2); `sqlx`
/// 0.9 then fails to, and takes the connection to be within it for ever. Such a connection is replaced.
async fn begin_writing(writer: &Pool<Sqlite>) -> Result<sqlx::Transaction<'static, Sqlite>, sqlx::Error> {
    match writer.begin_with("BEGIN IMMEDIATE").await {
        Err(sqlx::Error::InvalidSavePointStatement | sqlx::Error::BeginFailed) => {
            tracing::warn!("the connection to the database is in no state to write, and is replaced");
            writer.acquire().await?.close().await?;
            writer.begin_with("BEGIN IMMEDIATE").await
        }
        begun => begun,
    }
}

/// Whether the error says that someone else has the database.
fn is_locked(error: &sqlx::Error) -> bool {
    // SQLITE_BUSY and SQLITE_LOCKED with their extended codes (https://www.sqlite.org/rescode.html): the primary code is the low byte.
    let code = error.as_database_error().and_then(sqlx::error::DatabaseError::code).and_then(|code| code.parse::<u32>().ok());
    code.is_some_and(|code| matches!(code & 0xff, 5 | 6))
}

fn version(text: &str) -> Option<[u32; 3]> {
    let mut parts = text.split('.').map(|part| part.parse().ok());
    Some([parts.next()??, parts.next()??, parts.next()??])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_transaction_that_found_no_room_hinders_none_after_it() {
        let directory = std::env::temp_dir().join(format!("ventricle-full-{}", uuid::Uuid::now_v7()));
        let database = Database::sqlite(&directory, Duration::ZERO).await.unwrap();
        let write = async |database: &Database| {
            let mut transaction = database.begin().await?;
            transaction.execute("CREATE TABLE IF NOT EXISTS notes (text TEXT)", vec![]).await?;
            transaction.execute("INSERT INTO notes VALUES ($1)", vec!["x".repeat(1 << 20).into()]).await?;
            transaction.commit().await
        };
        // SQLite says of the file what it says of the disk: full.
        database.fetch("PRAGMA max_page_count = 16", vec![]).await.unwrap();
        let full = write(&database).await.unwrap_err();
        assert!(full.is_passing() && full.to_string().contains("full"), "{full}");
        let Database::Sqlite(embedded) = &database else { unreachable!() };
        let mut connection = embedded.writer.acquire().await.unwrap();
        sqlx::query("PRAGMA max_page_count = 1000000").execute(&mut *connection).await.unwrap();
        drop(connection);
        for _ in 0..3 {
            write(&database).await.unwrap();
        }
        let rows = database.fetch("SELECT COUNT(*) FROM notes", vec![]).await.unwrap();
        assert_eq!(rows[0].get::<i64>(0).unwrap(), 3);
        database.close().await;
        std::fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn versions_are_compared_by_number() {
        let recent = |text: &str| version(text).is_some_and(|version| version >= LEAST_SQLITE.1);
        assert!(recent("3.51.3") && recent("3.100.0") && recent("4.0.0"));
        assert!(!recent("3.51.2") && !recent("3.9.9") && !recent("") && !recent("3.51"));
        assert_eq!(version(LEAST_SQLITE.0), Some(LEAST_SQLITE.1));
    }
}
