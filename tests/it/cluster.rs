//! A PostgreSQL server that a test has to itself, by `tests/tools/postgres.sh`.

use sqlx::PgConnection;
use std::{
    io::Write as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};
use uuid::Uuid;

/// A PostgreSQL server of a test's own.
pub(crate) struct Cluster {
    directory: PathBuf,
    pub(crate) url: String,
}

impl Cluster {
    fn script() -> Command {
        Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/postgres.sh"))
    }

    /// Starts a server for this; where PostgreSQL is not installed: `None` with a word on standard error, a failure where `CI` is set.
    #[expect(clippy::disallowed_methods, reason = "tests decide by the environment whether a skip is a failure")]
    pub(crate) fn start(what: &str) -> Option<Self> {
        let directory = std::env::temp_dir().join(format!("ventricle-postgres-{}", Uuid::now_v7()));
        let output = Self::script().arg("start").arg(&directory).output().unwrap();
        if output.status.code() == Some(3) {
            assert!(std::env::var_os("CI").is_none(), "PostgreSQL is not installed");
            eprintln!("skipped: {what}, as PostgreSQL is not installed (apt-get install postgresql)");
            return None;
        }
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        Some(Self { directory, url: String::from_utf8(output.stdout).unwrap().trim().to_owned() })
    }

    fn act(&self, action: &str) {
        let status = Self::script().arg(action).arg(&self.directory).status().unwrap();
        assert!(status.success(), "{action}: {status}");
    }

    /// Ends every process of the server at once and starts it again.
    pub(crate) fn crash(&self) {
        self.act("crash");
    }

    /// Stops the server for the time being.
    pub(crate) fn halt(&self) {
        self.act("halt");
    }

    /// Starts it again where it was.
    pub(crate) fn resume(&self) {
        self.act("resume");
    }

    /// Runs a program that comes with the server on these bytes; returns what it printed.
    pub(crate) fn run(&self, program: &str, arguments: &[&str], input: &[u8]) -> Vec<u8> {
        let mut command = Self::script();
        command.arg("run").arg(&self.directory).arg(program).args(arguments);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        child.stdin.take().unwrap().write_all(input).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{program}: {}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        drop(Self::script().arg("stop").arg(&self.directory).status());
    }
}

/// The processes of the server that listen for this schema.
pub(crate) async fn listeners(connection: &mut PgConnection) -> Vec<i32> {
    let channel: String = sqlx::query_scalar("SELECT 'ventricle_' || CAST(CAST(quote_ident(current_schema()) AS regnamespace) AS oid)")
        .fetch_one(&mut *connection)
        .await
        .unwrap();
    let sql = "SELECT pid FROM pg_stat_activity WHERE query = $1 ORDER BY pid";
    sqlx::query_scalar(sql).bind(format!("LISTEN \"{channel}\"")).fetch_all(connection).await.unwrap()
}
