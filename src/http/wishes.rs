//! What a request asks of its job: how it is computed, how long it and its input are kept, who is told of its end.

use super::{AppState, problem::Problem};
use crate::{
    access::Caller,
    callbacks,
    jobs::NewJob,
    parameters::{self, ParameterError},
    pipeline::{parameters::Parameters, pose, region},
    study::Study,
    subject::Subject,
};
use serde_json::Value;
use std::{sync::Arc, time::Duration};

/// What this service grants.
pub(super) struct Rules {
    longest_retention_s: u64,
    /// `None`: there are no callbacks.
    callbacks: Option<Arc<callbacks::Rules>>,
}

impl Rules {
    pub(super) fn of(state: &AppState) -> Self {
        Self { longest_retention_s: state.longest_retention.as_secs(), callbacks: state.callbacks.clone() }
    }
}

/// What was asked for and is granted.
pub(super) struct Wishes {
    parameters: Parameters,
    retention: Option<Duration>,
    callback_url: Option<String>,
    /// `None`: nothing was said.
    pub keep_input: Option<bool>,
}

impl Wishes {
    /// Reads parameters for a job on a study.
    ///
    /// Errors: parameters that are unknown, out of range or not to be had here, and marks outside of the study.
    pub(super) fn read(written: &Value, rules: &Rules, study: &Study) -> Result<Self, Problem> {
        let mut request = parameters::parse_for_job(written, rules.longest_retention_s)?;
        let retention = request.retention_seconds.map(Duration::from_secs);
        let keep_input = request.keep_input;
        let callback_url = callback_url(request.callback_url.take(), rules.callbacks.as_deref())?;
        let parameters = parameters::resolve(request)?;
        region::check_marks(&study.grid, &parameters.region)?;
        pose::check_marks(&study.grid, &parameters.pose)?;
        Ok(Self { parameters, retention, callback_url, keep_input })
    }

    /// The job.
    pub(super) fn job(
        self,
        caller: &Caller,
        study: Study,
        subject: Option<Subject>,
        idempotency_key: Option<String>,
        request_hash: [u8; 32],
    ) -> NewJob {
        let Self { parameters, retention, callback_url, keep_input } = self;
        let (owner, most_queued) = (caller.owner.clone(), caller.queued_jobs());
        NewJob { owner, most_queued, idempotency_key, request_hash, study, subject, parameters, retention, callback_url, keep_input }
    }
}

/// Who is told of the job's end: the URL asked for, if it may be called, else the operator's.
fn callback_url(requested: Option<String>, callbacks: Option<&callbacks::Rules>) -> Result<Option<String>, ParameterError> {
    let refused = |code, detail: String| ParameterError::one(code, "/callback_url", detail);
    match (callbacks, requested) {
        (None, None) => Ok(None),
        (None, Some(_)) => {
            let detail = "`callback_url` is not available: this service has no secret to sign callbacks with. Leave it out, or ask the operator \
                          to set --callback-secret-file.";
            Err(refused("unavailable_parameter", detail.to_owned()))
        }
        (Some(rules), requested) => rules.url(requested).map_err(|error| refused("invalid_parameter", format!("`callback_url` {error}"))),
    }
}
