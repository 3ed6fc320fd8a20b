//! Every setting of the service: a flag and an environment variable each, checked once at start. The only reader of the environment.

mod access;
mod dimse;
mod error;
mod hosts;
mod outward;
mod secret;
mod traces;
mod transport;

pub use access::{AccessError, AccessSettings, default_keys_file};
pub use dimse::DimseSettings;
pub use error::ConfigError;
pub use hosts::Hosts;
pub use outward::OutwardSettings;
pub use secret::Secret;
pub use traces::TraceSettings;
pub use transport::{ProxyHeader, TransportError, TransportSettings};

use crate::access::is_owner;
use clap::{Args, Parser, ValueEnum, builder::BoolishValueParser};
use std::{net::SocketAddr, num::NonZeroUsize, path::PathBuf, time::Duration};

/// A hundred years: what is meant to be kept for longer is kept until it is deleted.
const LONGEST_RETENTION_HOURS: u64 = 876_000;

/// Where Linux has the program of the calling process, even if its file was replaced meanwhile.
const OWN_PROGRAM: &str = "/proc/self/exe";

/// The program that is running, to start it a second time.
///
/// # Errors
/// The system does not know.
pub fn own_program() -> std::io::Result<PathBuf> {
    let linux = PathBuf::from(OWN_PROGRAM);
    if linux.exists() { Ok(linux) } else { std::env::current_exe() }
}

/// Settings of `ventricle serve`.
#[derive(Debug, Clone, Args)]
pub struct ServeSettings {
    /// Address and port to listen on; port 0 takes a free one and prints it.
    #[arg(long, env = "VENTRICLE_LISTEN", default_value = "127.0.0.1:8080")]
    pub listen: SocketAddr,

    /// Who may come in, and how much each may use.
    #[command(flatten)]
    pub access: AccessSettings,

    /// Directory of the embedded database. Made if absent.
    #[arg(long, env = "VENTRICLE_DATA_DIR", default_value = "./data")]
    pub data_dir: PathBuf,

    /// PostgreSQL to use instead of the embedded database, when several nodes share the work: `postgres://user:password@host/database`.
    #[arg(long, env = "VENTRICLE_DATABASE_URL", hide_env_values = true)]
    pub database_url: Option<String>,

    /// Connections to PostgreSQL; one more listens for what other nodes do.
    #[arg(long, env = "VENTRICLE_DATABASE_CONNECTIONS", default_value = "10", value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub database_connections: u32,

    /// Name of this node, for people who look at the leases in the table and at the log [default: host name and process id].
    #[arg(long, env = "VENTRICLE_NODE", value_parser = node_name)]
    pub node: Option<String>,

    /// Seconds after which a job whose worker gave no sign of life is taken back; workers give one six times as often.
    #[arg(long, env = "VENTRICLE_LEASE_SECONDS", default_value = "30", value_parser = clap::value_parser!(u64).range(2..=3600))]
    pub lease_seconds: u64,

    /// Jobs worked on at once [default: one a processor; with `--threads-per-worker` the processors divided by it].
    #[arg(long, env = "VENTRICLE_WORKERS")]
    pub workers: Option<NonZeroUsize>,

    /// Threads of each job [default: by load: all processors for a job alone, one where as many run or wait].
    #[arg(long, env = "VENTRICLE_THREADS_PER_WORKER")]
    pub threads_per_worker: Option<NonZeroUsize>,

    /// Largest request body in MiB; a larger one is answered 413.
    #[arg(long, env = "VENTRICLE_MAX_BODY_MB", default_value = "64", value_parser = clap::value_parser!(u64).range(1..=2048))]
    pub max_body_mb: u64,

    /// Largest request with DICOM instances (`/dicom-web/studies`) in MiB, of which each may have `--max-body-mb`; a larger one is answered 413.
    #[arg(long, env = "VENTRICLE_MAX_STUDY_MB", default_value = "1024", value_parser = clap::value_parser!(u64).range(1..=65536))]
    pub max_study_mb: u64,

    /// Seconds without a further instance after which a series that does not say how many it has is reconstructed as it is.
    #[arg(long, env = "VENTRICLE_QUIET_SECONDS", default_value = "10", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub quiet_seconds: u64,

