//! Traces as a collector gets them: of requests, of jobs and their stages; whose parent is whose; and what a collector that is no good costs.

use crate::{
    collector::{Collector, Manner, attributes},
    observed::{phantom_of_noise, small},
    served::{Answer, Directory, Served, answer},
};
use opentelemetry_proto::tonic::trace::v1::{Span, span::SpanKind, status::StatusCode};
use serde_json::{Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};
use ventricle::traces::Attribute;

const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
const PARENT: &str = "b7ad6b7169203331";
/// Longer than anything here should take, and shorter than for ever.
const LONG: Duration = Duration::from_mins(2);

fn parent(sampled: bool) -> String {
    format!("00-{TRACE}-{PARENT}-0{}", u8::from(sampled))
}

/// The service with its log in a file, and with what OpenTelemetry's own programs would read from the environment.
fn service(data: &Path, log: &Path, flags: &[&str]) -> Served {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ventricle"));
    command
        .args(["serve", "--listen", "127.0.0.1:0", "--log", "info", "--log-format", "json", "--node", "the-node", "--data-dir"])
        .arg(data);
    command.env("OTEL_RESOURCE_ATTRIBUTES", "from=outside").env("OTEL_SERVICE_NAME", "outside").env("OTEL_TRACES_SAMPLER", "always_off");
    command.env("OTEL_SPAN_ATTRIBUTE_COUNT_LIMIT", "1").env("OTEL_EXPORTER_OTLP_HEADERS", "from=outside");
    command.stderr(fs::File::create(log).unwrap());
    Served::start_by(command, flags)
}

fn agent() -> ureq::Agent {
    let config = ureq::Agent::config_builder().http_status_as_error(false).allow_non_standard_methods(true);
    config.timeout_global(Some(Duration::from_mins(1))).build().new_agent()
}

fn submit(service: &Served, media_type: &str, body: &[u8], traceparent: Option<&str>) -> Answer {
    let request = agent().post(format!("{}/v1/reconstructions", service.url)).header("content-type", media_type);
    let request = match traceparent {
        Some(traceparent) => request.header("traceparent", traceparent).header("tracestate", "vendor=text"),
        None => request,
    };
    answer(request.send(body).unwrap())
}

/// Stops the service, which sends what it has.
fn stop(service: Served) {
    service.signal("TERM");
    assert!(service.ended(LONG).success());
}

fn named<'a>(spans: &'a [Span], name: &str) -> Vec<&'a Span> {
    spans.iter().filter(|span| span.name == name).collect()
}

fn said(span: &Span) -> BTreeMap<String, Value> {
    attributes(&span.attributes)
}

fn is_error(span: &Span) -> bool {
    let status = span.status.clone().unwrap_or_default();
    assert_eq!(status.message, "", "a description would be text");
    status.code() == StatusCode::Error
}

#[test]
fn a_request_its_job_and_the_stages_are_told_to_the_collector() {
    let (data, collector) = (Directory::new("traces"), Collector::start(Manner::Takes));
    let log = data.0.join("log");
    let headers = data.0.join("headers");
    fs::write(&headers, "Authorization=Bearer abc, X-Team=7\n").unwrap();
    let service =
        service(&data.0, &log, &["--otlp-endpoint", &format!("{}/", collector.url), "--otlp-headers-file", headers.to_str().unwrap()]);
    let id = submit(&service, "application/dicom", &small(), Some(&parent(true))).json()["id"].as_str().unwrap().to_owned();
    let finished = service.finished(&id, LONG);
    assert_eq!(finished["state"], "succeeded", "{finished}");
    let noise = submit(&service, "application/json", phantom_of_noise().to_string().as_bytes(), Some("not a parent")).json();
    let noise = service.finished(noise["id"].as_str().unwrap(), LONG);
    let code = noise["error"]["code"].as_str().unwrap();
    for path in ["/nowhere/at/all", "/healthz", "/readyz", "/metrics"] {
        service.get(path);
    }
    let invented = ureq::http::Request::builder().method("INVENTED").uri(format!("{}/v1/reconstructions/{id}", service.url));
    drop(agent().run(invented.body(()).unwrap()).unwrap());
    stop(service);

    for request in collector.received() {
        let head = request.head.to_lowercase();
        assert!(head.starts_with("post /v1/traces http/1.1\r\n"), "{head}");
        for line in ["content-type: application/x-protobuf", "authorization: bearer abc", "x-team: 7"] {
            assert!(head.lines().any(|header| header == line), "{line} is not in {head}");
        }
        assert!(!head.contains("outside"), "{head}");
    }
    for batch in collector.batches() {
        let resource = attributes(&batch.resource.unwrap().attributes);
        let version = env!("CARGO_PKG_VERSION");
        let expected = [("service.name", "ventricle"), ("service.version", version), ("service.instance.id", "the-node")];
        assert_eq!(resource, expected.map(|(name, value)| (name.to_owned(), json!(value))).into());
        assert!(batch.scope_spans.iter().all(|scope| scope.scope.as_ref().is_some_and(|scope| scope.name == "ventricle")));
    }
    let spans = collector.spans();
    sound(&spans);
    requests(&spans, &id);
    job(&spans, &id);

    // The one in which there was no ventricle.
    let failed = *named(&spans, "job").iter().find(|span| said(span)["ventricle.job.id"] == noise["id"]).unwrap();
    assert!(is_error(failed));
    assert_eq!((&said(failed)["ventricle.job.outcome"], &said(failed)["error.type"]), (&json!("failed"), &json!(code)));
    assert!(spans.iter().any(|span| span.name == "localisation" && span.parent_span_id == failed.span_id));

    // The log names the traces.
    let lines: Vec<Value> = fs::read_to_string(&log).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let trace_of =
        |message: &str| lines.iter().find(|line| line["message"] == message).map(|line| line["span"]["trace_id"].clone()).unwrap();
    assert_eq!(trace_of("job accepted"), TRACE);
    let job = *named(&spans, "job").iter().find(|span| said(span)["ventricle.job.id"] == *id).unwrap();
    assert_eq!(trace_of("job finished"), hex::encode(&job.trace_id));
}

