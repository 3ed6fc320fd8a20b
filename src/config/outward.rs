//! Settings of what is told and sent to others: callbacks, and results.

use super::{ConfigError, Secret, secret::secret};
use clap::Args;
use std::path::PathBuf;

/// Fewest characters of a secret: 16 random letters and digits are 95 bits, beyond guessing.
pub(super) const LEAST_SECRET: usize = 16;

/// What is told and sent to others.
#[derive(Debug, Clone, Args)]
pub struct OutwardSettings {
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
}

impl OutwardSettings {
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ServeSettings;

    fn settings(flags: &[&str]) -> OutwardSettings {
        ServeSettings::from_flags(flags.iter().copied()).unwrap().outward
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
}
