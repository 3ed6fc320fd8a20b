//! The counts as the search reads them: all gates summed, smoothed, on one isotropic lattice, unknown where nothing was measured.

use crate::{study::Study, volume::Grid};
use glam::DVec3;
use ndarray::Array3;

/// Spacing of the lattice. The smoothed counts change little over 4 mm; finer only costs.
const STEP_MM: f64 = 4.0;
/// A lattice of more nodes gets wider steps: a body of 60 x 60 x 130 cm has as many at 7 mm.
const MOST_NODES: f64 = 1.5e6;
/// Smoothing on top of the camera's blur: the noise of a voxel goes, a wall of 10 mm stays.
pub(super) const SMOOTHING_MM: f64 = 3.5;
/// Coarse voxels need at least this many of their spacings, or the voxels would show through.
const LEAST_SMOOTHING_VOXELS: f64 = 0.55;
/// More than a quarter of exact zeros is a mask of the field of view, not dark tissue.
const MASK_FRACTION: f64 = 0.25;
/// Counts at the rim of a mask, as part of the maximum: soft tissue has 5 % and more of the wall's uptake.
const MASK_RIM: f64 = 0.02;
/// Below this part of its full weight a node is not known.
const LEAST_WEIGHT: f32 = 0.5;

/// Smoothed counts on an isotropic lattice that is centred on the study's grid, so that turning the grid about turns the lattice with it.
#[derive(Debug, Clone)]
pub(super) struct Field {
    /// Nodes along `[x, y, z]`, each odd.
    pub nodes: [usize; 3],
    /// Distance between nodes.
    pub step_mm: f64,
    /// The first node in grid mm.
    pub origin_mm: DVec3,
    /// Smoothed counts, x fastest; NaN where unknown, and once more at the end.
    values: Vec<f32>,
}

impl Field {
    /// The sum of a study's gates; `None` if there are no counts.
    pub(super) fn of(study: &Study) -> Option<Self> {
        let mut sum = Array3::<f32>::zeros(study.grid.shape);
        for gate in &study.gates {
            sum += &gate.volume.counts;
        }
        let largest = sum.iter().copied().fold(0.0, f32::max);
        if largest <= 0.0 {
            return None;
        }
        let mask = known(&sum, largest);
        let lattice = Self::lattice(&study.grid);
        let counts =
            lattice.resample(&study.grid, sum.indexed_iter().map(|(voxel, &count)| if mask[voxel] { count } else { 0.0 }).collect());
        let full = lattice.weights(&study.grid);
        let weight = if mask.iter().all(|&inside| inside) {
            full.clone()
        } else {
            lattice.resample(&study.grid, mask.iter().map(|&inside| f32::from(u8::from(inside))).collect())
        };
        let values = counts
            .iter()
            .zip(weight.iter().zip(&full))
            .map(|(&count, (&weight, &full))| if weight > LEAST_WEIGHT * full { count / weight } else { f32::NAN })
            .chain([f32::NAN])
            .collect();
        Some(Self { values, ..lattice })
    }

    /// The nodes without values.
    fn lattice(grid: &Grid) -> Self {
        let [nz, ny, nx] = grid.shape;
        let [dz, dy, dx] = grid.spacing_mm;
        let extent = DVec3::new(nx as f64 * dx, ny as f64 * dy, nz as f64 * dz);
        let step_mm = STEP_MM.max((extent.x * extent.y * extent.z / MOST_NODES).cbrt());
        // From the middle as far as the voxels reach.
        let half = (extent / 2.0 / step_mm).to_array().map(|half| half.floor() as usize);
        let centre = DVec3::new((nx - 1) as f64 * dx, (ny - 1) as f64 * dy, (nz - 1) as f64 * dz) / 2.0;
        let origin_mm = centre - DVec3::new(half[0] as f64, half[1] as f64, half[2] as f64) * step_mm;
        Self { nodes: half.map(|half| 2 * half + 1), step_mm, origin_mm, values: Vec::new() }
    }

    /// Gaussian weighted sums of voxels at the nodes, one axis after the other.
    fn resample(&self, grid: &Grid, voxels: Vec<f32>) -> Vec<f32> {
        let [nz, ny, nx] = grid.shape;
        let (mut values, mut shape) = (voxels, [nx, ny, nz]);
        for axis in 0..3 {
            values = contract(&values, shape, axis, &self.rows(grid, axis));
            shape[axis] = self.nodes[axis];
        }
        values
    }

    /// The sum of the weights of all voxels at the nodes.
    fn weights(&self, grid: &Grid) -> Vec<f32> {
        let sums: [Vec<f32>; 3] =
            std::array::from_fn(|axis| self.rows(grid, axis).iter().map(|(_, weights)| weights.iter().sum()).collect());
        let [x, y, z] = &sums;
        z.iter().flat_map(|z| y.iter().flat_map(move |y| x.iter().map(move |x| x * y * z))).collect()
    }

