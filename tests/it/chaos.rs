//! Whatever is done to the service, what was accepted is finished, with its result, once in effect: `make chaos`. The tests of CI do
//! the same with fewer jobs (`CHAOS_JOBS`, `CHAOS_KILLS`).

use crate::served::{Directory, Served};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sqlx::{ConnectOptions, Connection, SqliteConnection, sqlite::SqliteConnectOptions};
use std::{
    collections::BTreeSet,
    path::Path,
    process::Command,
    sync::{
        Mutex,
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
}

/// A small real study: one gate on a coarse grid, so that a job is a fraction of a second.
fn study(gates: usize, grid: Grid) -> Vec<u8> {
    let imaging = Imaging { gates, grid, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

const COARSE: Grid = Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] };
/// The quickest real reconstruction.
const QUICK: &str = "preset=clinical&refine.enabled=false&mesh.level=2";

/// Where the service listens now; it changes with every restart.
struct Address(Mutex<String>);

impl Address {
    fn get(&self) -> String {
        self.0.lock().unwrap().clone()
    }

    fn set(&self, url: &str) {
        url.clone_into(&mut self.0.lock().unwrap());
    }
}

/// What the clients of a run saw.
#[derive(Default)]
struct Seen {
    accepted: Mutex<BTreeSet<String>>,
    unanswered: AtomicUsize,
    full: AtomicUsize,
}

/// Posts one job as a careful client does: with a key, again when there was no answer, later when the queue is full.
fn post(agent: &ureq::Agent, address: &Address, seen: &Seen, key: &str, body: &[u8]) {
    let deadline = Instant::now() + Duration::from_mins(5);
    loop {
        assert!(Instant::now() < deadline, "{key} was not accepted in five minutes");
        let request = agent
            .post(format!("{}/v1/reconstructions?{QUICK}", address.get()))
            .header("content-type", "application/dicom")
            .header("idempotency-key", key);
        let Ok(mut answer) = request.send(body) else {
            seen.unanswered.fetch_add(1, Ordering::Relaxed);
            thread::sleep(Duration::from_millis(50));
            continue;
        };
        match answer.status().as_u16() {
            200 | 202 => {
                let Ok(text) = answer.body_mut().read_to_string() else {
                    seen.unanswered.fetch_add(1, Ordering::Relaxed);
                    continue;
                };
                let job: serde_json::Value = serde_json::from_str(&text).unwrap();
                seen.accepted.lock().unwrap().insert(job["id"].as_str().unwrap().to_owned());
                return;
            }
            503 => {
                seen.full.fetch_add(1, Ordering::Relaxed);
                let pause = answer.headers().get("retry-after").expect("a 503 says when to come back").to_str().unwrap();
                thread::sleep(Duration::from_secs(pause.parse().unwrap()));
            }
            status => panic!("{key}: {status} {}", answer.body_mut().read_to_string().unwrap_or_default()),
        }
    }
}

fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(Duration::from_secs(30))).build().new_agent()
}

/// Posts all jobs from several clients while `meanwhile` runs.
fn post_all<T>(jobs: usize, address: &Address, seen: &Seen, body: &[u8], meanwhile: impl FnOnce(&AtomicBool) -> T) -> T {
    let (next, done) = (AtomicUsize::new(0), AtomicBool::new(false));
    thread::scope(|scope| {
        let clients: Vec<_> = (0..4)
            .map(|_| {
                scope.spawn(|| {
                    let agent = agent();
                    loop {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        if number >= jobs {
                            return;
                        }
                        post(&agent, address, seen, &format!("job-{number}"), body);
                    }
                })
            })
            .collect();
        scope.spawn(|| {
            for client in clients {
                client.join().unwrap();
            }
            done.store(true, Ordering::Relaxed);
        });
        meanwhile(&done)
    })
}

