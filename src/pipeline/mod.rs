//! From a study to its ventricle: García & Susín's method, section 8 of the paper, one file a stage.
//!
//! Pure functions: no clock, files, network, environment or database. The same study and parameters give the same result to the last
//! bit at any number of threads.

mod arc;
mod axis;
pub mod block_matrix;
pub mod borders;
pub mod canny;
pub mod conditions;
pub mod deform;
mod ends;
mod freeze;
pub mod gaps;
pub mod gvf;
pub mod integrate;
pub mod measure;
pub mod models;
pub mod monitor;
pub mod parameters;
mod plain;
pub mod region;
pub mod rest;
mod rings;
pub mod smooth;
pub mod thickness;
pub mod trace;
pub mod wall;

use crate::{
    mesh::{Mesh, wall::Wall},
    study::{Study, Warning},
    volume::{Grid, Volume},
};
use borders::Borders;
use gvf::Flow;
use monitor::{Monitor, Stage};
use parameters::{Parameters, Seed};
use rayon::prelude::*;
use region::Extent;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicUsize, Ordering};

/// The two surfaces of the ventricular wall.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Surface {
    /// The inner surface, around the cavity.
    Endocardial,
    /// The outer surface.
    Epicardial,
}

impl Surface {
    /// Both surfaces, inner first.
    pub const BOTH: [Self; 2] = [Self::Endocardial, Self::Epicardial];

    /// The name used in JSON, glTF and URLs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Endocardial => "endocardial",
            Self::Epicardial => "epicardial",
        }
    }
}

/// One value for each surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct PerSurface<T> {
    /// Of the inner surface.
    pub endocardial: T,
    /// Of the outer surface.
    pub epicardial: T,
}

impl<T> PerSurface<T> {
    /// The value of a function for each surface.
    pub fn of(mut value: impl FnMut(Surface) -> T) -> Self {
        Self { endocardial: value(Surface::Endocardial), epicardial: value(Surface::Epicardial) }
    }

    /// The value of one surface.
    pub fn get(&self, surface: Surface) -> &T {
        match surface {
            Surface::Endocardial => &self.endocardial,
            Surface::Epicardial => &self.epicardial,
        }
    }
}

/// A fitted surface and how it was reached.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The surface in grid mm.
    pub mesh: Mesh,
    /// Time steps until all particles were frozen or the evolution was ended.
    pub steps: usize,
    /// What ended the evolution.
    pub stop: rest::Stop,
    /// Fraction of particles that froze on the border, 0-1.
    pub frozen: f64,
    /// Fraction of particles less than one voxel (the largest spacing) from a border voxel's centre, 0-1. Says how far the evolution
    /// converged (the paper's Table 1), not how right the surface is.
    pub within_one_voxel: f64,
    /// Mean distance of the particles to the nearest border voxel's centre, in mm.
    pub mean_distance_mm: f64,
    /// Relative residual of the gradient vector flow the particles followed, one a component of the field (x, y, z).
    pub gvf_residual: [f64; 3],
    /// Iterations of that solve, likewise.
    pub gvf_iterations: [usize; 3],
    /// Distances to the border over time, if they were asked for.
    pub trace: Option<trace::Trace>,
}

/// One gate's result.
#[derive(Debug, Clone, PartialEq)]
pub struct GateReconstruction {
    /// Both surfaces.
    pub fits: PerSurface<Fit>,
    /// What putting the wall between them in order took.
    pub wall_order: wall::WallOrder,
}

impl GateReconstruction {
    /// The wall between the surfaces as tetrahedra, in grid mm; `None` if the surfaces differ in topology, which no reconstruction's do.
    pub fn wall(&self) -> Option<Wall> {
        Wall::between(&self.fits.endocardial.mesh, &self.fits.epicardial.mesh)
    }

    /// Volume inside a surface, up to the valve plane, in ml.
    pub fn volume_ml(&self, surface: Surface) -> f64 {
        self.fits.get(surface).mesh.volume_ml()
    }

    /// Volume between the surfaces in ml.
    pub fn myocardial_ml(&self) -> f64 {
        self.volume_ml(Surface::Epicardial) - self.volume_ml(Surface::Endocardial)
    }
}

/// Where the ventricle was looked for: the marks that were given and, for the rest, the estimates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Centre `[x, y]` in grid mm, half way between the ends.
    pub centre_mm: [f64; 2],
    /// How far the centre moves `[x, y]` a mm of z: the tilt of the ventricle's axis against the stack.
    pub axis_slope: [f64; 2],
    /// Radius of the filtering circle in mm.
    pub radius_mm: f64,
    /// First useful slice, counted from 1.
    pub first_slice: usize,
    /// Last useful slice, counted from 1.
    pub last_slice: usize,
    /// Whether the base is at the last slice (`false`: at the first; the stack runs from base to apex).
    pub base_at_last_slice: bool,
}

