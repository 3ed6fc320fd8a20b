//! How a receiver knows that a callback is this service's and new: HMAC-SHA256 over time and body, in the form that Stripe made common.

use hmac::{Hmac, KeyInit as _, Mac as _, digest::InvalidLength};
use sha2::Sha256;

/// Signs with the secret shared with the receivers.
#[derive(Clone)]
pub struct Signer {
    keyed: Hmac<Sha256>,
}

impl std::fmt::Debug for Signer {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Signer(…)")
    }
}

impl Signer {
    /// A signer with this secret, of any length.
    pub fn new(secret: &str) -> Result<Self, InvalidLength> {
        Ok(Self { keyed: Hmac::new_from_slice(secret.as_bytes())? })
    }

    /// The value of `Ventricle-Signature`: `t=<unix seconds>,v1=<HMAC of "<t>.<body>" in hexadecimal>`.
    pub(super) fn sign(&self, unix_s: u64, body: &[u8]) -> String {
        let mut keyed = self.keyed.clone();
        keyed.update(format!("{unix_s}.").as_bytes());
        keyed.update(body);
        format!("t={unix_s},v1={}", hex::encode(keyed.finalize().into_bytes()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Python: `hmac.new(b"whsec_test_secret_of_the_tests", b'1700000000.{"id":"x"}', "sha256").hexdigest()`.
    #[test]
    fn a_signature_is_what_another_implementation_makes() {
        let signer = Signer::new("whsec_test_secret_of_the_tests").unwrap();
        let expected = "t=1700000000,v1=844ab337c1775040f7a13562b108edb6e897c22e9de7450782db3a914f80f28f";
        assert_eq!(signer.sign(1_700_000_000, br#"{"id":"x"}"#), expected);
        assert_ne!(signer.sign(1_700_000_001, br#"{"id":"x"}"#)[13..], expected[13..]);
        assert_eq!(format!("{signer:?}"), "Signer(…)");
    }
}
