//! What can go wrong with the store, as sentences for the operator; clients are told less (`http/problem.rs` decides).

use std::path::PathBuf;

/// The queue is full; try again later.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("The queue is full. Try again in {retry_after_s} s.")]
pub struct QueueFull {
    /// When there is probably room again, in s, from the measured rate (1 to 600).
    pub retry_after_s: u64,
}

/// As many jobs of one owner wait as may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{waiting} jobs of this owner wait already, as many as may. Send the request again when some are done.")]
pub struct OwnerFull {
    /// How many wait.
    pub waiting: u64,
    /// When all that waits is probably done, in s.
    pub retry_after_s: u64,
}

/// Why a submission was not accepted.
#[derive(Debug, thiserror::Error)]
pub enum SubmitError {
    /// The owner used this idempotency key before, for another request.
    #[error("This idempotency key was already used for a different request. Use a new key for a new request.")]
    KeyReused,
    /// The owner has another instance of this UID.
    #[error("Another instance with this SOP Instance UID is stored already. Delete the job that was made of it first.")]
    InstanceConflict,
    /// Instances that were to become a job were deleted meanwhile.
    #[error("Instances of this study were deleted while it was put together. What is left of it waits for the rest; send it again.")]
    InstancesGone,
    /// There will never be room for the job: it alone is more than may wait.
    #[error("The study takes {bytes} bytes as it is stored, and all that waits may take {limit}. Send fewer gates, or a smaller matrix.")]
    TooLarge {
        /// Bytes of its stored form.
        bytes: u64,
        /// Most bytes that may wait.
        limit: u64,
    },
    /// No room for the job now.
    #[error(transparent)]
    QueueFull(#[from] QueueFull),
    /// No room for the owner's jobs now.
    #[error(transparent)]
    OwnerFull(#[from] OwnerFull),
    /// The store failed; nothing was accepted.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A failure of the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another process (or another store of this one) has the directory.
    #[error(
        "The data directory {} is in use by another process. One directory serves one process: stop the other one, give this one its own \
         --data-dir, or let several share the work with --database-url.",
        directory.display()
    )]
    DirectoryInUse {
        /// The directory.
        directory: PathBuf,
    },
    /// The data directory cannot be made or used.
    #[error("The data directory {} cannot be used: {source}.", directory.display())]
    Directory {
        /// The directory.
        directory: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// PostgreSQL, or what stands before it, gave no connection in time.
    #[error(
        "PostgreSQL gave no connection within {seconds} s. Look whether the server that --database-url names runs, and whether it (or the \
         pooler before it) has connections left for this node."
    )]
    NoConnection {
        /// How long was waited.
        seconds: u64,
    },
    /// The linked SQLite is older than what the store was proven on.
    #[error("SQLite {found} is linked; {required} or later is required.")]
    SqliteTooOld {
        /// The version that answers.
        found: String,
        /// The least version.
        required: &'static str,
    },
    /// SQLite refused one of the settings durability rests on.
    #[error("SQLite did not accept the setting {setting}: it answers {found}.")]
    Setting {
        /// The setting and the wanted value.
        setting: &'static str,
        /// What is in force.
        found: String,
    },
    /// The database was written by a later version of this program.
    #[error(
        "The database has schema version {found}; this program knows versions up to {known}. Use the program that wrote it or a later one."
    )]
    SchemaTooNew {
        /// The version in the database.
        found: i64,
        /// The latest version this program knows.
        known: i64,
    },
    /// What is stored is not what was stored.
    #[error("Stored data is damaged: {what}.")]
    Damaged {
        /// Which data and how.
        what: String,
    },
    /// The database failed or does not answer.
    #[error("The database failed: {0}.")]
    Database(#[from] sqlx::Error),
    /// The runtime ended before the operation did.
    #[error("The operation was interrupted by the end of the process.")]
    Interrupted,
}

impl StoreError {
    /// Whether the same operation may succeed later without anyone's doing: the database restarts, is full or is out of connections.
    pub fn is_passing(&self) -> bool {
        let Self::Database(error) = self else { return false };
        match error {
            sqlx::Error::Io(_)
            | sqlx::Error::Tls(_)
            | sqlx::Error::Protocol(_)
            | sqlx::Error::PoolTimedOut
            | sqlx::Error::WorkerCrashed => true,
            sqlx::Error::Database(error) => error.code().is_some_and(|code| is_passing_code(&code)),
            _ => false,
        }
    }
}

/// PostgreSQL: connection, a database that was made read-only, a transaction that this node paused in for too long, rollback, resources,
/// object state, operator intervention, errors of the system (Appendix A of its manual; always five characters).
/// SQLite: busy, locked, read-only, disk error, disk full, no file descriptor to open it with (<https://www.sqlite.org/rescode.html>; a number whose low byte is the primary code).
fn is_passing_code(code: &str) -> bool {
    if code.len() == 5 {
        return ["08", "25006", "25P03", "40", "53", "55", "57", "58"].iter().any(|class| code.starts_with(class));
    }
    code.parse::<u32>().is_ok_and(|code| matches!(code & 0xff, 5 | 6 | 8 | 10 | 13 | 14))
}
