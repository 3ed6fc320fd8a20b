//! Table 2 (§7.3): the meshes that the evolution starts from.

use super::{
    PaperError,
    experiment::Experiment,
    printed::{self, PrintedTriangles},
};
use crate::{
    drawing::markdown::Table,
    mesh::{Mesh, TriangleQuality},
    pipeline::Surface,
};

/// Subdivisions of the icosahedron of the paper's meshes 1, 2, 3.
pub const LEVELS: [u32; 3] = [2, 3, 4];

/// A mesh of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Particles.
    pub particles: usize,
    /// Triangles.
    pub triangles: usize,
    /// Their measures.
    pub quality: TriangleQuality,
    /// Area of the whole mesh in mm².
    pub area_mm2: f64,
}

impl Row {
    /// The measures of a mesh.
    pub fn of(mesh: &Mesh) -> Self {
        let (particles, triangles) = (mesh.positions.len(), mesh.triangles.len());
        Self { particles, triangles, quality: mesh.quality(), area_mm2: mesh.area_mm2() }
    }
}

/// The ellipsoids that bound the outer border of the paper's phantom.
pub fn measure() -> Result<[Row; 3], PaperError> {
    let experiment = Experiment::paper_phantom()?;
    Ok(LEVELS.map(|level| Row::of(&experiment.seed(Surface::Epicardial, level))))
}

/// The table, with the sphere that each printed mesh has the area of.
pub fn markdown(rows: &[Row; 3]) -> String {
    let mut table = Table::new(["", "mesh 1", "paper", "mesh 2", "paper", "mesh 3", "paper"]);
    let mut line = |name: &str, ours: &dyn Fn(&Row) -> String, paper: &dyn Fn(usize) -> String| {
        let cells = rows.iter().enumerate().flat_map(|(mesh, row)| [ours(row), paper(mesh)]);
        table.row(std::iter::once(name.to_owned()).chain(cells));
    };
    let as_printed = |of: fn(&PrintedTriangles) -> (f64, f64)| {
        move |mesh: usize| {
            let (area, aspect) = of(&printed::INITIAL_MESHES[mesh]);
            format!("{area} / {aspect}")
        }
    };
    line("particles", &|row| row.particles.to_string(), &|mesh| [162, 642, 2562][mesh].to_string());
    line("triangles", &|row| row.triangles.to_string(), &|mesh| printed::TRIANGLES[mesh].to_string());
    line("mean (mm² / mm)", &|row| measures(&row.quality, 0), &as_printed(|p| (p.area_mm2[0], p.aspect_mm[0])));
    line("largest", &|row| measures(&row.quality, 1), &as_printed(|p| (p.area_mm2[1], p.aspect_mm[1])));
    line("smallest", &|row| measures(&row.quality, 2), &as_printed(|p| (p.area_mm2[2], p.aspect_mm[2])));
    let sphere = |area_mm2: f64| format!("{:.1}", (area_mm2 / (4.0 * std::f64::consts::PI)).sqrt());
    line("whole area (mm²)", &|row| format!("{:.0}", row.area_mm2), &|mesh| format!("{:.0}", printed::initial_area_mm2(mesh)));
    line("radius of a sphere of that area (mm)", &|row| sphere(row.area_mm2), &|mesh| sphere(printed::initial_area_mm2(mesh)));
    table.to_string()
}

/// Area and area over longest edge: the mean (0), the largest (1) or the smallest (2).
pub(super) fn measures(quality: &TriangleQuality, which: usize) -> String {
    format!("{:.2} / {:.2}", quality.area_mm2[which], quality.aspect_mm[which])
}