#[test]
fn sqlite_loses_nothing_to_kills_at_random_times() {
    let plan = Plan::of(40, 3);
    let data = Directory::new("chaos");
    let body = study(1, COARSE);
    let flags = ["--threads-per-worker", "1", "--workers", "2"];
    let workers = 2;
    let seed = 20;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut service = Served::start(&data.0, &flags);
    let address = Address(Mutex::new(service.url.clone()));
    let seen = Seen::default();
    let began = Instant::now();
    let mut kills = 0;
    service = post_all(plan.jobs, &address, &seen, &body, |done| {
        while kills < plan.kills || !done.load(Ordering::Relaxed) {
            if kills == plan.kills {
                thread::sleep(Duration::from_millis(20));
                continue;
            }
            thread::sleep(Duration::from_millis(300 + u64::from(random.next_u32() % 1700)));
            service.kill();
            kills += 1;
            service = Served::start(&data.0, &flags);
            address.set(&service.url);
        }
        service
    });
    let accepted = seen.accepted.lock().unwrap().clone();
    let mut attempts = 0;
    for id in &accepted {
        let job = service.finished(id, Duration::from_mins(5));
        assert_eq!(job["state"], "succeeded", "{job}");
        attempts += usize::try_from(job["attempt"].as_u64().unwrap()).unwrap();
    }
    println!(
        "SQLite: {} jobs accepted and succeeded, {kills} kills, {attempts} executions, {} requests without an answer, {} times full, {:.0} s",
        accepted.len(),
        seen.unanswered.load(Ordering::Relaxed),
        seen.full.load(Ordering::Relaxed),
        began.elapsed().as_secs_f64()
    );
    assert_eq!(accepted.len(), plan.jobs);
    assert!(attempts <= plan.jobs + kills * workers, "{attempts} executions");
    service.kill();
    tokio::runtime::Runtime::new().unwrap().block_on(assert_whole(&data.0, plan.jobs));
}

/// What the file says when nobody has it: as many jobs as were accepted, each with its report, and nothing else.
async fn assert_whole(data: &Path, jobs: usize) {
    let mut database = SqliteConnectOptions::new().filename(data.join("ventricle.sqlite")).connect().await.unwrap();
    let count =
        async |database: &mut SqliteConnection, sql: &'static str| -> i64 { sqlx::query_scalar(sql).fetch_one(database).await.unwrap() };
    let wanted = i64::try_from(jobs).unwrap();
    assert_eq!(count(&mut database, "SELECT COUNT(*) FROM jobs").await, wanted, "a job a key");
    assert_eq!(count(&mut database, "SELECT COUNT(*) FROM jobs WHERE state = 'succeeded'").await, wanted);
    let without = "SELECT COUNT(*) FROM jobs WHERE NOT EXISTS (SELECT 1 FROM blobs WHERE job_id = jobs.id AND name = 'report')";
    assert_eq!(count(&mut database, without).await, 0, "jobs without their result");
    let orphans = "SELECT COUNT(*) FROM blobs WHERE NOT EXISTS (SELECT 1 FROM jobs WHERE id = job_id AND state = 'succeeded')";
    assert_eq!(count(&mut database, orphans).await, 0, "results without their job");
    let integrity: String = sqlx::query_scalar("PRAGMA integrity_check").fetch_one(&mut database).await.unwrap();
    assert_eq!(integrity, "ok");
    database.close().await.unwrap();
}

/// Accepting a job is a promise to keep it: the file is synchronised before each 202.
#[test]
fn every_accepted_job_is_synchronised_to_disk() {
    if Command::new("strace").arg("-V").output().is_err() {
        crate::shared::absent("strace");
        return;
    }
    let data = Directory::new("fsync");
    let mut service = Served::start(&data.0, &["--workers", "1"]);
    let log = data.0.join("strace.log");
    let mut strace = Command::new("strace")
        .args(["-f", "-e", "trace=fsync,fdatasync", "-o"])
        .arg(&log)
        .args(["-p", &service.id().to_string()])
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let traced = |service: &Served| {
        let status = std::fs::read_to_string(format!("/proc/{}/status", service.id())).unwrap();
        status.lines().any(|line| line.starts_with("TracerPid:") && !line.ends_with("\t0"))
    };
    let deadline = Instant::now() + Duration::from_secs(10);
    while !traced(&service) {
        assert!(Instant::now() < deadline && service.is_alive(), "strace does not attach");
        thread::sleep(Duration::from_millis(20));
    }
    let syncs = || std::fs::read_to_string(&log).unwrap_or_default().lines().filter(|line| line.contains("sync(")).count();
    let body = study(1, COARSE);
    let jobs = 10;
    let before = syncs();
    for _ in 0..jobs {
        assert_eq!(service.post_with(QUICK, "application/dicom", &body).status, 202);
    }
    let seen = syncs() - before;
    strace.kill().unwrap();
    strace.wait().unwrap();
    assert!(seen >= jobs, "{seen} synchronisations for {jobs} accepted jobs");
    println!("{seen} synchronisations while {jobs} jobs were accepted");
}
