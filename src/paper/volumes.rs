//! Table 4 (§7.4): the recovered volume by solver, against the volume of the thresholded voxels.

use super::{
    PaperError,
    experiment::{Experiment, Run},
    models::solver_name,
    printed, threshold,
};
use crate::{
    drawing::markdown::{Table, grouped, signed},
    pipeline::{
        Surface,
        parameters::{Parameters, Solver},
    },
    volume::Volume,
};
use glam::DVec3;

/// The volumes that can be read off the voxels themselves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thresholded {
    /// The level as a fraction of the largest count.
    pub level: f64,
    /// Volume of the voxels in mm³.
    pub raw_mm3: f64,
    /// Volume with the cavity of every slice filled, in mm³.
    pub filled_mm3: f64,
    /// Mean radius of the isocontour in the middle slice of the cylinder, in mm.
    pub radius_mm: f64,
}

/// A solver's result.
#[derive(Debug, Clone)]
pub struct Row {
    /// Everything it ran with.
    pub parameters: Parameters,
    /// Whether it started from the ellipsoid enlarged to the printed area, outside the border, rather than from the bounding one.
    pub from_outside: bool,
    /// What came of it.
    pub run: Run,
    /// The recovered external volume in mm³.
    pub volume_mm3: f64,
    /// The level of the counts, as a fraction of the largest, whose filled voxels have that volume.
    pub same_level: f64,
}

/// Everything in the table.
#[derive(Debug, Clone)]
pub struct Volumes {
    /// The phantom's exact external volume in mm³.
    pub exact_mm3: f64,
    /// Its outer radius in mm.
    pub exact_radius_mm: f64,
    /// Thresholded voxels at 20 and 50 % of the largest count.
    pub thresholded: [Thresholded; 2],
    /// Mean radius of the Canny border in the middle slice, in mm.
    pub border_radius_mm: f64,
    /// The solvers: from the bounding ellipsoid and from outside, with particles moved to the edge and left where they froze.
    pub rows: Vec<Row>,
}

/// Euler, midpoint and RK4 with the printed time steps: free model, smoothing, mesh 2. GVF constant and damping are those of §7.5.
pub fn measure() -> Result<Volumes, PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let surface = Surface::Epicardial;
    let flow = experiment.flow(surface, &Parameters::paper())?;
    let counts = experiment.counts();
    let mut rows = Vec::new();
    for (from_outside, subvoxel) in [(false, true), (false, false), (true, true), (true, false)] {
        for (solver, printed) in [Solver::Euler, Solver::Midpoint, Solver::Rk4].into_iter().zip(printed::SOLVERS) {
            let mut parameters = Parameters::paper();
            parameters.deform.solver = solver;
            parameters.deform.time_step_s = printed.time_step_s;
            parameters.deform.subvoxel = subvoxel;
            let seed = experiment.start(surface, parameters.mesh.level, from_outside);
            let run = experiment.run_from(seed, surface, &flow, &parameters, &mut |_| ())?;
            let volume_mm3 = run.evolved.mesh.signed_volume_mm3();
            rows.push(Row { parameters, from_outside, volume_mm3, same_level: threshold::level_of_volume(counts, volume_mm3), run });
        }
    }
    let gate = &experiment.simulation.truth.gates[0];
    let (exact_mm3, exact_radius_mm) = (gate.epicardial_ml * 1000.0, printed::R2_MM);
    let middle = middle_slice(counts);
    Ok(Volumes {
        exact_mm3,
        exact_radius_mm,
        thresholded: [printed::THRESHOLD, 0.5].map(|level| thresholded(counts, &experiment, level, middle)),
        border_radius_mm: border_radius_mm(&experiment, middle),
        rows,
    })
}

/// A slice in the middle of the cylinder's straight part: the grid's.
fn middle_slice(counts: &Volume) -> usize {
    counts.grid.shape[0] / 2
}

