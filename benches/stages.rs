//! What each stage and a whole cycle take, on one thread and on all, and how that grows with voxels and gates. `make bench` prints the
//! tables of docs/performance.md and writes all of it to target/bench/stages.json.
//!
//! Stages that are functions of their own are measured by criterion. The others are measured within whole runs, by the monitor that the
//! pipeline announces them to. Times are processor time, but for whole cycles on all threads.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)]

mod measure;

use cpu_time::ProcessTime;
use criterion::{
    BatchSize, Criterion, Throughput,
    measurement::{Measurement, ValueFormatter, WallTime},
};
use measure::{Watch, heart, machine, median, target, timed};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::{Map, Value, json};
use std::{fs, hint::black_box, path::Path, time::Duration};
use ventricle::{
    analysis::analyse,
    export::glb,
    intake::{self, Limits, Options, Part},
    phantom::dicom,
    pipeline::{
        self, canny,
        monitor::Silent,
        parameters::{Parameters, Preset},
        pose, region,
    },
    report::{self, Timing},
    study::Study,
};

/// How often a whole cycle runs, unless `--test` asks for no more than that everything runs (`cargo bench --bench stages -- --test`).
const ROUNDS: usize = 5;
/// Rows of the table of cost: `[z, y, x]` and gates.
const SIZES: [([usize; 3], usize); 4] = [([12, 32, 32], 8), ([24, 64, 64], 8), ([32, 64, 64], 16), ([48, 128, 128], 8)];
/// Rounds of that table; the largest is eight times the usual study, about as many voxels as phantoms may have.
const SIZE_ROUNDS: usize = 3;

fn main() {
    let only_tests = std::env::args().any(|argument| argument == "--test");
    let (rounds, size_rounds) = if only_tests { (1, 1) } else { (ROUNDS, SIZE_ROUNDS) };
    let mut criterion = Criterion::default()
        .with_measurement(ProcessorTime(WallTime))
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .sample_size(10)
        .without_plots()
        .output_directory(&target().join("criterion"))
        .configure_from_args();
    // This thread and no other: from now on it is the pool's, installed or not.
    let one = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    let all = ThreadPoolBuilder::new().build().unwrap();
    let eight_gates = heart([24, 64, 64], 8);
    alone(&mut criterion, &eight_gates);
    criterion.final_summary();
    let found = json!({
        "machine": machine(),
        "alone": estimates(&target().join("criterion/stages")),
        "cycles": cycles(&one, &all, eight_gates, rounds),
        "sizes": sizes(&one, size_rounds),
    });
    let folder = target().join("bench");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("stages.json"), serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
    print(&found);
}

/// Processor time of the process, told as criterion tells seconds.
struct ProcessorTime(WallTime);

impl Measurement for ProcessorTime {
    type Intermediate = ProcessTime;
    type Value = Duration;

    fn start(&self) -> ProcessTime {
        ProcessTime::now()
    }

    fn end(&self, began: ProcessTime) -> Duration {
        began.elapsed()
    }

    fn add(&self, a: &Duration, b: &Duration) -> Duration {
        *a + *b
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        self.0.formatter()
    }
}

/// The stages that are functions of their own, on eight gates of the paper's grid unless a gate is said.
fn alone(criterion: &mut Criterion<ProcessorTime>, study: &Study) {
    let mut group = criterion.benchmark_group("stages");
    let bytes = dicom::write(study).unwrap();
    let decode = || {
        let parts = [Part { media_type: None, filename: None, bytes: &bytes }];
        intake::read(&parts, &Options::default(), &Limits::default()).unwrap()
    };
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("decode DICOM", |bench| bench.iter(decode));
    let (clinical, paper) = (Parameters::clinical(), Parameters::paper());
    group.throughput(Throughput::Elements((study.grid.voxels() * study.gates.len()) as u64));
    group.bench_function("localisation", |bench| bench.iter(|| pose::find(study, &clinical.pose, &clinical.region, &Silent).unwrap()));
    group.bench_function("region", |bench| bench.iter(|| region::locate(study, &paper.region).unwrap().extents(black_box(study))));
    let extents = region::locate(study, &paper.region).unwrap().extents(study);
    group.throughput(Throughput::Elements(study.grid.voxels() as u64));
    group.bench_function("edges of a gate", |bench| {
        bench.iter(|| canny::gradient(black_box(&study.gates[0].volume), &extents[0].known, &paper.edges));
    });
    for (preset, parameters) in [("clinical", &clinical), ("paper", &paper)] {
        let reconstruction = pipeline::reconstruct(study, parameters, &Silent).unwrap();
        group.throughput(Throughput::Elements(study.gates.len() as u64));
        group.bench_function(format!("analysis, {preset}"), |bench| bench.iter(|| analyse(study, black_box(&reconstruction))));
        let analysis = analyse(study, &reconstruction);
        group.bench_function(format!("report, {preset}"), |bench| {
            bench.iter(|| serde_json::to_vec(&report::build("bench", study, &reconstruction, &analysis, &Timing::default())).unwrap());
        });
        group.bench_function(format!("glTF, {preset}"), |bench| {
            bench.iter_batched(|| (), |()| glb::cycle(study, &reconstruction, &analysis).unwrap(), BatchSize::PerIteration);
        });
    }
    group.finish();
}

