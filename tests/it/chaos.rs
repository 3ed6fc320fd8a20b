//! Whatever is done to the service, what was accepted is finished, with its result, once in effect: `make chaos`. The tests of CI do
//! the same with fewer jobs (`CHAOS_JOBS`, `CHAOS_KILLS`).

mod database;
mod descriptors;
mod faults;
mod full_disk;
mod poison;
mod postgres;
mod set_clock;
mod sqlite;

use crate::served::Served;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::{
    collections::BTreeSet,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};
use ventricle::{
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    volume::Grid,
};

/// What a run does.
struct Plan {
    jobs: usize,
    kills: usize,
}

impl Plan {
    /// As the environment says, or so many.
    #[expect(clippy::disallowed_methods, reason = "how long a test run takes is a matter of the run")]
    fn of(jobs: usize, kills: usize) -> Self {
        let number = |name: &str, otherwise: usize| std::env::var(name).ok().map_or(otherwise, |text| text.parse().unwrap());
        Self { jobs: number("CHAOS_JOBS", jobs), kills: number("CHAOS_KILLS", kills) }
    }

    /// Waits a random time, so that what is done is spread over the run.
    fn pause(&self, random: &mut ChaCha8Rng) {
        let most_ms = 128 * self.jobs / self.kills.max(1);
        thread::sleep(Duration::from_millis(300 + random.next_u64() % most_ms.max(1) as u64));
    }
}

/// Two runs at once would kill each other's time: each has the machine to itself.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> std::sync::MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A small real study: one gate on a coarse grid, so that a job is a fraction of a second.
fn study() -> Vec<u8> {
    let imaging = Imaging { gates: 1, grid: Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] }, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

/// The quickest real reconstruction.
const QUICK: &str = "preset=clinical&refine.enabled=false&mesh.level=2";
/// Few enough places for clients to be refused, and more than they can fill between two kills of a slow machine.
const PLACES: [&str; 2] = ["--max-queued-jobs", "8"];

/// Where a service listens now; it changes with every restart.
struct Address(Mutex<String>);

impl Address {
    fn of(service: &Served) -> Self {
        Self(Mutex::new(service.url.clone()))
    }

    fn get(&self) -> String {
        self.0.lock().unwrap().clone()
    }

    fn set(&self, service: &Served) {
        self.0.lock().unwrap().clone_from(&service.url);
    }
}

/// What the clients of a run saw.
#[derive(Default)]
struct Seen {
    accepted: Mutex<BTreeSet<String>>,
    unanswered: AtomicUsize,
    unavailable: AtomicUsize,
    full: AtomicUsize,
}

impl Seen {
    fn accepted(&self) -> BTreeSet<String> {
        self.accepted.lock().unwrap().clone()
    }

    fn say(&self, engine: &str, done: &str, executions: usize, began: Instant) {
        println!(
            "{engine}: {} jobs accepted and succeeded; {done}; {executions} executions; {} requests without an answer, {} refused for the \
             queue being full and {} for the store being away, all sent again and accepted; {:.0} s",
            self.accepted().len(),
            self.unanswered.load(Ordering::Relaxed),
            self.full.load(Ordering::Relaxed),
            self.unavailable.load(Ordering::Relaxed),
            began.elapsed().as_secs_f64()
        );
    }
}

/// One job to post.
struct Posted<'a> {
    key: &'a str,
    query: &'a str,
    body: &'a [u8],
}

