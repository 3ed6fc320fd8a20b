//! The counts that the model is fitted to: around the ventricle, every gate scaled to the same total, neighbouring voxels binned where the
//! blur makes them alike.

use super::{
    basis::Angle,
    exposure::Crop,
    fit::VoxelPlace,
    rays::{self, Rays},
    shape::Space,
};
use crate::study::Study;
use glam::DVec3;

/// How far around the pose counts are looked at: half a wall, the blur, what the margin of the fit asks for.
const AROUND_MM: f64 = 30.0;
/// Voxels are binned up to this many standard deviations of the point-spread function: at half the sampling rate, 20 % of a blurred
/// shape's amplitude is left and less of its noise's information on it.
const BIN: f64 = 1.75;
/// And up to the volume of a cube whose side is so many standard deviations, and no longer than this in mm: two thirds of a wall.
const CUBE: f64 = 1.1;
const LARGEST_CUBE_MM: f64 = 6.5;

/// What is fitted to.
pub(super) struct Counts {
    pub(super) crop: Crop,
    pub(super) space: Space,
    /// Counts of every gate as parts of the wall's, all gates scaled to the same total.
    pub(super) gates: Vec<Vec<f32>>,
    /// Voxels within the field of view.
    pub(super) known: Vec<bool>,
    /// Where the voxels lie on the wall.
    pub(super) places: Vec<VoxelPlace>,
    /// Variance over mean of a bin of each gate, if counts are Poisson's.
    pub(super) noise: Vec<f64>,
    /// Counts of a voxel that are 1 here, in each gate.
    pub(super) unit: Vec<f64>,
}

/// How many voxels of a box are binned along each axis: one more at a time where the bin is shortest, as long as it may grow.
fn binning(spacing_mm: [f64; 3], sigma_mm: f64, shape: [usize; 3]) -> [usize; 3] {
    let largest_mm3 = (CUBE * sigma_mm).min(LARGEST_CUBE_MM).powi(3);
    let mut bin = [1; 3];
    loop {
        let length = |axis: usize, more: usize| (bin[axis] + more) as f64 * spacing_mm[axis];
        let volume_mm3: f64 = (0..3).map(|axis| length(axis, 0)).product();
        let may_grow = |axis: &usize| {
            let grown = length(*axis, 1);
            let larger_mm3 = volume_mm3 * grown / length(*axis, 0);
            bin[*axis] < shape[*axis] && grown <= BIN * sigma_mm && larger_mm3 <= largest_mm3
        };
        match (0..3).filter(may_grow).min_by(|a, b| length(*a, 1).total_cmp(&length(*b, 1))) {
            Some(axis) => bin[axis] += 1,
            None => return bin,
        }
    }
}

/// The counts around the ventricle, each gate scaled to the mean total, as parts of the wall's counts.
pub(super) fn gather(study: &Study, space: &Space, rays: &[Rays], sigma_mm: f64) -> Counts {
    let grid = study.grid;
    let frame = &space.frame;
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (point, reach) in
        [(DVec3::ZERO, frame.unit_mm.max(frame.apex_mm) + AROUND_MM), (DVec3::Z * frame.base_mm, frame.unit_mm + AROUND_MM)]
    {
        let point = frame.grid(point);
        low = low.min(point - reach);
        high = high.max(point + reach);
    }
    let (from, to) = (grid.fractional_index(low), grid.fractional_index(high));
    let first: [usize; 3] = std::array::from_fn(|axis| (from[axis].floor().max(0.0) as usize).min(grid.shape[axis] - 1));
    let end: [usize; 3] = std::array::from_fn(|axis| (to[axis].ceil().max(0.0) as usize + 1).min(grid.shape[axis]).max(first[axis] + 1));
    let bin = binning(grid.spacing_mm, sigma_mm, std::array::from_fn(|axis| end[axis] - first[axis]));
    let crop = Crop {
        origin_mm: std::array::from_fn(|axis| (first[axis] as f64 + (bin[axis] - 1) as f64 / 2.0) * grid.spacing_mm[axis]),
        spacing_mm: std::array::from_fn(|axis| bin[axis] as f64 * grid.spacing_mm[axis]),
        shape: std::array::from_fn(|axis| (end[axis] - first[axis]) / bin[axis]),
    };
    let totals: Vec<f64> = study.gates.iter().map(|gate| gate.volume.total()).collect();
    let mean = totals.iter().sum::<f64>() / totals.len() as f64;
    let wall = rays::percentile(rays.iter().map(|rays| rays.wall), 0.5);
    let members = |voxel: usize| {
        let [_, ny, nx] = crop.shape;
        let at = [voxel / (ny * nx), voxel / nx % ny, voxel % nx];
        let start: [usize; 3] = std::array::from_fn(|axis| first[axis] + at[axis] * bin[axis]);
        (0..bin[0]).flat_map(move |z| (0..bin[1]).flat_map(move |y| (0..bin[2]).map(move |x| [start[0] + z, start[1] + y, start[2] + x])))
    };
    let size = bin.iter().product::<usize>() as f64;
    let gates: Vec<Vec<f32>> = study
        .gates
        .iter()
        .zip(&totals)
        .map(|(gate, total)| {
            let scale = mean / total.max(f64::MIN_POSITIVE) / wall / size;
            (0..crop.voxels())
                .map(|voxel| (members(voxel).map(|member| f64::from(gate.volume.counts[member])).sum::<f64>() * scale) as f32)
                .collect()
        })
        .collect();
    let known = (0..crop.voxels())
        .map(|voxel| members(voxel).all(|member| study.gates.iter().any(|gate| gate.volume.counts[member] > 0.0)))
        .collect();
    let mut places = Vec::with_capacity(crop.voxels());
    places.extend(crop.centres_mm().map(|centre| {
        let local = frame.local(centre);
        let (s, phi, r) = frame.bullet(local);
        VoxelPlace { spot: space.basis.at(s, &Angle::new(phi)), r, z: local.z }
    }));
    let unit: Vec<f64> = totals.iter().map(|total| wall * total / mean.max(f64::MIN_POSITIVE)).collect();
    let noise = unit.iter().map(|unit| 1.0 / (unit * size).max(f64::MIN_POSITIVE)).collect();
    Counts { crop, space: *space, gates, known, places, noise, unit }
}

#[cfg(test)]
mod tests {
    use super::binning;

    #[test]
    fn bins_are_about_cubes_and_no_wider_than_the_blur() {
        let large = [100; 3];
        assert_eq!(binning([6.4; 3], 5.0, large), [1, 1, 1], "two would be wider than 8.75 mm");
        assert_eq!(binning([4.0; 3], 5.0, large), [2, 1, 1], "128 mm³; 166 may be");
        assert_eq!(binning([2.0, 2.0, 2.0], 5.0, large), [3, 3, 2], "144 mm³");
        assert_eq!(binning([4.0; 3], 2.0, large), [1, 1, 1], "a sharp image is not binned");
        assert_eq!(binning([3.2; 3], 8.0, large), [2, 2, 2], "262 of 275 mm³, the most");
        assert_eq!(binning([2.0, 2.0, 2.0], 5.0, [1, 2, 100]), [1, 2, 4], "the box ends, then the blur");
    }
}