    /// Of each node along an axis (0: x), the first voxel it sees and the weights from there.
    fn rows(&self, grid: &Grid, axis: usize) -> Vec<(usize, Vec<f32>)> {
        let spacing = grid.spacing_mm[2 - axis];
        let sigma = SMOOTHING_MM.max(LEAST_SMOOTHING_VOXELS * spacing);
        gaussian_rows(grid.shape[2 - axis], spacing, sigma, self.nodes[axis], self.origin_mm[axis], self.step_mm)
    }

    /// Values at places in memory.
    pub(super) fn gather(&self, places: &[u32], values: &mut Vec<f32>) {
        values.clear();
        values.extend(places.iter().map(|place| self.values[*place as usize]));
    }

    /// The place of an unknown value.
    pub(super) fn nowhere(&self) -> u32 {
        self.values.len() as u32 - 1
    }

    /// The node's value; NaN where unknown or outside.
    pub(super) fn node(&self, [x, y, z]: [i32; 3]) -> f32 {
        let [nx, ny, nz] = self.nodes;
        let (x, y, z) = (x as usize, y as usize, z as usize);
        // Negative indices became huge ones.
        if x < nx && y < ny && z < nz { self.values[(z * ny + y) * nx + x] } else { f32::NAN }
    }

    /// A point in grid mm, in steps of the lattice from its first node.
    pub(super) fn index_of(&self, point_mm: DVec3) -> DVec3 {
        (point_mm - self.origin_mm) / self.step_mm
    }

    /// A node in grid mm.
    pub(super) fn position_mm(&self, [x, y, z]: [i32; 3]) -> DVec3 {
        self.origin_mm + DVec3::new(f64::from(x), f64::from(y), f64::from(z)) * self.step_mm
    }

    /// The far corner of the lattice in grid mm.
    pub(super) fn last_mm(&self) -> DVec3 {
        self.position_mm(self.nodes.map(|nodes| nodes as i32 - 1))
    }

    /// Trilinear interpolation over the known of the eight nodes around a point; `None` where most of the weight is unknown.
    pub(super) fn at(&self, point_mm: DVec3) -> Option<f64> {
        let index = self.index_of(point_mm);
        let low = index.floor();
        let part = index - low;
        let [x, y, z] = [low.x as i32, low.y as i32, low.z as i32];
        let (mut sum, mut weight) = (0.0, 0.0);
        for corner in 0..8 {
            let [i, j, k] = [corner & 1, corner >> 1 & 1, corner >> 2];
            let value = self.node([x + i, y + j, z + k]);
            if !value.is_nan() {
                let side = |bit: i32, part: f64| if bit == 1 { part } else { 1.0 - part };
                let share = side(i, part.x) * side(j, part.y) * side(k, part.z);
                sum += share * f64::from(value);
                weight += share;
            }
        }
        (weight > 0.5).then(|| sum / weight)
    }

    /// Forgets what lies where `keep` (of grid mm) says no.
    pub(super) fn restrict(&mut self, keep: impl Fn(DVec3) -> bool) {
        let [nx, ny, _] = self.nodes;
        for node in 0..self.values.len() - 1 {
            let place = [node % nx, node / nx % ny, node / (nx * ny)].map(|index| index as i32);
            if !keep(self.position_mm(place)) {
                self.values[node] = f32::NAN;
            }
        }
    }
}

/// Normalised Gaussian weights of the voxels for each node: the first voxel and the weights from there.
fn gaussian_rows(voxels: usize, spacing: f64, sigma: f64, nodes: usize, origin: f64, step: f64) -> Vec<(usize, Vec<f32>)> {
    (0..nodes)
        .map(|node| {
            let at = origin + node as f64 * step;
            let reach = 3.5 * sigma;
            let first = ((at - reach) / spacing).ceil().max(0.0) as usize;
            let last = (((at + reach) / spacing).floor().max(0.0) as usize).min(voxels - 1);
            let first = first.min(last);
            (first, (first..=last).map(|voxel| (-0.5 * ((voxel as f64 * spacing - at) / sigma).powi(2)).exp() as f32).collect())
        })
        .collect()
}

