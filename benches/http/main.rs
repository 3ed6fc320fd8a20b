//! The release service as a process of its own, measured through HTTP: what it accepts, how fast it answers while it computes, what it adds to
//! a reconstruction, how it shares processors and how much memory it takes. `make bench-http` prints the tables of docs/performance.md and
//! writes the same figures to `bench/http.json` in cargo's target directory.
//!
//! Sections may be named (`cargo bench --bench http -- memory events`); without names all are measured. Each is measured once a round; the tables have
//! medians over the rounds.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)]

mod client;
mod figures;
mod service;

use client::Client;
use figures::{Table, quantile};
use hyper::body::Bytes;
use service::{Cluster, Place, Service};
use std::{
    env,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};
use tokio::{
    task::JoinHandle,
    time::{Instant, sleep, sleep_until},
};
use ventricle::{
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    volume::Grid,
};

const ROUNDS: usize = 3;
/// Clients that submit at once.
const CLIENTS: usize = 8;
/// Polls a second of the open loop, and the connections that they go over.
const RATE: usize = 200;
const CONNECTIONS: usize = 16;
const STREAMS: usize = 1000;
const QUEUED: usize = 200;

fn main() {
    allow_descriptors();
    let named: Vec<String> = env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let wanted = |section: &str| named.is_empty() || named.iter().any(|name| name == section);
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let mut tables = Vec::new();
    runtime.block_on(async {
        let studies = Studies::simulate();
        if wanted("accepted") {
            tables.push(accepted(&studies).await);
        }
        if wanted("answers") {
            tables.push(answers(&studies).await);
        }
        if wanted("whole") {
            tables.push(whole(&studies).await);
        }
        if wanted("sharing") {
            tables.push(sharing(&studies).await);
        }
        if wanted("events") {
            tables.push(events(&studies).await);
        }
        if wanted("memory") {
            tables.push(memory(&studies).await);
        }
    });
    tables.iter().for_each(Table::print);
    println!("\n{}", figures::write(&tables).display());
}

/// A thousand listeners are more than the usual limit on open files.
fn allow_descriptors() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let maximum = getrlimit(Resource::Nofile).maximum;
    assert!(maximum.is_none_or(|maximum| maximum > STREAMS as u64 + 200), "the hard limit on open files is {maximum:?}");
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).unwrap();
}

struct Studies {
    /// Eight gates of 64 × 64 × 24 voxels.
    whole: Bytes,
    /// One gate of 32 × 32 × 24.
    small: Bytes,
}

impl Studies {
    fn simulate() -> Self {
        let dicom = |gates: usize, grid: Grid| {
            let imaging = Imaging { gates, grid, ..Imaging::default() };
            let study = phantom::simulate(&Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) }).unwrap().study;
            Bytes::from(phantom::dicom::write(&study).unwrap())
        };
        Self { whole: dicom(8, Imaging::default().grid), small: dicom(1, Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] }) }
    }
}

fn say(section: &str, round: usize) {
    eprintln!("{section}, round {round} of {ROUNDS}");
}

/// Submits so many from several clients at once; their ids and how long it took in s.
async fn submit(address: SocketAddr, preset: &'static str, dicom: &Bytes, studies: usize) -> (Vec<String>, f64) {
    let began = Instant::now();
    let clients: Vec<_> = (0..CLIENTS.min(studies))
        .map(|number| {
            let dicom = dicom.clone();
            tokio::spawn(async move {
                let mut client = Client::connect(address).await;
                let mut ids = Vec::new();
                for _ in (number..studies).step_by(CLIENTS) {
                    ids.push(client.submit(preset, &dicom).await);
                }
                ids
            })
        })
        .collect();
    let mut ids = Vec::new();
    for client in clients {
        ids.extend(client.await.unwrap());
    }
    (ids, began.elapsed().as_secs_f64())
}

/// Studies accepted a second, each committed to disk before its 202, while the workers reconstruct those before.
async fn accepted(studies: &Studies) -> Table {
    let mut table = Table::new("accepted", "accepted, each synchronised, 8 clients, workers busy");
    let cluster = Cluster::start();
    if cluster.is_none() {
        eprintln!("not measured: PostgreSQL is not installed (Debian package postgresql)");
    }
    for round in 1..=ROUNDS {
        say("accepted", round);
        let sqlite = [("sqlite", "SQLite", Place::Sqlite)];
        let postgres = cluster.iter().map(|cluster| ("postgres", "PostgreSQL", Place::Postgres(&cluster.url)));
        for (id, name, place) in sqlite.into_iter().chain(postgres) {
            let service = Service::start(&place, &[]);
            for (kind, told, dicom, many) in
                [("small", "small studies (49 kB)", &studies.small, 240), ("whole", "eight-gate studies (1.6 MB)", &studies.whole, 48)]
            {
                let (_, seconds) = submit(service.address, "clinical", dicom, many).await;
                table.add(&format!("{id}.{kind}"), &format!("{name}, {told}"), "a second", many as f64 / seconds);
            }
        }
    }
    table
}

