//! A simulated gate with its borders, from which every run of the tables starts: the same border and field for every model and solver.

use super::{PaperError, printed};
use crate::{
    mesh::Mesh,
    phantom::{self, Phantom, Simulation, Truth},
    pipeline::{
        PerSurface, Surface,
        borders::{self, Border, Borders},
        canny,
        deform::{self, Evolved, Moment, Setting},
        gvf::{self, Flow},
        measure,
        monitor::Silent,
        parameters::{MeshParameters, Parameters, RegionMarks},
        region::{self, Extent},
    },
    volume::{Grid, Volume},
};
use std::time::Instant;

/// One gate of a simulated study with the borders found in it.
#[derive(Debug, Clone)]
pub struct Experiment {
    /// The study and its truth.
    pub simulation: Simulation,
    /// Which gate, from 0.
    pub gate: usize,
    /// Where the ventricle lies.
    pub extent: Extent,
    /// Its borders.
    pub borders: Borders,
}

/// One evolution and what is measured on it.
#[derive(Debug, Clone)]
pub struct Run {
    /// The mesh and how it ended.
    pub evolved: Evolved,
    /// Wall-clock seconds of the evolution alone: the field is the same for all.
    pub seconds: f64,
    /// Fraction of the particles less than one voxel from the border, 0-1.
    pub within_one_voxel: f64,
    /// Mean distance of the particles to the nearest border voxel's centre in mm.
    pub mean_distance_mm: f64,
}

impl Run {
    /// Simulated time in s.
    pub fn simulated_s(&self, parameters: &Parameters) -> f64 {
        self.evolved.steps as f64 * parameters.deform.time_step_s
    }
}

impl Experiment {
    /// Simulates a phantom and finds the borders of one of its gates (from 0).
    ///
    /// Errors: those of the simulation and of the region.
    pub fn new(phantom: &Phantom, gate: usize, parameters: &Parameters) -> Result<Self, PaperError> {
        Self::of(phantom::simulate(phantom)?, gate, parameters)
    }

    /// Finds the borders of one gate (from 0) of a simulated study.
    fn of(simulation: Simulation, gate: usize, parameters: &Parameters) -> Result<Self, PaperError> {
        let location = region::locate(&simulation.study, &parameters.region)?;
        let extent = location.extents(&simulation.study).swap_remove(gate);
        let gradient = canny::gradient(&simulation.study.gates[gate].volume, &extent.known, &parameters.edges);
        let borders = borders::borders(&gradient, &extent, parameters);
        for surface in Surface::BOTH {
            borders::check(gate + 1, surface, borders.found.get(surface))?;
        }
        Ok(Self { simulation, gate, extent, borders })
    }

    /// The paper's phantom with the exact marks in place of the paper's manual ones.
    pub fn paper_phantom() -> Result<Self, PaperError> {
        let phantom = Phantom::paper();
        let simulation = phantom::simulate(&phantom)?;
        let region = exact_marks(&phantom, &simulation.truth);
        Self::of(simulation, 0, &Parameters { region, ..Parameters::paper() })
    }

    /// The lattice.
    pub fn grid(&self) -> &Grid {
        &self.simulation.study.grid
    }

    /// The gate's counts.
    pub fn counts(&self) -> &Volume {
        &self.simulation.study.gates[self.gate].volume
    }

    /// One border.
    pub fn border(&self, surface: Surface) -> &Border {
        self.borders.found.get(surface)
    }

    /// The field of one border.
    pub fn flow(&self, surface: Surface, parameters: &Parameters) -> Result<Flow, PaperError> {
        Ok(gvf::flow(self.grid(), self.border(surface), &parameters.gvf, &Silent)?)
    }

    /// The fields of both borders.
    pub fn flows(&self, parameters: &Parameters) -> Result<PerSurface<Flow>, PaperError> {
        let [endocardial, epicardial] = Surface::BOTH.map(|surface| self.flow(surface, parameters));
        Ok(PerSurface { endocardial: endocardial?, epicardial: epicardial? })
    }