/// The reconstructed cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// One result a gate of the study, in order.
    pub gates: Vec<GateReconstruction>,
    /// Where the ventricle was found.
    pub region: Region,
    /// The parameters used.
    pub parameters: Parameters,
    /// What the reader should know.
    pub warnings: Vec<Warning>,
}

/// Why a study could not be reconstructed. Each is a sentence for the user and has a stable code.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PipelineError {
    /// The monitor said stop.
    #[error("The reconstruction was cancelled.")]
    Cancelled,
    /// Nothing in the counts looks like a left ventricle.
    #[error("No left ventricle was found: {why}. Send a short-axis reconstruction of the heart, or mark the ventricle with `region`.")]
    NoLeftVentricle {
        /// What was looked for and not found.
        why: String,
    },
    /// A mark given in the request does not fit the study.
    #[error("The given region does not fit the study: {why}.")]
    RegionOutside {
        /// Which mark, its value and the limits.
        why: String,
    },
    /// The slices are said not to be short axis, and nothing was found in them.
    #[error(
        "The file names its slices as long-axis slices, and in them no left ventricle was reconstructed ({why}). The method looks for rings: \
         send the study resliced to its short axis."
    )]
    NotShortAxis {
        /// What was looked for and not found.
        why: String,
    },
    /// A gate has no usable border.
    #[error("Gate {gate}: no {} border was found: {why}.", surface.name())]
    NoBorder {
        /// Counted from 1.
        gate: usize,
        /// Which border.
        surface: Surface,
        /// What was looked for and not found.
        why: String,
    },
    /// The evolution ended in something that is not a ventricle.
    #[error("Gate {gate}: the {} mesh did not converge: {why}.", surface.name())]
    NotConverged {
        /// Counted from 1.
        gate: usize,
        /// Which surface.
        surface: Surface,
        /// What went wrong.
        why: String,
    },
}

impl PipelineError {
    /// The same error, or the orientation as its likely cause where intake had doubts about it.
    fn for_want_of_short_axis(self, study: &Study) -> Self {
        let doubtful = study.warnings.iter().any(|warning| warning.code == crate::study::LONG_AXIS_SLICES);
        match self {
            Self::NoLeftVentricle { why } | Self::NoBorder { why, .. } | Self::NotConverged { why, .. } if doubtful => {
                Self::NotShortAxis { why }
            }
            error => error,
        }
    }

    /// The stable code of the problem.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Cancelled => "cancelled",
            Self::NoLeftVentricle { .. } => "no_left_ventricle",
            Self::NotShortAxis { .. } => "not_short_axis",
            Self::RegionOutside { .. } => "region_outside_study",
            Self::NoBorder { .. } => "no_border",
            Self::NotConverged { .. } => "not_converged",
        }
    }
}

/// Reconstructs every gate of a study.
///
/// The steps of the paper's section 8: the region, then for every gate Canny edges, borders, gradient vector flow, the
/// evolution of both surfaces, and the order of the wall between them. Gates run in parallel on the caller's rayon pool, the evolutions one
/// after the other where each starts from the gate before ([`Seed::PreviousGate`]); nothing is reduced across them in parallel.
pub fn reconstruct(study: &Study, parameters: &Parameters, monitor: &dyn Monitor) -> Result<Reconstruction, PipelineError> {
    reconstruct_cycle(study, parameters, monitor).map_err(|error| error.for_want_of_short_axis(study))
}

fn reconstruct_cycle(study: &Study, parameters: &Parameters, monitor: &dyn Monitor) -> Result<Reconstruction, PipelineError> {
    let (location, extents) = observed(monitor, Stage::Region, None, || {
        let location = region::locate(study, &parameters.region)?;
        let extents = location.extents(study);
        Ok((location, extents))
    })?;
    let found = study
        .gates
        .par_iter()
        .enumerate()
        .map(|(gate, counts)| find_borders(gate, &counts.volume, &extents[gate], parameters, monitor))
        .collect::<Vec<_>>();
    let found = first_error(found)?;
    let gates = evolve_cycle(study, &found, parameters, monitor)?;
    let mut warnings = location.warnings();
    let region = location.region(&study.grid);
    let unseen = |(gate, borders): (usize, &Borders)| {
        gaps::warnings(gate + 1, &borders.coverage, &borders.unseen, study.orientation.as_ref(), region.base_at_last_slice)
    };
    warnings.extend(found.iter().enumerate().flat_map(unseen));
    warnings.extend(gates.iter().enumerate().filter_map(|(gate, result)| wall::warning(gate + 1, &result.wall_order)));
    Ok(Reconstruction { gates, region, parameters: parameters.clone(), warnings })
}

