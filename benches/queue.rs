//! What the queue carries, and what more nodes bring: jobs that do nothing, and real eight-gate studies, at one, two and three nodes on
//! one PostgreSQL whose commits are synchronised to disk. `make bench-queue` prints the tables of docs/performance.md.
//!
//! Every configuration runs once a round, one after the other; the tables have medians over the rounds.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)]

use std::{
    env,
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::Arc,
    time::{Duration, Instant},
};
use ventricle::{
    jobs::{Backend, NewJob, Output, Store, StoreSettings, Threads, Work, WorkerSettings, start_workers},
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    pipeline::parameters::Parameters,
    study::Study,
    volume::Grid,
};

const ROUNDS: usize = 5;
const EMPTY_JOBS: usize = 1000;
const REAL_JOBS: usize = 12;

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    match arguments.as_slice() {
        // This program again, as a node with workers that do nothing.
        [role, url, workers] if role == "node" => runtime.block_on(node(url, workers.parse().unwrap())),
        _ => runtime.block_on(measure()),
    }
}

/// A PostgreSQL server that lives as long as this.
struct Cluster {
    directory: PathBuf,
    url: String,
}

impl Cluster {
    fn script(action: &str, directory: &Path) -> Command {
        let mut command = Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tools/postgres.sh"));
        command.arg(action).arg(directory);
        command
    }

    fn start() -> Self {
        let directory = env::temp_dir().join(format!("ventricle-bench-{}", uuid::Uuid::now_v7()));
        let output = Self::script("durable", &directory).stderr(Stdio::inherit()).output().unwrap();
        assert!(output.status.success(), "no PostgreSQL: {}", output.status);
        Self { directory, url: String::from_utf8(output.stdout).unwrap().trim().to_owned() }
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        drop(Self::script("stop", &self.directory).status());
    }
}

fn settings(backend: Backend) -> StoreSettings {
    StoreSettings { backend, max_queued_jobs: 1 << 20, ..StoreSettings::default() }
}

async fn store(url: &str) -> Store {
    Store::open(settings(Backend::Postgres { url: url.to_owned() })).await.unwrap()
}

fn nothing(workers: usize) -> WorkerSettings {
    let work: Work =
        Arc::new(|_, _, _, _| Ok(vec![Output { name: "report".into(), media_type: "application/json", data: b"{}".to_vec() }]));
    WorkerSettings { workers, threads: Threads::Fixed(1), work, ..WorkerSettings::default() }
}

/// Works from the first line on standard input to its end.
async fn node(url: &str, workers: usize) {
    let store = store(url).await;
    println!("ready");
    let line = || std::io::stdin().lock().read_line(&mut String::new()).unwrap();
    tokio::task::spawn_blocking(line).await.unwrap();
    let _workers = start_workers(store, nothing(workers)).unwrap();
    tokio::task::spawn_blocking(line).await.unwrap();
}

/// A process, killed when dropped, that has said that it is ready.
struct Node(Child);

impl Node {
    fn start(command: &mut Command) -> Self {
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert!(!line.is_empty(), "the node does not start");
        Self(child)
    }

