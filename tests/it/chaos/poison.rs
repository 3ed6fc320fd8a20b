//! A job that ends its process, three times: it fails, the others do not.

use super::{Address, Posted, QUICK, Seen, agent, alone, post, study};
use crate::served::{Directory, Served};
use ndarray::Array3;
use std::{
    path::Path,
    process::Command,
    thread,
    time::{Duration, Instant},
};
use ventricle::{
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    study::{Gate, Study},
    volume::{Grid, Volume},
};

/// Memory that the process may take beyond what it has when it starts (which grows with the processors, as each has threads): enough for small
/// jobs and to read a large study (105 MiB were measured), not for the gradient vector flow of one (335 MiB). An allocation beyond it
/// ends a Rust program.
const MEMORY_MIB: u64 = 175;

/// A real study on a grid three times as fine as a camera's.
fn large_study() -> Vec<u8> {
    let imaging = Imaging { gates: 1, grid: Grid { shape: [40, 80, 80], spacing_mm: [3.0, 2.4, 2.4] }, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    let study = phantom::simulate(&phantom).unwrap().study;
    let grid = Grid { shape: [120, 240, 240], spacing_mm: [1.0, 0.8, 0.8] };
    let coarse = &study.gates[0].volume.counts;
    let counts = Array3::from_shape_fn((120, 240, 240), |(z, y, x)| coarse[[z / 3, y / 3, x / 3]]);
    let gates = vec![Gate { volume: Volume { grid, counts }, duration_ms: None }];
    phantom::dicom::write(&Study { grid, gates, ..study }).unwrap()
}

fn start(data: &Path) -> Served {
    let service = Served::start(data, &["--workers", "1", "--threads-per-worker", "1"]);
    let status = std::fs::read_to_string(format!("/proc/{}/status", service.id())).unwrap();
    let taken_kib = status.lines().find_map(|line| line.strip_prefix("VmData:")?.trim().split(' ').next()?.parse::<u64>().ok()).unwrap();
    let limit = format!("--data={}", (taken_kib << 10) + (MEMORY_MIB << 20));
    let limited = Command::new("prlimit").args(["--pid", &service.id().to_string(), &limit]).status().unwrap();
    assert!(limited.success(), "prlimit (Debian package util-linux): {limited}");
    service
}

#[test]
fn a_job_that_ends_its_process_fails_after_three_attempts_and_the_others_finish() {
    let _alone = alone();
    let data = Directory::new("poison");
    let mut service = start(&data.0);
    let address = [Address::of(&service)];
    let (agent, seen, small) = (agent(), Seen::default(), study());
    let others = |from: usize| -> Vec<String> {
        (from..from + 3)
            .map(|number| post(&agent, &address, 0, &seen, &Posted { key: &format!("job-{number}"), query: QUICK, body: &small }))
            .collect()
    };
    let mut ids = others(0);
    let poison = Posted { key: "poison", query: "preset=paper&mesh.level=2", body: &large_study() };
    let poison = post(&agent, &address, 0, &seen, &poison);
    let mut deaths = 0;
    let mut job = serde_json::Value::Null;
    let deadline = Instant::now() + Duration::from_mins(2);
    while job["state"] != "failed" {
        assert!(Instant::now() < deadline, "after {deaths} deaths: {job}");
        if service.is_alive() {
            if let Some(found) = service.try_get(&format!("/v1/reconstructions/{poison}")) {
                job = found.json();
                assert_ne!(job["state"], "succeeded", "{MEMORY_MIB} MiB are enough for it");
            }
            thread::sleep(Duration::from_millis(20));
        } else {
            deaths += 1;
            service = start(&data.0);
            address[0].set(&service);
            if deaths == 1 {
                ids.extend(others(3));
            }
        }
    }
    assert_eq!((deaths, &job["attempt"], &job["error"]["code"]), (3, &3.into(), &"worker_lost".into()), "{job}");
    for id in &ids {
        let done = service.finished(id, Duration::from_mins(1));
        assert_eq!((&done["state"], &done["attempt"]), (&"succeeded".into(), &1.into()), "{done}");
    }
    assert_eq!(ids.len(), 6);
}