/// All results, or of several failures the first gate's, whichever thread was first.
fn first_error<T>(results: Vec<Result<T, PipelineError>>) -> Result<Vec<T>, PipelineError> {
    results.into_iter().collect()
}

/// Both borders of a gate, each fit to carry a surface.
fn find_borders(
    gate: usize,
    counts: &Volume,
    extent: &Extent,
    parameters: &Parameters,
    monitor: &dyn Monitor,
) -> Result<Borders, PipelineError> {
    let in_gate = Some(gate);
    let gradient = observed(monitor, Stage::Edges, in_gate, || Ok(canny::gradient(counts, &extent.known, &parameters.edges)))?;
    let borders = observed(monitor, Stage::Borders, in_gate, || Ok(borders::borders(&gradient, extent, parameters)))?;
    for surface in Surface::BOTH {
        borders::check(gate + 1, surface, borders.found.get(surface))?;
    }
    Ok(borders)
}

/// Draws the meshes of every gate to their borders. Gates run in parallel unless each starts from the one before.
fn evolve_cycle(
    study: &Study,
    borders: &[Borders],
    parameters: &Parameters,
    monitor: &dyn Monitor,
) -> Result<Vec<GateReconstruction>, PipelineError> {
    let total = borders.len();
    let done = AtomicUsize::new(0);
    monitor.advance(0, total);
    let ellipsoids = |of: &[Borders]| {
        PerSurface::of(|surface| deform::ellipsoid(of.iter().flat_map(|gate| &gate.found.get(surface).points), &parameters.mesh))
    };
    let evolve = |gate: usize, seeds: PerSurface<Mesh>| {
        let result = evolve_gate(gate, &study.grid, &borders[gate], seeds, parameters, monitor);
        monitor.advance(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        result
    };
    let own = |gate: usize| ellipsoids(&borders[gate..=gate]);
    match parameters.mesh.seed {
        Seed::OwnEllipsoid => first_error((0..total).into_par_iter().map(|gate| evolve(gate, own(gate))).collect()),
        Seed::CommonEllipsoid => {
            let common = ellipsoids(borders);
            first_error((0..total).into_par_iter().map(|gate| evolve(gate, common.clone())).collect())
        }
        Seed::PreviousGate => {
            let mut gates: Vec<GateReconstruction> = Vec::with_capacity(total);
            for gate in 0..total {
                let seeds = gates.last().map_or_else(|| own(gate), |last| PerSurface::of(|surface| last.fits.get(surface).mesh.clone()));
                gates.push(evolve(gate, seeds)?);
            }
            Ok(gates)
        }
    }
}

fn evolve_gate(
    gate: usize,
    grid: &Grid,
    borders: &Borders,
    seeds: PerSurface<Mesh>,
    parameters: &Parameters,
    monitor: &dyn Monitor,
) -> Result<GateReconstruction, PipelineError> {
    let in_gate = Some(gate);
    let evolve = |surface: Surface, seed: Mesh| {
        let border = borders.found.get(surface);
        let flow = observed(monitor, Stage::GradientVectorFlow, in_gate, || gvf::flow(grid, border, &parameters.gvf, monitor))?;
        let setting = deform::Setting { grid, border, flow: &flow, parameters, monitor };
        let evolved = observed(monitor, Stage::Deformation, in_gate, || deform::evolve(seed, &setting, &mut |_| ()))?;
        Ok((evolved, flow))
    };
    let (inner, outer) = rayon::join(|| evolve(Surface::Endocardial, seeds.endocardial), || evolve(Surface::Epicardial, seeds.epicardial));
    let ((mut inner, inner_flow), (mut outer, outer_flow)) = (inner?, outer?);
    let wall_order = observed(monitor, Stage::Wall, in_gate, || Ok(wall::order(&mut inner.mesh, &mut outer.mesh)))?;
    let result = observed(monitor, Stage::Measurement, in_gate, || {
        let swings = !parameters.deform.freezing;
        let fit =
            |surface, evolved, flow: &Flow| measure::fit((gate + 1, surface), evolved, borders.found.get(surface), flow, grid, swings);
        let fits = PerSurface {
            endocardial: fit(Surface::Endocardial, inner, &inner_flow)?,
            epicardial: fit(Surface::Epicardial, outer, &outer_flow)?,
        };
        Ok(GateReconstruction { fits, wall_order })
    })?;
    if parameters.deform.freezing {
        measure::check(gate + 1, &result)?;
    }
    Ok(result)
}

/// Runs a stage between its announcements.
fn observed<T>(
    monitor: &dyn Monitor,
    stage: Stage,
    gate: Option<usize>,
    work: impl FnOnce() -> Result<T, PipelineError>,
) -> Result<T, PipelineError> {
    monitor::check(monitor)?;
    monitor.begin(stage, gate);
    let result = work();
    monitor.end(stage, gate);
    result
}
