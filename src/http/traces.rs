//! Traces of the running service: to whom they are told, and the span of a request.

use super::{layers, service::ServeError};
use crate::{
    callbacks::{Allowed, Sender, Target},
    config::ServeSettings,
    traces::{Deliver, MEDIA_TYPE, Method, Request, Service, Span, Traces, parent},
};
use axum::{
    extract::MatchedPath,
    http::{HeaderName, HeaderValue},
};
use std::sync::Arc;

const TRACEPARENT: HeaderName = HeaderName::from_static("traceparent");

/// Begins to tell traces, if these settings name a collector. The operator names it: it may be in the hospital's own network, and is what is
/// connected to whatever it answers.
pub(super) fn start(settings: &ServeSettings) -> Result<Traces, ServeError> {
    let Some(url) = settings.traces.url() else { return Ok(Traces::default()) };
    let headers: Arc<[(String, String)]> = settings.traces.headers()?.into();
    let allowed = Allowed::parse(settings.outward.callback_allow.iter().map(String::as_str))?.with_hosts_of([url.as_str()]);
    let target = Target::parse(&url, &allowed).map_err(ServeError::OtlpEndpoint)?;
    let allowed = Arc::new(allowed);
    let sender = if target.secure() { Sender::new(allowed, &settings.outward.callback_ca_file)? } else { Sender::without_tls(allowed) };
    let url: Arc<str> = url.into();
    let deliver = Deliver::new(move |body| {
        let (sender, url, headers) = (sender.clone(), Arc::clone(&url), Arc::clone(&headers));
        Box::pin(async move { sender.deliver(&url, MEDIA_TYPE, &headers, body).await })
    });
    let scheme = if settings.transport.tls().is_some() { "https" } else { "http" };
    let service = Service { node: settings.node_name(), scheme };
    Ok(Traces::start(&service, settings.traces.otlp_sample_ratio, deliver))
}

/// The span of a request; none of one that only looks whether the service is well.
pub(super) fn span(traces: &Traces, request: &axum::extract::Request) -> Span {
    let route = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    if route.is_some_and(layers::is_look) {
        return Span::default();
    }
    let parent = parent(request.headers().get_all(TRACEPARENT).iter().map(HeaderValue::as_bytes));
    traces.request(Request { method: Method::named(request.method().as_str()), route, parent })
}