/// Posts one job as a careful client does: with a key, to a first address and to the next when there was no answer, after `Retry-After`
/// when refused. Returns the job's id.
fn post(agent: &ureq::Agent, addresses: &[Address], first: usize, seen: &Seen, posted: &Posted<'_>) -> String {
    let (key, deadline) = (posted.key, Instant::now() + Duration::from_mins(5));
    for address in addresses.iter().cycle().skip(first) {
        assert!(Instant::now() < deadline, "{key} was not accepted in five minutes");
        let request = agent
            .post(format!("{}/v1/reconstructions?{}", address.get(), posted.query))
            .header("content-type", "application/dicom")
            .header("idempotency-key", key);
        let Ok(mut answer) = request.send(posted.body) else {
            seen.unanswered.fetch_add(1, Ordering::Relaxed);
            thread::sleep(Duration::from_millis(50));
            continue;
        };
        let status = answer.status().as_u16();
        let Ok(text) = answer.body_mut().read_to_string() else {
            seen.unanswered.fetch_add(1, Ordering::Relaxed);
            continue;
        };
        let body: serde_json::Value = serde_json::from_str(&text).unwrap();
        match status {
            200 | 202 => {
                let id = body["id"].as_str().unwrap().to_owned();
                seen.accepted.lock().unwrap().insert(id.clone());
                return id;
            }
            503 => {
                let refused = if body["code"] == "queue_full" { &seen.full } else { &seen.unavailable };
                refused.fetch_add(1, Ordering::Relaxed);
                let pause = answer.headers().get("retry-after").expect("a 503 says when to come back").to_str().unwrap();
                thread::sleep(Duration::from_secs(pause.parse().unwrap()));
            }
            _ => panic!("{key}: {status} {text}"),
        }
    }
    unreachable!("addresses are cycled through")
}

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(Duration::from_secs(30))).build().new_agent()
}

/// Posts so many jobs from several clients while `meanwhile` runs, and more until it has ended; returns what it returned.
fn post_all<T>(jobs: usize, addresses: &[Address], seen: &Seen, meanwhile: impl FnOnce() -> T) -> T {
    let body = study();
    let (next, over) = (AtomicUsize::new(0), AtomicBool::new(false));
    thread::scope(|scope| {
        for client in 0..4 {
            let (body, next, over) = (&body, &next, &over);
            scope.spawn(move || {
                let agent = agent();
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= jobs && over.load(Ordering::Relaxed) {
                        return;
                    }
                    let posted = Posted { key: &format!("job-{number}"), query: QUICK, body };
                    post(&agent, addresses, (client + number) % addresses.len(), seen, &posted);
                }
            });
        }
        // However it ends, the clients do too.
        let _over = SetWhenDropped(&over);
        meanwhile()
    })
}

struct SetWhenDropped<'a>(&'a AtomicBool);

impl Drop for SetWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The jobs' attempts once all have succeeded.
fn executions(service: &Served, accepted: &BTreeSet<String>) -> usize {
    let attempts = accepted.iter().map(|id| {
        let job = service.finished(id, Duration::from_mins(5));
        assert_eq!(job["state"], "succeeded", "{job}");
        usize::try_from(job["attempt"].as_u64().unwrap()).unwrap()
    });
    attempts.sum()
}

/// The same study gives the same report, interrupted or not.
fn assert_reports_agree(service: &Served, accepted: &BTreeSet<String>) {
    let mut reports = BTreeSet::new();
    for id in accepted {
        let mut report = service.get(&format!("/v1/reconstructions/{id}/report")).json();
        assert_eq!(report["id"], id.as_str());
        report.as_object_mut().unwrap().retain(|key, _| key != "id" && key != "timing_ms");
        reports.insert(report.to_string());
    }
    assert_eq!(reports.len(), 1);
}

/// Queries of the database when all is done, what each counts, and whether there are to be as many as jobs, or none.
const COUNTS: [(&str, &str, bool); 5] = [
    ("jobs, one a key", "SELECT COUNT(*) FROM jobs", true),
    ("jobs that succeeded", "SELECT COUNT(*) FROM jobs WHERE state = 'succeeded' AND lease_owner IS NULL", true),
    ("reports", "SELECT COUNT(*) FROM blobs WHERE name = 'report'", true),
    (
        "jobs without their result",
        "SELECT COUNT(*) FROM jobs WHERE NOT EXISTS (SELECT 1 FROM blobs WHERE job_id = jobs.id AND name = 'report')",
        false,
    ),
    (
        "results without their job",
        "SELECT COUNT(*) FROM blobs WHERE NOT EXISTS (SELECT 1 FROM jobs WHERE id = job_id AND state = 'succeeded')",
        false,
    ),
];