/// Medians and their 95 % intervals in seconds, by the name of the function, as criterion has written them.
fn estimates(folder: &Path) -> Value {
    let mut found = Map::new();
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let folder = entry.unwrap().path().join("new");
        let read = |name: &str| -> Option<Value> { serde_json::from_slice(&fs::read(folder.join(name)).ok()?).ok() };
        let (Some(about), Some(estimates)) = (read("benchmark.json"), read("estimates.json")) else { continue };
        let seconds = |of: &Value| of.as_f64().unwrap_or(f64::NAN) / 1e9;
        let (median, interval) = (&estimates["median"], &estimates["median"]["confidence_interval"]);
        let row = json!({
            "median_s": seconds(&median["point_estimate"]), "least_s": seconds(&interval["lower_bound"]), "most_s": seconds(&interval["upper_bound"]),
        });
        found.insert(about["function_id"].as_str().unwrap_or_default().to_owned(), row);
    }
    found.into()
}

/// Both presets on two studies, in turns; on one thread with the time of each stage.
fn cycles(one: &ThreadPool, all: &ThreadPool, eight_gates: Study, rounds: usize) -> Vec<Value> {
    let studies = [eight_gates, heart([32, 64, 64], 16)];
    let presets = [Parameters::clinical(), Parameters::paper()];
    let runs: Vec<(&Study, &Parameters)> = studies.iter().flat_map(|study| presets.iter().map(move |preset| (study, preset))).collect();
    let mut measured: Vec<Cycle> = runs.iter().map(|_| Cycle::default()).collect();
    for round in 1..=rounds {
        eprintln!("whole cycles, round {round} of {rounds}");
        for ((study, parameters), cycle) in runs.iter().zip(&mut measured) {
            let watch = Watch::default();
            let (took, _) = one.install(|| timed(|| pipeline::reconstruct(study, parameters, &watch).unwrap()));
            cycle.processor_s.push(took.processor.as_secs_f64());
            cycle.clock_s.push(took.clock.as_secs_f64());
            cycle.stages.push(watch.seconds());
            let (took, _) = all.install(|| timed(|| pipeline::reconstruct(study, parameters, &Silent).unwrap()));
            cycle.all_threads_clock_s.push(took.clock.as_secs_f64());
        }
    }
    runs.iter().zip(measured).map(|((study, parameters), cycle)| cycle.told(study, parameters, all.current_num_threads())).collect()
}

/// What each round measured of one preset on one study.
#[derive(Default)]
struct Cycle {
    processor_s: Vec<f64>,
    clock_s: Vec<f64>,
    all_threads_clock_s: Vec<f64>,
    stages: Vec<Vec<(&'static str, f64)>>,
}

impl Cycle {
    fn told(self, study: &Study, parameters: &Parameters, threads: usize) -> Value {
        let stage = |place: usize| median(self.stages.iter().map(|round| round[place].1).collect());
        let stages: Vec<Value> =
            self.stages[0].iter().enumerate().map(|(place, (name, _))| json!({ "stage": name, "processor_s": stage(place) })).collect();
        json!({
            "preset": preset(parameters), "shape": study.grid.shape, "gates": study.gates.len(), "rounds": self.processor_s.len(),
            "processor_s": median(self.processor_s), "clock_s": median(self.clock_s), "stages": stages,
            "all_threads": threads, "all_threads_clock_s": median(self.all_threads_clock_s),
        })
    }
}

fn preset(parameters: &Parameters) -> &'static str {
    match parameters.preset {
        Preset::Clinical => "clinical",
        Preset::Paper => "paper",
    }
}

