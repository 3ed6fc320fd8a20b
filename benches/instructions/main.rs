//! The guard against slower code: counts of instructions, which no other load on a machine changes, of a small fixed workload under
//! valgrind, compared with what is committed in benches/instructions.json. `make guard` compares, `make guard-update` commits.
//!
//! Each workload is a run of its own of this program. What reading the study takes is a run too, and subtracted: release programs carry no
//! names that valgrind could tell functions by.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)]

mod judge;
#[path = "../measure/mod.rs"]
mod measure;

use glam::DVec3;
use judge::{Committed, complaints};
use measure::{heart, target};
use ndarray::Array3;
use rayon::ThreadPoolBuilder;
use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
};
use ventricle::{
    intake::{self, Limits, Options, Part},
    phantom::{Imaging, dicom},
    pipeline::{
        self,
        borders::{Border, BorderPoint},
        gvf,
        monitor::Silent,
        parameters::Parameters,
        simd::{self, Level},
    },
    study::Study,
    volume::{Grid, VoxelSet},
};

/// How far a count may drift before it is told: another libc chooses other instructions for the same work.
const TOLERANCE_PERCENT: f64 = 3.0;

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).filter(|argument| argument != "--bench").collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["work", name, study] => work(name, Path::new(study)),
        ["update"] => measured().map_or(ExitCode::FAILURE, update),
        _ => measured().map_or(ExitCode::FAILURE, |counts| compare(&counts)),
    }
}

type Workload = fn(&Study);

/// What is counted. The first does nothing but read the study.
const WORKLOADS: [(&str, Workload); 4] =
    [("nothing", |_| ()), ("gradient vector flow", flow), ("preset paper", paper), ("preset clinical", clinical)];

/// The gradient vector flow of two ellipsoids, about the surfaces of a ventricle, on the paper's grid.
fn flow(_: &Study) {
    let (grid, parameters) = (Imaging::PAPER_GRID, Parameters::paper().gvf);
    for half_axes in [DVec3::new(22.0, 22.0, 38.0), DVec3::new(33.0, 33.0, 48.0)] {
        gvf::flow(&grid, &shell(&grid, half_axes), &parameters, &Silent).unwrap();
    }
}

/// The voxels that the surface of an ellipsoid in the middle of a grid runs through.
fn shell(grid: &Grid, half_axes: DVec3) -> Border {
    let centre = grid.position_mm(grid.shape.map(|voxels| voxels / 2));
    let thickness = grid.smallest_spacing_mm() / half_axes.min_element() / 2.0;
    let points = VoxelSet { member: Array3::from_elem(grid.shape, true) }
        .voxels()
        .filter_map(|voxel| {
            let position_mm = grid.position_mm(voxel);
            let from_centre = (position_mm - centre) / half_axes;
            let normal = (from_centre / half_axes).normalize_or(DVec3::Z);
            ((from_centre.length() - 1.0).abs() <= thickness).then_some(BorderPoint { voxel, position_mm, normal })
        })
        .collect();
    Border { points }
}

fn paper(study: &Study) {
    pipeline::reconstruct(study, &Parameters::paper(), &Silent).unwrap();
}

fn clinical(study: &Study) {
    pipeline::reconstruct(study, &Parameters::clinical(), &Silent).unwrap();
}

/// Under valgrind: one workload on one thread, which is this one, with the instructions that valgrind knows.
fn work(name: &str, study: &Path) -> ExitCode {
    simd::use_at_most(Level::Avx2);
    let bytes = fs::read(study).unwrap();
    let parts = [Part { media_type: None, filename: None, bytes: &bytes }];
    let study = intake::read(&parts, &Options::default(), &Limits::default()).unwrap().study;
    let (_, work) = WORKLOADS.into_iter().find(|(of, _)| *of == name).unwrap();
    let pool = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    pool.install(|| work(&study));
    ExitCode::SUCCESS
}

/// The instructions of every workload.
fn measured() -> Option<BTreeMap<String, u64>> {
    let folder = target().join("bench/instructions");
    fs::create_dir_all(&folder).unwrap();
    let study = folder.join("study.dcm");
    fs::write(&study, dicom::write(&heart([12, 32, 32], 2)).unwrap()).unwrap();
    let mut counts = BTreeMap::new();
    let mut reading = 0;
    for (name, _) in WORKLOADS {
        let count = instructions(name, &study, &folder)?;
        if name == "nothing" {
            reading = count;
        } else {
            counts.insert(name.to_owned(), count - reading);
        }
    }
    Some(counts)
}

/// The instructions of a run of this program with one workload.
fn instructions(name: &str, study: &Path, folder: &Path) -> Option<u64> {
    let out = folder.join("callgrind.out");
    let status = Command::new("valgrind")
        .args(["--quiet", "--tool=callgrind"])
        .arg(format!("--callgrind-out-file={}", out.display()))
        .arg(env::current_exe().unwrap())
        .args(["work", name])
        .arg(study)
        .stdout(Stdio::null())
        .status();
    match status {
        Ok(status) if status.success() => {}
        Ok(status) => {
            eprintln!("The workload `{name}` ended under valgrind with {status}.");
            return None;
        }
        Err(error) => {
            eprintln!("valgrind could not be started: {error}. Install it (Debian package valgrind).");
            return None;
        }
    }
    let told = fs::read_to_string(out).unwrap();
    let total = told.lines().find_map(|line| line.strip_prefix("totals: ")?.split_whitespace().next()?.parse().ok());
    if total.is_none() {
        eprintln!("callgrind wrote no `totals:` for the workload `{name}`.");
    }
    total
}

fn committed() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/instructions.json")
}

fn update(counts: BTreeMap<String, u64>) -> ExitCode {
    print(&counts);
    let committed_now = Committed { tolerance_percent: TOLERANCE_PERCENT, counts };
    fs::write(committed(), serde_json::to_string_pretty(&committed_now).unwrap() + "\n").unwrap();
    ExitCode::SUCCESS
}

fn compare(counts: &BTreeMap<String, u64>) -> ExitCode {
    print(counts);
    let committed: Committed = serde_json::from_slice(&fs::read(committed()).unwrap()).unwrap();
    let complaints = complaints(&committed, counts);
    for complaint in &complaints {
        eprintln!("{complaint}");
    }
    if complaints.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn print(counts: &BTreeMap<String, u64>) {
    for (name, count) in counts {
        println!("{name}: {:.1} million instructions", *count as f64 / 1e6);
    }
}
