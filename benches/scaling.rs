//! What 1, 10 and 1 000 studies a minute need: a queue simulated from what `make bench-http` measured. `make bench-scaling` prints the tables of
//! docs/performance.md.
//!
//! Studies arrive at random (Poisson, fixed seed) and are worked on in their order, by as many workers as there are processors. Each takes the
//! measured processor time, evenly spread from half of it to half as much again. A job begins with the threads that the service would
//! give it (`Threads::ByLoad`), which make it faster by Amdahl's law with the share of parallel work that two threads were measured to have; where
//! more threads run than there are processors, they share them. The same parameters give the same tables to the last digit.
//!
//! `cargo bench --bench scaling -- --service-s 1.2 --speedup 1.4 --accepted 46 --carried 260` takes other figures than the measured ones.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)]

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::{collections::VecDeque, env, fs, path::PathBuf};
use ventricle::jobs::Threads;

const SEED: u64 = 1;
const STUDIES: usize = 20_000;
const RATES_A_MINUTE: [f64; 3] = [1.0, 10.0, 1000.0];
const PROCESSORS: [usize; 12] = [1, 2, 4, 8, 12, 16, 20, 24, 32, 48, 64, 96];
/// What an eight-gate study of 64 × 64 × 24 voxels brings and leaves (docs/operations.md, "Disk").
const INPUT_MB: f64 = 1.57;
const RESULTS_MB: f64 = 2.26;
/// Days that results are kept by default.
const RETENTION_DAYS: f64 = 30.0;
/// Commits of a job: accepted, claimed, the first heartbeat, finished, and its share of a deletion of ten.
const COMMITS: f64 = 4.1;
/// Commits a second of a running job that tells its progress.
const PROGRESS_A_SECOND: f64 = 4.0;

struct Parameters {
    /// Time of a study on one thread while every other processor is busy too, in s.
    service_s: f64,
    /// How much sooner a study is done by two threads.
    speedup: f64,
    /// Eight-gate studies accepted a second by one PostgreSQL.
    accepted: f64,
    /// Jobs a second that one PostgreSQL carries (`make bench-queue`).
    carried: f64,
}

fn main() {
    let parameters = parameters();
    let Parameters { service_s, speedup, accepted, carried } = parameters;
    println!(
        "a study: {service_s:.2} s on one thread, {speedup:.2} times sooner on two; PostgreSQL accepts {accepted:.0} studies and carries {carried:.0} jobs a second"
    );
    println!(
        "\n| studies a minute | processors | busy | waits: median | p99 | done after: median | p99 | longest queue |\n|---|---|---|---|---|---|---|---|"
    );
    for rate in RATES_A_MINUTE {
        let a_second = rate / 60.0;
        let enough = |processors: &usize| a_second * service_s < 0.97 * *processors as f64;
        for processors in PROCESSORS.into_iter().filter(enough).take(3) {
            let Simulated { busy, mut waits_s, mut done_s, longest_queue } = simulate(&parameters, a_second, processors);
            println!(
                "| {rate:.0} | {processors} | {:.0} % | {:.2} s | {:.2} s | {:.2} s | {:.2} s | {longest_queue} |",
                100.0 * busy,
                quantile(&mut waits_s, 0.5),
                quantile(&mut waits_s, 0.99),
                quantile(&mut done_s, 0.5),
                quantile(&mut done_s, 0.99),
            );
        }
    }
    println!(
        "\n| studies a minute | processors that reconstruct | commits a second | of the queue's jobs | of what is accepted | MB a second in, out | kept for 30 days |\n|---|---|---|---|---|---|---|"
    );
    for rate in RATES_A_MINUTE {
        let a_second = rate / 60.0;
        println!(
            "| {rate:.0} | {:.2} | {:.1} | {:.1} % | {:.1} % | {:.2}, {:.2} | {:.2} TB |",
            a_second * service_s,
            a_second * (COMMITS + PROGRESS_A_SECOND * service_s),
            100.0 * a_second / carried,
            100.0 * a_second / accepted,
            a_second * INPUT_MB,
            a_second * RESULTS_MB,
            a_second * RESULTS_MB * RETENTION_DAYS * 86400.0 / 1e6,
        );
    }
}