/// The preset `clinical` on the same heart in voxels of four sizes, and the exponent of its cost.
fn sizes(one: &ThreadPool, rounds: usize) -> Value {
    let parameters = Parameters::clinical();
    let studies: Vec<Study> = SIZES.iter().map(|&(shape, gates)| heart(shape, gates)).collect();
    let mut seconds = vec![Vec::new(); studies.len()];
    for round in 1..=rounds {
        eprintln!("four sizes, round {round} of {rounds}");
        for (study, seconds) in studies.iter().zip(&mut seconds) {
            let (took, _) = one.install(|| timed(|| pipeline::reconstruct(study, &parameters, &Silent).unwrap()));
            seconds.push(took.processor.as_secs_f64());
        }
    }
    let rows: Vec<(usize, f64)> =
        studies.iter().zip(seconds).map(|(study, seconds)| (study.grid.voxels() * study.gates.len(), median(seconds))).collect();
    let told: Vec<Value> = SIZES
        .iter()
        .zip(&rows)
        .map(|((shape, gates), (voxels, seconds))| json!({ "shape": shape, "gates": gates, "voxels": voxels, "processor_s": seconds }))
        .collect();
    json!({ "rows": told, "exponent": exponent(&rows) })
}

/// Slope of the line through the logarithms, by least squares.
fn exponent(rows: &[(usize, f64)]) -> f64 {
    let points: Vec<(f64, f64)> = rows.iter().map(|&(voxels, seconds)| ((voxels as f64).ln(), seconds.ln())).collect();
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / points.len() as f64;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let (shared, spread) =
        points.iter().fold((0.0, 0.0), |(shared, spread), point| (shared + (point.0 - x) * (point.1 - y), spread + (point.0 - x).powi(2)));
    shared / spread
}

/// The tables of docs/performance.md.
fn print(found: &Value) {
    let about = &found["machine"];
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    println!(
        "\n{}, {} processors, Linux {}, {}, instructions {}.",
        text(&about["processor"]),
        about["processors"],
        text(&about["kernel"]),
        text(&about["rustc"]),
        text(&about["instructions"])
    );
    println!("\n| on its own, one thread | processor time | 95 % interval |\n|---|---|---|");
    for (name, row) in found["alone"].as_object().into_iter().flatten() {
        println!("| {name} | {} | {} to {} |", duration(&row["median_s"]), duration(&row["least_s"]), duration(&row["most_s"]));
    }
    println!("\n| whole cycle | processor time, one thread | clock, one thread | clock, all threads | ratio |\n|---|---|---|---|---|");
    let cycles = || found["cycles"].as_array().into_iter().flatten();
    for cycle in cycles() {
        let ratio = seconds(&cycle["clock_s"]) / seconds(&cycle["all_threads_clock_s"]);
        println!(
            "| {} | {} | {} | {} | {ratio:.2} |",
            of(cycle),
            duration(&cycle["processor_s"]),
            duration(&cycle["clock_s"]),
            duration(&cycle["all_threads_clock_s"])
        );
    }
    println!("\n| whole cycle | stage | processor time | part |\n|---|---|---|---|");
    for cycle in cycles() {
        for stage in cycle["stages"].as_array().into_iter().flatten() {
            let part = 100.0 * seconds(&stage["processor_s"]) / seconds(&cycle["processor_s"]);
            println!("| {} | {} | {} | {part:.1} % |", of(cycle), text(&stage["stage"]), duration(&stage["processor_s"]));
        }
    }
    println!("\n| voxels × gates | all voxels | processor time | ns a voxel |\n|---|---|---|---|");
    for row in found["sizes"]["rows"].as_array().into_iter().flatten() {
        let voxels = row["voxels"].as_f64().unwrap_or(f64::NAN);
        println!("| {} | {voxels} | {} | {:.0} |", size(row), duration(&row["processor_s"]), seconds(&row["processor_s"]) / voxels * 1e9);
    }
    println!("\nFitted exponent: {:.2}.", found["sizes"]["exponent"].as_f64().unwrap_or(f64::NAN));
}

fn of(cycle: &Value) -> String {
    format!("{}, {}", cycle["preset"].as_str().unwrap_or_default(), size(cycle))
}

fn size(row: &Value) -> String {
    format!("{} × {} × {} × {}", row["shape"][2], row["shape"][1], row["shape"][0], row["gates"])
}

fn seconds(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn duration(value: &Value) -> String {
    match seconds(value) {
        s if s >= 1.0 => format!("{s:.2} s"),
        s if s >= 1e-3 => format!("{:.1} ms", s * 1e3),
        s => format!("{:.0} µs", s * 1e6),
    }
}