/// Replaces one axis (0: x, fastest) by weighted sums over it.
fn contract(values: &[f32], shape: [usize; 3], axis: usize, rows: &[(usize, Vec<f32>)]) -> Vec<f32> {
    let stride: usize = shape[..axis].iter().product();
    let outer: usize = shape[axis + 1..].iter().product();
    let mut result = vec![0.0; stride * rows.len() * outer];
    for block in 0..outer {
        let from = &values[block * shape[axis] * stride..][..shape[axis] * stride];
        for (node, (first, weights)) in rows.iter().enumerate() {
            let to = &mut result[(block * rows.len() + node) * stride..][..stride];
            for (offset, &weight) in weights.iter().enumerate() {
                let line = &from[(first + offset) * stride..][..stride];
                for (to, from) in to.iter_mut().zip(line) {
                    *to += weight * from;
                }
            }
        }
    }
    result
}

/// All voxels, less those that no gate has counts in when a mask must have made them: they are many, and counts end at them abruptly.
/// Where counts fade to zero, as without background, zero was measured.
fn known(sum: &Array3<f32>, largest: f32) -> Array3<bool> {
    let dark = sum.iter().filter(|&&count| count == 0.0).count();
    let many = dark as f64 > MASK_FRACTION * sum.len() as f64;
    let masked = many && rim_mean(sum) > MASK_RIM * f64::from(largest);
    sum.mapv(|count| !masked || count != 0.0)
}

/// Mean count of the voxels that have counts next to a voxel that has none.
fn rim_mean(sum: &Array3<f32>) -> f64 {
    let (mut total, mut rim) = (0.0, 0_usize);
    for ((z, y, x), &count) in sum.indexed_iter().filter(|(_, count)| **count != 0.0) {
        let is_dark = |z: usize, y: usize, x: usize| sum.get([z, y, x]) == Some(&0.0);
        // One less than zero is no index.
        let below = |index: usize| index.wrapping_sub(1);
        let along = [(z + 1, y, x), (below(z), y, x), (z, y + 1, x), (z, below(y), x), (z, y, x + 1), (z, y, below(x))];
        if along.into_iter().any(|(z, y, x)| is_dark(z, y, x)) {
            total += f64::from(count);
            rim += 1;
        }
    }
    total / rim.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        study::{Acquisition, Format, Gate},
        volume::Volume,
    };

    fn study(grid: Grid, counts: impl Fn(DVec3) -> f64) -> Study {
        let counts = Array3::from_shape_fn(grid.shape, |(z, y, x)| counts(grid.position_mm([z, y, x])) as f32);
        let gates = vec![Gate { volume: Volume { grid, counts }, duration_ms: None }];
        Study { grid, gates, orientation: None, acquisition: Acquisition::unknown(Format::Phantom), warnings: Vec::new() }
    }

    #[test]
    fn slow_changes_are_kept_on_any_grid() {
        for spacing_mm in [[6.0, 3.0, 3.0], [5.74, 2.87, 2.87], [6.4, 6.4, 6.4]] {
            let grid = Grid { shape: [20, 30, 26], spacing_mm };
            let linear = |p: DVec3| 100.0 + p.x - 0.5 * p.y + 0.3 * p.z;
            let field = Field::of(&study(grid, linear)).unwrap();
            let middle = grid.position_mm([10, 15, 13]);
            for offset in [DVec3::ZERO, DVec3::new(3.1, -2.2, 1.3), DVec3::new(-7.0, 5.0, 9.0)] {
                let at = middle + offset;
                assert!((field.at(at).unwrap() - linear(at)).abs() < 0.15, "{spacing_mm:?}: {:?} {}", field.at(at), linear(at));
            }
            assert!(field.at(DVec3::splat(-30.0)).is_none());
            // The lattice lies in the grid as its mirror image does.
            let far = grid.position_mm([19, 29, 25]);
            assert!((field.origin_mm + field.last_mm() - far).length() < 1e-9);
        }
    }

    #[test]
    fn a_mask_is_unknown_and_fading_counts_are_known() {
        let grid = Grid { shape: [16, 40, 40], spacing_mm: [4.0, 3.0, 3.0] };
        let from_axis = |p: DVec3| (p.truncate() - glam::DVec2::splat(58.5)).length();
        let masked = Field::of(&study(grid, |p| if from_axis(p) < 35.0 { 100.0 - from_axis(p) } else { 0.0 })).unwrap();
        assert!(masked.at(DVec3::new(58.5, 10.0, 30.0)).is_none());
        assert!((masked.at(DVec3::new(58.5, 28.5, 30.0)).unwrap() - 70.0).abs() < 3.0, "no counts are lost at the rim");
        let fading = Field::of(&study(grid, |p| (100.0 * (-0.5 * (from_axis(p) / 8.0).powi(2)).exp()).round())).unwrap();
        assert!(fading.at(DVec3::new(58.5, 10.0, 30.0)).is_some());
        assert!(Field::of(&study(grid, |_| 0.0)).is_none());
    }
}
