//! Which traces are told: those whose parent is, jobs whose request was, and of the others a part.

use opentelemetry::{
    Context, KeyValue,
    trace::{Link, SpanKind, TraceId, TraceState},
};
use opentelemetry_sdk::trace::{Sampler, SamplingDecision, SamplingResult, ShouldSample};

/// The sampler of a service that tells this part (0 to 1) of the traces that begin in it.
pub(super) fn sampler(ratio: f64) -> Sampler {
    Sampler::ParentBased(Box::new(AsLinked(Sampler::TraceIdRatioBased(ratio))))
}

/// Decides as was decided for what a span is linked to, so that a job is told with its request; else by the sampler inside.
#[derive(Debug, Clone)]
struct AsLinked(Sampler);

impl ShouldSample for AsLinked {
    fn should_sample(
        &self,
        parent: Option<&Context>,
        trace: TraceId,
        name: &str,
        kind: &SpanKind,
        attributes: &[KeyValue],
        links: &[Link],
    ) -> SamplingResult {
        let Some(link) = links.first() else { return self.0.should_sample(parent, trace, name, kind, attributes, links) };
        let decision = if link.span_context.is_sampled() { SamplingDecision::RecordAndSample } else { SamplingDecision::Drop };
        SamplingResult { decision, attributes: Vec::new(), trace_state: TraceState::NONE }
    }
}