/// What is given on the command line, else what was measured.
fn parameters() -> Parameters {
    let arguments: Vec<String> = env::args().collect();
    let given = |flag: &str| arguments.windows(2).find(|pair| pair[0] == flag).map(|pair| pair[1].parse::<f64>().unwrap());
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).with_file_name("bench/http.json");
    let measured: Value = fs::read(&path).map(|text| serde_json::from_slice(&text).unwrap()).unwrap_or_default();
    let figure = |id: &str| {
        let figures = measured["figures"].as_array();
        let found = figures.and_then(|figures| figures.iter().find(|figure| figure["id"] == id));
        found.and_then(|figure| figure["median"].as_f64()).unwrap_or_else(|| panic!("{} has no {id}: run make bench-http", path.display()))
    };
    let processors = || measured["machine"]["processors"].as_f64().unwrap();
    Parameters {
        service_s: given("--service-s").unwrap_or_else(|| processors() / figure("sharing.one-thread.queue")),
        speedup: given("--speedup").unwrap_or_else(|| figure("sharing.one-thread.alone") / figure("sharing.by-load.alone")),
        accepted: given("--accepted").unwrap_or_else(|| figure("accepted.postgres.whole")),
        carried: given("--carried").unwrap_or(260.0),
    }
}

struct Simulated {
    /// Share of the processors' time.
    busy: f64,
    /// From arrival to beginning.
    waits_s: Vec<f64>,
    /// From arrival to end.
    done_s: Vec<f64>,
    longest_queue: usize,
}

struct Job {
    arrived_s: f64,
    /// Work that is left, in s of one thread.
    left_s: f64,
    threads: usize,
}

fn simulate(parameters: &Parameters, a_second: f64, processors: usize) -> Simulated {
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    // Amdahl: 1 / (1 - p + p / 2) = speedup.
    let parallel = (2.0 * (1.0 - 1.0 / parameters.speedup)).clamp(0.0, 1.0);
    let faster = |threads: usize| 1.0 / (1.0 - parallel + parallel / threads as f64);
    let mut simulated = Simulated { busy: 0.0, waits_s: Vec::new(), done_s: Vec::new(), longest_queue: 0 };
    let (mut waiting, mut running): (VecDeque<Job>, Vec<Job>) = (VecDeque::new(), Vec::new());
    let (mut now_s, mut arrives_s, mut arrived) = (0.0, 0.0, 0);
    while simulated.done_s.len() < STUDIES {
        let threads: usize = running.iter().map(|job| job.threads).sum();
        let share = (processors as f64 / threads.max(1) as f64).min(1.0);
        let ends_s = running.iter().map(|job| now_s + job.left_s / (faster(job.threads) * share)).fold(f64::INFINITY, f64::min);
        let next_s = if arrived < STUDIES { ends_s.min(arrives_s) } else { ends_s };
        let passed_s: f64 = next_s - now_s;
        simulated.busy += passed_s * (threads as f64 * share);
        for job in &mut running {
            job.left_s -= passed_s * faster(job.threads) * share;
        }
        now_s = next_s;
        running.retain(|job| {
            let ended = job.left_s < 1e-9;
            if ended {
                simulated.done_s.push(now_s - job.arrived_s);
            }
            !ended
        });
        if arrived < STUDIES && now_s >= arrives_s {
            let left_s = parameters.service_s * random.random_range(0.5..1.5);
            waiting.push_back(Job { arrived_s: now_s, left_s, threads: 0 });
            arrived += 1;
            arrives_s = now_s - (1.0 - random.random::<f64>()).ln() / a_second;
        }
        while running.len() < processors
            && let Some(job) = waiting.pop_front()
        {
            simulated.waits_s.push(now_s - job.arrived_s);
            let threads = Threads::ByLoad(processors).of_job(running.len() + 1, waiting.len(), processors);
            running.push(Job { threads, ..job });
        }
        simulated.longest_queue = simulated.longest_queue.max(waiting.len());
    }
    simulated.busy /= now_s * processors as f64;
    simulated
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(values.len() as f64 * share) as usize]
}
