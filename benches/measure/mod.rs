//! What the benches share: the studies they work on, processor time, and where it was measured.
#![allow(dead_code, clippy::unwrap_used)] // each bench uses its part

use cpu_time::ProcessTime;
use serde_json::{Map, Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::Mutex,
    thread,
    time::{Duration, Instant},
};
use ventricle::{
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    pipeline::{
        monitor::{Monitor, Stage},
        simd,
    },
    study::Study,
    volume::Grid,
};

/// A normal heart in the field of the paper's grid, whatever the number of voxels it is divided into: shape `[z, y, x]`.
pub(crate) fn heart(shape: [usize; 3], gates: usize) -> Study {
    let field = Imaging::PAPER_GRID;
    let spacing_mm = [0, 1, 2].map(|axis| field.spacing_mm[axis] * field.shape[axis] as f64 / shape[axis] as f64);
    let imaging = Imaging { grid: Grid { shape, spacing_mm }, gates, ..Imaging::default() };
    phantom::simulate(&Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) }).unwrap().study
}

/// What some work took.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Took {
    /// Processor time of the process, all its threads together.
    pub(crate) processor: Duration,
    pub(crate) clock: Duration,
}

/// Does some work and measures it.
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> (Took, T) {
    let (processor, clock) = (ProcessTime::now(), Instant::now());
    let result = work();
    (Took { processor: processor.elapsed(), clock: clock.elapsed() }, result)
}

/// The middle one; of an even number the lower of the two.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(values.len() - 1) / 2]
}

/// Adds up the processor time of each stage. On one thread only: there stages do not overlap.
#[derive(Default)]
pub(crate) struct Watch(Mutex<Vec<(Stage, Option<ProcessTime>, Duration)>>);

impl Watch {
    /// Seconds of each stage that ran, in the order of their first run.
    pub(crate) fn seconds(&self) -> Vec<(&'static str, f64)> {
        self.0.lock().unwrap().iter().map(|(stage, _, total)| (stage.name(), total.as_secs_f64())).collect()
    }
}

impl Monitor for Watch {
    fn begin(&self, stage: Stage, _gate: Option<usize>) {
        let mut stages = self.0.lock().unwrap();
        let place = stages.iter().position(|(of, ..)| *of == stage).unwrap_or_else(|| {
            stages.push((stage, None, Duration::ZERO));
            stages.len() - 1
        });
        stages[place].1 = Some(ProcessTime::now());
    }

    fn end(&self, stage: Stage, _gate: Option<usize>) {
        let mut stages = self.0.lock().unwrap();
        for (_, began, total) in stages.iter_mut().filter(|(of, ..)| *of == stage) {
            *total += began.take().map_or(Duration::ZERO, |began| began.elapsed());
        }
    }
}

/// The directory that cargo builds into.
pub(crate) fn target() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap().to_owned()
}

/// The machine that measures.
pub(crate) fn machine() -> Map<String, Value> {
    let told = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let processor =
        told.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": ")).map_or(std::env::consts::ARCH, |(_, name)| name);
    let kernel = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let rustc = Command::new("rustc")
        .arg("--version")
        .output()
        .map_or_else(|_| String::new(), |out| String::from_utf8_lossy(&out.stdout).into_owned());
    let processors = thread::available_parallelism().map_or(1, usize::from);
    let about = json!({
        "processor": processor, "processors": processors, "kernel": kernel.trim(), "rustc": rustc.trim(), "instructions": simd::level().name(),
    });
    about.as_object().unwrap().clone()
}
