//! Voxels and millimetres: the only place where one becomes the other.
//!
//! Arrays are ordered `[slice, row, column]` = `[z, y, x]`; points are `DVec3 { x, y, z }` in millimetres, with the centre of voxel
//! `[0, 0, 0]` at the origin, `x` along columns, `y` along rows and `z` along slices. This frame is called *grid millimetres*;
//! [`crate::study::Orientation`] takes it to the patient.

use glam::DVec3;
use ndarray::Array3;
use serde::{Deserialize, Serialize};

/// A regular lattice of voxels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Voxels along `[z, y, x]`.
    pub shape: [usize; 3],
    /// Distance between voxel centres along `[z, y, x]`, in mm, each positive.
    pub spacing_mm: [f64; 3],
}

impl Grid {
    /// Number of voxels.
    pub fn voxels(&self) -> usize {
        self.shape.iter().product()
    }

    /// Volume of one voxel in mm³.
    pub fn voxel_mm3(&self) -> f64 {
        self.spacing_mm.iter().product()
    }

    /// Spacing as a vector `(x, y, z)` in mm.
    pub fn step_mm(&self) -> DVec3 {
        let [z, y, x] = self.spacing_mm;
        DVec3::new(x, y, z)
    }

    /// The smallest spacing in mm.
    pub fn smallest_spacing_mm(&self) -> f64 {
        self.spacing_mm.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Centre of voxel `[z, y, x]` in grid mm.
    pub fn position_mm(&self, [z, y, x]: [usize; 3]) -> DVec3 {
        DVec3::new(x as f64, y as f64, z as f64) * self.step_mm()
    }

    /// Fractional voxel index `[z, y, x]` of a point in grid mm.
    pub fn fractional_index(&self, point_mm: DVec3) -> [f64; 3] {
        let index = point_mm / self.step_mm();
        [index.z, index.y, index.x]
    }

    /// The voxel whose cell holds the point, if the grid has it.
    pub fn voxel_at(&self, point_mm: DVec3) -> Option<[usize; 3]> {
        let mut voxel = [0; 3];
        for (axis, index) in self.fractional_index(point_mm).into_iter().enumerate() {
            let nearest = index.round();
            if !(nearest >= 0.0 && nearest < self.shape[axis] as f64) {
                return None;
            }
            voxel[axis] = nearest as usize;
        }
        Some(voxel)
    }
}

/// Counts on a grid: one gate of a study.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// The lattice.
    pub grid: Grid,
    /// Counts, `[z, y, x]`, all finite.
    pub counts: Array3<f32>,
}

impl Volume {
    /// An empty (all zero) volume.
    pub fn zeros(grid: Grid) -> Self {
        Self { grid, counts: Array3::zeros(grid.shape) }
    }

    /// Sum of all counts.
    pub fn total(&self) -> f64 {
        self.counts.iter().map(|&count| f64::from(count)).sum()
    }

    /// The largest count, 0 for an empty volume.
    pub fn maximum(&self) -> f32 {
        self.counts.iter().copied().fold(0.0, f32::max)
    }
}

/// A set of voxels on a grid.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VoxelSet {
    /// Membership, `[z, y, x]`.
    pub member: Array3<bool>,
}

impl VoxelSet {
    /// The empty set on a grid of this shape.
    pub fn empty(shape: [usize; 3]) -> Self {
        Self { member: Array3::from_elem(shape, false) }
    }

    /// Number of voxels in the set.
    pub fn len(&self) -> usize {
        self.member.iter().filter(|&&inside| inside).count()
    }

    /// Whether no voxel is in the set.
    pub fn is_empty(&self) -> bool {
        !self.member.iter().any(|&inside| inside)
    }

    /// The voxels `[z, y, x]` in the set, in memory order.
    pub fn voxels(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        self.member.indexed_iter().filter(|(_, inside)| **inside).map(|((z, y, x), _)| [z, y, x])
    }
}

/// A vector at every voxel, one array a component (they vectorise better apart).
#[derive(Debug, Clone, PartialEq)]
pub struct VectorField {
    /// The lattice.
    pub grid: Grid,
    /// Components along grid `x`, `y`, `z`, each `[z, y, x]`.
    pub components: [Array3<f32>; 3],
}

