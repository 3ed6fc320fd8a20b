//! The queue of spans that have ended, and who sends them: a task of its own, a batch at a time, each once. A collector that is slow or away costs the
//! spans that find no room meanwhile and nothing else: who ends a span never waits.

use opentelemetry::Context;
use opentelemetry_proto::{
    tonic::collector::trace::v1::ExportTraceServiceRequest,
    transform::{common::tonic::ResourceAttributesWithSchema, trace::tonic::group_spans_by_resource_and_scope},
};
use opentelemetry_sdk::{
    Resource,
    error::OTelSdkResult,
    trace::{Span as SdkSpan, SpanData, SpanProcessor},
};
use prost::Message as _;
use std::{
    fmt,
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use tokio::{
    sync::mpsc::{self, Receiver, Sender},
    task::JoinHandle,
    time::{sleep, timeout},
};
use tokio_util::sync::CancellationToken;

/// Most spans that wait: some 4 MB.
const MOST_WAITING: usize = 4096;
/// Most spans that are sent at once.
const MOST_AT_ONCE: usize = 512;
/// How long the first span of a batch waits for others.
const PAUSE: Duration = Duration::from_secs(2);
/// Time in which a batch must be answered.
const ANSWER_TIME: Duration = Duration::from_secs(10);

/// Media type of what is sent.
pub const MEDIA_TYPE: &str = "application/x-protobuf";

/// Sends one request to the collector, or says why not, without its URL and the headers.
#[derive(Clone)]
pub struct Deliver(Arc<dyn Fn(Vec<u8>) -> Delivering + Send + Sync>);

type Delivering = Pin<Box<dyn Future<Output = Result<(), String>> + Send>>;

impl Deliver {
    /// By this function.
    pub fn new(deliver: impl Fn(Vec<u8>) -> Delivering + Send + Sync + 'static) -> Self {
        Self(Arc::new(deliver))
    }
}

/// What became of spans.
#[derive(Debug, Clone, Copy)]
enum Became {
    /// The collector has taken them.
    Sent,
    /// It refused them, or did not answer.
    Failed,
    /// There was no room for them.
    Dropped,
}

fn count(became: Became, spans: usize) {
    let outcome = match became {
        Became::Sent => "sent",
        Became::Failed => "failed",
        Became::Dropped => "dropped",
    };
    metrics::counter!("ventricle_trace_spans_total", "outcome" => outcome).increment(spans as u64);
}

/// Where spans go when they end.
#[derive(Debug)]
pub(super) struct Queue(Sender<SpanData>);

impl Queue {
    /// A queue, and who sends what is in it on the current runtime, until nobody has the queue any more or it is stopped.
    pub(super) fn start(resource: &Resource, deliver: Deliver) -> (Self, Export) {
        for became in [Became::Sent, Became::Failed, Became::Dropped] {
            count(became, 0);
        }
        let (sender, waiting) = mpsc::channel(MOST_WAITING);
        let stopping = CancellationToken::new();
        let task = Task { waiting, deliver, resource: resource.into(), stopping: stopping.clone(), failing: false };
        let task = Mutex::new(Some(tokio::spawn(task.run())));
        (Self(sender), Export { stopping, task })
    }
}

impl SpanProcessor for Queue {
    fn on_start(&self, _: &mut SdkSpan, _: &Context) {}

    fn on_end(&self, span: SpanData) {
        if self.0.try_send(span).is_err() {
            count(Became::Dropped, 1);
        }
    }

    fn force_flush(&self) -> OTelSdkResult {
        Ok(())
    }

    fn shutdown_with_timeout(&self, _: Duration) -> OTelSdkResult {
        Ok(())
    }
}

/// The task that sends.
#[derive(Debug)]
pub(super) struct Export {
    stopping: CancellationToken,
    task: Mutex<Option<JoinHandle<()>>>,
}

impl Export {
    /// Sends what waits, within this time, and nothing after it.
    pub(super) async fn stop(&self, within: Duration) {
        self.stopping.cancel();
        let task = self.task.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(mut task) = task else { return };
        if timeout(within, &mut task).await.is_err() {
            task.abort();
            tracing::warn!("the collector of traces did not take the last spans in time");
        }
    }
}

struct Task {
    waiting: Receiver<SpanData>,
    deliver: Deliver,
    resource: ResourceAttributesWithSchema,
    stopping: CancellationToken,
    /// Whether the last batch was not taken.
    failing: bool,
}

impl Task {
    async fn run(mut self) {
        loop {
            let mut batch = Vec::new();
            let stopping = self.stopping.clone();
            tokio::select! {
                taken = self.waiting.recv_many(&mut batch, MOST_AT_ONCE) => if taken == 0 { return },
                () = stopping.cancelled() => break,
            }
            if batch.len() < MOST_AT_ONCE {
                tokio::select! {
                    () = sleep(PAUSE) => {}
                    () = stopping.cancelled() => {}
                }
            }
            self.fill(&mut batch);
            self.send(batch).await;
        }
        loop {
            let mut batch = Vec::new();
            self.fill(&mut batch);
            if batch.is_empty() {
                return;
            }
            self.send(batch).await;
        }
    }

    /// Adds what waits, as far as it may go at once.
    fn fill(&mut self, batch: &mut Vec<SpanData>) {
        while batch.len() < MOST_AT_ONCE
            && let Ok(span) = self.waiting.try_recv()
        {
            batch.push(span);
        }
    }

    async fn send(&mut self, batch: Vec<SpanData>) {
        let spans = batch.len();
        let resource_spans = group_spans_by_resource_and_scope(batch, &self.resource);
        let body = ExportTraceServiceRequest { resource_spans }.encode_to_vec();
        let late = || Err(format!("it did not answer within {} s", ANSWER_TIME.as_secs()));
        let answer = timeout(ANSWER_TIME, (self.deliver.0)(body)).await.unwrap_or_else(|_| late());
        match answer {
            Ok(()) => {
                count(Became::Sent, spans);
                if std::mem::take(&mut self.failing) {
                    tracing::info!("the collector takes traces again");
                }
            }
            Err(why) => {
                count(Became::Failed, spans);
                // Once, however long it lasts: the metric tells the rest.
                if !std::mem::replace(&mut self.failing, true) {
                    tracing::warn!(why, "the collector does not take traces; they are dropped until it does");
                }
            }
        }
    }
}

impl fmt::Debug for Deliver {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Deliver(…)")
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::{Attempt, Method, Request, Service, Span, Traces, current, parent},
        *,
    };
    use uuid::Uuid;

    /// What was delivered: the names of its spans, a list for each request.
    type Delivered = Arc<Mutex<Vec<Vec<String>>>>;

    fn traces(ratio: f64, answer: impl Fn() -> Result<(), String> + Send + Sync + 'static) -> (Traces, Delivered) {
        let delivered = Delivered::default();
        let seen = Arc::clone(&delivered);
        let answer = Arc::new(answer);
        let deliver = Deliver::new(move |body| {
            let request = ExportTraceServiceRequest::decode(body.as_slice()).unwrap();
            let spans = request.resource_spans.into_iter().flat_map(|of| of.scope_spans).flat_map(|of| of.spans);
            seen.lock().unwrap().push(spans.map(|span| span.name).collect());
            let answer = answer();
            Box::pin(async move { answer })
        });
        let service = Service { node: "here".to_owned(), scheme: "http" };
        (Traces::start(&service, ratio, deliver), delivered)
    }

    fn request() -> Request<'static> {
        Request { method: Method::named("GET"), route: Some("/{id}"), parent: None }
    }

    #[tokio::test]
    async fn what_has_ended_is_sent_at_the_stop_in_batches() {
        let (traces, delivered) = traces(1.0, || Ok(()));
        for _ in 0..MOST_AT_ONCE + 3 {
            traces.request(request()).answered(200);
        }
        let open = traces.request(request());
        traces.stop(Duration::from_mins(1)).await;
        let sizes: Vec<usize> = delivered.lock().unwrap().iter().map(Vec::len).collect();
        assert_eq!(sizes.iter().sum::<usize>(), MOST_AT_ONCE + 3, "{sizes:?}");
        assert!(sizes.iter().all(|spans| *spans <= MOST_AT_ONCE), "{sizes:?}");
        // Too late, and no harm.
        open.answered(500);
        traces.stop(Duration::ZERO).await;
        assert_eq!(delivered.lock().unwrap().iter().flatten().find(|name| *name != "GET /{id}"), None);
    }

    #[tokio::test]
    async fn what_finds_no_room_is_dropped_without_waiting() {
        let (traces, delivered) = traces(1.0, || Err("no".to_owned()));
        // One task alone runs here: nothing is taken out meanwhile.
        for _ in 0..MOST_WAITING + 100 {
            traces.request(request()).answered(200);
        }
        traces.stop(Duration::from_mins(1)).await;
        assert_eq!(delivered.lock().unwrap().iter().map(Vec::len).sum::<usize>(), MOST_WAITING);
    }

    #[tokio::test]
    async fn a_collector_that_never_answers_holds_nobody() {
        let service = Service { node: "here".to_owned(), scheme: "http" };
        let traces = Traces::start(&service, 1.0, Deliver::new(|_| Box::pin(std::future::pending())));
        traces.request(request()).answered(200);
        timeout(ANSWER_TIME, traces.stop(Duration::from_millis(50))).await.unwrap();
    }

    #[tokio::test]
    async fn a_job_is_told_with_its_request_and_so_are_their_parts() {
        let (never, delivered) = traces(0.0, || Ok(()));
        let sampled = parent([b"00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01".as_slice()]);
        for (parent, told) in [(None, false), (sampled, true)] {
            let span = never.request(Request { parent, ..request() });
            assert_eq!(span.trace_id().is_some(), told);
            let attempt = Attempt { job: Uuid::nil(), number: 1, preset: "paper", waited: Duration::ZERO, origin: span.origin() };
            span.answered(202);
            let job = never.job(attempt);
            assert_eq!(job.trace_id().is_some(), told);
            assert_ne!(job.trace_id(), span.trace_id().or(Some(String::new())), "a trace of its own");
            let now = std::time::SystemTime::now();
            job.part("rays", now, now, []);
        }
        never.stop(Duration::from_mins(1)).await;
        assert_eq!(*delivered.lock().unwrap().concat(), ["GET /{id}", "rays", "job"]);
    }

    #[tokio::test]
    async fn what_runs_now_belongs_to_the_span_it_runs_in() {
        let (traces, _) = traces(1.0, || Ok(()));
        assert_eq!(current().trace_id(), None);
        let span = traces.request(request());
        assert!(span.trace_id().is_some());
        let (inside, begun) =
            span.scope(async { (current().trace_id(), tokio::spawn(async { current().trace_id() }).await.unwrap()) }).await;
        assert_eq!((inside, begun), (span.trace_id(), None));
        assert_eq!(Span::default().scope(async { current().trace_id() }).await, None);
    }
}