    fn go(&mut self) {
        self.0.stdin.as_mut().unwrap().write_all(b"go\n").unwrap();
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

fn job(study: &Study) -> NewJob {
    NewJob {
        most_queued: None,
        owner: "bench".into(),
        idempotency_key: None,
        request_hash: [0; 32],
        study: study.clone(),
        subject: None,
        parameters: Parameters::clinical(),
        retention: None,
        keep_input: None,
        callback_url: None,
    }
}

/// Jobs accepted a second, each in a transaction of its own, from eight clients.
async fn submit(store: &Store, study: &Study, jobs: usize) -> f64 {
    let began = Instant::now();
    let clients: Vec<_> = (0..8)
        .map(|client| {
            let (store, study) = (store.clone(), study.clone());
            tokio::spawn(async move {
                for _ in (client..jobs).step_by(8) {
                    store.submit(store.reserve(1 << 20).unwrap(), job(&study)).await.unwrap();
                }
            })
        })
        .collect();
    for client in clients {
        client.await.unwrap();
    }
    jobs as f64 / began.elapsed().as_secs_f64()
}

/// Jobs finished a second, from now until none is left.
async fn drain(store: &Store, jobs: usize) -> f64 {
    let began = Instant::now();
    loop {
        let counts = store.counts().await.unwrap();
        if counts.queued + counts.running == 0 {
            return jobs as f64 / began.elapsed().as_secs_f64();
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

fn phantom(gates: usize, grid: Grid) -> Study {
    let imaging = Imaging { gates, grid, ..Imaging::default() };
    phantom::simulate(&Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) }).unwrap().study
}

/// One line of a table: its name and what each round measured.
struct Row(String, Vec<f64>);

impl Row {
    fn median(&self) -> f64 {
        let mut sorted = self.1.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    }
}

fn print(title: &str, rows: &[Row]) {
    println!("\n| {title} | jobs a second | least to most | ratio |\n|---|---|---|---|");
    for row in rows {
        let (least, most) = row.1.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), &rate| (least.min(rate), most.max(rate)));
        println!("| {} | {:.2} | {least:.2} to {most:.2} | {:.2} |", row.0, row.median(), row.median() / rows[0].median());
    }
}

async fn measure() {
    let cluster = Cluster::start();
    let store = store(&cluster.url).await;
    let small = phantom(1, Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] });
    let eight_gates = phantom(8, Imaging::default().grid);

    let mut accepted = vec![Row("PostgreSQL, small studies".into(), vec![]), Row("PostgreSQL, eight-gate studies".into(), vec![])];
    accepted.push(Row("SQLite, small studies".into(), vec![]));
    let mut empty: Vec<Row> = Vec::new();
    for workers in [1, 4] {
        empty.extend((1..=3).map(|nodes| Row(format!("{nodes} nodes × {workers} workers"), vec![])));
    }
    empty.push(Row("SQLite × 1 worker".into(), vec![]));
    let program = env::current_exe().unwrap();
    for round in 1..=ROUNDS {
        eprintln!("empty jobs, round {round} of {ROUNDS}");
        for (row, (workers, nodes)) in
            empty.iter_mut().zip([1, 4].into_iter().flat_map(|workers| (1..=3).map(move |nodes| (workers, nodes))))
        {
            let mut running: Vec<Node> =
                (0..nodes).map(|_| Node::start(Command::new(&program).args(["node", &cluster.url, &workers.to_string()]))).collect();
            accepted[0].1.push(submit(&store, &small, EMPTY_JOBS).await);
            running.iter_mut().for_each(Node::go);
            row.1.push(drain(&store, EMPTY_JOBS).await);
        }
        let directory = env::temp_dir().join(format!("ventricle-bench-{}", uuid::Uuid::now_v7()));
        let embedded = Store::open(settings(Backend::Sqlite { directory: directory.clone() })).await.unwrap();
        accepted[2].1.push(submit(&embedded, &small, EMPTY_JOBS).await);
        let workers = start_workers(embedded.clone(), nothing(1)).unwrap();
        empty[6].1.push(drain(&embedded, EMPTY_JOBS).await);
        workers.drain(Duration::ZERO).await;
        drop((workers, embedded));
        drop(std::fs::remove_dir_all(directory));
    }
    let mut real: Vec<Row> = (1..=3).map(|nodes| Row(format!("{nodes} nodes × 1 worker × 1 thread"), vec![])).collect();
    real.push(Row("1 node × 1 worker × all processors".into(), vec![]));
    for round in 1..=ROUNDS {
        eprintln!("eight-gate jobs, round {round} of {ROUNDS}");
        for (row, (nodes, threads)) in real.iter_mut().zip([(1, Some("1")), (2, Some("1")), (3, Some("1")), (1, None)]) {
            let running: Vec<Node> = (0..nodes)
                .map(|_| {
                    let mut command = Command::new(env!("CARGO_BIN_EXE_ventricle"));
                    command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--database-url", &cluster.url]);
                    Node::start(
                        command.args(["--workers", "1"]).args(threads.into_iter().flat_map(|threads| ["--threads-per-worker", threads])),
                    )
                })
                .collect();
            let began = Instant::now();
            accepted[1].1.push(submit(&store, &eight_gates, REAL_JOBS).await);
            drain(&store, REAL_JOBS).await;
            row.1.push(REAL_JOBS as f64 / began.elapsed().as_secs_f64());
            drop(running);
        }
    }
    print("accepted, each synchronised, 8 clients", &accepted);
    print("jobs that do nothing", &empty);
    print("eight-gate studies, clinical", &real);
}