/// What is true of every span.
fn sound(spans: &[Span]) {
    let ids: BTreeSet<_> = spans.iter().map(|span| &span.span_id).collect();
    assert_eq!(ids.len(), spans.len(), "each has an id of its own");
    for span in spans {
        assert!(span.trace_id.len() == 16 && span.span_id.len() == 8 && matches!(span.parent_span_id.len(), 0 | 8), "{span:?}");
        assert!(span.trace_id.iter().any(|byte| *byte > 0) && span.span_id.iter().any(|byte| *byte > 0), "{span:?}");
        assert!(span.start_time_unix_nano > 0 && span.start_time_unix_nano <= span.end_time_unix_nano, "{span:?}");
        assert_eq!(span.trace_state, "");
        let events = span.events.iter().flat_map(|event| attributes(&event.attributes));
        let unknown: Vec<_> = said(span).into_iter().chain(events).filter(|(name, _)| !Attribute::NAMES.contains(&name.as_str())).collect();
        assert!(unknown.is_empty(), "{}: {unknown:?}", span.name);
    }
}

fn requests(spans: &[Span], id: &str) {
    let [submitted, noise] = named(spans, "POST /v1/reconstructions").try_into().unwrap();
    assert_eq!((hex::encode(&submitted.trace_id), hex::encode(&submitted.parent_span_id)), (TRACE.to_owned(), PARENT.to_owned()));
    assert!(submitted.kind() == SpanKind::Server && !is_error(submitted));
    let expected = [
        ("http.request.method", json!("POST")),
        ("http.route", json!("/v1/reconstructions")),
        ("http.response.status_code", json!(202)),
        ("url.scheme", json!("http")),
        ("ventricle.job.id", json!(id)),
    ];
    assert_eq!(said(submitted), expected.map(|(name, value)| (name.to_owned(), value)).into());
    assert_eq!(submitted.events.iter().map(|event| event.name.as_str()).collect::<Vec<_>>(), ["job accepted"]);
    assert!(hex::encode(&noise.trace_id) != TRACE && noise.parent_span_id.is_empty(), "what is no parent is none");

    let looks = named(spans, "GET /v1/reconstructions/{id}");
    assert!(looks.len() >= 2 && looks.iter().all(|span| said(span)["http.response.status_code"] == 200), "{looks:?}");
    let [nowhere] = named(spans, "GET").try_into().unwrap();
    assert_eq!((said(nowhere).get("http.route"), &said(nowhere)["http.response.status_code"]), (None, &json!(404)));
    assert!(!is_error(nowhere), "the client's fault is no error of the server");
    let [invented] = named(spans, "HTTP /v1/reconstructions/{id}").try_into().unwrap();
    assert_eq!(said(invented)["http.request.method"], "_OTHER");
    assert!(!spans.iter().any(|span| ["healthz", "readyz", "metrics"].iter().any(|look| span.name.contains(look))));
}

