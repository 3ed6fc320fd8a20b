//! What an operator sees of a service at work: the numbers of a job, the lines that tie a request to it, and that neither can be made to grow
//! by those who call.

use crate::served::{Directory, Served};
use serde_json::Value;
use std::{collections::BTreeSet, time::Duration};
use ventricle::{
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    volume::Grid,
};

/// A small study that is done soon.
pub(crate) fn small() -> Vec<u8> {
    let imaging = Imaging { gates: 2, grid: Grid { shape: [20, 32, 32], spacing_mm: [6.4; 3] }, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

/// The series of `/metrics`, each with its labels.
fn series(service: &Served) -> BTreeSet<String> {
    let text = String::from_utf8(service.get("/metrics").body).unwrap();
    text.lines().filter(|line| !line.starts_with('#')).filter_map(|line| Some(line.rsplit_once(' ')?.0.to_owned())).collect()
}

fn agent() -> ureq::Agent {
    let config = ureq::Agent::config_builder().http_status_as_error(false).allow_non_standard_methods(true);
    config.timeout_global(Some(Duration::from_mins(1))).build().new_agent()
}

/// Sends every kind of request that there is to every kind of path, with words of one's own wherever a client can put one.
fn hammer(service: &Served, word: &str) {
    let agent = agent();
    let uid = uuid::Uuid::now_v7();
    let paths = [
        format!("/{word}"),
        format!("/v1/{word}?{word}={word}"),
        format!("/v1/reconstructions?limit={word}"),
        format!("/v1/reconstructions/{uid}"),
        format!("/v1/reconstructions/{word}"),
        format!("/v1/reconstructions/{uid}/{word}"),
        format!("/v1/reconstructions/{uid}/report"),
        format!("/v1/reconstructions/{uid}/comparison?with={word}"),
        format!("/v1/reconstructions/{uid}/polar-maps/{word}.png"),
        format!("/v1/reconstructions/{uid}/gates/7/wall.vtu"),
        format!("/v1/reconstructions/{uid}/gates/{word}/wall.vtu"),
        format!("/dicom-web/studies/{word}"),
        format!("/assets/{word}.js"),
        format!("/embed/{word}.js"),
        format!("/studies/{word}"),
        format!("/docs/{word}"),
        "/metrics".to_owned(),
        "/healthz".to_owned(),
    ];
    for path in &paths {
        for method in ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "PROPFIND", &word.to_uppercase()] {
            let request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", service.url));
            let request = request.header("content-type", format!("text/{word}")).header("user-agent", word).header("x-request-id", word);
            let request = request.header("idempotency-key", word).header("accept", format!("{word}/{word}"));
            let request = request.body(word.to_owned()).unwrap();
            // A connection that was closed after the answer before is found to be so by a request that nobody gets: it is sent again.
            assert!((0..5).any(|_| agent.run(request.clone()).is_ok()), "{method} {path}");
        }
    }
}

#[test]
fn no_request_makes_a_new_series() {
    let data = Directory::new("series");
    let service = Served::start(&data.0, &[]);
    hammer(&service, "zqfirst");
    // Numbers that come by themselves: a look of the workers.
    let began = std::time::Instant::now();
    while service.metric("ventricle_store_duration_seconds_count{operation=\"claim\"}") < 1.0 {
        assert!(began.elapsed() < Duration::from_mins(1), "no worker looks for jobs");
    }
    let before = series(&service);
    assert!(before.len() > 100, "{before:#?}");
    for word in ["zqagain", "zqthird", "zqx9", "zq-much-longer-word-with-dashes"] {
        hammer(&service, word);
    }
    let after = series(&service);
    let new: Vec<&String> = after.difference(&before).collect();
    assert!(new.is_empty(), "{new:#?}");
    assert!(after.iter().all(|series| !series.to_lowercase().contains("zq")), "{after:#?}");
    assert!(
        after.iter().any(|series| series.contains("path=\"unmatched\"")) && after.iter().any(|series| series.contains("method=\"other\""))
    );
}

#[test]
fn a_job_is_seen_in_numbers_and_its_lines_name_it_and_its_request() {
    let data = Directory::new("observed");
    let log = data.0.join("log");
    let service = Served::start_logging(&data.0, &log, &[]);
    let request = agent().post(format!("{}/v1/reconstructions", service.url)).header("content-type", "application/dicom");
    let accepted = crate::served::answer(request.header("x-request-id", "the-first").send(&small()).unwrap()).json();
    let id = accepted["id"].as_str().unwrap().to_owned();
    assert_eq!(service.finished(&id, Duration::from_mins(2))["state"], "succeeded");
    // Nothing but noise: no ventricle is there.
    let noise = phantom_of_noise();
    let failed = service.post("application/json", noise.to_string().as_bytes()).json();
    let failed = service.finished(failed["id"].as_str().unwrap(), Duration::from_mins(2));
    let code = failed["error"]["code"].as_str().unwrap();
    assert_eq!(service.get("/nowhere").status, 404);

    let whole = |series: &str| service.metric(series) as u64;
    for stage in ["localisation", "rays", "model_fit", "wall", "results"] {
        let count = format!("ventricle_job_stage_duration_seconds_count{{stage=\"{stage}\",preset=\"clinical\"}}");
        assert_eq!(whole(&count), 1, "{count}");
    }
    for (metric, expected) in [
        ("ventricle_job_duration_seconds_count{state=\"succeeded\",preset=\"clinical\"}", 1),
        ("ventricle_job_duration_seconds_count{state=\"failed\",preset=\"clinical\"}", 1),
        (&format!("ventricle_jobs_failed_total{{code=\"{code}\"}}"), 1),
        ("ventricle_http_problems_total{code=\"not_found\"}", 1),
        ("ventricle_store_duration_seconds_count{operation=\"submit\"}", 2),
        ("ventricle_store_duration_seconds_count{operation=\"finish\"}", 2),
        // The one that asks.
        ("ventricle_http_requests_in_flight", 1),
    ] {
        assert_eq!(whole(metric), expected, "{metric}");
    }
    for operation in ["claim", "heartbeat", "read"] {
        let count = format!("ventricle_store_duration_seconds_count{{operation=\"{operation}\"}}");
        assert!(service.metric(&count) >= 2.0, "{count}");
    }
    assert!(service.metric("process_resident_memory_bytes") > 1e6 && service.metric("process_cpu_seconds_total") > 0.0);
    let built = series(&service).into_iter().find(|series| series.starts_with("ventricle_build_info")).unwrap();
    assert!(built.contains(&format!("version=\"{}\"", env!("CARGO_PKG_VERSION"))), "{built}");
    assert!(built.contains("commit=\"") && built.contains("rustc=\"1.") && built.contains("profile=\""), "{built}");

    let lines: Vec<Value> = std::fs::read_to_string(&log).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let named = |message: &str| lines.iter().filter(|line| line["message"] == message).cloned().collect::<Vec<_>>();
    let accepted = named("job accepted");
    assert_eq!(accepted.len(), 2);
    assert_eq!((&accepted[0]["job_id"], &accepted[0]["span"]["request_id"]), (&id.as_str().into(), &"the-first".into()), "{accepted:?}");
    let ended = named("job finished");
    assert_eq!((&ended[0]["span"]["job_id"], &ended[0]["span"]["attempt"]), (&id.as_str().into(), &1.into()), "{ended:?}");
    let answered = named("answered");
    assert!(answered.len() > 5 && answered.iter().all(|line| line["span"]["request_id"].is_string()), "{answered:?}");
    assert!(answered.iter().any(|line| line["span"]["path"] == "/v1/reconstructions/{id}"), "{answered:?}");
}

/// A study of even counts, as JSON.
pub(crate) fn phantom_of_noise() -> Value {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let counts: Vec<u8> = (0..2 * 6 * 16 * 16_u32).flat_map(|voxel| ((voxel * 7919 % 13) as u16 + 50).to_le_bytes()).collect();
    serde_json::json!({
        "grid": {"gates": 2, "shape": [6, 16, 16], "spacing_mm": [5.0, 5.0, 5.0]}, "dtype": "uint16", "counts": STANDARD.encode(counts),
    })
}
