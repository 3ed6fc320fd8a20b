//! A span under way, and the one that what runs now belongs to.

use super::{attribute::Attribute, origins::Origin};
use opentelemetry::{
    Context, KeyValue,
    trace::{SpanBuilder, SpanContext, Status, TraceContextExt as _, Tracer as _},
};
use opentelemetry_sdk::trace::SdkTracer;
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::SystemTime,
};
use tokio::task::futures::TaskLocalFuture;
use uuid::Uuid;

tokio::task_local! {
    /// The span that the task works for.
    static CURRENT: Span;
}

/// The span that what runs now belongs to; none outside of [`Span::scope`], and in tasks that were begun inside of it.
pub fn current() -> Span {
    CURRENT.try_with(Span::clone).unwrap_or_default()
}

/// A span, or none where there is no collector. Clones are the same span, which ends with the last of them if not before.
#[derive(Debug, Clone, Default)]
pub struct Span(Option<Begun>);

#[derive(Debug, Clone)]
struct Begun {
    context: Context,
    tracer: SdkTracer,
    /// Whether it has said which job it made.
    named_a_job: Arc<AtomicBool>,
}

impl Span {
    pub(super) fn begin(tracer: &SdkTracer, builder: SpanBuilder, parent: Option<Origin>) -> Self {
        let context = parent.map_or_else(Context::new, |parent| Context::new().with_remote_span_context(parent.into()));
        let context = context.with_span(tracer.build_with_context(builder, &context));
        Self(Some(Begun { context, tracer: tracer.clone(), named_a_job: Arc::default() }))
    }

    /// Runs a future as part of this span.
    pub fn scope<F: Future>(&self, future: F) -> TaskLocalFuture<Self, F> {
        CURRENT.scope(self.clone(), future)
    }

    /// The id of its trace, where it is one that is told.
    pub fn trace_id(&self) -> Option<String> {
        self.context().filter(SpanContext::is_sampled).map(|context| context.trace_id().to_string())
    }

    /// How others refer to it, whether it is told or not.
    pub fn origin(&self) -> Option<Origin> {
        self.context().and_then(|context| Origin::of(&context))
    }

    fn context(&self) -> Option<SpanContext> {
        self.0.as_ref().map(|begun| begun.context.span().span_context().clone())
    }

    /// Says something of it.
    pub fn set(&self, attribute: Attribute) {
        if let Some(begun) = &self.0 {
            begun.context.span().set_attribute(attribute.into());
        }
    }

    /// Says that a job was accepted within it. The first one is an attribute too, as most requests make one.
    pub fn accepted(&self, job: Uuid) {
        let Some(begun) = &self.0 else { return };
        begun.context.span().add_event("job accepted", vec![Attribute::JobId(job).into()]);
        if !begun.named_a_job.swap(true, Ordering::Relaxed) {
            self.set(Attribute::JobId(job));
        }
    }

    /// Says by which status it was answered, and ends it.
    pub fn answered(&self, status: u16) {
        self.set(Attribute::ResponseStatus(status));
        if status >= 500 {
            self.failed(status.to_string());
        }
        self.end();
    }

    /// Says that it failed, and by which code.
    pub fn failed(&self, code: String) {
        let Some(begun) = &self.0 else { return };
        begun.context.span().set_attribute(Attribute::ErrorCode(code).into());
        // Without a description: that would be text.
        begun.context.span().set_status(Status::error(""));
    }

    /// A part of it that is over.
    pub fn part(&self, name: &'static str, began: SystemTime, ended: SystemTime, attributes: impl IntoIterator<Item = Attribute>) {
        use opentelemetry::trace::Span as _;
        let Some(begun) = &self.0 else { return };
        let builder = begun.tracer.span_builder(name).with_start_time(began).with_attributes(attributes.into_iter().map(KeyValue::from));
        // A clock that was set back meanwhile would make it end before it began.
        begun.tracer.build_with_context(builder, &begun.context).end_with_timestamp(ended.max(began));
    }

    /// Ends it now. What is said of it later is not told.
    pub fn end(&self) {
        if let Some(begun) = &self.0 {
            begun.context.span().end();
        }
    }
}
