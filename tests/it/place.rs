//! Where the jobs of a test are kept, and small jobs and workers for it.
//!
//! The tests of the store run on SQLite, each in a directory of its own, and, where `TEST_DATABASE_URL` names a PostgreSQL database
//! (`postgres://user@host/database`; `make test` starts a server), on that too, each in a schema of its own.

use ndarray::Array3;
use sqlx::{AssertSqlSafe, ConnectOptions as _, Connection, PgConnection, sqlite::SqliteConnectOptions};
use std::{
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};
use uuid::Uuid;
use ventricle::{
    jobs::{
        Backend, Job, NewJob, Output, Progress, State, Store, StoreSettings, Submitted, Threads, Work, WorkError, WorkerSettings, Workers,
        start_workers,
    },
    pipeline::{monitor::Monitor, parameters::Parameters},
    study::{Acquisition, Format, Gate, Study},
    volume::{Grid, Volume},
};

/// A directory, or a schema of a PostgreSQL database. Goes with the test, with all that is in it.
pub(crate) struct Place {
    /// Empty on PostgreSQL.
    pub(crate) directory: PathBuf,
    pub(crate) backend: Backend,
    schema: Option<(String, String)>,
}

/// Makes tests of functions `async fn(&Place)`: each in a module `sqlite` and, skipped without a server, in a module `postgres`.
macro_rules! on_both_engines {
    ($($test:ident),* $(,)?) => {
        mod sqlite {
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
            async fn $test() {
                super::$test(&$crate::place::Place::sqlite()).await;
            })*
        }
        $crate::place::on_postgres! { $($test),* }
    };
}
pub(crate) use on_both_engines;

/// Makes tests of functions `async fn(&Place)` in a module `postgres`, skipped without a server.
macro_rules! on_postgres {
    ($($test:ident),* $(,)?) => {
        mod postgres {
            $(#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
            async fn $test() {
                if let Some(place) = $crate::place::Place::postgres().await {
                    super::$test(&place).await;
                }
            })*
        }
    };
}
pub(crate) use on_postgres;

/// The PostgreSQL database to test on. Absent: `None` with a word on standard error, a failure where `CI` is set.
#[expect(clippy::disallowed_methods, reason = "which engines are tested is a matter of the test run, not of the program's settings")]
fn server() -> Option<String> {
    let server = std::env::var("TEST_DATABASE_URL").ok();
    if server.is_none() {
        assert!(std::env::var_os("CI").is_none(), "TEST_DATABASE_URL names no PostgreSQL database; make test starts one");
        eprintln!("skipped: the store on PostgreSQL, as TEST_DATABASE_URL is not set (make test starts a server)");
    }
    server
}

impl Place {
    /// A directory.
    pub(crate) fn sqlite() -> Self {
        let directory = std::env::temp_dir().join(format!("ventricle-jobs-{}", Uuid::now_v7()));
        Self { backend: Backend::Sqlite { directory: directory.clone() }, directory, schema: None }
    }

    /// A schema of the database to test on, if there is one.
    pub(crate) async fn postgres() -> Option<Self> {
        Some(Self::postgres_at(&server()?).await)
    }

    /// A schema of this database.
    pub(crate) async fn postgres_at(server: &str) -> Self {
        let schema = format!("ventricle_{}", Uuid::now_v7().simple());
        execute(server, &format!("CREATE SCHEMA {schema}")).await.unwrap();
        let separator = if server.contains('?') { '&' } else { '?' };
        let url = format!("{server}{separator}options[search_path]={schema}");
        Self { backend: Backend::Postgres { url }, directory: PathBuf::new(), schema: Some((server.to_owned(), schema)) }
    }

    /// All of a PostgreSQL database, which is left as it is.
    pub(crate) fn postgres_database(url: String) -> Self {
        Self { backend: Backend::Postgres { url }, directory: PathBuf::new(), schema: None }
    }

    /// Where a program finds the database.
    pub(crate) fn url(&self) -> &str {
        match &self.backend {
            Backend::Postgres { url } => url,
            Backend::Sqlite { .. } => panic!("not on PostgreSQL"),
        }
    }

    pub(crate) fn settings(&self) -> StoreSettings {
        StoreSettings { backend: self.backend.clone(), connections: 4, retry_pause: Duration::ZERO, ..StoreSettings::default() }
    }

    pub(crate) async fn open(&self) -> Store {
        Store::open(self.settings()).await.unwrap()
    }