impl VectorField {
    /// Trilinear interpolation at a point in grid mm; points outside are clamped to the grid's faces.
    pub fn sample(&self, point_mm: DVec3) -> DVec3 {
        let cell = Cell::at(&self.grid, point_mm);
        let [x, y, z] = &self.components;
        DVec3::new(cell.interpolate(x), cell.interpolate(y), cell.interpolate(z))
    }
}

/// Trilinear interpolation of a scalar array at a point in grid mm; points outside are clamped to the grid's faces.
pub fn sample_scalar(grid: &Grid, values: &Array3<f32>, point_mm: DVec3) -> f64 {
    Cell::at(grid, point_mm).interpolate(values)
}

/// The eight voxels around a point, as places in memory order, and where the point lies among them.
struct Cell {
    /// Without, with a step along x, y, both; then the same a step along z.
    places: [usize; 8],
    fraction: [f64; 3],
}

impl Cell {
    fn at(grid: &Grid, point_mm: DVec3) -> Self {
        let [_, ny, nx] = grid.shape;
        let strides = [ny * nx, nx, 1];
        let (mut low, mut step, mut fraction) = (0, [0; 3], [0.0; 3]);
        for (axis, index) in grid.fractional_index(point_mm).into_iter().enumerate() {
            let last = grid.shape[axis] - 1;
            let clamped = index.clamp(0.0, last as f64);
            // Truncation is the floor of what is not negative, and much faster.
            let floor = clamped as usize;
            low += floor * strides[axis];
            step[axis] = if floor < last { strides[axis] } else { 0 };
            fraction[axis] = clamped - floor as f64;
        }
        let [z, y, x] = step;
        Self { places: [0, x, y, y + x, z, z + x, z + y, z + y + x].map(|offset| low + offset), fraction }
    }

    fn interpolate(&self, values: &Array3<f32>) -> f64 {
        match values.as_slice() {
            Some(flat) => self.between(flat),
            // Not in standard order; never met in the pipeline.
            None => self.between(&values.iter().copied().collect::<Vec<f32>>()),
        }
    }

    fn between(&self, flat: &[f32]) -> f64 {
        let [fz, fy, fx] = self.fraction;
        let [a, b, c, d, e, f, g, h] = self.places.map(|place| f64::from(flat[place]));
        let linear = |low: f64, high: f64, part: f64| low * (1.0 - part) + high * part;
        let (near, far) = (linear(linear(a, b, fx), linear(c, d, fx), fy), linear(linear(e, f, fx), linear(g, h, fx), fy));
        linear(near, far, fz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { shape: [4, 5, 6], spacing_mm: [6.0, 3.0, 2.0] };

    #[test]
    fn voxel_and_millimetres_are_inverse() {
        for voxel in [[0, 0, 0], [3, 4, 5], [1, 2, 3]] {
            assert_eq!(GRID.voxel_at(GRID.position_mm(voxel)), Some(voxel));
        }
        assert_eq!(GRID.position_mm([1, 2, 3]), DVec3::new(6.0, 6.0, 6.0));
        assert_eq!(GRID.voxel_at(DVec3::new(-1.1, 0.0, 0.0)), None);
        assert_eq!(GRID.voxel_at(DVec3::new(11.1, 0.0, 0.0)), None);
        assert_eq!(GRID.voxel_at(DVec3::new(f64::NAN, 0.0, 0.0)), None);
    }

    #[test]
    fn interpolation_is_exact_for_linear_functions_and_clamps_outside() {
        let linear = |p: DVec3| 1.0 + 2.0 * p.x - 0.5 * p.y + 0.25 * p.z;
        let values = Array3::from_shape_fn(GRID.shape, |(z, y, x)| linear(GRID.position_mm([z, y, x])) as f32);
        let inside = DVec3::new(3.3, 7.7, 11.1);
        assert!((sample_scalar(&GRID, &values, inside) - linear(inside)).abs() < 1e-5);
        let outside = DVec3::new(-50.0, 7.7, 11.1);
        assert!((sample_scalar(&GRID, &values, outside) - linear(DVec3::new(0.0, 7.7, 11.1))).abs() < 1e-5);
    }
}
