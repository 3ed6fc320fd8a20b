//! The plain gradient operator that the paper compares Canny with (§7.1, figure 6) and does not define: the length of the counts' own
//! gradient against one threshold. No Gaussian, no thinning, no hysteresis.
//!
//! A border is as thick as the threshold leaves it, and lies at the centres of its voxels: a place between them would be that of a
//! ridge, which this operator does not look for. Particles freeze in the first of its voxels that they enter, on the outer side.

use super::{
    canny::{EdgePoint, Gradient, fractions},
    parameters::EdgeParameters,
};
use crate::volume::{VectorField, VoxelSet};
use glam::DVec3;
use ndarray::Array3;

/// Central differences of the counts between known voxels, a mm along `[z, y, x]`; one-sided where only one neighbour is known, zero
/// where none is. Outside the camera's field of view nothing was measured, so that its rim is no edge.
pub(super) fn difference(counts: &Array3<f32>, known: &VoxelSet, axis: usize, spacing_mm: f64) -> Array3<f32> {
    let length = counts.raw_dim()[axis];
    Array3::from_shape_fn(counts.raw_dim(), |(z, y, x)| {
        let here = [z, y, x];
        let at = |index: Option<usize>| {
            let mut voxel = here;
            voxel[axis] = index.filter(|&index| index < length)?;
            known.member[voxel].then_some((voxel[axis], counts[voxel]))
        };
        let own = at(Some(here[axis]));
        let (low, high) = (at(here[axis].checked_sub(1)).or(own), at(Some(here[axis] + 1)).or(own));
        match (own, low, high) {
            (Some(_), Some((low, before)), Some((high, after))) if high > low => {
                (after - before) / (spacing_mm as f32 * (high - low) as f32)
            }
            _ => 0.0,
        }
    })
}

/// The eligible voxels whose gradient is at least `threshold` times the largest of them, of their slice in `slice` mode.
pub(super) fn edges(gradient: &Gradient, eligible: &VoxelSet, parameters: &EdgeParameters) -> Vec<EdgePoint> {
    let VectorField { grid, components: [x, y, z] } = &gradient.field;
    let points: Vec<EdgePoint> = eligible
        .voxels()
        .filter_map(|voxel| {
            let direction = DVec3::new(f64::from(x[voxel]), f64::from(y[voxel]), f64::from(z[voxel]));
            let uphill = direction.try_normalize()?;
            Some(EdgePoint { voxel, position_mm: grid.position_mm(voxel), uphill, strength: gradient.magnitude[voxel] })
        })
        .collect();
    let fractions = fractions(&points, parameters.mode, grid.shape[0]);
    points.into_iter().zip(fractions).filter_map(|(point, part)| (part >= parameters.threshold).then_some(point)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{
        canny::gradient,
        parameters::{EdgeMode, EdgeOperator, Parameters},
    };
    use super::*;
    use crate::volume::{Grid, Volume};

    /// Counts that rise by 3 a mm along rows, 2 along columns and 5 along slices.
    fn slope() -> Volume {
        let grid = Grid { shape: [6, 9, 8], spacing_mm: [4.0, 3.0, 2.0] };
        let counts = Array3::from_shape_fn(grid.shape, |(z, y, x)| grid.position_mm([z, y, x]).dot(DVec3::new(2.0, 3.0, 5.0)) as f32);
        Volume { grid, counts }
    }

    fn parameters(mode: EdgeMode) -> EdgeParameters {
        EdgeParameters { operator: EdgeOperator::Gradient, mode, ..Parameters::paper().edges }
    }

    #[test]
    fn the_gradient_of_a_slope_is_its_own_everywhere() {
        let volume = slope();
        let mut known = VoxelSet { member: Array3::from_elem(volume.grid.shape, true) };
        // A mask with a rim inside the grid: what lies beyond it must not count.
        for ((_, y, x), inside) in known.member.indexed_iter_mut() {
            *inside = y >= 2 && x >= 3;
        }
        let mut masked = volume.clone();
        for (voxel, count) in masked.counts.indexed_iter_mut() {
            *count = if known.member[voxel] { *count } else { 0.0 };
        }
        for (mode, length) in [(EdgeMode::Slice, 13.0_f32), (EdgeMode::Volume, 38.0)] {
            let found = gradient(&masked, &known, &parameters(mode));
            for voxel in known.voxels() {
                assert!((found.magnitude[voxel] - length.sqrt()).abs() < 1e-3, "{mode:?} {voxel:?}: {}", found.magnitude[voxel]);
            }
            assert!(found.magnitude.indexed_iter().all(|((z, y, x), &m)| known.member[[z, y, x]] || m == 0.0));
        }
    }

    #[test]
    fn the_threshold_is_a_part_of_the_largest_of_the_slice_or_of_the_volume() {
        // One step a slice, of 10 in the even and 4 in the odd slices.
        let grid = Grid { shape: [4, 8, 12], spacing_mm: [3.0; 3] };
        let counts = Array3::from_shape_fn(grid.shape, |(z, _, x)| if x < 6 { 0.0 } else { [10.0, 4.0][z % 2] });
        let volume = Volume { grid, counts };
        let everywhere = VoxelSet { member: Array3::from_elem(grid.shape, true) };
        let flat = gradient(&volume, &everywhere, &parameters(EdgeMode::Slice));
        // A step is two voxels thick under central differences: 8 rows, 2 columns, in each slice.
        let by_slice = edges(&flat, &everywhere, &parameters(EdgeMode::Slice));
        assert_eq!(by_slice.len(), 4 * 8 * 2);
        for point in &by_slice {
            assert_eq!(point.position_mm, grid.position_mm(point.voxel));
            assert!(point.uphill.x > 0.999 && (5..=6).contains(&point.voxel[2]));
        }
        let in_volume = edges(&flat, &everywhere, &parameters(EdgeMode::Volume));
        assert_eq!(in_volume.len(), 2 * 8 * 2, "the weaker slices have less than half of the largest");
    }
}
