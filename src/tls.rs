//! Certificates and their keys as files, and the connections that are encrypted with them. The files may change while the service runs: they are
//! read again when it is told so.

use std::{
    fmt, io,
    path::{Path, PathBuf},
    sync::{Arc, PoisonError, RwLock},
};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        ServerConfig,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
    },
    server::TlsStream,
};

/// First byte of every connection that is to be encrypted: a record of the handshake (RFC 8446 5.1).
pub const HANDSHAKE_RECORD: u8 = 22;

/// Who listens, as its settings call it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// HTTP.
    Http,
    /// DICOM associations (PS3.15 B.12: TLS below the protocol, no client certificates).
    Dimse,
}

impl Purpose {
    /// The flags of its certificate and of its key.
    fn flags(self) -> [&'static str; 2] {
        match self {
            Self::Http => ["--tls-cert", "--tls-key"],
            Self::Dimse => ["--dimse-tls-cert", "--dimse-tls-key"],
        }
    }

    /// What is spoken over the connection, as both sides agree on while they shake hands: the first is liked best.
    fn protocols(self) -> Vec<Vec<u8>> {
        match self {
            Self::Http => vec![b"h2".to_vec(), b"http/1.1".to_vec()],
            Self::Dimse => Vec::new(),
        }
    }
}

impl fmt::Display for Purpose {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Http => "HTTP listener",
            Self::Dimse => "DICOM listener",
        })
    }
}

/// Why a listener cannot be encrypted with what is given.
#[derive(Debug, thiserror::Error)]
#[error(
    "The {purpose} cannot use {}: {why}. Name the PEM file of its certificate and of the authorities between with {}, and the PEM file of its \
     key, without a password, with {}.",
    path.display(), purpose.flags()[0], purpose.flags()[1]
)]
pub struct TlsError {
    /// Who would use it.
    pub purpose: Purpose,
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub why: String,
}

/// What accepts encrypted connections, with the certificate that was read last.
pub struct Acceptor {
    purpose: Purpose,
    certificates: PathBuf,
    key: PathBuf,
    current: RwLock<TlsAcceptor>,
}

impl fmt::Debug for Acceptor {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { purpose, certificates, key, current: _ } = self;
        formatter.debug_struct("Acceptor").field("purpose", purpose).field("certificates", certificates).field("key", key).finish()
    }
}

impl Acceptor {
    /// With the certificates and the key of these PEM files.
    pub fn open(purpose: Purpose, certificates: &Path, key: &Path) -> Result<Self, TlsError> {
        let current = RwLock::new(read(purpose, certificates, key)?);
        Ok(Self { purpose, certificates: certificates.to_owned(), key: key.to_owned(), current })
    }

    /// Reads the files again, for the connections from now on. What cannot be used changes nothing.
    pub fn reload(&self) -> Result<(), TlsError> {
        let read = read(self.purpose, &self.certificates, &self.key)?;
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = read;
        Ok(())
    }

    /// Who listens with it.
    pub fn purpose(&self) -> Purpose {
        self.purpose
    }

    /// Shakes hands over a new connection. Takes as long as the other side likes.
    pub async fn accept<S: AsyncRead + AsyncWrite + Unpin>(&self, stream: S) -> io::Result<TlsStream<S>> {
        let acceptor = self.current.read().unwrap_or_else(PoisonError::into_inner).clone();
        acceptor.accept(stream).await
    }
}

fn read(purpose: Purpose, certificates: &Path, key: &Path) -> Result<TlsAcceptor, TlsError> {
    let error = |path: &Path, why: String| TlsError { purpose, path: path.to_owned(), why };
    let chain = CertificateDer::pem_file_iter(certificates)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|why| error(certificates, why.to_string()))?;
    if chain.is_empty() {
        return Err(error(certificates, "it holds no certificate".to_owned()));
    }
    let key_file = key;
    let key = PrivateKeyDer::from_pem_file(key_file).map_err(|why| error(key_file, why.to_string()))?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
        .map_err(|why| error(key_file, why.to_string()))?;
    config.alpn_protocols = purpose.protocols();
    Ok(TlsAcceptor::from(Arc::new(config)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_do_not_fit_are_refused_by_name_and_the_last_ones_kept() {
        let folder = std::env::temp_dir().join(format!("ventricle-tls-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir_all(&folder).unwrap();
        let (certificate, key, other) = (folder.join("cert.pem"), folder.join("key.pem"), folder.join("other.pem"));
        let refused = |key: &Path| Acceptor::open(Purpose::Dimse, &certificate, key).err().unwrap().to_string();
        let absent = refused(&key);
        assert!(absent.contains(certificate.to_str().unwrap()) && absent.contains("--dimse-tls-cert"), "{absent}");
        let made = rcgen::generate_simple_self_signed(["pacs.example".to_owned()]).unwrap();
        std::fs::write(&certificate, made.cert.pem()).unwrap();
        std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
        std::fs::write(&other, rcgen::KeyPair::generate().unwrap().serialize_pem()).unwrap();
        assert!(refused(&folder.join("absent.pem")).contains("absent.pem"));
        assert!(refused(&other).contains("other.pem"));
        let acceptor = Acceptor::open(Purpose::Http, &certificate, &key).unwrap();
        acceptor.reload().unwrap();
        let first = acceptor.current.read().unwrap().clone();
        std::fs::write(&certificate, "no certificate").unwrap();
        let broken = acceptor.reload().unwrap_err().to_string();
        assert!(broken.contains("cert.pem: it holds no certificate") && broken.contains("with --tls-key"), "{broken}");
        assert!(Arc::ptr_eq(acceptor.current.read().unwrap().config(), first.config()));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