    /// Runs statements past the store; on SQLite while no store has the directory.
    pub(crate) async fn run(&self, sql: String) {
        match &self.backend {
            Backend::Sqlite { directory } => {
                std::fs::create_dir_all(directory).unwrap();
                let options = SqliteConnectOptions::new().filename(directory.join("ventricle.sqlite")).create_if_missing(true);
                let mut connection = options.connect().await.unwrap();
                sqlx::raw_sql(AssertSqlSafe(sql)).execute(&mut connection).await.unwrap();
                connection.close().await.unwrap();
            }
            Backend::Postgres { url } => execute(url, &sql).await.unwrap(),
        }
    }

    /// A connection past the store.
    pub(crate) async fn connect(&self) -> PgConnection {
        PgConnection::connect(self.url()).await.unwrap()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let Some((server, schema)) = self.schema.take() else {
            if !self.directory.as_os_str().is_empty() {
                std::fs::remove_dir_all(&self.directory).ok();
            }
            return;
        };
        // Its own runtime, as the test's cannot be waited for here. What a stopped worker may still hold is not worth waiting for either.
        let dropped = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            let sql = format!("SET lock_timeout = '2s'; DROP SCHEMA {schema} CASCADE");
            runtime.block_on(async { tokio::time::timeout(Duration::from_secs(5), execute(&server, &sql)).await.map(drop) })
        });
        drop(dropped.join());
    }
}

async fn execute(server: &str, sql: &str) -> Result<(), sqlx::Error> {
    let mut connection = PgConnection::connect(server).await?;
    sqlx::raw_sql(AssertSqlSafe(sql.to_owned())).execute(&mut connection).await?;
    connection.close().await
}

pub(crate) fn study() -> Study {
    let grid = Grid { shape: [2, 3, 4], spacing_mm: [6.0, 3.0, 3.0] };
    let gate = |gate: usize| Gate {
        volume: Volume { grid, counts: Array3::from_shape_fn((2, 3, 4), |(z, y, x)| (gate + z + y + x) as f32) },
        duration_ms: Some(100.0),
    };
    Study {
        grid,
        gates: (0..4).map(gate).collect(),
        orientation: None,
        acquisition: Acquisition::unknown(Format::Phantom),
        warnings: Vec::new(),
    }
}

pub(crate) fn new_job() -> NewJob {
    NewJob {
        most_queued: None,
        subject: None,
        owner: "someone".into(),
        idempotency_key: None,
        request_hash: [1; 32],
        study: study(),
        parameters: Parameters::paper(),
        retention: None,
        keep_input: None,
        callback_url: None,
    }
}

pub(crate) async fn submit(store: &Store) -> Job {
    let submitted = store.submit(store.reserve(100).unwrap(), new_job()).await.unwrap();
    assert!(matches!(submitted, Submitted::Created(_)));
    submitted.job().clone()
}

pub(crate) fn work(work: impl Fn(&Study, &Parameters, Uuid, &Progress) -> Result<Vec<Output>, WorkError> + Send + Sync + 'static) -> Work {
    Arc::new(work)
}

pub(crate) fn output(name: &str, data: &[u8]) -> Output {
    Output { name: name.into(), media_type: "application/json", data: data.to_vec() }
}

/// Work that goes on until it is told to stop.
pub(crate) fn endless() -> Work {
    work(|_, _, _, progress| {
        while !progress.is_cancelled() {
            std::thread::sleep(Duration::from_millis(2));
        }
        Err(WorkError::Cancelled)
    })
}

pub(crate) fn workers(store: &Store, work: Work) -> Workers {
    let settings = WorkerSettings {
        threads: Threads::Fixed(1),
        heartbeat: Duration::from_millis(100),
        progress_interval: Duration::from_millis(20),
        poll: Duration::from_millis(50),
        work,
        ..WorkerSettings::default()
    };
    start_workers(store.clone(), settings).unwrap()
}

pub(crate) async fn until(store: &Store, id: Uuid, wanted: impl Fn(&Job) -> bool) -> Job {
    let deadline = Instant::now() + Duration::from_secs(20);
    let mut version = 0;
    loop {
        let job = store.wait_for_change(id, version, Duration::from_secs(1)).await.unwrap().unwrap();
        if wanted(&job) {
            return job;
        }
        assert!(!job.state.is_final() && Instant::now() < deadline, "the job never got there: {job:?}");
        version = job.version;
    }
}

pub(crate) async fn until_state(store: &Store, id: Uuid, state: State) -> Job {
    until(store, id, |job| job.state == state).await
}
