//! A disk without a free byte, under the database and the audit log.

use super::{
    QUICK, alone,
    faults::{SOON, accepted, assert_finished, assert_refused, say, some_accepted, until_ready, until_told},
    study,
};
use crate::served::{Directory, Served, program};
use std::{
    fs::{self, File},
    io::Write as _,
    path::PathBuf,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

/// A file system of so many MiB, seen by the service alone: no other program's disk is filled.
const MIB: &str = "48";

/// A command that runs another one with such a file system at a directory.
fn with_disk(directory: &Directory) -> Command {
    let mut command = Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "bash", "-c"]);
    command.arg(format!("mount -t tmpfs -o size={MIB}m ventricle \"$0\" && exec \"$@\"")).arg(&directory.0);
    command
}

#[test]
fn a_full_disk_loses_nothing() {
    let _alone = alone();
    let directory = Directory::new("full-disk");
    if !with_disk(&directory).arg("true").stderr(Stdio::null()).status().is_ok_and(|status| status.success()) {
        crate::shared::absent("util-linux, on a system where unshare may mount");
        return;
    }
    let log = Directory::new("full-disk-log");
    let mut command = with_disk(&directory);
    command.arg(program()).args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--min-free-disk-mb", "2", "--data-dir"]);
    command.arg(&directory.0).arg("--audit-log").arg(directory.0.join("audit"));
    command.stderr(File::create(log.0.join("log")).unwrap());
    let mut service = Served::start_by(command, &["--workers", "1"]);
    until_ready(&service);
    let done = accepted(&service, QUICK);
    assert_finished(&service, std::slice::from_ref(&done));
    let mut ids = some_accepted(&service);
    assert_eq!(service.get("/readyz").status, 200);

    // By way of the process: nobody else sees that file system.
    let seen = PathBuf::from(format!("/proc/{}/root{}", service.id(), directory.0.display()));
    let filler = seen.join("filler");
    let mut file = File::create(&filler).unwrap();
    while file.write_all(&[1; 4096]).is_ok() {}
    assert_eq!(file.write(&[1]).unwrap_err().kind(), std::io::ErrorKind::StorageFull);
    for line in ["store", "disk"] {
        until_told(&service, line, false);
    }
    // The last block of the audit log is still to be filled.
    let began = Instant::now();
    while service.get("/readyz").json()["checks"]["audit"]["ok"] == true {
        assert_eq!(service.get("/v1/reconstructions").status, 200);
        assert!(began.elapsed() < SOON, "the audit log is written on");
    }
    let told = until_told(&service, "store", false);
    assert_refused(&service.post_with(QUICK, "application/dicom", &study()), "store_unavailable");
    assert_eq!(service.get("/healthz").status, 200);
    assert_eq!(service.get(&format!("/v1/reconstructions/{done}/report")).status, 200, "what is there can be read");
    // Until what runs has ended and cannot be stored.
    let began = Instant::now();
    while !fs::read_to_string(log.0.join("log")).unwrap().contains("the end of the job could not be stored yet") {
        assert!(began.elapsed() < SOON, "{}", fs::read_to_string(log.0.join("log")).unwrap());
        thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(service.get("/v1/reconstructions?state=failed").json()["reconstructions"], serde_json::json!([]));
    assert!(service.is_alive());

    drop(file);
    fs::remove_file(filler).unwrap();
    until_ready_after_a_deed(&service);
    ids.push(accepted(&service, QUICK));
    let attempts = assert_finished(&service, &ids);
    assert_eq!(attempts, ids.len() as u64, "no attempt is charged for a disk");
    let audit = fs::read_to_string(seen.join("audit")).unwrap();
    let torn = audit.lines().filter(|line| serde_json::from_str::<serde_json::Value>(line).is_err()).count();
    assert!(torn <= 1, "one line, the one that met the end of the disk: {audit}");
    assert!(audit.ends_with('\n'), "what came after it is whole");
    say("disk full", &told, ids.len(), attempts);
}

/// The audit log is found writable by writing what somebody did.
fn until_ready_after_a_deed(service: &Served) {
    let deed = service.get("/v1/reconstructions");
    assert_eq!(deed.status, 200);
    until_ready(service);
}
