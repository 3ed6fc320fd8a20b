//! Table 3 (§7.3): the triangles after the reconstruction.

use super::{
    PaperError,
    experiment::Experiment,
    initial_meshes::{LEVELS, Row, measures},
    printed,
};
use crate::{
    drawing::markdown::Table,
    pipeline::{Surface, parameters::Parameters},
};

/// A reconstructed mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reconstructed {
    /// Which surface.
    pub surface: Surface,
    /// How it was reached.
    pub way: Way,
    /// Its triangles.
    pub row: Row,
    /// Triangles that face inwards.
    pub inverted: usize,
}

/// How a mesh is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Way {
    /// Whether it started from the ellipsoid enlarged to the area of the printed mesh, and its particles stayed where they froze (see Table 4),
    /// instead of from the bounding one to the edge.
    pub from_outside: bool,
    /// Whether smoothing was on.
    pub smoothing: bool,
}

/// The free model on both surfaces of the paper's phantom at the three levels, with the parameters of §7.5.
pub fn measure() -> Result<Vec<Reconstructed>, PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let flows = experiment.flows(&Parameters::paper())?;
    let mut found = Vec::new();
    for (from_outside, smoothing) in [(false, true), (false, false), (true, true), (true, false)] {
        for (surface, level) in Surface::BOTH.into_iter().flat_map(|surface| LEVELS.map(|level| (surface, level))) {
            let mut parameters = Parameters::paper();
            parameters.mesh.level = level;
            parameters.deform.smoothing = smoothing;
            parameters.deform.subvoxel = !from_outside;
            let seed = experiment.start(surface, level, from_outside);
            let mesh = experiment.run_from(seed, surface, flows.get(surface), &parameters, &mut |_| ())?.evolved.mesh;
            let inverted = mesh.inverted_triangles(mesh.centroid());
            found.push(Reconstructed { surface, way: Way { from_outside, smoothing }, row: Row::of(&mesh), inverted });
        }
    }
    Ok(found)
}

/// The table.
pub fn markdown(found: &[Reconstructed]) -> String {
    let mut table = Table::new(["mesh", "mean (mm² / mm)", "largest", "smallest", "whole area (mm²)", "inverted triangles"]);
    for (mesh, paper) in printed::RECONSTRUCTIONS.iter().enumerate() {
        let pair = |which: usize| format!("{} / {}", paper.area_mm2[which], paper.aspect_mm[which]);
        let area = format!("{:.0}", paper.area_mm2[0] * printed::TRIANGLES[mesh] as f64);
        table.row([format!("{}, **paper**", mesh + 1), pair(0), pair(1), pair(2), area, "—".to_owned()]);
        for one in found.iter().filter(|one| one.row.triangles == printed::TRIANGLES[mesh]) {
            let Way { from_outside, smoothing } = one.way;
            let way = if from_outside { ", from outside, where they froze" } else { "" };
            let smoothed = if smoothing { "" } else { ", not smoothed" };
            let smallest = format!("{:.4} / {:.4}", one.row.quality.area_mm2[2], one.row.quality.aspect_mm[2]);
            table.row([
                format!("{}, {}{way}{smoothed}", mesh + 1, one.surface.name()),
                measures(&one.row.quality, 0),
                measures(&one.row.quality, 1),
                smallest,
                format!("{:.0}", one.row.area_mm2),
                one.inverted.to_string(),
            ]);
        }
    }
    table.to_string()
}
