//! What traces are told of an attempt at a job: its span, which of its steps took how long, and what it came to.

use super::{lease::Claim, numbers::preset, progress::Progress, store::Store};
use crate::traces::{Attempt, Attribute, Span, Traces, current};
use std::time::SystemTime;

/// What an attempt came to where that is no state of the job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Without {
    /// Another worker has the job, or had it.
    Lease,
    /// The service stops: another attempt will be made, as if this one had not been.
    Time,
    /// The database did not take what it came to: another attempt will be made when the lease is over.
    Store,
}

impl Without {
    fn name(self) -> &'static str {
        match self {
            Self::Lease => "lost",
            Self::Time => "given_back",
            Self::Store => "not_stored",
        }
    }
}

/// The span of an attempt.
pub(super) fn span(traces: &Traces, store: &Store, claim: &Claim) -> Span {
    traces.job(Attempt {
        job: claim.id,
        number: claim.attempt,
        preset: preset(&claim.parameters),
        waited: claim.waited,
        origin: store.inner.origins.of(claim.id),
    })
}

/// A step of the attempt that runs now, under way.
pub(super) struct Step {
    name: &'static str,
    began: SystemTime,
}

impl Step {
    /// Begins now.
    pub(super) fn begin(name: &'static str) -> Self {
        Self { name, began: SystemTime::now() }
    }

    /// Ends now.
    pub(super) fn end(self) {
        current().part(self.name, self.began, SystemTime::now(), []);
    }
}

/// Tells the stages of the attempt that runs now, as far as they have come to an end.
pub(super) fn stages(progress: &Progress) {
    let span = current();
    for stage in progress.stages() {
        let attributes = [Attribute::StageRuns(stage.runs), Attribute::StageBusy(stage.busy)];
        span.part(stage.name, stage.began, stage.ended, attributes);
    }
}

/// Tells what the attempt that runs now came to: a state of the job, and the code of its problem if it has one.
pub(super) fn ended(state: &'static str, code: Option<String>) {
    let span = current();
    span.set(Attribute::JobOutcome(state));
    if let Some(code) = code {
        span.failed(code);
    }
}

/// Tells that the attempt that runs now came to nothing.
pub(super) fn ended_without(what: Without) {
    current().set(Attribute::JobOutcome(what.name()));
}
