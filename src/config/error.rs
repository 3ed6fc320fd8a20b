//! Why the service does not start, with what to give instead.

use super::{AccessError, TransportError, outward::LEAST_SECRET};
use std::{net::SocketAddr, path::PathBuf};

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
