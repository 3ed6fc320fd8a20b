//! From a study to its ventricle: García & Susín's method, section 8 of the paper, one file a stage.
//!
//! Pure functions: no clock, files, network, environment or database. The same study and parameters give the same result to the last
//! bit at any number of threads.

mod arc;
mod axis;
pub mod block_matrix;
pub mod borders;
pub mod canny;
pub mod clinical;
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
mod nearest;
mod paper;
pub mod parameters;
mod plain;
pub mod pose;
pub mod region;
pub mod rest;
mod ring_scan;
mod rings;
pub mod simd;
pub mod smooth;
pub mod thickness;
pub mod trace;
pub mod wall;

use crate::{
    mesh::{Mesh, wall::Wall},
    study::{Study, Warning},
};
use clinical::ModelFit;
use glam::DVec3;
use monitor::{Monitor, Stage};
use parameters::{Parameters, Preset};
use pose::Pose;
use serde::{Deserialize, Serialize};

/// Gives back the memory that the calling thread keeps from one study to the next.
pub fn forget() {
    gvf::forget();
    clinical::forget();
}

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
    /// Time steps of the deformable model, or Gauss-Newton steps of the clinical preset's model.
    pub steps: usize,
    /// How a deformable model got there; `None` where none ran (the clinical preset).
    pub evolution: Option<Evolution>,
}

/// How a deformable model reached its border.
#[derive(Debug, Clone, PartialEq)]
pub struct Evolution {
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
    /// Where the slices cut the ventricle; `None` where they do not cut it across.
    pub region: Option<Region>,
    /// Unit vector from apex to base in the grid.
    pub to_base: DVec3,
    /// Where the ventricle lies, however the slices lie (clinical preset).
    pub pose: Option<Pose>,
    /// What the model of the camera says of the study (clinical preset).
    pub model: Option<ModelFit>,
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
    #[error(
        "No left ventricle was found: {why}. Send a reconstruction of the heart (for the preset `paper`, of short-axis slices), or mark the \
         ventricle with `pose` or `region`."
    )]
    NoLeftVentricle {
        /// What was looked for and not found.
        why: String,
    },
    /// A mark given in the request does not fit the study.
    #[error("The given marks do not fit the study: {why}.")]
    RegionOutside {
        /// Which mark, its value and the limits.
        why: String,
    },
    /// The slices are said not to be short axis, and the paper's method, which needs them so, found nothing in them.
    #[error(
        "The file names its slices as long-axis slices, and in them no left ventricle was reconstructed ({why}). The preset `paper` looks for \
         rings: choose `clinical`, or send the study resliced to its short axis."
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

/// Reconstructs every gate of a study, by the method of the preset.
pub fn reconstruct(study: &Study, parameters: &Parameters, monitor: &dyn Monitor) -> Result<Reconstruction, PipelineError> {
    match parameters.preset {
        Preset::Clinical => clinical::reconstruct(study, parameters, monitor),
        Preset::Paper => paper::reconstruct(study, parameters, monitor).map_err(|error| error.for_want_of_short_axis(study)),
    }
}

/// All results, or of several failures the first gate's, whichever thread was first.
fn first_error<T>(results: Vec<Result<T, PipelineError>>) -> Result<Vec<T>, PipelineError> {
    results.into_iter().collect()
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
