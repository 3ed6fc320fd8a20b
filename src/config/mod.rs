//! Every setting of the service: a flag and an environment variable each, checked once at start. The only reader of the environment.

mod access;
mod traces;
mod transport;

pub use access::{AccessError, AccessSettings, default_keys_file};
pub use traces::TraceSettings;
pub use transport::{ProxyHeader, TransportError, TransportSettings};

use crate::{access::is_owner, dimse::is_ae_title, jobs::ANONYMOUS};
use clap::{Args, Parser, ValueEnum, builder::BoolishValueParser};
use std::{net::SocketAddr, num::NonZeroUsize, path::PathBuf, time::Duration};

/// A hundred years: what is meant to be kept for longer is kept until it is deleted.
const LONGEST_RETENTION_HOURS: u64 = 876_000;
/// Fewest characters of a secret: 16 random letters and digits are 95 bits, beyond guessing.
const LEAST_SECRET: usize = 16;

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

    /// Seconds a request body may take to arrive; then 408.
    #[arg(long, env = "VENTRICLE_UPLOAD_SECONDS", default_value = "120", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub upload_seconds: u64,

    /// Seconds that running jobs get to finish after SIGTERM or SIGINT; what is not finished then continues at the next start.
    #[arg(long, env = "VENTRICLE_DRAIN_SECONDS", default_value = "25", value_parser = clap::value_parser!(u64).range(0..=3600))]
    pub drain_seconds: u64,

    /// URL told of the end of every job that gives no `callback_url` of its own. Needs a secret.
    #[arg(long, env = "VENTRICLE_CALLBACK_URL", hide_env_values = true)]
    pub callback_url: Option<Secret>,

    /// Secret that callbacks are signed with, at least 16 characters. Better in the environment or in a file than on the command line.
    #[arg(long, env = "VENTRICLE_CALLBACK_SECRET", hide_env_values = true)]
    pub callback_secret: Option<Secret>,

    /// File that holds that secret, white space at its ends left out.
    #[arg(long, env = "VENTRICLE_CALLBACK_SECRET_FILE")]
    pub callback_secret_file: Option<PathBuf>,

    /// Where callbacks may go beside public addresses, separated by commas: hosts and addresses, each with a port or for all, which may be http
    /// too, and networks as `10.0.0.0/8`.
    #[arg(long, env = "VENTRICLE_CALLBACK_ALLOW", value_delimiter = ',')]
    pub callback_allow: Vec<String>,

    /// PEM file of the certificate authorities that receivers of callbacks are checked against.
    #[arg(long, env = "VENTRICLE_CALLBACK_CA_FILE", default_value = "/etc/ssl/certs/ca-certificates.crt")]
    pub callback_ca_file: PathBuf,

    /// Where the structured report of every job that succeeds is sent: `https://host/dicom-web/studies` (STOW-RS), or
    /// `dicom://TITLE@host:port` (C-STORE, unencrypted: only to hosts that `--callback-allow` names).
    #[arg(long, env = "VENTRICLE_RESULTS_TO")]
    pub results_to: Option<String>,

    /// Value of the header Authorization that STOW-RS with results is sent with, as `Basic …` or `Bearer …`. Better in the environment or in a file
    /// than on the command line.
    #[arg(long, env = "VENTRICLE_RESULTS_AUTHORIZATION", hide_env_values = true)]
    pub results_authorization: Option<Secret>,

    /// File that holds that value, white space at its ends left out.
    #[arg(long, env = "VENTRICLE_RESULTS_AUTHORIZATION_FILE")]
    pub results_authorization_file: Option<PathBuf>,

    /// Address and port to listen on for DICOM associations (C-STORE, C-ECHO); port 0 takes a free one and prints it. None by default.
    #[arg(long, env = "VENTRICLE_DIMSE_LISTEN")]
    pub dimse_listen: Option<SocketAddr>,

    /// AE title of this service.
    #[arg(long, env = "VENTRICLE_DIMSE_AE_TITLE", default_value = "VENTRICLE", value_parser = ae_title)]
    pub dimse_ae_title: String,

    /// Calling AE titles that may associate, separated by commas; any if none is named, which only a loopback address allows.
    #[arg(long, env = "VENTRICLE_DIMSE_CALLING_AE", value_delimiter = ',', value_parser = ae_title)]
    pub dimse_calling_ae: Vec<String>,

    /// Confirms that only those callers reach the address of DICOM associations: needed for anything but a loopback address, since anybody can
    /// give an AE title.
    #[arg(long, env = "VENTRICLE_DIMSE_TRUSTED_NETWORK", value_parser = BoolishValueParser::new())]
    pub dimse_trusted_network: bool,

    /// Owner of the jobs that come by DICOM associations: who has a key or token of the same owner sees them.
    #[arg(long, env = "VENTRICLE_DIMSE_OWNER", default_value = ANONYMOUS, value_parser = owner)]
    pub dimse_owner: String,

    /// DICOM associations at once; more are rejected for the moment.
    #[arg(long, env = "VENTRICLE_DIMSE_MAX_ASSOCIATIONS", default_value = "8", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub dimse_max_associations: u16,

    /// PEM file of the certificate with which DICOM associations are encrypted, and of the authorities between. Needs its key.
    #[arg(long, env = "VENTRICLE_DIMSE_TLS_CERT")]
    pub dimse_tls_cert: Option<PathBuf>,

    /// PEM file of the key of that certificate, without a password.
    #[arg(long, env = "VENTRICLE_DIMSE_TLS_KEY")]
    pub dimse_tls_key: Option<PathBuf>,

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

