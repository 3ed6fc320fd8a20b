//! Figure 7 (§7.1): the inner (blue) and the outer (green) border voxels of the phantom.

use super::{
    super::{PaperError, experiment::Experiment},
    EXTERNAL, INTERNAL,
    render::{Canvas, FINE_LEVELS},
    view,
};
use crate::{
    drawing::raster::Picture,
    {
        drawing::svg::{Anchor, FAINT, INK, Sheet, hex},
        pipeline::Surface,
    },
};
use glam::DVec3;
use ndarray::Axis;

/// Width of a slice's picture in voxels, about its middle.
const SHOWN: usize = 34;
/// Part of a voxel that its box fills in the three-dimensional picture.
const BOX: f64 = 0.86;

/// The phantom's border voxels in three dimensions, the outer ones cut open, and in three slices.
pub(super) fn draw() -> Result<String, PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let grid = *experiment.grid();
    let gate = &experiment.simulation.truth.gates[0];
    let [apex, base] = [gate.apex_mm, gate.base_mm].map(|point| point.map_or(DVec3::ZERO, DVec3::from_array));
    let centre = (apex + base) / 2.0;
    let colours = [(Surface::Epicardial, EXTERNAL), (Surface::Endocardial, INTERNAL)];

    let mut canvas = Canvas::new(view(centre, 0.205), 620, 620);
    // Towards the viewer, to the right: the quarter that is taken away.
    let cut = [DVec3::new(-1.0, 0.0, 0.0), DVec3::new(0.0, -1.0, 0.0)];
    for (surface, colour) in colours {
        for point in &experiment.border(surface).points {
            let at = grid.position_mm(point.voxel);
            let hides = surface == Surface::Epicardial && cut.iter().all(|side| (at - centre).dot(*side) > 0.0);
            if !hides {
                canvas.cuboid(at, grid.step_mm() * BOX / 2.0, colour);
            }
        }
    }

    let mut sheet = Sheet::new(900.0, 415.0);
    sheet.text((450.0, 26.0), 16.0, Anchor::Middle, INK, "Border voxels of the paper's phantom");
    sheet.picture((5.0, 44.0), (340.0, 340.0), &canvas.picture(FINE_LEVELS).png()?, false);
    sheet.text((175.0, 402.0), 12.0, Anchor::Middle, FAINT, "apex below; a quarter of the outer border removed");
    let counts = experiment.counts();
    let [_, rows, columns] = grid.shape;
    let slice_at = |part: f64| ((apex.z + part * (base.z - apex.z)) / grid.spacing_mm[0]).round() as usize;
    for (index, (name, part)) in [("apical", 0.25), ("middle", 0.5), ("basal", 0.85)].into_iter().enumerate() {
        let slice = slice_at(part);
        let mut picture = Picture::grey(&counts.counts.index_axis(Axis(0), slice), 0.0, 1.5 * counts.maximum());
        for (surface, colour) in colours {
            for point in experiment.border(surface).points.iter().filter(|point| point.voxel[0] == slice) {
                picture.set(point.voxel[2], point.voxel[1], colour);
            }
        }
        let (x, y, side) = (358.0 + 180.0 * index as f64, 120.0, 172.0);
        sheet.text((x + side / 2.0, y - 10.0), 14.0, Anchor::Middle, INK, &format!("{name} (slice {})", slice + 1));
        let picture = picture.cut(((columns - SHOWN) / 2, (rows - SHOWN) / 2), (SHOWN, SHOWN)).enlarged(8);
        sheet.picture((x, y), (side, side), &picture.png()?, true);
    }
    let millimetres = SHOWN as f64 * grid.spacing_mm[2];
    sheet.text((888.0, 310.0), 11.0, Anchor::End, FAINT, &format!("slices: {millimetres:.0} mm wide, counts in grey"));
    for (x, colour, surface, name) in
        [(400.0, INTERNAL, Surface::Endocardial, "internal"), (620.0, EXTERNAL, Surface::Epicardial, "external")]
    {
        sheet.rectangle((x, 346.0), (14.0, 14.0), &hex(colour));
        let count = experiment.border(surface).points.len();
        sheet.text((x + 22.0, 358.0), 13.0, Anchor::Start, INK, &format!("{name} border, {count} voxels"));
    }
    Ok(sheet.finish())
}
