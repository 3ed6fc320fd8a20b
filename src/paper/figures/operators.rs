//! Figure 6 (§7.1): a slice, a plain gradient operator on it, and Canny's.

use super::{
    super::{
        PaperError,
        experiment::{Experiment, exact_marks},
    },
    EXTERNAL, INTERNAL,
};
use crate::{
    drawing::raster::Picture,
    drawing::svg::{Anchor, FAINT, INK, Sheet},
    phantom::{self, Imaging, Phantom, Uptake},
    pipeline::{
        Surface, canny,
        parameters::{EdgeOperator, EdgeParameters, Parameters},
    },
    volume::VoxelSet,
};
use ndarray::Axis;

/// Width of the pictures in voxels, about the middle of the slice.
const SHOWN: usize = 40;

/// The paper's phantom with background, noise and 150 counts in its brightest voxel, in its middle slice.
pub(super) fn draw() -> Result<String, PaperError> {
    let clean = Phantom::paper();
    let noisy = Phantom {
        uptake: Uptake { background: Uptake::default().background, ..clean.uptake.clone() },
        imaging: Imaging { noise_seed: Some(1), ..clean.imaging.clone() },
        ..clean
    };
    let truth = phantom::simulate(&noisy)?.truth;
    let parameters = Parameters { region: exact_marks(&noisy, &truth), ..Parameters::paper() };
    let experiment = Experiment::new(&noisy, 0, &parameters)?;
    let counts = experiment.counts();
    let [slices, rows, columns] = counts.grid.shape;
    let slice = slices / 2;
    let corner = ((columns - SHOWN) / 2, (rows - SHOWN) / 2);
    let image = counts.counts.index_axis(Axis(0), slice);
    let original = Picture::grey(&image, 0.0, counts.maximum());

    // Every voxel of the circle: one threshold for both borders, as the paper has it.
    let mut eligible = VoxelSet::empty(counts.grid.shape);
    for ((z, y, x), member) in eligible.member.indexed_iter_mut() {
        let off_axis = experiment.extent.from_axis_mm(counts.grid.position_mm([z, y, x]));
        *member = off_axis.length() <= experiment.extent.radius_mm;
    }
    let marked = |operator: EdgeOperator| {
        let edges = EdgeParameters { operator, ..parameters.edges };
        let gradient = canny::gradient(counts, &experiment.extent.known, &edges);
        let mut picture = Picture::of_colour(columns, rows, [0.0; 3]);
        for point in canny::edges(&gradient, &eligible, &edges).iter().filter(|point| point.voxel[0] == slice) {
            picture.set(point.voxel[2], point.voxel[1], [1.0; 3]);
        }
        picture
    };
    let mut both = original.clone();
    for (surface, colour) in [(Surface::Epicardial, EXTERNAL), (Surface::Endocardial, INTERNAL)] {
        for point in experiment.border(surface).points.iter().filter(|point| point.voxel[0] == slice) {
            both.set(point.voxel[2], point.voxel[1], colour);
        }
    }
    let edges = &parameters.edges;
    let panels = [
        (original, "counts".to_owned(), format!("slice {} of {slices}", slice + 1)),
        (marked(EdgeOperator::Gradient), "gradient".to_owned(), format!("its length ≥ {} of the largest", edges.threshold)),
        (marked(EdgeOperator::Canny), "Canny".to_owned(), format!("σ {} pixels, {} and {}", edges.sigma, edges.low, edges.high)),
        (both, "borders".to_owned(), "thresholds for each border".to_owned()),
    ];
    let mut sheet = Sheet::new(900.0, 310.0);
    sheet.text((450.0, 24.0), 16.0, Anchor::Middle, INK, "Edge operators on a slice of the paper's phantom with noise");
    for (index, (picture, name, about)) in panels.into_iter().enumerate() {
        let (x, y, side) = (12.0 + 222.0 * index as f64, 58.0, 210.0);
        sheet.text((x + side / 2.0, y - 10.0), 14.0, Anchor::Middle, INK, &name);
        sheet.picture((x, y), (side, side), &picture.cut(corner, (SHOWN, SHOWN)).enlarged(8).png()?, true);
        sheet.text((x + side / 2.0, y + side + 18.0), 12.0, Anchor::Middle, FAINT, &about);
    }
    let millimetres = SHOWN as f64 * counts.grid.spacing_mm[2];
    sheet.text((888.0, 302.0), 11.0, Anchor::End, FAINT, &format!("each picture {millimetres:.0} mm wide; inner border blue, outer green"));
    Ok(sheet.finish())
}
