//! Ventricle's side of `make bench-peers`: a process that stays alive, is told on standard input what to do next and answers each line with
//! a line of JSON that has the processor time it took. `benches/peers/compare.py` drives it, in turns with the programs of others.
#![allow(clippy::unwrap_used, missing_docs)]

mod measure;

use measure::{Took, Watch, heart, target, timed};
use ndarray::Array3;
use rayon::ThreadPoolBuilder;
use serde_json::{Map, Value, json};
use std::{
    env, fs,
    io::BufRead,
    path::Path,
    process::{Command, exit},
};
use ventricle::{
    pipeline::{
        self, PerSurface, Surface, borders, canny, gvf,
        monitor::Silent,
        parameters::{EdgeMode, EdgeParameters, Parameters},
        region::{self, Extent},
        simd,
    },
    study::Study,
    volume::VoxelSet,
};

fn main() {
    if env::args().nth(1).as_deref() == Some("answer") {
        answer_lines();
    } else {
        compare();
    }
}

/// Starts the driver with this program as one of the peers.
fn compare() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers");
    let python = target().join("peers/bin/python");
    if !python.exists() {
        println!("There is nothing to compare with: run `make bench-peers`, which installs it.");
        return;
    }
    let mut driver = Command::new(python);
    // One thread for each of them.
    for limit in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS"] {
        driver.env(limit, "1");
    }
    driver.env("NUMBA_CACHE_DIR", target().join("peers/numba")).env("PYTHONDONTWRITEBYTECODE", "1");
    driver.arg(folder.join("compare.py")).arg(env::current_exe().unwrap()).arg(target().join("bench/peers.json"));
    exit(driver.status().unwrap().code().unwrap_or(1));
}

fn answer_lines() {
    // One thread, this one: nothing is handed over, and the process's time is the work's.
    let pool = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    let peer = Peer::new();
    println!("{}", json!({ "ready": true, "instructions": simd::level().name() }));
    for line in std::io::stdin().lock().lines() {
        let line = line.unwrap();
        let words: Vec<&str> = line.split_whitespace().collect();
        println!("{}", pool.install(|| peer.answer(&words)));
    }
}

/// The work that is shared by all questions: eight gates of a normal heart on the paper's grid.
struct Peer {
    study: Study,
    parameters: Parameters,
    extents: Vec<Extent>,
    borders: PerSurface<borders::Border>,
}

impl Peer {
    fn new() -> Self {
        let study = heart([24, 64, 64], 8);
        let parameters = Parameters::paper();
        let extents = region::locate(&study, &parameters.region).unwrap().extents(&study);
        let gradient = canny::gradient(&study.gates[0].volume, &extents[0].known, &parameters.edges);
        let borders = borders::borders(&gradient, &extents[0], &parameters).found;
        Self { study, parameters, extents, borders }
    }

    fn answer(&self, words: &[&str]) -> Value {
        match words {
            ["export", folder] => self.export(Path::new(folder)),
            ["gvf"] => self.flow(),
            ["explicit", steps] => self.explicit(steps.parse().unwrap()),
            ["paper"] => self.paper(),
            ["gradient"] => self.edges(EdgeMode::Volume, false),
            ["canny", "slice"] => self.edges(EdgeMode::Slice, true),
            ["canny", "volume"] => self.edges(EdgeMode::Volume, true),
            _ => json!({ "error": format!("`{}` is no question", words.join(" ")) }),
        }
    }