    /// The initial mesh of a surface (§7.3).
    pub fn seed(&self, surface: Surface, level: u32) -> Mesh {
        self.seed_scaled(surface, level, 1.0)
    }

    /// The initial mesh enlarged about its middle until its area is that of the printed mesh of as many triangles (Table 2): the paper's
    /// meshes start outside the data.
    pub fn seed_of_printed_area(&self, surface: Surface, level: u32) -> Mesh {
        let seed = self.seed(surface, level);
        let printed = printed::TRIANGLES.iter().position(|&triangles| triangles == seed.triangles.len());
        let scale = printed.map_or(1.0, |mesh| (printed::initial_area_mm2(mesh) / seed.area_mm2()).sqrt());
        self.seed_scaled(surface, level, scale)
    }

    /// The initial mesh of a run: of the printed area (outside the border), or bounding it.
    pub fn start(&self, surface: Surface, level: u32, from_outside: bool) -> Mesh {
        if from_outside { self.seed_of_printed_area(surface, level) } else { self.seed(surface, level) }
    }

    fn seed_scaled(&self, surface: Surface, level: u32, seed_scale: f64) -> Mesh {
        let mesh = MeshParameters { level, seed_scale, ..Parameters::paper().mesh };
        deform::ellipsoid(&self.border(surface).points, &mesh)
    }

    /// Lets the bounding ellipsoid of a surface evolve in a field; `watch` sees the seed and every step.
    pub fn run(
        &self,
        surface: Surface,
        flow: &Flow,
        parameters: &Parameters,
        watch: &mut dyn FnMut(&Moment<'_>),
    ) -> Result<Run, PaperError> {
        self.run_from(self.seed(surface, parameters.mesh.level), surface, flow, parameters, watch)
    }

    /// Lets a mesh evolve to the border of a surface in its field.
    pub fn run_from(
        &self,
        seed: Mesh,
        surface: Surface,
        flow: &Flow,
        parameters: &Parameters,
        watch: &mut dyn FnMut(&Moment<'_>),
    ) -> Result<Run, PaperError> {
        let border = self.border(surface);
        let setting = Setting { grid: self.grid(), border, flow, parameters, monitor: &Silent };
        let start = Instant::now();
        let evolved = deform::evolve(seed, &setting, watch)?;
        let seconds = start.elapsed().as_secs_f64();
        let distances = measure::distances(&evolved.mesh.positions, border, self.grid());
        Ok(Run { evolved, seconds, within_one_voxel: distances.within_one_voxel, mean_distance_mm: distances.mean_mm })
    }
}

/// The marks of §8, steps 1 and 2, as someone would set them who knows the phantom: its axis, the slices that it reaches into, and a circle
/// 20 mm outside of it.
pub fn exact_marks(phantom: &Phantom, truth: &Truth) -> RegionMarks {
    const ROOM_MM: f64 = 20.0;
    let Some((apex, base)) = truth.gates.first().and_then(|gate| gate.apex_mm.zip(gate.base_mm)) else {
        return RegionMarks::default();
    };
    let grid = phantom.imaging.grid;
    let slice = |z_mm: f64| ((z_mm / grid.spacing_mm[0]).round().max(0.0) as usize).min(grid.shape[0] - 1) + 1;
    let outer_mm = phantom.shape.surfaces(0.0).map_or(0.0, |surfaces| surfaces.epicardium.widest_radius_mm());
    RegionMarks {
        centre_mm: Some([f64::midpoint(apex[0], base[0]), f64::midpoint(apex[1], base[1])]),
        radius_mm: Some(outer_mm + ROOM_MM),
        first_slice: Some(slice(apex[2].min(base[2]))),
        last_slice: Some(slice(apex[2].max(base[2]))),
    }
}
