//! Settings that nothing shows, given as they are or in a file.

use super::ConfigError;
use std::path::PathBuf;

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

/// A secret given as it is or in a file, not both.
pub(super) fn secret(flag: &'static str, given: Option<&Secret>, file: Option<&PathBuf>) -> Result<Option<Secret>, ConfigError> {
    match (given, file) {
        (Some(_), Some(_)) => Err(ConfigError::SecretTwice { flag }),
        (given, None) => Ok(given.cloned()),
        (None, Some(path)) => {
            let unreadable = |error: std::io::Error| ConfigError::SecretFile { flag, path: path.clone(), why: error.to_string() };
            Ok(Some(Secret(std::fs::read_to_string(path).map_err(unreadable)?.trim().to_owned())))
        }
    }
}
