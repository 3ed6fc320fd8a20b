//! Traces: what a request and a job took, step by step, told to a collector by OTLP over HTTP. Off unless the operator names a collector.
//!
//! A span holds what [`Attribute`] has a place for and nothing else: no text that a client, a file or a patient could have written. Nothing of the
//! log becomes part of a trace, and what libraries below tell of themselves does not either. The environment variables of OpenTelemetry's own
//! programs (`OTEL_…`) change nothing.
//!
//! | file | what it is |
//! |---|---|
//! | `attribute.rs` | what may be said of a span |
//! | `span.rs` | a span under way, and the one that what runs now belongs to |
//! | `parent.rs` | the span that a request says it belongs to (W3C Trace Context) |
//! | `sampling.rs` | which traces are told |
//! | `origins.rs` | which span submitted which job |
//! | `export.rs` | the queue of spans that have ended, and who sends them |

mod attribute;
mod export;
mod origins;
mod parent;
mod sampling;
mod span;

pub use attribute::{Attribute, ERROR_CODE, Method};
pub use export::{Deliver, MEDIA_TYPE};
pub use origins::{Origin, Origins};
pub use parent::parent;
pub use span::{Span, current};

use export::{Export, Queue};
use opentelemetry::{
    InstrumentationScope, KeyValue,
    trace::{SpanKind, TracerProvider as _},
};
use opentelemetry_sdk::{
    Resource,
    trace::{SdkTracer, SdkTracerProvider, SpanLimits},
};
use std::{sync::Arc, time::Duration};
use uuid::Uuid;

/// Name of the service, and of what makes its spans.
const NAME: &str = "ventricle";

/// What begins spans. Clones are cheap, and belong together. By default there is no collector, and no span either.
#[derive(Debug, Clone, Default)]
pub struct Traces(Option<Arc<Running>>);

#[derive(Debug)]
struct Running {
    tracer: SdkTracer,
    scheme: &'static str,
    export: Export,
}

/// What is told of the service with every batch of spans.
#[derive(Debug, Clone)]
pub struct Service {
    /// Name of this node.
    pub node: String,
    /// By which scheme it is reached: `http` or `https`.
    pub scheme: &'static str,
}

/// A request as its span has it.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Its method.
    pub method: Method,
    /// The route that it took, as it is written in this program; none if there is no such route.
    pub route: Option<&'a str>,
    /// The span that it says it belongs to.
    pub parent: Option<Origin>,
}

/// An attempt at a job as its span has it.
#[derive(Debug, Clone, Copy)]
pub struct Attempt {
    /// The job.
    pub job: Uuid,
    /// Which attempt it is.
    pub number: i64,
    /// The preset it is reconstructed by.
    pub preset: &'static str,
    /// From its acceptance to this attempt.
    pub waited: Duration,
    /// The span of the request that submitted it, where this process knows it.
    pub origin: Option<Origin>,
}

impl Traces {
    /// Tells spans to a collector from here on: of traces that begin here this part (0 to 1), of others what whoever began them decided. To be
    /// called on a runtime, on which they are sent.
    pub fn start(service: &Service, sample_ratio: f64, deliver: Deliver) -> Self {
        let resource = Resource::builder_empty().with_service_name(NAME).with_attributes([
            KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
            KeyValue::new("service.instance.id", service.node.clone()),
        ]);
        let resource = resource.build();
        let (queue, export) = Queue::start(&resource, deliver);
        // All that the environment could choose is chosen here.
        let provider = SdkTracerProvider::builder()
            .with_resource(resource)
            .with_sampler(sampling::sampler(sample_ratio))
            .with_span_limits(SpanLimits::default())
            .with_span_processor(queue)
            .build();
        let scope = InstrumentationScope::builder(NAME).with_version(env!("CARGO_PKG_VERSION")).build();
        Self(Some(Arc::new(Running { tracer: provider.tracer_with_scope(scope), scheme: service.scheme, export })))
    }

    /// The span of a request.
    pub fn request(&self, request: Request<'_>) -> Span {
        let Some(running) = &self.0 else { return Span::default() };
        let name = match (request.method.known(), request.route) {
            (Some(method), Some(route)) => format!("{method} {route}"),
            (Some(method), None) => method.to_owned(),
            (None, Some(route)) => format!("HTTP {route}"),
            (None, None) => "HTTP".to_owned(),
        };
        let builder = running.builder(name, SpanKind::Server);
        let attributes = [Attribute::RequestMethod(request.method), Attribute::UrlScheme(running.scheme)];
        let route = request.route.map(|route| Attribute::HttpRoute(route.to_owned()));
        let attributes = attributes.into_iter().chain(route).map(KeyValue::from);
        Span::begin(&running.tracer, builder.with_attributes(attributes), request.parent)
    }

    /// The span of an attempt at a job: a trace of its own, linked to the request, which has long been answered.
    pub fn job(&self, attempt: Attempt) -> Span {
        let Some(running) = &self.0 else { return Span::default() };
        let attributes = [
            Attribute::JobId(attempt.job),
            Attribute::JobAttempt(attempt.number),
            Attribute::JobPreset(attempt.preset),
            Attribute::JobWait(attempt.waited),
        ];
        let builder = running.builder("job", SpanKind::Consumer).with_attributes(attributes.map(KeyValue::from));
        let links = attempt.origin.map(Origin::link);
        Span::begin(&running.tracer, builder.with_links(links.into_iter().collect()), None)
    }

    /// Sends what has ended, within this time, and nothing after it.
    pub async fn stop(&self, within: Duration) {
        if let Some(running) = &self.0 {
            running.export.stop(within).await;
        }
    }
}

impl Running {
    fn builder(&self, name: impl Into<std::borrow::Cow<'static, str>>, kind: SpanKind) -> opentelemetry::trace::SpanBuilder {
        use opentelemetry::trace::Tracer as _;
        self.tracer.span_builder(name).with_kind(kind)
    }
}
