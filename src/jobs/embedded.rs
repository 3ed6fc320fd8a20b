//! The embedded database: SQLite in a data directory that one process has for itself.

use super::{database::ACQUIRE_TIMEOUT, error::StoreError};
use futures_util::future::try_join_all;
use sqlx::{
    Pool, Sqlite,
    sqlite::{SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqliteLockingMode, SqlitePoolOptions, SqliteSynchronous},
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
/// Pause between attempts to get the lock of the data directory.
const LOCK_PAUSE: Duration = Duration::from_millis(100);

/// The database of a data directory that this process has for itself.
#[derive(Debug, Clone)]
pub(super) struct Embedded {
    /// One connection: SQLite has one writer at a time.
    pub(super) writer: Pool<Sqlite>,
    pub(super) readers: Pool<Sqlite>,
    /// Locked until it is closed.
    lock: Arc<File>,
}

impl Embedded {
    /// Opens the database of a data directory, for this process alone. Fails with [`StoreError::DirectoryInUse`] when another
    /// process has it and keeps it longer than `wait`.
    pub(super) async fn open(directory: &Path, wait: Duration) -> Result<Self, StoreError> {
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
        // Now, and not when they are needed: opening one takes file descriptors, and a disk that can be written.
        drop(try_join_all((0..READERS).map(|_| readers.acquire())).await?);
        let embedded = Self { writer, readers, lock: Arc::new(lock) };
        embedded.check().await?;
        Ok(embedded)
    }

    /// Begins a transaction on the connection that writes.
    ///
    /// SQLite ends one by itself that meets the end of the disk or an error of it (<https://www.sqlite.org/lang_transaction.html>, 3.2); `sqlx`
    /// 0.9 then fails to, and takes the connection to be within it for ever. Such a connection is replaced.
    pub(super) async fn begin(&self) -> Result<sqlx::Transaction<'static, Sqlite>, sqlx::Error> {
        match self.writer.begin_with("BEGIN IMMEDIATE").await {
            Err(sqlx::Error::InvalidSavePointStatement | sqlx::Error::BeginFailed) => {
                tracing::warn!("the connection to the database is in no state to write, and is replaced");
                self.writer.acquire().await?.close().await?;
                self.writer.begin_with("BEGIN IMMEDIATE").await
            }
            begun => begun,
        }
    }

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

    pub(super) async fn close(&self) {
        self.readers.close().await;
        // Last, as it merges the log into the file.
        self.writer.close().await;
        if let Err(error) = self.lock.unlock() {
            tracing::warn!(%error, "the data directory stays locked until this process ends");
        }
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
    use super::{super::database::Database, *};

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