    /// Jobs that may wait; more are answered 503 with `Retry-After`.
    #[arg(long, env = "VENTRICLE_MAX_QUEUED_JOBS", default_value = "1000", value_parser = clap::value_parser!(u64).range(1..))]
    pub max_queued_jobs: u64,

    /// MiB of input that may wait or be on its way; more is answered 503 with `Retry-After`.
    #[arg(long, env = "VENTRICLE_MAX_QUEUED_MB", default_value = "4096", value_parser = clap::value_parser!(u64).range(1..=1_048_576))]
    pub max_queued_mb: u64,

    /// MiB that must be free in the data directory for the service to call itself ready.
    #[arg(long, env = "VENTRICLE_MIN_FREE_DISK_MB", default_value = "256")]
    pub min_free_disk_mb: u64,

    /// Keeps the input of finished jobs (counts and UIDs, no names) instead of deleting it.
    #[arg(long, env = "VENTRICLE_KEEP_INPUT", value_parser = BoolishValueParser::new())]
    pub keep_input: bool,

    /// Keeps the patient and study attributes of DICOM files (name, id, birth date, sex, accession number …) with their job, for its DICOM results
    /// alone, so that they can be filed with the study.
    #[arg(long, env = "VENTRICLE_KEEP_PATIENT", value_parser = BoolishValueParser::new())]
    pub keep_patient: bool,

    /// Hours a finished reconstruction is kept with all its data, unless its request says otherwise; 0: until someone deletes it.
    #[arg(long, env = "VENTRICLE_RETENTION_HOURS", default_value = "720", value_parser = clap::value_parser!(u64).range(0..=LONGEST_RETENTION_HOURS))]
    pub retention_hours: u64,

    /// Most hours that a request may ask for (`retention_seconds`).
    #[arg(long, env = "VENTRICLE_MAX_RETENTION_HOURS", default_value = "8760", value_parser = clap::value_parser!(u64).range(1..=LONGEST_RETENTION_HOURS))]
    pub max_retention_hours: u64,

    /// Seconds a request body may take to arrive; then 408. One with DICOM instances may take as long again for each `--max-body-mb` of it that
    /// came. 30 s without a byte are too long for any.
    #[arg(long, env = "VENTRICLE_UPLOAD_SECONDS", default_value = "120", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub upload_seconds: u64,

    /// Seconds that running jobs get to finish after SIGTERM or SIGINT; what is not finished then continues at the next start.
    #[arg(long, env = "VENTRICLE_DRAIN_SECONDS", default_value = "25", value_parser = clap::value_parser!(u64).range(0..=3600))]
    pub drain_seconds: u64,

    /// What is told and sent to others.
    #[command(flatten)]
    pub outward: OutwardSettings,

    /// How DICOM associations are taken.
    #[command(flatten)]
    pub dimse: DimseSettings,

    /// How HTTP is carried.
    #[command(flatten)]
    pub transport: TransportSettings,

    /// Origins of web pages that may call the service (CORS), separated by commas, or `*` for any. None by default.
    #[arg(long, env = "VENTRICLE_CORS_ORIGIN", value_delimiter = ',')]
    pub cors_origin: Vec<String>,

    /// Where traces go.
    #[command(flatten)]
    pub traces: TraceSettings,

    /// Form of the log on standard error.
    #[arg(long, env = "VENTRICLE_LOG_FORMAT", value_enum, default_value = "text")]
    pub log_format: LogFormat,

    /// What is logged: a level, or directives as `info,ventricle::jobs=debug`.
    #[arg(long, env = "VENTRICLE_LOG", default_value = "info")]
    pub log: String,
}

/// Form of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// Which web pages may call the service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cors {
    /// None but its own.
    Off,
    /// Any.
    Any,
    /// Those of these origins.
    Origins(Vec<String>),
}

