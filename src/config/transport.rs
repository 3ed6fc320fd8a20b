//! Settings of the transport: how connections are encrypted, who may speak for others, and how much of the network may be open or held at once.

use crate::networks::Network;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// How HTTP is carried.
#[derive(Debug, Clone, Args)]
pub struct TransportSettings {
    /// PEM file of the certificate that HTTP is encrypted with, and of the authorities between. Needs its key; SIGHUP reads both again.
    #[arg(long, env = "VENTRICLE_TLS_CERT")]
    pub tls_cert: Option<PathBuf>,

    /// PEM file of the key of that certificate, without a password.
    #[arg(long, env = "VENTRICLE_TLS_KEY")]
    pub tls_key: Option<PathBuf>,

    /// Seconds for which browsers are told to come by HTTPS only (`Strict-Transport-Security`), where the service itself encrypts; 0: they are
    /// not told.
    #[arg(long, env = "VENTRICLE_HSTS_SECONDS", default_value = "31536000")]
    pub hsts_seconds: u64,

    /// Addresses and networks (`10.0.0.0/8`) of proxies, separated by commas, that are believed when they name the client they speak for.
    /// None by default: no header changes whom a request is counted for.
    #[arg(long, env = "VENTRICLE_TRUSTED_PROXY", value_delimiter = ',')]
    pub trusted_proxy: Vec<Network>,

    /// Header in which those proxies name the client; the other one is not looked at, as clients could send it through them.
    #[arg(long, env = "VENTRICLE_TRUSTED_PROXY_HEADER", value_enum, default_value = "x-forwarded-for")]
    pub trusted_proxy_header: ProxyHeader,

    /// HTTP connections at once; more are closed as they come.
    #[arg(long, env = "VENTRICLE_MAX_CONNECTIONS", default_value = "4096", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub max_connections: u32,

    /// HTTP connections at once from one address (of IPv6, from one /64 network); loopback addresses and trusted proxies may have more.
    #[arg(long, env = "VENTRICLE_MAX_CONNECTIONS_PER_CLIENT", default_value = "1024", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub max_connections_per_client: u32,

    /// Request bodies with studies that are received and parsed at once, of one owner at most half of them. As many again wait up to 10 s; more
    /// are answered 503 with `Retry-After`.
    #[arg(long, env = "VENTRICLE_MAX_UPLOADS", default_value = "64", value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub max_uploads: u32,

    /// MiB that such bodies may take of the memory, those of one owner at most half. Each has its place before it is read; one that finds none waits up to 10 s and is then
    /// answered 503 with `Retry-After`.
    #[arg(long, env = "VENTRICLE_MAX_UPLOAD_MEMORY_MB", default_value = "512", value_parser = clap::value_parser!(u64).range(1..=1_048_576))]
    pub max_upload_memory_mb: u64,
}

/// How a proxy names the client it speaks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum ProxyHeader {
    /// `X-Forwarded-For: address, address`.
    #[default]
    XForwardedFor,
    /// `Forwarded: for=address` (RFC 7239).
    Forwarded,
}

/// Why HTTP cannot be carried with the settings given.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TransportError {
    /// A certificate without its key, or the other way round.
    #[error("HTTP is encrypted with a certificate and its key: give both --tls-cert and --tls-key, or neither.")]
    Tls,
    /// No single body could ever be read.
    #[error(
        "A body may have {body} MiB but all bodies together only {memory} MiB of memory: give at least as much to --max-upload-memory-mb, or \
         less to --max-body-mb."
    )]
    MemorySmallerThanBody {
        /// Largest body in MiB.
        body: u64,
        /// Memory of all in MiB.
        memory: u64,
    },
}

impl TransportSettings {
    /// Checks what no single setting can say, where a body may have so many MiB.
    pub(super) fn validate(&self, max_body_mb: u64) -> Result<(), TransportError> {
        if self.tls_cert.is_some() != self.tls_key.is_some() {
            return Err(TransportError::Tls);
        }
        if self.max_upload_memory_mb < max_body_mb {
            return Err(TransportError::MemorySmallerThanBody { body: max_body_mb, memory: self.max_upload_memory_mb });
        }
        Ok(())
    }

    /// The files of certificate and key, if HTTP is to be encrypted.
    pub fn tls(&self) -> Option<(&PathBuf, &PathBuf)> {
        self.tls_cert.as_ref().zip(self.tls_key.as_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::{super::ServeSettings, *};

    fn settings(flags: &[&str]) -> ServeSettings {
        ServeSettings::from_flags(flags.iter().copied()).unwrap()
    }

    #[test]
    fn nothing_is_encrypted_and_nobody_trusted_by_default() {
        let TransportSettings { trusted_proxy, trusted_proxy_header, hsts_seconds, .. } = settings(&[]).transport;
        assert_eq!((trusted_proxy, trusted_proxy_header, hsts_seconds), (vec![], ProxyHeader::XForwardedFor, 31_536_000));
        assert_eq!(settings(&[]).transport.tls(), None);
    }

    #[test]
    fn a_certificate_needs_its_key_and_a_body_its_memory() {
        for half in ["--tls-cert", "--tls-key"] {
            assert_eq!(settings(&[half, "a.pem"]).validate(), Err(TransportError::Tls.into()));
        }
        let both = settings(&["--tls-cert", "a.pem", "--tls-key", "b.pem"]);
        both.validate().unwrap();
        assert_eq!(both.transport.tls(), Some((&"a.pem".into(), &"b.pem".into())));
        let small = settings(&["--max-upload-memory-mb", "63"]).validate();
        assert_eq!(small, Err(TransportError::MemorySmallerThanBody { body: 64, memory: 63 }.into()));
        settings(&["--max-upload-memory-mb", "64"]).validate().unwrap();
    }

    #[test]
    fn proxies_are_addresses_and_networks() {
        let given = settings(&["--trusted-proxy", "10.1.2.3,fd00::/8", "--trusted-proxy-header", "forwarded"]).transport;
        assert_eq!(given.trusted_proxy, ["10.1.2.3".parse().unwrap(), "fd00::/8".parse().unwrap()]);
        assert_eq!(given.trusted_proxy_header, ProxyHeader::Forwarded);
        let refused = ServeSettings::from_flags(["--trusted-proxy", "proxy.example"]).unwrap_err().to_string();
        assert!(refused.contains("`proxy.example` is neither an address nor a network"), "{refused}");
    }
}
