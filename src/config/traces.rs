//! Settings of traces: whether they are told, to whom, and how many of them.

use super::{ConfigError, Secret, secret::secret};
use clap::Args;
use std::path::PathBuf;

/// Headers that are the transport's own.
const NOT_TO_SET: [&str; 7] =
    ["connection", "content-encoding", "content-length", "content-type", "host", "transfer-encoding", "user-agent"];

/// Where traces go.
#[derive(Debug, Clone, Args)]
pub struct TraceSettings {
    /// Collector that is told traces by OTLP over HTTP, without `/v1/traces`: `http://127.0.0.1:4318`. None by default.
    #[arg(long, env = "VENTRICLE_OTLP_ENDPOINT", value_parser = endpoint)]
    pub otlp_endpoint: Option<String>,

    /// Headers that traces are sent with, separated by commas, as `Authorization=Bearer …,X-Team=7`. Better in the environment or in a file than
    /// on the command line.
    #[arg(long, env = "VENTRICLE_OTLP_HEADERS", hide_env_values = true)]
    pub otlp_headers: Option<Secret>,

    /// File that holds those headers, white space at its ends left out.
    #[arg(long, env = "VENTRICLE_OTLP_HEADERS_FILE")]
    pub otlp_headers_file: Option<PathBuf>,

    /// Part of the traces that is told, from 0 to 1, of those that begin here; a request that names its parent is told if its parent is.
    #[arg(long, env = "VENTRICLE_OTLP_SAMPLE_RATIO", default_value = "1", value_parser = ratio)]
    pub otlp_sample_ratio: f64,
}

impl TraceSettings {
    /// The URL that traces are posted to, if they are.
    pub fn url(&self) -> Option<String> {
        self.otlp_endpoint.as_ref().map(|endpoint| format!("{}/v1/traces", endpoint.trim_end_matches('/')))
    }

    /// The headers that they are posted with, by name.
    pub fn headers(&self) -> Result<Vec<(String, String)>, ConfigError> {
        let Some(given) = secret("otlp-headers", self.otlp_headers.as_ref(), self.otlp_headers_file.as_ref())? else {
            return Ok(Vec::new());
        };
        given.expose().split(',').map(|header| named(header).ok_or(ConfigError::OtlpHeaders)).collect()
    }
}

/// A header written as `name=value`, if it is one that may be set.
fn named(header: &str) -> Option<(String, String)> {
    let (name, value) = header.split_once('=')?;
    let (name, value) = (name.trim(), value.trim());
    let in_name = |byte: u8| byte.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&byte);
    let is_name = !name.is_empty() && name.bytes().all(in_name) && !NOT_TO_SET.iter().any(|own| name.eq_ignore_ascii_case(own));
    let is_value = !value.is_empty() && value.bytes().all(|byte| (b' '..=b'~').contains(&byte));
    (is_name && is_value).then(|| (name.to_owned(), value.to_owned()))
}

/// A URL that `/v1/traces` can stand after.
fn endpoint(text: &str) -> Result<String, String> {
    let host = text.strip_prefix("https://").or(text.strip_prefix("http://"));
    if host.is_some_and(|host| !host.is_empty() && !host.starts_with('/') && !host.contains(['?', '#', '@', ' '])) {
        return Ok(text.to_owned());
    }
    Err("a collector is named as http://host:4318 or https://host/path, without user, query and fragment.".to_owned())
}

/// A part of a whole.
fn ratio(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(ratio) if (0.0..=1.0).contains(&ratio) => Ok(ratio),
        _ => Err("the part is a number from 0 to 1.".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::{super::ServeSettings, *};

    fn settings(flags: &[&str]) -> TraceSettings {
        ServeSettings::from_flags(flags.iter().copied()).unwrap().traces
    }

    #[test]
    fn nothing_is_told_by_default() {
        assert_eq!((settings(&[]).url(), settings(&[]).headers()), (None, Ok(vec![])));
    }

    #[test]
    fn a_collector_is_a_url_that_the_path_can_stand_after() {
        for (given, url) in [
            ("http://127.0.0.1:4318", "http://127.0.0.1:4318/v1/traces"),
            ("https://collector.example/otlp/", "https://collector.example/otlp/v1/traces"),
        ] {
            assert_eq!(settings(&["--otlp-endpoint", given]).url().as_deref(), Some(url));
        }
        for wrong in ["127.0.0.1:4318", "grpc://a.example:4317", "http://", "http:///v1", "http://a.example/?key=1", "http://u:p@a.example"]
        {
            assert!(ServeSettings::from_flags(["--otlp-endpoint", wrong]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn headers_are_not_shown_and_not_guessed() {
        let given = settings(&["--otlp-headers", "Authorization=Basic a2V5OnRleHQ=, x-team = 7"]);
        let expected = [("Authorization", "Basic a2V5OnRleHQ="), ("x-team", "7")].map(|(name, value)| (name.to_owned(), value.to_owned()));
        assert_eq!(given.headers(), Ok(expected.to_vec()));
        assert!(!format!("{given:?}").contains("a2V5"));
        for wrong in ["", "Authorization", "=value", "name=", "a b=c", "a=b,", "Host=a.example", "content-length=1", "a=b\r\nc: d"] {
            assert_eq!(settings(&["--otlp-headers", wrong]).headers(), Err(ConfigError::OtlpHeaders), "{wrong:?}");
        }
        let twice = settings(&["--otlp-headers", "a=b", "--otlp-headers-file", "x"]).headers();
        assert_eq!(twice, Err(ConfigError::SecretTwice { flag: "otlp-headers" }));
    }

    #[test]
    fn a_part_is_at_most_the_whole() {
        assert_eq!(settings(&["--otlp-sample-ratio", "0.25"]).otlp_sample_ratio.to_string(), "0.25");
        for wrong in ["-0.1", "1.1", "NaN", "half"] {
            assert!(ServeSettings::from_flags([format!("--otlp-sample-ratio={wrong}").as_str()]).is_err(), "{wrong}");
        }
    }
}
