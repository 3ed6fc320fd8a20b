//! Table 3 (§7.3): the triangles after the reconstruction.

use super::{
    PaperError,
    experiment::Experiment,
    initial_meshes::{LEVELS, Row, measures},
    markdown::Table,
    printed,
};
use crate::pipeline::{Surface, parameters::Parameters};

/// A reconstructed mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reconstructed {
    /// Which surface.
    pub surface: Surface,
    /// Whether smoothing was on.
    pub smoothing: bool,
    /// Its triangles.
    pub row: Row,
    /// Triangles that face inwards.
    pub inverted: usize,
}

/// The free model on both surfaces of the paper's phantom at the three levels, with the parameters of §7.5, smoothed and not.
pub fn measure() -> Result<Vec<Reconstructed>, PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let flows = experiment.flows(&Parameters::paper())?;
    let mut found = Vec::new();
    for (smoothing, surface) in [true, false].into_iter().flat_map(|smoothing| Surface::BOTH.map(|surface| (smoothing, surface))) {
        for level in LEVELS {
            let mut parameters = Parameters::paper();
            parameters.mesh.level = level;
            parameters.deform.smoothing = smoothing;
            let mesh = experiment.run(surface, flows.get(surface), &parameters, &mut |_| ())?.evolved.mesh;
            found.push(Reconstructed { surface, smoothing, row: Row::of(&mesh), inverted: mesh.inverted_triangles(mesh.centroid()) });
        }
    }
    Ok(found)
}

/// The table.
pub fn markdown(found: &[Reconstructed]) -> String {
    let mut table = Table::new(["mesh", "mean (mm² / mm)", "largest", "smallest", "inverted triangles"]);
    for (mesh, paper) in printed::RECONSTRUCTIONS.iter().enumerate() {
        let pair = |which: usize| format!("{} / {}", paper.area_mm2[which], paper.aspect_mm[which]);
        table.row([format!("{}, **paper**", mesh + 1), pair(0), pair(1), pair(2), "—".to_owned()]);
        for one in found.iter().filter(|one| one.row.triangles == printed::TRIANGLES[mesh]) {
            let smoothed = if one.smoothing { "" } else { ", not smoothed" };
            let smallest = format!("{:.4} / {:.4}", one.row.quality.area_mm2[2], one.row.quality.aspect_mm[2]);
            let (mean, largest) = (measures(&one.row.quality, 0), measures(&one.row.quality, 1));
            table.row([format!("{}, {}{smoothed}", mesh + 1, one.surface.name()), mean, largest, smallest, one.inverted.to_string()]);
        }
    }
    table.to_string()
}
