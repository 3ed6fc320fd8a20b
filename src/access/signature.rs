//! How tokens' signatures are verified: by ring, which TLS uses too. The two libraries that `jsonwebtoken` offers would be a second and a third
//! implementation of the same.

use jsonwebtoken::{
    Algorithm, AlgorithmFamily, DecodingKey, DecodingKeyKind,
    crypto::{CryptoProvider, JwtVerifier, KeyUtils},
    errors::{ErrorKind, Result},
};
use ring::signature::{self as verification, RsaParameters, RsaPublicKeyComponents, UnparsedPublicKey, VerificationAlgorithm};
use signature::{Error, Verifier};
use std::sync::Once;

/// The algorithms that are accepted: signatures by public keys. No secret is shared with a provider, and nothing goes unsigned.
pub(super) const ALGORITHMS: [Algorithm; 9] = [
    Algorithm::RS256,
    Algorithm::RS384,
    Algorithm::RS512,
    Algorithm::PS256,
    Algorithm::PS384,
    Algorithm::PS512,
    Algorithm::ES256,
    Algorithm::ES384,
    Algorithm::EdDSA,
];

static PROVIDER: CryptoProvider = CryptoProvider {
    // Nothing is signed here.
    signer_factory: |_, _| Err(ErrorKind::UnsupportedAlgorithm.into()),
    verifier_factory: |algorithm, key| Ok(Box::new(ByRing { algorithm: *algorithm, key: key.clone(), by: by(*algorithm, key.family())? })),
    key_utils: KeyUtils::new_unimplemented(),
};

/// Tells `jsonwebtoken` of ring, once a process.
pub(super) fn install() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        // Fails only where one is installed.
        let _ = PROVIDER.install_default();
    });
}

/// One verification.
struct ByRing {
    algorithm: Algorithm,
    key: DecodingKey,
    by: By,
}

enum By {
    Rsa(&'static RsaParameters),
    Curve(&'static dyn VerificationAlgorithm),
}

/// RSA keys of less than 2048 bits are refused by ring.
fn by(algorithm: Algorithm, family: AlgorithmFamily) -> Result<By> {
    let by = match algorithm {
        Algorithm::RS256 => By::Rsa(&verification::RSA_PKCS1_2048_8192_SHA256),
        Algorithm::RS384 => By::Rsa(&verification::RSA_PKCS1_2048_8192_SHA384),
        Algorithm::RS512 => By::Rsa(&verification::RSA_PKCS1_2048_8192_SHA512),
        Algorithm::PS256 => By::Rsa(&verification::RSA_PSS_2048_8192_SHA256),
        Algorithm::PS384 => By::Rsa(&verification::RSA_PSS_2048_8192_SHA384),
        Algorithm::PS512 => By::Rsa(&verification::RSA_PSS_2048_8192_SHA512),
        Algorithm::ES256 => By::Curve(&verification::ECDSA_P256_SHA256_FIXED),
        Algorithm::ES384 => By::Curve(&verification::ECDSA_P384_SHA384_FIXED),
        Algorithm::EdDSA => By::Curve(&verification::ED25519),
        _ => return Err(ErrorKind::UnsupportedAlgorithm.into()),
    };
    if family.algorithms().contains(&algorithm) { Ok(by) } else { Err(ErrorKind::InvalidKeyFormat.into()) }
}

impl Verifier<Vec<u8>> for ByRing {
    fn verify(&self, message: &[u8], signature: &Vec<u8>) -> std::result::Result<(), Error> {
        let verified = match (&self.by, self.key.kind()) {
            (By::Rsa(parameters), DecodingKeyKind::RsaModulusExponent { n, e }) => {
                RsaPublicKeyComponents { n, e }.verify(parameters, message, signature)
            }
            (By::Rsa(parameters), DecodingKeyKind::SecretOrDer(key)) => UnparsedPublicKey::new(*parameters, key).verify(message, signature),
            (By::Curve(algorithm), DecodingKeyKind::SecretOrDer(key)) => UnparsedPublicKey::new(*algorithm, key).verify(message, signature),
            (By::Curve(_), DecodingKeyKind::RsaModulusExponent { .. }) => return Err(Error::new()),
        };
        verified.map_err(|_| Error::new())
    }
}

impl JwtVerifier for ByRing {
    fn algorithm(&self) -> Algorithm {
        self.algorithm
    }
}