/// Looks at jobs: as many as go when nothing else happens, and at a fixed rate while all workers reconstruct.
async fn answers(studies: &Studies) -> Table {
    let mut table = Table::new("answers", "GET /v1/reconstructions/{id}");
    for round in 1..=ROUNDS {
        say("answers", round);
        let service = Service::start(&Place::Sqlite, &[]);
        let mut client = Client::connect(service.address).await;
        let done = client.submit("clinical", &studies.whole).await;
        client.succeeded(&done).await;
        table.add("idle", "idle, 8 connections", "a second", closed_loop(service.address, &done, Duration::from_millis(1500)).await);
        add_latencies(
            &mut table,
            "idle",
            "idle, 200 a second",
            open_loop(service.address, vec![done.clone()], Duration::from_secs(3)).await,
        );

        let (ids, _) = submit(service.address, "clinical", &studies.whole, 8).await;
        let feeder = feed(service.address, studies.whole.clone());
        let busy = busy(service.address);
        let paths = ids.into_iter().chain([done]).collect();
        add_latencies(
            &mut table,
            "busy",
            "all workers busy, 200 a second",
            open_loop(service.address, paths, Duration::from_secs(8)).await,
        );
        feeder.abort();
        table.add("busy.share", "looks at which all workers were busy", "%", busy.stop().await);
    }
    table
}

fn add_latencies(table: &mut Table, id: &str, name: &str, mut latencies_ms: Vec<f64>) {
    for (share, told) in [(0.5, "p50"), (0.99, "p99"), (1.0, "longest")] {
        table.add(&format!("{id}.{told}"), &format!("{name}, {told}"), "ms", quantile(&mut latencies_ms, share));
    }
}

/// Looks a second when each follows the answer before.
async fn closed_loop(address: SocketAddr, id: &str, time: Duration) -> f64 {
    let end = Instant::now() + time;
    let clients: Vec<_> = (0..CLIENTS)
        .map(|_| {
            let path = format!("/v1/reconstructions/{id}");
            tokio::spawn(async move {
                let mut client = Client::connect(address).await;
                let mut looks = 0_usize;
                while Instant::now() < end {
                    client.get(&path).await;
                    looks += 1;
                }
                looks
            })
        })
        .collect();
    let mut looks = 0;
    for client in clients {
        looks += client.await.unwrap();
    }
    looks as f64 / time.as_secs_f64()
}

/// Times in ms from when each look was due to its answer: one that waits for a stall counts all of it, as do those due meanwhile.
async fn open_loop(address: SocketAddr, ids: Vec<String>, time: Duration) -> Vec<f64> {
    let ids = Arc::new(ids);
    let looks = (time.as_secs_f64() * RATE as f64) as usize;
    let began = Instant::now() + Duration::from_millis(100);
    let clients: Vec<_> = (0..CONNECTIONS)
        .map(|number| {
            let ids = Arc::clone(&ids);
            tokio::spawn(async move {
                let mut client = Client::connect(address).await;
                let mut latencies_ms = Vec::new();
                for look in (number..looks).step_by(CONNECTIONS) {
                    let due = began + Duration::from_secs_f64(look as f64 / RATE as f64);
                    sleep_until(due).await;
                    client.get(&format!("/v1/reconstructions/{}", ids[look % ids.len()])).await;
                    latencies_ms.push(due.elapsed().as_secs_f64() * 1e3);
                }
                latencies_ms
            })
        })
        .collect();
    let mut latencies_ms = Vec::new();
    for client in clients {
        latencies_ms.extend(client.await.unwrap());
    }
    latencies_ms
}

async fn count(client: &mut Client, state: &str) -> usize {
    client.json(&format!("/v1/reconstructions?state={state}&limit=20")).await["reconstructions"].as_array().unwrap().len()
}

/// Submits whenever fewer than ten wait.
fn feed(address: SocketAddr, dicom: Bytes) -> JoinHandle<()> {
    tokio::spawn(async move {
        let mut client = Client::connect(address).await;
        loop {
            if count(&mut client, "queued").await < 10 {
                client.submit("clinical", &dicom).await;
            }
            sleep(Duration::from_millis(100)).await;
        }
    })
}