fn job(spans: &[Span], id: &str) {
    let [submitted, _] = named(spans, "POST /v1/reconstructions").try_into().unwrap();
    let job = *named(spans, "job").iter().find(|span| said(span)["ventricle.job.id"] == *id).unwrap();
    assert!(job.kind() == SpanKind::Consumer && job.parent_span_id.is_empty() && job.trace_id != submitted.trace_id && !is_error(job));
    let [link] = job.links.as_slice() else { panic!("{job:?}") };
    assert_eq!((&link.trace_id, &link.span_id), (&submitted.trace_id, &submitted.span_id));
    let mut told = said(job);
    assert!(told.remove("ventricle.job.wait_s").unwrap().as_f64().unwrap() >= 0.0);
    let expected = [
        ("ventricle.job.id", json!(id)),
        ("ventricle.job.attempt", json!(1)),
        ("ventricle.job.preset", json!("clinical")),
        ("ventricle.job.outcome", json!("succeeded")),
    ];
    assert_eq!(told, expected.map(|(name, value)| (name.to_owned(), value)).into());

    let mut parts: Vec<&Span> = spans.iter().filter(|span| span.parent_span_id == job.span_id).collect();
    parts.sort_by_key(|span| span.start_time_unix_nano);
    let names: Vec<&str> = parts.iter().map(|span| span.name.as_str()).collect();
    assert_eq!(names, ["input", "localisation", "rays", "model_fit", "wall", "results", "storing"]);
    for part in &parts {
        assert_eq!(part.trace_id, job.trace_id);
        // Stages are reckoned from the beginning by a clock that is not the calendar's.
        let slack = 1_000_000;
        assert!(part.start_time_unix_nano + slack >= job.start_time_unix_nano, "{part:?} {job:?}");
        assert!(part.end_time_unix_nano <= job.end_time_unix_nano + slack, "{part:?} {job:?}");
    }
    for stage in &parts[1..6] {
        let told = said(stage);
        assert!(told["ventricle.stage.runs"].as_i64().unwrap() >= 1 && told["ventricle.stage.busy_s"].as_f64().unwrap() > 0.0, "{told:?}");
    }
    let ends: Vec<u64> = ["localisation", "results", "storing"].map(|name| named_in(&parts, name).end_time_unix_nano).to_vec();
    assert!(ends.is_sorted(), "{ends:?}");
}

fn named_in<'a>(spans: &[&'a Span], name: &str) -> &'a Span {
    spans.iter().find(|span| span.name == name).unwrap()
}

#[test]
fn a_part_is_told_and_whoever_names_a_parent_decides() {
    let (data, collector) = (Directory::new("sampled"), Collector::start(Manner::Takes));
    let service = service(&data.0, &data.0.join("log"), &["--otlp-endpoint", &collector.url, "--otlp-sample-ratio", "0"]);
    let (study, told, untold) = (small(), parent(true), parent(false));
    let submitted = [Some(&told), Some(&untold), None].map(|parent| {
        let job = submit(&service, "application/dicom", &study, parent.map(String::as_str)).json();
        let id = job["id"].as_str().unwrap().to_owned();
        assert_eq!(service.finished(&id, LONG)["state"], "succeeded");
        id
    });
    stop(service);
    let spans = collector.spans();
    sound(&spans);
    let [request] = named(&spans, "POST /v1/reconstructions").try_into().unwrap();
    assert_eq!(hex::encode(&request.trace_id), TRACE);
    let [job] = named(&spans, "job").try_into().unwrap();
    assert_eq!(said(job)["ventricle.job.id"], submitted[0], "the job of the request that is told, and no other");
    assert!(spans.iter().all(|span| span.trace_id == request.trace_id || span.trace_id == job.trace_id));
}

