//! No file descriptor left: the system gives none, or clients hold all.

use super::{
    QUICK, alone,
    faults::{SOON, some_accepted},
    study,
};
use crate::{
    connection::Connection,
    encapsulated::{converted, phantom_file},
    served::{Directory, Served, program},
};
use axum::body::Bytes;
use serde_json::Value;
use std::{
    fs::{self, File},
    io::Read as _,
    net::{SocketAddr, TcpStream},
    process::Command,
    thread,
    time::{Duration, Instant},
};

fn open_files(service: &Served) -> usize {
    fs::read_dir(format!("/proc/{}/fd", service.id())).unwrap().count()
}

/// The soft limit alone, which may be raised again.
fn limit(service: &Served, files: usize) {
    let status = Command::new("prlimit").args(["--pid", &service.id().to_string(), &format!("--nofile={files}:")]).status().unwrap();
    assert!(status.success(), "prlimit (Debian package util-linux): {status}");
}

/// A file whose frames a decoder in a process of its own reads; `None` where what compresses it is not installed.
fn compressed() -> Option<Bytes> {
    let directory = Directory::new("compressed");
    converted(&directory.0, "dcmtk", &["dcmcjpls"], &phantom_file(1)).map(Bytes::from)
}

async fn post(connection: &mut Connection, body: Bytes) -> (u16, Value) {
    let path = format!("/v1/reconstructions?{QUICK}");
    let answer = connection.ask("POST", &path, &[("content-type", "application/dicom")], body).await.unwrap();
    assert!(answer.status != 503 || answer.retry_after_s.is_some(), "{}", answer.json());
    (answer.status, answer.json())
}

async fn until_succeeded(connection: &mut Connection, ids: &[String]) -> u64 {
    let mut attempts = 0;
    for id in ids {
        let began = Instant::now();
        loop {
            let path = format!("/v1/reconstructions/{id}");
            let job = connection.ask("GET", &path, &[("prefer", "wait=10")], Bytes::new()).await.unwrap().json();
            if job["state"] == "succeeded" {
                attempts += job["attempt"].as_u64().unwrap();
                break;
            }
            assert!(began.elapsed() < SOON && (job["state"] == "queued" || job["state"] == "running"), "{job}");
        }
    }
    attempts
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[expect(clippy::await_holding_lock, reason = "the test has the machine to itself, all its way")]
async fn without_a_file_descriptor_who_is_connected_is_served_and_nothing_is_lost() {
    let Some(compressed) = compressed() else { return };
    let _alone = alone();
    let data = Directory::new("descriptors");
    let log = data.0.join("log");
    let mut command = Command::new(program());
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--workers", "1", "--data-dir"]).arg(&data.0);
    command.stderr(File::create(&log).unwrap());
    let mut service = Served::start_by(command, &[]);
    let address: SocketAddr = service.url.trim_start_matches("http://").parse().unwrap();
    let mut connected = Connection::open(address, None).await;
    assert_eq!(connected.get("/readyz").await.unwrap().status, 200);
    let mut ids = some_accepted(&service);

    let before = open_files(&service);
    limit(&service, before.saturating_sub(1));
    let told = connected.get("/readyz").await.unwrap();
    let line = told.json()["checks"]["descriptors"].clone();
    assert_eq!((told.status, &line["ok"]), (503, &false.into()), "{}", told.json());
    // Who comes now waits: the system holds the connection for the service.
    let mut waiting = Connection::open(address, None).await;
    let (status, answer) = post(&mut connected, study().into()).await;
    assert_eq!(status, 202, "the database has its files open: {answer}");
    ids.push(answer["id"].as_str().unwrap().to_owned());
    let (status, answer) = post(&mut connected, compressed.clone()).await;
    assert_eq!((status, &answer["code"]), (503, &"decoder_unavailable".into()), "{answer}");
    let attempts = until_succeeded(&mut connected, &ids).await;
    thread::sleep(Duration::from_secs(3));
    let lines = fs::read_to_string(&log).unwrap().lines().filter(|line| line.contains("no connection could be accepted")).count();
    assert!((1..60).contains(&lines), "once a second, not as fast as can be: {lines}");

    limit(&service, 1024);
    assert_eq!(waiting.get("/readyz").await.unwrap().status, 200);
    assert_eq!(post(&mut waiting, compressed).await.0, 202);
    assert_eq!(attempts, ids.len() as u64);
    assert!(service.is_alive());
    super::faults::say("no file descriptor left", &line, ids.len(), attempts);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[expect(clippy::await_holding_lock, reason = "the test has the machine to itself, all its way")]
async fn clients_that_open_connections_and_do_nothing_leave_descriptors_for_work() {
    let Some(compressed) = compressed() else { return };
    let _alone = alone();
    let data = Directory::new("idle-clients");
    let mut command = Command::new("bash");
    command.args(["-c", "ulimit -n 512; exec \"$@\"", "bash"]).arg(program());
    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "error", "--workers", "1", "--data-dir"]).arg(&data.0);
    let service = Served::start_by(command, &[]);
    let address: SocketAddr = service.url.trim_start_matches("http://").parse().unwrap();
    let mut connected = Connection::open(address, None).await;
    assert_eq!(connected.get("/readyz").await.unwrap().status, 200);
    let mut idle = Vec::new();
    // The first that is closed as it comes.
    let refused = loop {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(if idle.len() < 200 { 1 } else { 50 }))).unwrap();
        match stream.read(&mut [0]) {
            Ok(0) => break idle.len(),
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => break idle.len(),
            _ => idle.push(stream),
        }
        assert!(idle.len() < 512, "nobody is refused");
    };
    assert!(refused >= 128, "{refused}");
    let ready = connected.get("/readyz").await.unwrap();
    assert_eq!(ready.status, 200, "{}", ready.json());
    let mut ids = Vec::new();
    let (status, answer) = post(&mut connected, study().into()).await;
    assert_eq!(status, 202, "{answer}");
    ids.push(answer["id"].as_str().unwrap().to_owned());
    let (status, answer) = post(&mut connected, compressed).await;
    assert_eq!(status, 202, "a decoder could be started: {answer}");
    ids.push(answer["id"].as_str().unwrap().to_owned());
    until_succeeded(&mut connected, &ids).await;
    drop(idle);
    println!("{refused} idle connections of 512 descriptors, then closed as they came");
}
