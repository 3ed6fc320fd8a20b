//! What the jobs and their store tell the metrics. Labels are names in this program, so that no study and no client can add a series.

use super::{
    error::{StoreError, SubmitError},
    job::State,
    progress::{Progress, RESULTS},
};
use crate::pipeline::parameters::Preset;
use serde::Deserialize;
use std::time::Instant;

/// What the store is asked for, as far as its time is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Operation {
    /// A worker asks for a job.
    Claim,
    /// A worker renews its lease.
    Heartbeat,
    /// A job is accepted.
    Submit,
    /// A job ends, with its results.
    Finish,
    /// A job, a list of jobs or stored data are read.
    Read,
}

impl Operation {
    fn name(self) -> &'static str {
        match self {
            Self::Claim => "claim",
            Self::Heartbeat => "heartbeat",
            Self::Submit => "submit",
            Self::Finish => "finish",
            Self::Read => "read",
        }
    }
}

/// Errors that may be a failure of the store, or an answer of it.
pub(super) trait MayBeFailure {
    /// Whether the store failed.
    fn is_failure(&self) -> bool;
}

impl MayBeFailure for StoreError {
    fn is_failure(&self) -> bool {
        true
    }
}

impl MayBeFailure for SubmitError {
    fn is_failure(&self) -> bool {
        matches!(self, Self::Store(_))
    }
}

/// Measures what the store does, and counts it where it fails.
pub(super) async fn timed<T, E: MayBeFailure>(operation: Operation, work: impl Future<Output = Result<T, E>>) -> Result<T, E> {
    let began = Instant::now();
    let result = work.await;
    metrics::histogram!("ventricle_store_duration_seconds", "operation" => operation.name()).record(began.elapsed().as_secs_f64());
    if result.as_ref().is_err_and(MayBeFailure::is_failure) {
        metrics::counter!("ventricle_store_failures_total", "operation" => operation.name()).increment(1);
    }
    result
}

/// Counts a job that reached a final state.
pub(super) fn finished(state: State) {
    metrics::counter!("ventricle_jobs_finished_total", "state" => state.name()).increment(1);
}

/// Counts a job that failed, by the code that its problem has.
pub(super) fn failed(code: &str) {
    finished(State::Failed);
    metrics::counter!("ventricle_jobs_failed_total", "code" => code.to_owned()).increment(1);
}

/// Records how long the last attempt at a job took.
pub(super) fn took(state: State, parameters: &str, duration_s: f64) {
    let labels = [("state", state.name()), ("preset", preset(parameters))];
    metrics::histogram!("ventricle_job_duration_seconds", &labels).record(duration_s);
}

/// The preset in the stored parameters of a job.
pub(super) fn preset(parameters: &str) -> &'static str {
    #[derive(Deserialize)]
    struct Chosen {
        preset: Preset,
    }
    serde_json::from_str(parameters).map_or("unknown", |chosen: Chosen| chosen.preset.name())
}

/// Records how long each stage of a reconstruction took, and with them what came after them.
pub(super) fn stages_took(progress: &Progress, preset: Preset, results_s: f64) {
    let stages = progress.stages_ms();
    let stages = stages.iter().map(|(stage, ms)| (stage.clone(), ms / 1e3));
    for (stage, seconds) in stages.chain([(RESULTS.to_owned(), results_s)]) {
        metrics::histogram!("ventricle_job_stage_duration_seconds", "stage" => stage, "preset" => preset.name()).record(seconds);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::parameters::Parameters;

    #[test]
    fn the_preset_is_that_of_the_stored_parameters() {
        for parameters in [Parameters::clinical(), Parameters::paper()] {
            assert_eq!(preset(&serde_json::to_string(&parameters).unwrap()), parameters.preset.name());
        }
        for stored in ["{}", "", "{\"preset\":\"DOE^JANE\"}"] {
            assert_eq!(preset(stored), "unknown");
        }
    }

    #[test]
    fn a_full_queue_is_an_answer_not_a_failure() {
        assert!(!SubmitError::KeyReused.is_failure() && !SubmitError::QueueFull(super::super::QueueFull { retry_after_s: 1 }).is_failure());
        assert!(SubmitError::Store(StoreError::Interrupted).is_failure() && StoreError::Interrupted.is_failure());
    }
}
