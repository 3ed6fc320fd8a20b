//! What every fault of the machine or the database is held to: what comes meanwhile is refused with a word, what can be read is, `/readyz` says
//! what is wrong, and what was accepted before is finished after, without anybody's doing.

use super::{QUICK, study};
use crate::served::{Answer, Served};
use serde_json::Value;
use std::time::{Duration, Instant};

/// How long a change may take to be told, and a service to be as before, on a machine that does other things too.
pub(super) const SOON: Duration = Duration::from_mins(1);
/// A real reconstruction that takes seconds, so that a fault meets it.
pub(super) const SLOW: &str = "preset=paper&mesh.level=4";

/// Waits until a line of `/readyz` is well, or is not; returns it.
pub(super) fn until_told(service: &Served, line: &str, ok: bool) -> Value {
    let began = Instant::now();
    loop {
        let answer = service.get("/readyz");
        let told = answer.json()["checks"][line].clone();
        if told["ok"] == ok {
            assert!(ok || answer.status == 503, "{} {told}", answer.status);
            return told;
        }
        assert!(began.elapsed() < SOON, "after {SOON:?} {line} is {told}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Waits until everything is well.
pub(super) fn until_ready(service: &Served) {
    let began = Instant::now();
    while service.get("/readyz").status != 200 {
        assert!(began.elapsed() < SOON, "after {SOON:?}: {}", service.get("/readyz").json());
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Submits a study; the id of its job.
pub(super) fn accepted(service: &Served, query: &str) -> String {
    let answer = service.post_with(query, "application/dicom", &study());
    assert_eq!(answer.status, 202, "{}", answer.json());
    answer.json()["id"].as_str().unwrap().to_owned()
}

/// Submits some, the first of which is slow, and waits until it runs.
pub(super) fn some_accepted(service: &Served) -> Vec<String> {
    let mut ids = vec![accepted(service, SLOW)];
    ids.extend((0..3).map(|_| accepted(service, QUICK)));
    until_runs(service, &ids[0]);
    ids
}

pub(super) fn until_runs(service: &Served, id: &str) {
    let began = Instant::now();
    loop {
        let job = service.get(&format!("/v1/reconstructions/{id}")).json();
        if job["state"] == "running" {
            return;
        }
        assert!(job["state"] == "queued" && began.elapsed() < SOON, "{job}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// What cannot be accepted is refused so that a client knows what to do, and nothing else.
pub(super) fn assert_refused(answer: &Answer, code: &str) {
    let problem = answer.json();
    assert_eq!((answer.status, &problem["code"]), (503, &code.into()), "{problem}");
    assert_eq!(answer.media_type, "application/problem+json");
}

/// Everything that was accepted succeeds, with its result; what was charged to the jobs is told.
pub(super) fn assert_finished(service: &Served, ids: &[String]) -> u64 {
    let mut attempts = 0;
    for id in ids {
        let job = service.finished(id, SOON);
        assert_eq!(job["state"], "succeeded", "{job}");
        attempts += job["attempt"].as_u64().unwrap();
        assert_eq!(service.get(&format!("/v1/reconstructions/{id}/report")).json()["id"], id.as_str());
    }
    attempts
}

/// One line of the table.
pub(super) fn say(fault: &str, told: &Value, jobs: usize, attempts: u64) {
    println!("{fault}: /readyz said {}; {jobs} of {jobs} accepted jobs succeeded, in {attempts} attempts", told["detail"]);
}