fn thresholded(counts: &Volume, experiment: &Experiment, level: f64, slice: usize) -> Thresholded {
    let voxels = threshold::at_least(counts, level);
    let z_mm = slice as f64 * counts.grid.spacing_mm[0];
    let centre = experiment.extent.at_axis_mm(glam::DVec2::ZERO, z_mm).truncate();
    Thresholded {
        level,
        raw_mm3: threshold::volume_mm3(&voxels, counts),
        filled_mm3: threshold::volume_mm3(&threshold::filled(&voxels), counts),
        radius_mm: threshold::outer_radius_mm(counts, centre, slice, level),
    }
}

fn border_radius_mm(experiment: &Experiment, slice: usize) -> f64 {
    let points: Vec<DVec3> = experiment
        .border(Surface::Epicardial)
        .points
        .iter()
        .filter(|point| point.voxel[0] == slice)
        .map(|point| point.position_mm)
        .collect();
    points.iter().map(|&point| experiment.extent.from_axis_mm(point).length()).sum::<f64>() / points.len().max(1) as f64
}

/// The two tables: what the voxels hold, and what the solvers recover.
pub fn markdown(found: &Volumes) -> String {
    let off = |volume: f64, from: f64| signed(100.0 * (volume / from - 1.0), 1);
    let exact = found.exact_mm3;
    let mut voxels = Table::new(["", "mm³", "of the external volume (%)", "outer radius in the middle slice (mm)"]);
    voxels.row(["external volume, exact".to_owned(), grouped(exact), "—".to_owned(), format!("{:.2}", found.exact_radius_mm)]);
    for one in &found.thresholded {
        let percent = 100.0 * one.level;
        let radius = format!("{:.2}", one.radius_mm);
        voxels.row([format!("voxels ≥ {percent:.0} %"), grouped(one.raw_mm3), off(one.raw_mm3, exact), radius.clone()]);
        voxels.row([format!("voxels ≥ {percent:.0} %, cavity filled"), grouped(one.filled_mm3), off(one.filled_mm3, exact), radius]);
    }
    voxels.row(["Canny border".to_owned(), "—".to_owned(), "—".to_owned(), format!("{:.2}", found.border_radius_mm)]);
    voxels.row(["**paper**: external volume".to_owned(), "305 301.4".to_owned(), "—".to_owned(), "—".to_owned()]);
    voxels.row([
        "**paper**: voxels ≥ 20 %".to_owned(),
        grouped(printed::THRESHOLDED_MM3),
        format!("{} (printed: {:.0})", signed(printed::thresholded_excess_percent(), 1), printed::THRESHOLDED_EXCESS_PERCENT),
        "—".to_owned(),
    ]);
    let mut solvers = Table::new([
        "solver",
        "Δt (s)",
        "start",
        "particles end",
        "volume (mm³)",
        "off the filled voxels ≥ 20 % (%)",
        "paper (%)",
        "off the exact volume (%)",
        "same volume as the level (%)",
        "frozen (%)",
        "steps",
        "computed in (s)",
        "paper (s)",
    ]);
    for (row, paper) in found.rows.iter().zip(printed::SOLVERS.iter().cycle()) {
        let deform = &row.parameters.deform;
        solvers.row([
            solver_name(deform.solver).to_owned(),
            deform.time_step_s.to_string(),
            if row.from_outside { "outside" } else { "bounding" }.to_owned(),
            if deform.subvoxel { "on the edge" } else { "where they froze" }.to_owned(),
            grouped(row.volume_mm3),
            off(row.volume_mm3, found.thresholded[0].filled_mm3),
            format!("{}", paper.error_percent),
            off(row.volume_mm3, exact),
            format!("{:.0}", 100.0 * row.same_level),
            format!("{:.1}", 100.0 * row.run.evolved.frozen),
            row.run.evolved.steps.to_string(),
            format!("{:.3}", row.run.seconds),
            paper.seconds.to_string(),
        ]);
    }
    format!("{voxels}\n{solvers}")
}
