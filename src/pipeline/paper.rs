//! The paper's method, section 8: the region, then for every gate Canny edges, borders, gradient vector flow, the evolution of both
//! surfaces, and the order of the wall between them.

use super::{
    GateReconstruction, PerSurface, PipelineError, Reconstruction, Surface,
    borders::{self, Borders},
    canny::{self, Smoothing},
    deform, first_error, gaps,
    gvf::{self, Flow},
    measure,
    monitor::{Monitor, Stage},
    observed,
    parameters::{EdgeOperator, Parameters, Seed},
    region::{self, Extent},
    wall,
};
use crate::{
    mesh::Mesh,
    study::Study,
    volume::{Grid, Volume},
};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Gates run in parallel on the caller's rayon pool, the evolutions one after the other where each starts from the gate before
/// ([`Seed::PreviousGate`]); nothing is reduced across them in parallel.
pub(super) fn reconstruct(study: &Study, parameters: &Parameters, monitor: &dyn Monitor) -> Result<Reconstruction, PipelineError> {
    let (location, extents) = observed(monitor, Stage::Region, None, || {
        let location = region::locate(study, &parameters.region)?;
        let extents = location.extents(study);
        Ok((location, extents))
    })?;
    // All gates have the field of view of the study.
    let canny = parameters.edges.operator == EdgeOperator::Canny;
    let smoothing = canny.then(|| canny::smoothing(&study.grid, location.known(), &parameters.edges));
    let found = study
        .gates
        .par_iter()
        .enumerate()
        .map(|(gate, counts)| find_borders(gate, &counts.volume, &extents[gate], smoothing.as_ref(), parameters, monitor))
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
    let to_base = if region.base_at_last_slice { DVec3::Z } else { DVec3::NEG_Z };
    Ok(Reconstruction { gates, region: Some(region), to_base, pose: None, model: None, parameters: parameters.clone(), warnings })
}

/// Both borders of a gate, each fit to carry a surface.
fn find_borders(
    gate: usize,
    counts: &Volume,
    extent: &Extent,
    smoothing: Option<&Smoothing<'_>>,
    parameters: &Parameters,
    monitor: &dyn Monitor,
) -> Result<Borders, PipelineError> {
    let in_gate = Some(gate);
    let gradient =
        observed(monitor, Stage::Edges, in_gate, || Ok(canny::gradient_after(smoothing, counts, &extent.known, &parameters.edges)))?;
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
