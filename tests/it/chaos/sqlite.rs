//! The embedded database: `kill -9` at random times.

use super::{Address, COUNTS, PLACES, Plan, QUICK, Seen, alone, assert_reports_agree, executions, post_all, study};
use crate::served::{Directory, Served};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sqlx::{ConnectOptions, Connection, sqlite::SqliteConnectOptions};
use std::{
    path::Path,
    process::Command,
    sync::atomic::Ordering,
    thread,
    time::{Duration, Instant},
};

#[test]
fn sqlite_loses_nothing_to_kills_at_random_times() {
    let _alone = alone();
    let plan = Plan::of(40, 3);
    let workers = 2;
    let data = Directory::new("chaos");
    let flags = [["--workers", "2"], ["--threads-per-worker", "1"], PLACES].concat();
    let mut random = ChaCha8Rng::seed_from_u64(20);
    let mut service = Served::start(&data.0, &flags);
    let address = [Address::of(&service)];
    let seen = Seen::default();
    let began = Instant::now();
    service = post_all(plan.jobs, &address, &seen, || {
        for _ in 0..plan.kills {
            plan.pause(&mut random);
            service.kill();
            service = Served::start(&data.0, &flags);
            address[0].set(&service);
        }
        service
    });
    let accepted = seen.accepted();
    let executions = executions(&service, &accepted);
    assert_reports_agree(&service, &accepted);
    seen.say("SQLite", &format!("{} kills", plan.kills), executions, began);
    assert!(accepted.len() >= plan.jobs && seen.full.load(Ordering::Relaxed) > 0);
    assert!(executions <= accepted.len() + plan.kills * workers, "{executions} executions");
    service.kill();
    tokio::runtime::Runtime::new().unwrap().block_on(assert_whole(&data.0, accepted.len()));
}

/// What the file says when nobody has it.
async fn assert_whole(data: &Path, jobs: usize) {
    let mut database = SqliteConnectOptions::new().filename(data.join("ventricle.sqlite")).connect().await.unwrap();
    for (what, sql, every) in COUNTS {
        let count: i64 = sqlx::query_scalar(sql).fetch_one(&mut database).await.unwrap();
        assert_eq!(count, if every { i64::try_from(jobs).unwrap() } else { 0 }, "{what}");
    }
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
    let body = study();
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
