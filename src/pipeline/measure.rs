//! What is measured on the fitted surfaces, and what is refused.

use super::{
    Evolution, Fit, GateReconstruction, PipelineError, Surface,
    borders::Border,
    deform::Evolved,
    gvf::Flow,
    nearest::{Centres, nearest},
};
use crate::volume::Grid;
use glam::DVec3;

/// Density of myocardium in g/ml: 1.053 for blood-perfused rat heart (Vinnakota and Bassingthwaighte, Am J Physiol Heart Circ Physiol
/// 286:H1742, 2004), 1.05 by the convention of the cardiac imaging societies, which is what other packages multiply with.
pub const MYOCARDIAL_DENSITY_G_PER_ML: f64 = 1.05;

/// A mesh whose particles missed the border by more than this part has not found it.
const LEAST_WITHIN_ONE_VOXEL: f64 = 0.5;

/// Measures an evolved mesh against its border. Where particles were to swing freely about it (`swings`), how far off they ended is what was
/// asked for, and no failure.
pub fn fit(
    (gate, surface): (usize, Surface),
    evolved: Evolved,
    border: &Border,
    flow: &Flow,
    grid: &Grid,
    swings: bool,
) -> Result<Fit, PipelineError> {
    let Distances { within_one_voxel, mean_mm } = distances(&evolved.mesh.positions, border, grid);
    let volume = evolved.mesh.volume_ml();
    let lost = within_one_voxel < LEAST_WITHIN_ONE_VOXEL || volume <= 0.0;
    if (lost && !swings) || !volume.is_finite() {
        let why = format!(
            "{:.0} % of its particles came within one voxel of the border and it encloses {volume:.1} ml",
            100.0 * within_one_voxel
        );
        return Err(PipelineError::NotConverged { gate, surface, why });
    }
    Ok(Fit {
        mesh: evolved.mesh,
        steps: evolved.steps,
        evolution: Some(Evolution {
            stop: evolved.stop,
            frozen: evolved.frozen,
            within_one_voxel,
            mean_distance_mm: mean_mm,
            gvf_residual: flow.residual,
            gvf_iterations: flow.iterations,
            trace: evolved.trace,
        }),
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
    let centres = Centres::of(border, grid);
    let (mut within, mut total_mm) = (0_usize, 0.0);
    for &position in positions {
        let [voxels, mm] = nearest(&centres, position.to_array());
        within += usize::from(voxels.sqrt() < 1.0);
        total_mm += mm.sqrt();
    }
    let particles = positions.len().max(1) as f64;
    Distances { within_one_voxel: within as f64 / particles, mean_mm: total_mm / particles }
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
