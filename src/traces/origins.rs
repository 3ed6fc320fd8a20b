//! Which span submitted which job. Known to the process that took the submission, for as long as not too many others came after it: nothing rests on it.

use opentelemetry::trace::{Link, SpanContext, SpanId, TraceFlags, TraceId, TraceState};
use std::{
    collections::{HashMap, VecDeque},
    sync::{Mutex, PoisonError},
};
use uuid::Uuid;

/// Most jobs that are known at once, of which each takes some hundred bytes.
const MOST: usize = 4096;

/// A span as others refer to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Origin {
    trace: TraceId,
    span: SpanId,
    flags: TraceFlags,
    remote: bool,
}

impl Origin {
    pub(super) fn of(context: &SpanContext) -> Option<Self> {
        let (trace, span, flags, remote) = (context.trace_id(), context.span_id(), context.trace_flags(), context.is_remote());
        context.is_valid().then_some(Self { trace, span, flags, remote })
    }

    pub(super) fn link(self) -> Link {
        Link::with_context(self.into())
    }
}

impl From<Origin> for SpanContext {
    fn from(origin: Origin) -> Self {
        Self::new(origin.trace, origin.span, origin.flags, origin.remote, TraceState::NONE)
    }
}

/// The spans that submitted the latest jobs.
#[derive(Debug, Default)]
pub struct Origins(Mutex<Known>);

#[derive(Debug, Default)]
struct Known {
    origins: HashMap<Uuid, Origin>,
    oldest_first: VecDeque<Uuid>,
}

impl Origins {
    /// Remembers which span submitted a job.
    pub fn remember(&self, job: Uuid, origin: Origin) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if known.origins.insert(job, origin).is_none() {
            known.oldest_first.push_back(job);
        }
        while known.oldest_first.len() > MOST {
            if let Some(oldest) = known.oldest_first.pop_front() {
                known.origins.remove(&oldest);
            }
        }
    }

    /// The span that submitted a job, if it is known still.
    pub fn of(&self, job: Uuid) -> Option<Origin> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).origins.get(&job).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_are_known_and_no_more() {
        let context = SpanContext::new(TraceId::from(7), SpanId::from(8), TraceFlags::SAMPLED, false, TraceState::NONE);
        let origin = Origin::of(&context).unwrap();
        let (origins, jobs) = (Origins::default(), (0..MOST as u128 + 2).map(Uuid::from_u128).collect::<Vec<_>>());
        for job in &jobs {
            origins.remember(*job, origin);
            origins.remember(*job, origin);
        }
        assert_eq!((origins.of(jobs[1]), origins.of(jobs[2])), (None, Some(origin)));
        assert_eq!(origins.0.lock().unwrap().origins.len(), MOST);
        assert_eq!(SpanContext::from(origin), context);
        assert_eq!(Origin::of(&SpanContext::NONE), None);
    }
}