impl ServeSettings {
    /// Settings from flags alone, as `ventricle serve` would read them; for tests and for a service inside another command. The
    /// environment fills in what the flags leave out.
    pub fn from_flags<'a>(flags: impl IntoIterator<Item = &'a str>) -> Result<Self, clap::Error> {
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            settings: ServeSettings,
        }
        Line::try_parse_from(std::iter::once("serve").chain(flags)).map(|line| line.settings)
    }

    /// Checks what no single setting can say.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.access.validate(self.listen, &self.data_dir)?;
        self.dimse.validate()?;
        self.transport.validate(self.max_body_mb)?;
        if let Some(origin) = self.cors_origin.iter().find(|origin| !is_origin(origin) && self.cors() != Cors::Any) {
            return Err(ConfigError::NotAnOrigin { origin: origin.clone() });
        }
        if self.database_url.as_ref().is_some_and(|url| !url.starts_with("postgres://") && !url.starts_with("postgresql://")) {
            return Err(ConfigError::NotPostgres);
        }
        if self.max_queued_mb < self.max_body_mb {
            return Err(ConfigError::QueueSmallerThanBody { body: self.max_body_mb, queued: self.max_queued_mb });
        }
        if self.retention_hours > self.max_retention_hours {
            return Err(ConfigError::RetentionOverCap { retention: self.retention_hours, max: self.max_retention_hours });
        }
        Ok(())
    }

    /// How long finished jobs are kept whose requests do not say; `None`: until someone deletes them.
    pub fn retention(&self) -> Option<Duration> {
        (self.retention_hours > 0).then(|| Duration::from_hours(self.retention_hours))
    }

    /// Longest a request may ask for.
    pub fn longest_retention(&self) -> Duration {
        Duration::from_hours(self.max_retention_hours)
    }

    /// Which web pages may call the service.
    pub fn cors(&self) -> Cors {
        match self.cors_origin.as_slice() {
            [] => Cors::Off,
            [any] if any == "*" => Cors::Any,
            origins => Cors::Origins(origins.to_vec()),
        }
    }

    /// Jobs worked on at once where there are so many processors: what is asked for, else so many that each processor has a thread.
    pub fn workers(&self, processors: NonZeroUsize) -> NonZeroUsize {
        let shared = || NonZeroUsize::new(processors.get() / self.threads_per_worker.unwrap_or(NonZeroUsize::MIN));
        self.workers.or_else(shared).unwrap_or(NonZeroUsize::MIN)
    }

    /// Largest body in bytes.
    pub fn max_body_bytes(&self) -> u64 {
        self.max_body_mb << 20
    }

    /// Name of this node: what is asked for, else one that no other node has.
    pub fn node_name(&self) -> String {
        self.node.clone().unwrap_or_else(|| {
            let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
            format!("{host}-{}", std::process::id())
        })
    }

    /// How long a worker may hold a job without a sign of life.
    pub fn lease(&self) -> Duration {
        Duration::from_secs(self.lease_seconds)
    }

    /// How often a worker gives a sign of life: one that is late costs no job, nor do four in a row.
    pub fn heartbeat(&self) -> Duration {
        self.lease() / 6
    }

    /// Time running jobs get to finish.
    pub fn drain_time(&self) -> Duration {
        Duration::from_secs(self.drain_seconds)
    }
}

/// Whether a text is `scheme://host[:port]` and nothing else.
fn is_origin(text: &str) -> bool {
    let host = text.strip_prefix("https://").or(text.strip_prefix("http://"));
    host.is_some_and(|host| !host.is_empty() && !host.contains(['/', '?', '#', '*', ' ', '@']))
}

/// A name of an owner of jobs.
pub fn owner(text: &str) -> Result<String, String> {
    if is_owner(text) {
        return Ok(text.to_owned());
    }
    Err("an owner's name has 1 to 128 characters, no control characters and no white space at its ends.".to_owned())
}

