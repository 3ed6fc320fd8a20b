//! API keys: how they are made and what is kept of them.
//!
//! A key is `ventricle_`, twelve hexadecimal digits that name it, `_` and 32 random bytes as base64 (URL alphabet). Of these bytes SHA-256 is
//! kept: they are random, so that nobody can go through them, and a slow hash would only make every request slow.

use base64::{Engine as _, engine::general_purpose::URL_SAFE_NO_PAD};
use ring::rand::{SecureRandom as _, SystemRandom};
use sha2::{Digest as _, Sha256};

/// What every key begins with: recognisable to people and to programs that look for secrets in sources.
const PREFIX: &str = "ventricle_";
/// Random bytes of a key's name.
const ID_BYTES: usize = 6;
/// Random bytes of its secret.
const SECRET_BYTES: usize = 32;

/// A new key. Its text is shown once and kept nowhere.
pub struct Made {
    /// Names the key.
    pub id: String,
    /// The key.
    pub text: String,
    /// What is kept.
    pub sha256: String,
}

impl Made {
    /// From the system's random numbers.
    ///
    /// # Errors
    /// The system has none.
    pub fn new() -> Result<Self, ring::error::Unspecified> {
        let random = SystemRandom::new();
        let (mut id, mut secret) = ([0; ID_BYTES], [0; SECRET_BYTES]);
        random.fill(&mut id)?;
        random.fill(&mut secret)?;
        let id = hex::encode(id);
        let secret = URL_SAFE_NO_PAD.encode(secret);
        Ok(Self { text: format!("{PREFIX}{id}_{secret}"), sha256: digest(&secret), id })
    }
}

/// Whether a text is meant as a key.
pub(super) fn is_key(text: &str) -> bool {
    text.starts_with(PREFIX)
}

/// The name in a key and the digest of its secret; `None` if the text is no key.
pub(super) fn taken_apart(text: &str) -> Option<(&str, String)> {
    let (id, secret) = text.strip_prefix(PREFIX)?.split_once('_')?;
    Some((id, digest(secret)))
}

fn digest(secret: &str) -> String {
    hex::encode(Sha256::digest(secret.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_names_itself_and_only_its_digest_is_kept() {
        let made = Made::new().unwrap();
        assert!(is_key(&made.text));
        let (id, digest) = taken_apart(&made.text).unwrap();
        assert_eq!((id, &digest), (made.id.as_str(), &made.sha256));
        assert_eq!(made.text.len(), PREFIX.len() + 12 + 1 + 43);
        assert!(!made.text.contains(&made.sha256));
        assert_ne!(Made::new().unwrap().text, made.text);
        assert_eq!(taken_apart("ventricle_x"), None);
    }
}
