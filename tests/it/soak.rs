//! The service under all that clients do at once, good and bad, at the capacity of the machine: `make soak` (half an hour). The tests of CI
//! do the same for a minute (`SOAK_SECONDS`), in which memory and descriptors still find their level: how flat they are, and how fast jobs are
//! looked at, is judged by the long run alone.

mod clients;
mod gauges;

use crate::served::{Directory, Served, program};
use clients::{Seen, Studies};
use gauges::{Gauges, median, quantile};
use serde_json::Value;
use std::{
    path::Path,
    process::Command,
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};
use tokio::task::JoinSet;

/// Of so many seconds or more, everything is judged.
const WHOLE_S: u64 = 1800;
/// What the last ten minutes may differ by: asked of the service.
const FLAT: f64 = 0.05;
/// What the last third of a short run may be above its second: memory still finds its level.
const STEADY: f64 = 1.25;
/// 99 of a hundred looks at a job are answered sooner, while all processors reconstruct: asked of the service.
const P99_MS: f64 = 25.0;
/// Looks at which all workers were busy, at least: else this is not the machine's capacity.
const BUSY: f64 = 0.9;
/// The rest of what was accepted is finished sooner.
const PATIENCE: Duration = Duration::from_mins(5);
/// Nothing is left of the clients sooner: a stream whose listener went away ends with its next sign of life, every 15 s, beside other tests later.
const SETTLED: Duration = Duration::from_mins(1);

#[expect(clippy::disallowed_methods, reason = "how long a test run takes is a matter of the run")]
fn time() -> Duration {
    Duration::from_secs(std::env::var("SOAK_SECONDS").map_or(60, |text| text.parse().unwrap()))
}

/// Makes a key that may do everything.
fn key(data: &Path) -> String {
    let mut command = Command::new(program());
    command.args(["keys", "add", "--json", "--owner", "soak", "--scope", "admin", "--scope", "submit", "--scope", "read", "--data-dir"]);
    let output = command.arg(data).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice::<Value>(&output.stdout).unwrap()["key"].as_str().unwrap().to_owned()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn mixed_load_leaves_memory_and_descriptors_as_they_were_and_errors_are_those_intended() {
    let time = time();
    let data = Directory::new("soak");
    let (log, audit) = (data.0.join("log"), data.0.join("audit"));
    let key = key(&data.0);
    let mut service = start(&data.0, &log, &audit);
    let target = clients::Target { address: service.url.trim_start_matches("http://").parse().unwrap(), key };
    let studies = Arc::new(Studies::simulate());
    let seen = Arc::new(Seen::default());
    clients::warm_up(&target, &studies).await;
    let files_before = gauges::files(service.id());

    let (began, gauges) = (Instant::now(), Gauges::default());
    let mut running = JoinSet::new();
    clients::start(&mut running, &target, &studies, &seen);
    let watched = gauges.watch(service.id(), time).await;
    seen.over.store(true, Ordering::Relaxed);
    let ended = tokio::time::timeout(PATIENCE, running.join_all()).await;
    assert!(ended.is_ok(), "clients wait on");
    let left = settle(&target, service.id(), files_before).await;

    let mut latencies_ms = std::mem::take(&mut *seen.latencies_ms.lock().unwrap());
    let (p50_ms, p99_ms) = (quantile(&mut latencies_ms, 0.5), quantile(&mut latencies_ms, 0.99));
    let busy = seen.busy();
    println!(
        "{:.0} s of load, with {} looks at jobs: p50 {p50_ms:.1} ms, p99 {p99_ms:.1} ms, longest {:.0} ms",
        began.elapsed().as_secs_f64(),
        latencies_ms.len(),
        quantile(&mut latencies_ms, 1.0)
    );
    println!("all workers busy at {:.0} % of looks", 100.0 * busy);
    println!("{}", seen.told());
    println!("descriptors: {files_before} before, {} after, at most {} meanwhile", left.files, watched.most_files());
    println!("resident memory by minute, MiB: {:?}", watched.by_minute_mib());
    println!("audit log: {} lines", std::fs::read_to_string(&audit).unwrap().lines().count());

    assert!(service.is_alive());
    let unintended = std::mem::take(&mut *seen.unintended.lock().unwrap());
    assert!(unintended.is_empty(), "{} answers were not intended, as {:#?}", unintended.len(), &unintended[..unintended.len().min(10)]);
    let log = std::fs::read_to_string(&log).unwrap();
    let errors: Vec<&str> = log.lines().filter(|line| line.contains("\"ERROR\"") || line.contains("panicked")).collect();
    assert!(errors.is_empty(), "{errors:#?}");
    seen.assert_every_job_ended();
    assert!(left.is_nothing(files_before), "{files_before} descriptors were open before; after: {left:?}");
    if time.as_secs() < WHOLE_S {
        let (middle, last) = watched.thirds_mib();
        assert!(last <= STEADY * middle, "{last:.0} MiB after {middle:.0}");
        return;
    }
    let last = watched.last_mib(Duration::from_mins(10));
    let (least, most) = (last.iter().copied().fold(f64::INFINITY, f64::min), last.iter().copied().fold(0.0, f64::max));
    println!(
        "last ten minutes, medians of a minute: {least:.1} to {most:.1} MiB ({:.1} %), median {:.1}",
        100.0 * (most / least - 1.0),
        median(&last)
    );
    assert!(most <= (1.0 + FLAT) * least, "{least:.1} to {most:.1} MiB");
    assert!(busy >= BUSY, "workers were busy at {:.0} % of looks", 100.0 * busy);
    assert!(p99_ms < P99_MS, "p99 {p99_ms:.1} ms");
}

/// What clients that are gone have left.
#[derive(Debug)]
struct Left {
    files: usize,
    reserved_bytes: f64,
    /// With the one that asks.
    connections: f64,
}

impl Left {
    fn is_nothing(&self, files_before: usize) -> bool {
        self.files <= files_before && self.reserved_bytes < 1.0 && self.connections < 2.0
    }
}

/// Waits until nothing is left, or for `SETTLED`.
async fn settle(target: &clients::Target, process: u32, files_before: usize) -> Left {
    let began = Instant::now();
    loop {
        tokio::time::sleep(Duration::from_secs(1)).await;
        let files = gauges::files(process);
        let reserved_bytes = target.metric("ventricle_upload_reserved_bytes").await;
        let left = Left { files, reserved_bytes, connections: target.metric("ventricle_http_connections").await };
        if left.is_nothing(files_before) || began.elapsed() > SETTLED {
            return left;
        }
    }
}

fn start(data: &Path, log: &Path, audit: &Path) -> Served {
    let mut command = Command::new(program());
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--log-format", "json", "--data-dir"]).arg(data);
    command.stderr(std::fs::File::create(log).unwrap()).arg("--audit-log").arg(audit);
    // Few places, so that clients are refused too; as many requests as come.
    Served::start_by(command, &["--max-queued-jobs", "8", "--requests-per-second", "100000"])
}