/// Who looks whether all workers are busy.
struct Busy {
    end: Arc<AtomicBool>,
    looks: JoinHandle<f64>,
}

fn busy(address: SocketAddr) -> Busy {
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get).min(20);
    let end = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&end);
    let looks = tokio::spawn(async move {
        let mut client = Client::connect(address).await;
        let (mut all, mut looks) = (0_usize, 0_usize);
        while !ended.load(Ordering::Relaxed) {
            looks += 1;
            all += usize::from(count(&mut client, "running").await >= workers);
            sleep(Duration::from_millis(250)).await;
        }
        100.0 * all as f64 / looks.max(1) as f64
    });
    Busy { end, looks }
}

impl Busy {
    /// Looks at which all were, in percent.
    async fn stop(self) -> f64 {
        self.end.store(true, Ordering::Relaxed);
        self.looks.await.unwrap()
    }
}

/// One study at a time, from the request to `succeeded`, against what its report says of the pipeline.
async fn whole(studies: &Studies) -> Table {
    let mut table = Table::new("whole", "one eight-gate study, nobody else");
    let service = Service::start(&Place::Sqlite, &[]);
    let mut client = Client::connect(service.address).await;
    let first = client.submit("clinical", &studies.whole).await;
    client.succeeded(&first).await;
    for round in 1..=ROUNDS {
        say("whole", round);
        for preset in ["clinical", "paper"] {
            let before_s = service.processor_s();
            let began = Instant::now();
            let id = client.submit(preset, &studies.whole).await;
            let accepted_ms = began.elapsed().as_secs_f64() * 1e3;
            client.succeeded(&id).await;
            let whole_ms = began.elapsed().as_secs_f64() * 1e3;
            let report = client.json(&format!("/v1/reconstructions/{id}/report")).await;
            let pipeline_ms = report["timing_ms"]["total"].as_f64().unwrap();
            let mut add =
                |id: &str, name: &str, unit, value| table.add(&format!("{preset}.{id}"), &format!("{preset}, {name}"), unit, value);
            add("accepted", "POST to 202", "ms", accepted_ms);
            add("whole", "POST to succeeded", "ms", whole_ms);
            add("pipeline", "of which pipeline", "ms", pipeline_ms);
            add("ratio", "the whole by the pipeline", "×", whole_ms / pipeline_ms);
            add("processor", "processor time of the service", "s", service.processor_s() - before_s);
        }
    }
    table
}

/// How jobs share processors: by load, and as fixed settings would have it.
async fn sharing(studies: &Studies) -> Table {
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let (all, jobs) = (processors.to_string(), 4 * processors);
    let fixed = |workers, threads| vec!["--workers", workers, "--threads-per-worker", threads];
    let settings: [(&str, &str, Vec<&str>); 4] = [
        ("by-load", "by load (default)", vec![]),
        ("one-worker", "one worker with all processors", fixed("1", &all)),
        ("one-thread", "a worker a processor, one thread each", fixed(&all, "1")),
        ("all-of-all", "a worker a processor, all threads each", fixed(&all, &all)),
    ];
    let mut table = Table::new("sharing", "eight-gate studies, clinical");
    for round in 1..=ROUNDS {
        say("sharing", round);
        for (id, name, flags) in &settings {
            let service = Service::start(&Place::Sqlite, flags);
            let mut client = Client::connect(service.address).await;
            let first = client.submit("clinical", &studies.whole).await;
            client.succeeded(&first).await;
            let began = Instant::now();
            let alone = client.submit("clinical", &studies.whole).await;
            client.succeeded(&alone).await;
            table.add(&format!("{id}.alone"), &format!("{name}: one alone"), "s", began.elapsed().as_secs_f64());
            let before_s = service.processor_s();
            let began = Instant::now();
            let (ids, _) = submit(service.address, "clinical", &studies.whole, jobs).await;
            for id in &ids {
                client.succeeded(id).await;
            }
            table.add(&format!("{id}.queue"), &format!("{name}: {jobs} at once"), "a second", jobs as f64 / began.elapsed().as_secs_f64());
            let processor_s = (service.processor_s() - before_s) / jobs as f64;
            table.add(&format!("{id}.processor"), &format!("{name}: processor time of each of them"), "s", processor_s);
        }
    }
    table
}