    /// Writes the counts of all gates and the edge maps of the first one as f32 in the order of memory, and what a reader must know of them.
    fn export(&self, folder: &Path) -> Value {
        let bytes = |values: &mut dyn Iterator<Item = f32>| values.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
        let mut gates = self.study.gates.iter().flat_map(|gate| gate.volume.counts.iter().copied());
        fs::write(folder.join("gates.f32"), bytes(&mut gates)).unwrap();
        let mut shapes = Vec::new();
        for surface in Surface::BOTH {
            let map = self.map(surface);
            shapes.push(map.shape().to_vec());
            fs::write(folder.join(format!("edges-{}.f32", surface.name())), bytes(&mut map.iter().copied())).unwrap();
        }
        let (edges, deform) = (&self.parameters.edges, &self.parameters.deform);
        json!({
            "shape": self.study.grid.shape, "spacing_mm": self.study.grid.spacing_mm, "gates": self.study.gates.len(),
            "map_shapes": shapes, "base_at_last_slice": self.extents[0].towards_base() > 0.0,
            "sigma": edges.sigma, "low": edges.low, "high": edges.high,
            "mu": gvf::unit_mu(self.parameters.gvf.mu), "tolerance": self.parameters.gvf.tolerance,
            "level": self.parameters.mesh.level, "time_step_s": deform.time_step_s, "damping_percent": deform.damping_percent,
            "max_steps": deform.max_steps,
        })
    }

    /// The edge map of a surface of the first gate, on the whole grid: 1 on the border's voxels, 0 elsewhere.
    fn map(&self, surface: Surface) -> Array3<f32> {
        let mut map = Array3::zeros(self.study.grid.shape);
        for point in &self.borders.get(surface).points {
            map[point.voxel] = 1.0;
        }
        map
    }

    /// The gradient vector flow of both surfaces of the first gate on the whole grid, in memory that is kept as by a worker.
    fn flow(&self) -> Value {
        let gvf = &self.parameters.gvf;
        let maps = Surface::BOTH.map(|surface| self.map(surface));
        let mut workspace = gvf::Workspace::default();
        let mut solve = || {
            let mut solve = |map| gvf::solve(&self.study.grid, map, gvf::unit_mu(gvf.mu), gvf.tolerance, &mut workspace, &Silent).unwrap();
            maps.each_ref().map(&mut solve)
        };
        solve();
        let (took, flows) = timed(solve);
        let residual = flows.iter().flat_map(|flow| flow.residual).fold(0.0, f64::max);
        let iterations: Vec<_> = flows.iter().map(|flow| flow.iterations).collect();
        with(took, json!({ "residual": residual, "iterations": iterations }))
    }

    /// So many steps of the paper's explicit scheme for both surfaces.
    fn explicit(&self, steps: usize) -> Value {
        let maps = Surface::BOTH.map(|surface| self.map(surface));
        let run = |map| gvf::explicit::run(&self.study.grid, map, gvf::unit_mu(self.parameters.gvf.mu), 0.0, steps, &Silent).unwrap();
        let (took, flows) = timed(|| maps.each_ref().map(run));
        let made = flows.iter().flat_map(|flow| flow.iterations).min();
        with(took, json!({ "steps": made }))
    }

    /// The whole preset `paper`.
    fn paper(&self) -> Value {
        let watch = Watch::default();
        let (took, result) = timed(|| pipeline::reconstruct(&self.study, &self.parameters, &watch).unwrap());
        let volumes = |surface| result.gates.iter().map(|gate| gate.volume_ml(surface)).collect::<Vec<_>>();
        with(
            took,
            json!({
                "endocardial_ml": volumes(Surface::Endocardial), "epicardial_ml": volumes(Surface::Epicardial), "stages": watch.seconds().into_iter().map(|(stage, seconds)| (stage.to_owned(), json!(seconds))).collect::<Map<_, _>>(),
            }),
        )
    }

    /// The gradient of the first gate, and its edges without a choice among voxels.
    fn edges(&self, mode: EdgeMode, thin: bool) -> Value {
        let parameters = EdgeParameters { mode, ..self.parameters.edges };
        let volume = &self.study.gates[0].volume;
        let mut all = VoxelSet::empty(volume.grid.shape);
        all.member.fill(true);
        let (took, found) = timed(|| {
            let gradient = canny::gradient(volume, &all, &parameters);
            if thin { canny::edges(&gradient, &all, &parameters).len() } else { gradient.magnitude.len() }
        });
        with(took, json!({ "found": found }))
    }
}

/// An answer with the time that it took.
fn with(took: Took, mut answer: Value) -> Value {
    answer["seconds"] = json!(took.processor.as_secs_f64());
    answer["clock_seconds"] = json!(took.clock.as_secs_f64());
    answer
}
