//! A clock that is set forward by more than results are kept, and back by more than that.

use super::{
    QUICK, alone,
    faults::{SLOW, SOON, accepted, assert_finished, say, until_ready, until_runs},
};
use crate::served::{Directory, Served, program};
use serde_json::Value;
use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::Command,
    thread,
    time::{Duration, Instant},
};

/// What sets the clock for one program, if it is installed.
fn library() -> Option<PathBuf> {
    let folders = fs::read_dir("/usr/lib").unwrap().filter_map(Result::ok);
    folders.map(|folder| folder.path().join("faketime/libfaketimeMT.so.1")).find(|path| path.exists())
}

/// The clock of the service.
struct Clock<'a>(&'a Path);

impl Clock<'_> {
    /// Sets it by so much from what it is in truth. Another file in its place: nobody reads half of it.
    fn set(&self, from_truth: &str) {
        let written = self.0.with_extension("new");
        fs::write(&written, from_truth).unwrap();
        fs::rename(written, self.0).unwrap();
    }
}

fn until_told_of(service: &Served, direction: &str) -> Value {
    let began = Instant::now();
    loop {
        let answer = service.get("/readyz");
        let told = answer.json()["checks"]["clock"].clone();
        assert!(answer.status == 200 && told["ok"] == true, "{}", answer.json());
        if told["detail"].as_str().unwrap().contains(direction) {
            return told;
        }
        assert!(began.elapsed() < SOON, "{told}");
        thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn a_clock_that_is_set_loses_and_delays_nothing() {
    let _alone = alone();
    let Some(library) = library() else {
        crate::shared::absent("libfaketime");
        return;
    };
    let data = Directory::new("set-clock");
    let path = data.0.join("clock");
    let clock = Clock(&path);
    clock.set("+0");
    let log = data.0.join("log");
    let mut command = Command::new(program());
    command
        .args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--workers", "1", "--lease-seconds", "6", "--data-dir"])
        .arg(&data.0);
    command.env("LD_PRELOAD", library).env("FAKETIME_TIMESTAMP_FILE", &path).env("FAKETIME_NO_CACHE", "1");
    // Time that passes is another clock, which nobody sets.
    command.env("FAKETIME_DONT_FAKE_MONOTONIC", "1").env("DONT_FAKE_MONOTONIC", "1");
    command.stderr(File::create(&log).unwrap());
    let mut service = Served::start_by(command, &["--retention-hours", "720"]);
    until_ready(&service);
    let mut ids = vec![accepted(&service, QUICK)];
    assert_finished(&service, &ids);
    // The reaper has looked at the clock: it does so every third of a lease.
    thread::sleep(Duration::from_secs(3));

    ids.extend([accepted(&service, SLOW), accepted(&service, QUICK)]);
    until_runs(&service, &ids[1]);
    clock.set("+40d");
    let forward = until_told_of(&service, "forward");
    assert!(forward["detail"].as_str().unwrap().contains("nothing is deleted"), "{forward}");
    ids.push(accepted(&service, QUICK));
    // Two looks more: what seems to be over for ten days is kept, and what seems to be held for forty is its worker's.
    thread::sleep(Duration::from_secs(5));
    let mut attempts = assert_finished(&service, &ids);
    assert_eq!(attempts, ids.len() as u64);

    let before = ids.len();
    ids.extend([accepted(&service, SLOW), accepted(&service, QUICK)]);
    until_runs(&service, &ids[before]);
    clock.set("-1d");
    until_told_of(&service, "back");
    ids.extend([accepted(&service, QUICK), accepted(&service, QUICK)]);
    attempts += assert_finished(&service, &ids[before..]);
    assert_eq!(attempts, ids.len() as u64, "{}", fs::read_to_string(&log).unwrap());
    let set =
        ["forward", "back"].map(|direction| service.metric(&format!("ventricle_clock_set_total{{direction=\"{direction}\"}}")) as u64);
    assert_eq!((set, service.metric("ventricle_leases_lost_total") as u64), ([1, 1], 0));
    assert!(service.is_alive());
    say("clock set forward by 40 days, then back by 41", &forward, ids.len(), attempts);
}