/// Half of the streams follow one job each, half all jobs, while jobs are done and others look.
async fn events(studies: &Studies) -> Table {
    const JOBS: usize = 6;
    let mut table = Table::new("events", "1 000 open streams of events");
    for round in 1..=ROUNDS {
        say("events", round);
        let service = Service::start(&Place::Sqlite, &[]);
        let address = service.address;
        let mut client = Client::connect(address).await;
        // What every job needs is there before memory is compared.
        let first = client.submit("clinical", &studies.small).await;
        client.json(&format!("/v1/reconstructions/{first}")).await;
        sleep(Duration::from_secs(2)).await;
        let before_mb = service.resident_mb();
        let mut opened = Vec::new();
        let ready = Arc::new(AtomicUsize::new(0));
        // Of all jobs first: they are to see every job from its beginning.
        for _ in 0..STREAMS / 2 {
            let mut events = Client::connect(address).await.listen("/v1/reconstructions/events").await;
            let ready = Arc::clone(&ready);
            opened.push(tokio::spawn(async move {
                let mut succeeded = 0;
                let mut waiting = true;
                while succeeded < JOBS {
                    let data = events.next().await.unwrap();
                    if std::mem::take(&mut waiting) {
                        ready.fetch_add(1, Ordering::Relaxed);
                    }
                    succeeded += String::from_utf8_lossy(&data).matches("\"state\":\"succeeded\"").count();
                }
                true
            }));
        }
        until(|| ready.load(Ordering::Relaxed) == STREAMS / 2).await;
        let listening_mb = service.resident_mb();
        let (ids, _) = submit(address, "clinical", &studies.whole, JOBS).await;
        for number in 0..STREAMS / 2 {
            let path = format!("/v1/reconstructions/{}/events", ids[number % JOBS]);
            let mut events = Client::connect(address).await.listen(&path).await;
            opened.push(tokio::spawn(async move {
                let mut succeeded = false;
                while let Some(data) = events.next().await {
                    succeeded |= String::from_utf8_lossy(&data).contains("\"state\":\"succeeded\"");
                }
                succeeded
            }));
        }
        table.add("memory", "memory of each (of those of all jobs)", "kB", (listening_mb - before_mb) * 1e3 / (STREAMS / 2) as f64);
        let looks = tokio::spawn(open_loop(address, ids.clone(), Duration::from_secs(5)));
        let mut told = 0;
        for stream in opened {
            told += usize::from(stream.await.unwrap());
        }
        assert_eq!(told, STREAMS, "streams that were told of every success");
        table.add("told", "streams that were told of every success", "", told as f64);
        add_latencies(&mut table, "looks", "looks meanwhile, 200 a second", looks.await.unwrap());
        table.add("peak", "peak of the service", "MB", service.peak_mb());
    }
    table
}

async fn until(reached: impl Fn() -> bool) {
    let began = Instant::now();
    while !reached() {
        assert!(began.elapsed() < Duration::from_mins(1), "not reached");
        sleep(Duration::from_millis(5)).await;
    }
}

/// Resident memory: after the start, after one study of each preset, and with a queue of two hundred.
async fn memory(studies: &Studies) -> Table {
    let mut table = Table::new("memory", "memory of the service");
    for round in 1..=ROUNDS {
        say("memory", round);
        let service = Service::start(&Place::Sqlite, &[]);
        let mut client = Client::connect(service.address).await;
        client.get("/readyz").await;
        table.add("idle", "idle", "MB", service.resident_mb());
        let id = client.submit("clinical", &studies.whole).await;
        client.succeeded(&id).await;
        table.add("one", "peak of one eight-gate study, clinical", "MB", service.peak_mb());
        submit(service.address, "clinical", &studies.whole, QUEUED / 2).await;
        let half_mb = service.peak_mb();
        submit(service.address, "clinical", &studies.whole, QUEUED / 2).await;
        let peak_mb = service.peak_mb();
        table.add("queued.peak", "peak with 200 queued, 8 uploads at once and the workers busy", "MB", peak_mb);
        table.add(
            "queued.each",
            "by which the second hundred of them raised it, each",
            "kB",
            (peak_mb - half_mb) * 1e3 / (QUEUED / 2) as f64,
        );
        drop(service);
        let service = Service::start(&Place::Sqlite, &[]);
        let mut client = Client::connect(service.address).await;
        let id = client.submit("paper", &studies.whole).await;
        client.succeeded(&id).await;
        table.add("one.paper", "peak of one eight-gate study, paper", "MB", service.peak_mb());
    }
    table
}
