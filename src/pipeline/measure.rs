//! What is measured on the fitted surfaces, and what is refused or warned of.

use super::{
    Fit, GateReconstruction, PipelineError, Surface,
    borders::{Border, Borders},
    deform::Evolved,
    gvf::Flow,
};
use crate::{study::Warning, volume::Grid};
use glam::DVec3;

/// A mesh whose particles missed the border by more than this part has not found it.
const LEAST_WITHIN_ONE_VOXEL: f64 = 0.5;
/// Mean part of the circumferences that met border, below which the gap is told.
const FULL_COVERAGE: f64 = 0.75;

/// Measures an evolved mesh against its border.
pub fn fit(gate: usize, surface: Surface, evolved: Evolved, border: &Border, flow: &Flow, grid: &Grid) -> Result<Fit, PipelineError> {
    let Distances { within_one_voxel, mean_mm } = distances(&evolved.mesh.positions, border, grid);
    let volume = evolved.mesh.volume_ml();
    if within_one_voxel < LEAST_WITHIN_ONE_VOXEL || !volume.is_finite() || volume <= 0.0 {
        let why = format!(
            "{:.0} % of its particles came within one voxel of the border and it encloses {volume:.1} ml",
            100.0 * within_one_voxel
        );
        return Err(PipelineError::NotConverged { gate, surface, why });
    }
    Ok(Fit {
        mesh: evolved.mesh,
        steps: evolved.steps,
        stop: evolved.stop,
        frozen: evolved.frozen,
        within_one_voxel,
        mean_distance_mm: mean_mm,
        gvf_residual: flow.residual,
        gvf_iterations: flow.iterations,
        trace: evolved.trace,
    })
}

/// How far particles are from the border.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distances {
    /// Fraction of them less than one voxel from a border voxel's centre, 0-1.
    pub within_one_voxel: f64,
    /// Mean distance to the nearest border voxel's centre in mm.
    pub mean_mm: f64,
}

/// Measures particles against their border (the paper's Table 1).
pub fn distances(positions: &[DVec3], border: &Border, grid: &Grid) -> Distances {
    let (mut within, mut total_mm) = (0_usize, 0.0);
    for &position in positions {
        let (voxels, mm) = nearest(position, border, grid);
        within += usize::from(voxels < 1.0);
        total_mm += mm;
    }
    let particles = positions.len().max(1) as f64;
    Distances { within_one_voxel: within as f64 / particles, mean_mm: total_mm / particles }
}

/// Distance to the nearest border voxel's centre, in voxels (each axis by its own spacing) and in mm.
fn nearest(position: DVec3, border: &Border, grid: &Grid) -> (f64, f64) {
    let step = grid.step_mm();
    let mut best = (f64::INFINITY, f64::INFINITY);
    for point in &border.points {
        let offset = position - grid.position_mm(point.voxel);
        best = (best.0.min((offset / step).length_squared()), best.1.min(offset.length_squared()));
    }
    (best.0.sqrt(), best.1.sqrt())
}

/// Refuses surfaces that are no wall.
pub fn check(gate: usize, result: &GateReconstruction) -> Result<(), PipelineError> {
    let (inner, outer) = (result.volume_ml(Surface::Endocardial), result.volume_ml(Surface::Epicardial));
    if inner < outer {
        return Ok(());
    }
    let why = format!("it encloses {inner:.1} ml, the epicardial one {outer:.1} ml");
    Err(PipelineError::NotConverged { gate, surface: Surface::Endocardial, why })
}

/// What the reader of a gate's result should know.
pub(super) fn warnings(gate: usize, found: &Borders) -> Vec<Warning> {
    Surface::BOTH
        .into_iter()
        .filter(|&surface| *found.coverage.get(surface) < FULL_COVERAGE)
        .map(|surface| {
            let seen = 100.0 * found.coverage.get(surface);
            let message =
                format!("The {} border was seen on {seen:.0} % of the circumferences; the surface bridges the rest.", surface.name());
            Warning::at_gate(gate, "partial_border", message)
        })
        .collect()
}