#[test]
fn an_attempt_that_is_given_back_and_one_that_is_cancelled_are_told_as_what_they_are() {
    let (data, collector) = (Directory::new("attempts"), Collector::start(Manner::Takes));
    let start = || service(&data.0, &data.0.join("log"), &["--otlp-endpoint", &collector.url, "--drain-seconds", "0"]);
    let deforming = |service: &Served, id: &str| {
        let began = Instant::now();
        while service.get(&format!("/v1/reconstructions/{id}")).json()["progress"]["stage"] != "deformation" {
            assert!(began.elapsed() < LONG, "it never deforms");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    // Minutes of work: it does not end by itself.
    let parameters = "preset=paper&mesh.level=4&deform.model=plane&deform.max_steps=20000&deform.time_step_s=0.001";
    let first = start();
    let id = first.post_with(parameters, "application/dicom", &small()).json()["id"].as_str().unwrap().to_owned();
    deforming(&first, &id);
    stop(first);
    let second = start();
    deforming(&second, &id);
    assert_eq!(second.delete(&format!("/v1/reconstructions/{id}")).status, 202);
    assert_eq!(second.finished(&id, LONG)["state"], "cancelled");
    stop(second);

    let spans = collector.spans();
    sound(&spans);
    let [given_back, cancelled] = named(&spans, "job").try_into().unwrap();
    for (span, attempt, outcome, links) in [(given_back, 1, "given_back", 1), (cancelled, 2, "cancelled", 0)] {
        let told = said(span);
        assert_eq!((&told["ventricle.job.id"], &told["ventricle.job.preset"]), (&json!(id), &json!("paper")));
        assert_eq!((&told["ventricle.job.attempt"], &told["ventricle.job.outcome"]), (&json!(attempt), &json!(outcome)));
        // Which request submitted it, the process that took it in knows, and no other.
        assert_eq!((span.links.len(), is_error(span)), (links, false));
        assert!(spans.iter().any(|part| part.name == "region" && part.parent_span_id == span.span_id), "{outcome}");
        assert!(!spans.iter().any(|part| part.name == "results" && part.parent_span_id == span.span_id), "{outcome}");
    }
}

/// A service whose collector is no good does its work, counts what was not taken, and ends in time.
fn bears(endpoint: &str, counted: bool) {
    let data = Directory::new("bears");
    let log = data.0.join("log");
    let service = service(&data.0, &log, &["--otlp-endpoint", endpoint]);
    let id = submit(&service, "application/dicom", &small(), None).json()["id"].as_str().unwrap().to_owned();
    assert_eq!(service.finished(&id, LONG)["state"], "succeeded");
    let began = Instant::now();
    let failed = || service.metric("ventricle_trace_spans_total{outcome=\"failed\"}");
    while counted && failed() < 1.0 {
        assert!(began.elapsed() < LONG, "nothing is counted");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(service.get("/readyz").status, 200);
    let began = Instant::now();
    stop(service);
    // The last spans have 3 s, and nothing else is to be done.
    assert!(began.elapsed() < Duration::from_secs(30), "{:?}", began.elapsed());
    let lines = fs::read_to_string(&log).unwrap();
    let told = lines.lines().filter(|line| line.contains("the collector does not take traces")).count();
    assert_eq!(told, usize::from(counted), "{lines}");
    assert!(!lines.contains(endpoint.trim_start_matches("http://")), "the log does not name the collector: {lines}");
}

#[test]
fn a_collector_that_refuses_costs_spans_alone() {
    let collector = Collector::start(Manner::Refuses);
    bears(&collector.url, true);
    assert!(!collector.received().is_empty());
}

#[test]
fn a_collector_that_never_answers_holds_neither_the_service_nor_its_end() {
    let collector = Collector::start(Manner::Hangs);
    bears(&collector.url, false);
    assert!(!collector.received().is_empty());
}

#[test]
fn a_collector_that_is_not_there_costs_spans_alone() {
    let gone = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    bears(&format!("http://{gone}"), true);
}

#[test]
fn without_the_setting_nothing_is_sent() {
    let (data, collector) = (Directory::new("untraced"), Collector::start(Manner::Takes));
    let log = data.0.join("log");
    let mut command = Command::new(env!("CARGO_BIN_EXE_ventricle"));
    command.args(["serve", "--listen", "127.0.0.1:0", "--log-format", "json", "--data-dir"]).arg(&data.0);
    command.env("OTEL_EXPORTER_OTLP_ENDPOINT", &collector.url).stderr(fs::File::create(&log).unwrap());
    let service = Served::start_by(command, &[]);
    let id = submit(&service, "application/dicom", &small(), Some(&parent(true))).json()["id"].as_str().unwrap().to_owned();
    assert_eq!(service.finished(&id, LONG)["state"], "succeeded");
    assert!(!String::from_utf8(service.get("/metrics").body).unwrap().contains("ventricle_trace_spans_total"));
    stop(service);
    assert!(collector.received().is_empty(), "{:?}", collector.spans());
    assert!(!fs::read_to_string(&log).unwrap().contains("trace_id"));
}

#[test]
fn a_collector_that_may_not_be_called_is_refused_at_the_start() {
    let data = Directory::new("no-collector");
    for (flags, reason) in [
        (["--otlp-endpoint", "collector:4318"], "a collector is named as"),
        (["--otlp-endpoint", "http://127.0.0.1:0"], "The URL of --otlp-endpoint is not an absolute URL"),
        (["--otlp-sample-ratio", "2"], "a number from 0 to 1"),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ventricle"));
        let ended = command.args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(&data.0).args(flags).output().unwrap();
        let told = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert!(!ended.status.success() && told.contains(reason), "{told}");
    }
}
