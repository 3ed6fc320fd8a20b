//! Certificate and key of the listener (PS3.15 B.12: TLS below the protocol, no client certificates).

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        ServerConfig,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
    },
};

/// Why the listener cannot be encrypted with what is given.
#[derive(Debug, thiserror::Error)]
#[error(
    "The DICOM listener cannot use {}: {why}. Name the PEM file of its certificate and of the authorities between with --dimse-tls-cert, and \
     the PEM file of its key, without a password, with --dimse-tls-key.",
    path.display()
)]
pub struct TlsError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub why: String,
}

/// What accepts TLS connections with the certificates and the key of these PEM files.
pub fn acceptor(certificates: &Path, key: &Path) -> Result<TlsAcceptor, TlsError> {
    let error = |path: &Path, why: String| TlsError { path: path.to_owned(), why };
    let chain = CertificateDer::pem_file_iter(certificates)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|why| error(certificates, why.to_string()))?;
    if chain.is_empty() {
        return Err(error(certificates, "it holds no certificate".to_owned()));
    }
    let key_file = key;
    let key = PrivateKeyDer::from_pem_file(key_file).map_err(|why| error(key_file, why.to_string()))?;
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
        .map_err(|why| error(key_file, why.to_string()))?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_do_not_fit_are_refused_by_name() {
        let folder = std::env::temp_dir().join(format!("ventricle-dimse-tls-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir_all(&folder).unwrap();
        let (certificate, key, other) = (folder.join("cert.pem"), folder.join("key.pem"), folder.join("other.pem"));
        let refused = |key: &Path| acceptor(&certificate, key).err().unwrap().to_string();
        assert!(refused(&key).contains(certificate.to_str().unwrap()));
        let made = rcgen::generate_simple_self_signed(["pacs.example".to_owned()]).unwrap();
        std::fs::write(&certificate, made.cert.pem()).unwrap();
        std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
        std::fs::write(&other, rcgen::KeyPair::generate().unwrap().serialize_pem()).unwrap();
        assert!(acceptor(&certificate, &key).is_ok());
        assert!(refused(&folder.join("absent.pem")).contains("absent.pem"));
        assert!(refused(&other).contains("other.pem"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
