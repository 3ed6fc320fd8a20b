//! Memory that a service holds when it has no more work.

use crate::served::{Directory, Served};
use std::{
    thread,
    time::{Duration, Instant},
};
use ventricle::phantom::{self, Phantom, Shape, Ventricle};

/// It is given back after half a minute; the machine may be busy with other tests, not the service.
const PATIENCE: Duration = Duration::from_mins(2);

fn resident_mib(service: &Served) -> f64 {
    service.metric("process_resident_memory_bytes") / f64::from(1 << 20)
}

#[test]
fn a_service_without_work_gives_back_most_of_what_a_study_took() {
    let data = Directory::new("memory");
    let service = Served::start(&data.0, &[]);
    let before_mib = resident_mib(&service);
    let study = phantom::simulate(&Phantom::of(Shape::Ventricle(Ventricle::NORMAL))).unwrap().study;
    let posted = service.post("application/dicom", &phantom::dicom::write(&study).unwrap());
    assert_eq!(posted.status, 202);
    let job = service.finished(posted.json()["id"].as_str().unwrap(), PATIENCE);
    assert_eq!(job["state"], "succeeded", "{job}");
    let kept_mib = resident_mib(&service);
    assert!(kept_mib > before_mib + 20.0, "{kept_mib:.1} MiB with what a study took, {before_mib:.1} without");
    let began = Instant::now();
    let given_back_mib = loop {
        thread::sleep(Duration::from_secs(2));
        let now_mib = resident_mib(&service);
        if now_mib < before_mib + (kept_mib - before_mib) / 2.0 || began.elapsed() > PATIENCE {
            break now_mib;
        }
    };
    assert!(
        given_back_mib < before_mib + (kept_mib - before_mib) / 2.0,
        "{before_mib:.1} MiB before, {kept_mib:.1} after, {given_back_mib:.1} when idle"
    );
}
