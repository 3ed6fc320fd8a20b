//! A collector of traces on loopback, which takes what it is sent, or does not, and keeps it.

use opentelemetry_proto::tonic::{
    collector::trace::v1::ExportTraceServiceRequest,
    common::v1::{AnyValue, KeyValue, any_value},
    trace::v1::{ResourceSpans, Span},
};
use prost::Message as _;
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

/// What it does with what it is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Manner {
    /// It answers 200.
    Takes,
    /// It answers 503.
    Refuses,
    /// It reads, and never answers.
    Hangs,
}

/// One request, as it came.
#[derive(Debug, Clone)]
pub(crate) struct Received {
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

/// A collector that is there until the process ends.
pub(crate) struct Collector {
    pub(crate) url: String,
    received: Arc<Mutex<Vec<Received>>>,
}

impl Collector {
    pub(crate) fn start(manner: Manner) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let received = Arc::<Mutex<Vec<Received>>>::default();
        let kept = Arc::clone(&received);
        thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let kept = Arc::clone(&kept);
                thread::spawn(move || take(&stream, manner, &kept));
            }
        });
        Self { url, received }
    }

    /// What has come so far.
    pub(crate) fn received(&self) -> Vec<Received> {
        self.received.lock().unwrap().clone()
    }

    /// What it was sent, batch by batch.
    pub(crate) fn batches(&self) -> Vec<ResourceSpans> {
        let requests = self.received().into_iter().map(|request| ExportTraceServiceRequest::decode(request.body.as_slice()).unwrap());
        requests.flat_map(|request| request.resource_spans).collect()
    }

    /// The spans that have come so far.
    pub(crate) fn spans(&self) -> Vec<Span> {
        self.batches().into_iter().flat_map(|batch| batch.scope_spans).flat_map(|scope| scope.spans).collect()
    }

    /// Waits for something to come.
    pub(crate) fn wait_for(&self, what: impl Fn(&Self) -> bool) {
        let began = Instant::now();
        while !what(self) {
            assert!(began.elapsed() < Duration::from_mins(1), "{:#?}", self.spans());
            thread::sleep(Duration::from_millis(20));
        }
    }
}

fn take(stream: &TcpStream, manner: Manner, kept: &Mutex<Vec<Received>>) {
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        if reader.read_line(&mut head).unwrap_or(0) == 0 {
            return;
        }
    }
    let length = head.lines().find_map(|line| line.to_lowercase().strip_prefix("content-length: ")?.parse().ok()).unwrap();
    let mut body = vec![0; length];
    if reader.read_exact(&mut body).is_err() {
        return;
    }
    kept.lock().unwrap().push(Received { head, body });
    let answer = match manner {
        Manner::Takes => "HTTP/1.1 200 OK\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
        Manner::Refuses => "HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
        Manner::Hangs => {
            // Until the other side gives up.
            let _ = reader.read(&mut [0]);
            return;
        }
    };
    let _ = (&mut &*stream).write_all(answer.as_bytes());
}

/// Attributes as JSON.
pub(crate) fn attributes(pairs: &[KeyValue]) -> BTreeMap<String, Value> {
    let value = |value: &Option<AnyValue>| match value.as_ref().and_then(|value| value.value.as_ref()).unwrap() {
        any_value::Value::StringValue(text) => json!(text),
        any_value::Value::IntValue(number) => json!(number),
        any_value::Value::DoubleValue(number) => json!(number),
        other => panic!("{other:?}"),
    };
    let attributes: BTreeMap<_, _> = pairs.iter().map(|pair| (pair.key.clone(), value(&pair.value))).collect();
    assert_eq!(attributes.len(), pairs.len(), "an attribute is there twice: {pairs:?}");
    attributes
}
