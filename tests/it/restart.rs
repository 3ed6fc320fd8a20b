//! `kill -9` in the middle of the work: what was accepted is finished, once in effect.

use crate::served::{Directory, Served};
use std::{collections::BTreeSet, time::Duration};
use ventricle::phantom::{self, Imaging, Phantom, Shape, Ventricle};

const JOBS: usize = 6;

/// A small real study that takes a worker about a second.
fn study() -> Vec<u8> {
    let imaging = Imaging { gates: 2, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

#[test]
fn accepted_jobs_all_finish_though_the_service_is_killed_twice() {
    let data = Directory::new("restart");
    let body = study();
    let one_worker = ["--workers", "1", "--threads-per-worker", "1"];
    let mut service = Served::start(&data.0, &one_worker);
    let mut accepted = BTreeSet::new();
    // The first kill comes while the first jobs run and others wait, the second while what was lost is worked on again.
    for pause_ms in [700, 1300] {
        for _ in 0..JOBS / 2 {
            let answer = service.post("application/dicom", &body);
            assert_eq!(answer.status, 202, "{}", String::from_utf8_lossy(&answer.body));
            accepted.insert(answer.json()["id"].as_str().unwrap().to_owned());
        }
        std::thread::sleep(Duration::from_millis(pause_ms));
        service.kill();
        service = Served::start(&data.0, &one_worker);
    }
    let mut attempts = 0;
    let mut reports = BTreeSet::new();
    for id in &accepted {
        let job = service.finished(id, Duration::from_mins(2));
        assert_eq!(job["state"], "succeeded", "{job}");
        attempts += job["attempt"].as_u64().unwrap();
        let report = service.get(&format!("/v1/reconstructions/{id}/report"));
        assert_eq!(report.status, 200);
        assert_eq!(report.json()["id"], id.as_str());
        let mut content = report.json();
        content.as_object_mut().unwrap().retain(|key, _| key != "id" && key != "timing_ms");
        reports.insert(content.to_string());
        let surfaces = service.get(&format!("/v1/reconstructions/{id}/surfaces.glb"));
        assert_eq!((surfaces.status, &surfaces.body[..4]), (200, b"glTF".as_slice()));
    }
    assert_eq!(reports.len(), 1, "the same study gives the same report, interrupted or not");
    // A kill costs at most the one job that the one worker had.
    assert!(attempts <= JOBS as u64 + 2, "{attempts} attempts for {JOBS} jobs and two kills");
    let listed = service.get("/v1/reconstructions?limit=100").json();
    let listed: BTreeSet<String> =
        listed["reconstructions"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap().to_owned()).collect();
    assert_eq!(listed, accepted);
}

#[test]
fn a_second_service_on_the_same_directory_is_refused() {
    let data = Directory::new("second");
    let _first = Served::start(&data.0, &[]);
    let second = std::process::Command::new(env!("CARGO_BIN_EXE_ventricle"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data-dir"])
        .arg(&data.0)
        .output()
        .unwrap();
    assert!(!second.status.success());
    let said = String::from_utf8_lossy(&second.stderr);
    assert!(said.contains("is in use by another process"), "{said}");
}
