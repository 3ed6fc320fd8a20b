//! Logs to standard error and numbers for Prometheus. Neither ever holds anything that names a patient: what is logged of a request is
//! its method, matched path, status, duration and id.

pub mod process;
mod zeros;

use crate::config::{ConfigError, LogFormat};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::{io::IsTerminal, sync::OnceLock};
use tracing_subscriber::EnvFilter;

/// Upper bounds in s of the buckets of every duration: from a cached report to the longest reconstruction.
const SECONDS: [f64; 14] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 30.0, 120.0];

/// The commit that a release was built from, `unknown` of other builds; the compiler's version; `release` or `debug`.
const BUILT: [(&str, &str); 4] =
    [("version", env!("CARGO_PKG_VERSION")), ("commit", env!("BUILT_COMMIT")), ("rustc", env!("BUILT_BY")), ("profile", env!("BUILT_AS"))];

/// Starts logging, once a process; later calls change nothing.
///
/// # Errors
/// When `directives` (a level, or `info,ventricle::jobs=debug`) cannot be read.
pub fn init(format: LogFormat, directives: &str) -> Result<(), ConfigError> {
    let filter = EnvFilter::try_new(directives)
        .map_err(|why| ConfigError::LogDirectives { directives: directives.to_owned(), why: why.to_string() })?;
    // A log that cannot be written (its disk is full) ends no request: by default the failure is printed, which fails likewise and panics.
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).log_internal_errors(false);
    // A second call finds a subscriber in place and leaves it there.
    let _already_logging = match format {
        LogFormat::Text => builder.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => builder.json().flatten_event(true).with_current_span(true).with_span_list(false).try_init(),
    };
    Ok(())
}

/// The process's recorder of metrics, installed at the first call.
pub fn metrics() -> PrometheusHandle {
    static HANDLE: OnceLock<PrometheusHandle> = OnceLock::new();
    HANDLE
        .get_or_init(|| {
            let builder = PrometheusBuilder::new();
            // The only error is an empty list of buckets; without buckets a histogram becomes a summary, which still is right.
            let builder = builder.set_buckets_for_metric(Matcher::Suffix("_seconds".into()), &SECONDS).unwrap_or_default();
            let recorder = builder.build_recorder();
            let handle = recorder.handle();
            if metrics::set_global_recorder(recorder).is_err() {
                tracing::warn!("another recorder of metrics is installed: /metrics stays empty");
            }
            metrics::gauge!("ventricle_build_info", &BUILT).set(1.0);
            zeros::begin();
            handle
        })
        .clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unreadable_directives_are_refused_by_name() {
        let error = init(LogFormat::Text, "ventricle=loud").unwrap_err();
        assert!(error.to_string().contains("ventricle=loud"), "{error}");
    }

    #[test]
    fn durations_are_histograms_with_buckets() {
        let handle = metrics();
        metrics::histogram!("ventricle_test_duration_seconds").record(0.02);
        assert!(handle.render().contains("ventricle_test_duration_seconds_bucket{le=\"0.025\"} 1"), "{}", handle.render());
    }
}