/// A name that can stand in a table, a log and a label without quotes.
fn node_name(text: &str) -> Result<String, String> {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    if (1..=64).contains(&text.len()) && text.chars().all(plain) {
        return Ok(text.to_owned());
    }
    Err("a node's name has 1 to 64 letters, digits and -_.".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(flags: &[&str]) -> ServeSettings {
        ServeSettings::from_flags(flags.iter().copied()).unwrap()
    }

    #[test]
    fn the_defaults_are_valid_and_local() {
        let settings = settings(&[]);
        settings.validate().unwrap();
        assert!(settings.listen.ip().is_loopback());
        assert_eq!(settings.cors(), Cors::Off);
        assert_eq!(settings.max_body_bytes(), 64 << 20);
        assert_eq!(settings.retention(), Some(Duration::from_hours(30 * 24)));
    }

    #[test]
    fn an_open_address_needs_an_acknowledgement_and_the_refusal_says_which() {
        let error = settings(&["--listen", "0.0.0.0:8080"]).validate().unwrap_err();
        assert!(error.to_string().contains("--insecure-no-auth"), "{error}");
        settings(&["--listen", "[::]:8080", "--insecure-no-auth"]).validate().unwrap();
        settings(&["--listen", "[::1]:8080"]).validate().unwrap();
    }

    #[test]
    fn an_open_service_on_loopback_is_called_by_names_of_its_machine() {
        let hosts = |flags: &[&str]| {
            let settings = settings(flags);
            settings.access.hosts(settings.listen)
        };
        assert_eq!(hosts(&[]), Hosts::Own(vec![]));
        assert_eq!(hosts(&["--allowed-host", "a.example,b.example"]), Hosts::Own(vec!["a.example".into(), "b.example".into()]));
        assert_eq!(hosts(&["--allowed-host", "*"]), Hosts::Any);
        assert_eq!(hosts(&["--listen", "0.0.0.0:80", "--insecure-no-auth"]), Hosts::Any);
        let named = ["--listen", "0.0.0.0:80", "--insecure-no-auth", "--allowed-host", "a.example"];
        assert_eq!(hosts(&named), Hosts::Own(vec!["a.example".into()]));
    }

    #[test]
    fn origins_are_checked() {
        assert_eq!(settings(&["--cors-origin", "*"]).cors(), Cors::Any);
        settings(&["--cors-origin", "https://a.example,http://localhost:5173"]).validate().unwrap();
        for wrong in ["a.example", "https://a.example/path", "*,https://a.example", "https://*"] {
            assert!(matches!(settings(&["--cors-origin", wrong]).validate(), Err(ConfigError::NotAnOrigin { .. })), "{wrong}");
        }
    }

    #[test]
    fn nodes_have_names_of_their_own_unless_given_one() {
        assert_eq!(settings(&["--node", "a-1.ward_2"]).node_name(), "a-1.ward_2");
        let own = settings(&[]).node_name();
        assert!(own.len() > 2 && own.ends_with(&format!("-{}", std::process::id())), "{own}");
        for wrong in ["", "a b", "a/b", &"a".repeat(65)] {
            assert!(ServeSettings::from_flags(["--node", wrong]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn workers_are_as_many_as_have_processors_unless_said_otherwise() {
        let eight = NonZeroUsize::new(8).unwrap();
        let workers = |flags: &[&str]| settings(flags).workers(eight).get();
        assert_eq!((workers(&[]), workers(&["--workers", "3"]), workers(&["--threads-per-worker", "3"])), (8, 3, 2));
        assert_eq!((workers(&["--threads-per-worker", "16"]), workers(&["--threads-per-worker", "8", "--workers", "8"])), (1, 8));
    }

    #[test]
    fn leases_outlive_missed_heartbeats() {
        assert_eq!((settings(&[]).lease(), settings(&[]).heartbeat()), (Duration::from_secs(30), Duration::from_secs(5)));
        let short = settings(&["--lease-seconds", "2"]);
        assert!(short.heartbeat() * 5 < short.lease());
        assert!(ServeSettings::from_flags(["--lease-seconds", "1"]).is_err());
    }

    #[test]
    fn what_is_kept_for_ever_has_no_end() {
        let settings = settings(&["--retention-hours", "0", "--max-retention-hours", "1"]);
        settings.validate().unwrap();
        assert_eq!((settings.retention(), settings.longest_retention()), (None, Duration::from_hours(1)));
    }

    #[test]
    fn what_could_never_work_is_refused() {
        assert!(matches!(
            settings(&["--max-retention-hours", "24"]).validate(),
            Err(ConfigError::RetentionOverCap { retention: 720, max: 24 })
        ));
        assert_eq!(settings(&["--database-url", "mysql://x"]).validate(), Err(ConfigError::NotPostgres));
        assert!(matches!(settings(&["--max-queued-mb", "32"]).validate(), Err(ConfigError::QueueSmallerThanBody { .. })));
        assert!(ServeSettings::from_flags(["--workers", "0"]).is_err());
        assert!(ServeSettings::from_flags(["--max-body-mb", "0"]).is_err());
    }
}