/// A text that no log, message or debugging output shows.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

impl Secret {
    /// The text.
    pub fn expose(&self) -> &str {
        &self.0
    }
}

impl From<&str> for Secret {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl std::fmt::Debug for Secret {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Secret(…)")
    }
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

/// Why the service does not start with the settings given.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// Who may come in.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// DICOM associations could come from outside.
    #[error(
        "{listen} is not a loopback address, and DICOM associations are not authenticated: whoever reaches it could send studies. Listen on \
         127.0.0.1, or name the callers with --dimse-calling-ae (VENTRICLE_DIMSE_CALLING_AE) and confirm with --dimse-trusted-network \
         (VENTRICLE_DIMSE_TRUSTED_NETWORK=true) that only they reach it: anybody can give an AE title."
    )]
    DimseExposed {
        /// The address asked for.
        listen: SocketAddr,
    },
    /// A certificate without its key, or the other way round.
    #[error("DICOM associations are encrypted with a certificate and its key: give both --dimse-tls-cert and --dimse-tls-key, or neither.")]
    DimseTls,
    /// HTTP cannot be carried so.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// A CORS origin that no browser sends.
    #[error("`{origin}` is not an origin: write scheme, host and, if needed, port, as https://viewer.example.org, or * alone for any.")]
    NotAnOrigin {
        /// What was given.
        origin: String,
    },
    /// A database address of another kind.
    #[error("The database URL does not begin with postgres:// or postgresql://. Leave it out for the embedded database.")]
    NotPostgres,
    /// No single request could ever be accepted.
    #[error("A body may have {body} MiB but all that waits only {queued} MiB: give at least as much to --max-queued-mb.")]
    QueueSmallerThanBody {
        /// Largest body in MiB.
        body: u64,
        /// Largest queue in MiB.
        queued: u64,
    },
    /// What is kept by default is more than may be asked for.
    #[error(
        "Reconstructions would be kept for {retention} h, but a request may ask for {max} h at most: give at least as much to \
         --max-retention-hours, or less to --retention-hours."
    )]
    RetentionOverCap {
        /// Hours by default.
        retention: u64,
        /// Most hours by request.
        max: u64,
    },
    /// Callbacks are wished for that could not be signed.
    #[error(
        "--callback-url (VENTRICLE_CALLBACK_URL) needs a secret to sign with: set --callback-secret-file, or VENTRICLE_CALLBACK_SECRET, to at \
         least {LEAST_SECRET} random characters."
    )]
    CallbackWithoutSecret,
    /// Two secrets for one purpose.
    #[error("--{flag} is given twice, as a value and as a file: use either --{flag}-file or the environment.")]
    SecretTwice {
        /// The flag without `-file`.
        flag: &'static str,
    },
    /// What cannot stand in a header.
    #[error("The value of --results-authorization is empty or has characters other than printable ASCII; give `Basic …` or `Bearer …`.")]
    NoHeaderValue,
    /// What cannot stand in headers, or is not to.
    #[error(
        "The value of --otlp-headers is no list of headers as `Authorization=Bearer …,X-Team=7`: names of letters, digits and hyphens, other than \
         those of the transport itself, values of printable ASCII."
    )]
    OtlpHeaders,
    /// A secret that could be guessed.
    #[error("The secret of callbacks has {length} characters; use at least {LEAST_SECRET} random ones, as `openssl rand -hex 32` prints.")]
    CallbackSecretTooShort {
        /// Its characters.
        length: usize,
    },
    /// A secret that cannot be read.
    #[error("The file of --{flag}-file, {}, cannot be read: {why}.", path.display())]
    SecretFile {
        /// The flag without `-file`.
        flag: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system says.
        why: String,
    },
    /// Log directives that cannot be read.
    #[error("`{directives}` does not say what to log: {why}.")]
    LogDirectives {
        /// What was given.
        directives: String,
        /// What is wrong with it.
        why: String,
    },
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
        if let Some(listen) = self.dimse_listen.filter(|listen| !listen.ip().is_loopback())
            && (!self.dimse_trusted_network || self.dimse_calling_ae.is_empty())
        {
            return Err(ConfigError::DimseExposed { listen });
        }
        if self.dimse_tls_cert.is_some() != self.dimse_tls_key.is_some() {
            return Err(ConfigError::DimseTls);
        }
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

    /// The secret that callbacks are signed with, if there is one; without it there are none.
    pub fn callback_secret(&self) -> Result<Option<Secret>, ConfigError> {
        let Some(secret) = secret("callback-secret", self.callback_secret.as_ref(), self.callback_secret_file.as_ref())? else {
            return if self.callback_url.is_some() { Err(ConfigError::CallbackWithoutSecret) } else { Ok(None) };
        };
        let length = secret.expose().chars().count();
        if length < LEAST_SECRET { Err(ConfigError::CallbackSecretTooShort { length }) } else { Ok(Some(secret)) }
    }

    /// What STOW-RS with results is authorised by, if anything; it can stand in a header.
    pub fn results_authorization(&self) -> Result<Option<Secret>, ConfigError> {
        let given = secret("results-authorization", self.results_authorization.as_ref(), self.results_authorization_file.as_ref())?;
        let printable = |secret: &Secret| !secret.expose().is_empty() && secret.expose().bytes().all(|byte| (b' '..=b'~').contains(&byte));
        if given.as_ref().is_some_and(|secret| !printable(secret)) { Err(ConfigError::NoHeaderValue) } else { Ok(given) }
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

/// An AE title (PS3.5 table 6.2-1).
fn ae_title(text: &str) -> Result<String, String> {
    if is_ae_title(text) {
        return Ok(text.to_owned());
    }
    Err("an AE title has 1 to 16 printable ASCII characters, no backslash and no space at its ends.".to_owned())
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

/// A secret given as it is or in a file.
fn secret(flag: &'static str, given: Option<&Secret>, file: Option<&PathBuf>) -> Result<Option<Secret>, ConfigError> {
    match (given, file) {
        (Some(_), Some(_)) => Err(ConfigError::SecretTwice { flag }),
        (given, None) => Ok(given.cloned()),
        (None, Some(path)) => {
            let unreadable = |error: std::io::Error| ConfigError::SecretFile { flag, path: path.clone(), why: error.to_string() };
            Ok(Some(Secret(std::fs::read_to_string(path).map_err(unreadable)?.trim().to_owned())))
        }
    }
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
    fn dicom_from_outside_needs_callers_and_an_acknowledgement() {
        let open = ["--dimse-listen", "0.0.0.0:104"];
        let (callers, proxy) = (["--dimse-calling-ae", "PACS,CAMERA 2"], ["--dimse-trusted-network"]);
        for flags in [open.to_vec(), [&open[..], &callers].concat(), [&open[..], &proxy].concat()] {
            assert!(matches!(settings(&flags).validate(), Err(ConfigError::DimseExposed { .. })), "{flags:?}");
        }
        let both = settings(&[&open[..], &callers, &proxy].concat());
        both.validate().unwrap();
        assert_eq!(both.dimse_calling_ae, ["PACS", "CAMERA 2"]);
        settings(&["--dimse-listen", "[::1]:11112"]).validate().unwrap();
        assert_eq!(settings(&["--dimse-tls-cert", "a.pem"]).validate(), Err(ConfigError::DimseTls));
        for wrong in ["", "SEVENTEEN_LETTERS", "A\\B", " A"] {
            assert!(ServeSettings::from_flags(["--dimse-ae-title", wrong]).is_err(), "{wrong}");
        }
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
    fn callbacks_need_one_secret_that_is_not_shown() {
        assert_eq!(settings(&[]).callback_secret(), Ok(None));
        let url = ["--callback-url", "https://a.example/?token=1"];
        assert_eq!(settings(&url).callback_secret(), Err(ConfigError::CallbackWithoutSecret));
        let given = settings(&["--callback-secret", "0123456789abcdef", url[0], url[1]]);
        assert_eq!(given.callback_secret().unwrap().unwrap().expose(), "0123456789abcdef");
        assert!(!format!("{given:?}").contains("0123456789abcdef") && !format!("{given:?}").contains("token"));
        let short = settings(&["--callback-secret", "0123456789abcde"]).callback_secret().unwrap_err();
        assert!(short.to_string().contains("at least 16") && !short.to_string().contains("0123"), "{short}");
        let twice = settings(&["--callback-secret", "0123456789abcdef", "--callback-secret-file", "x"]);
        assert_eq!(twice.callback_secret(), Err(ConfigError::SecretTwice { flag: "callback-secret" }));
        let path = std::env::temp_dir().join(format!("ventricle-secret-{}", uuid::Uuid::now_v7()));
        let from_file = settings(&["--callback-secret-file", path.to_str().unwrap()]);
        assert!(matches!(from_file.callback_secret(), Err(ConfigError::SecretFile { .. })));
        std::fs::write(&path, "  fedcba9876543210\n").unwrap();
        assert_eq!(from_file.callback_secret().unwrap().unwrap().expose(), "fedcba9876543210");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn results_are_authorised_by_what_a_header_can_hold() {
        assert_eq!(settings(&[]).results_authorization(), Ok(None));
        let given = settings(&["--results-authorization", "Bearer 0123"]);
        assert_eq!(given.results_authorization().unwrap().unwrap().expose(), "Bearer 0123");
        assert!(!format!("{given:?}").contains("0123"));
        for wrong in ["", "Bearer a\nb", "Bearer \u{e9}"] {
            let refused = settings(&["--results-authorization", wrong]).results_authorization();
            assert_eq!(refused, Err(ConfigError::NoHeaderValue), "{wrong:?}");
        }
        let missing = settings(&["--results-authorization-file", "/no/such/file"]).results_authorization().unwrap_err().to_string();
        assert!(missing.contains("--results-authorization-file, /no/such/file"), "{missing}");
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
