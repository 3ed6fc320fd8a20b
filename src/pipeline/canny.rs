//! Canny edges (paper §7.1, after Canny 1986): smoothed gradient, thinning along the gradient, hysteresis.
//!
//! In `slice` mode every slice is an image and σ counts pixels, as in the paper; in `volume` mode the Gaussian is isotropic in mm, with
//! σ times the in-plane spacing. Voxels outside the camera's field of view are unknown, not dark: smoothing is a normalised
//! convolution over the known ones, so that the mask's rim is no edge.
//!
//! [`gradient`] and [`edges`] answer for both operators; the other one is in `plain`.

use super::{
    parameters::{EdgeMode, EdgeOperator, EdgeParameters},
    plain,
    simd::vectorised,
};
use crate::volume::{Grid, VectorField, Volume, VoxelSet, sample_scalar};
use glam::DVec3;
use ndarray::{Array3, Zip};

/// The gradient of the counts, smoothed for Canny and as they are for the plain operator.
#[derive(Debug, Clone)]
pub struct Gradient {
    /// Gradient in counts a mm; the slice component is zero in `slice` mode.
    pub field: VectorField,
    /// Its length, `[z, y, x]`.
    pub magnitude: Array3<f32>,
}

/// A voxel on an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgePoint {
    /// The voxel `[z, y, x]`.
    pub voxel: [usize; 3],
    /// The edge at sub-voxel precision, in grid mm: the vertex of the parabola through the gradient's length.
    pub position_mm: DVec3,
    /// Unit gradient: the direction in which counts grow.
    pub uphill: DVec3,
    /// Length of the gradient in counts a mm.
    pub strength: f32,
}

/// A Gaussian ends where it has fallen below 3·10⁻⁴ of its maximum.
const KERNEL_SIGMAS: f64 = 4.0;

/// The smoothing that Canny's operator begins with, the same for all gates of a study.
pub fn smoothing<'a>(grid: &Grid, known: &'a VoxelSet, edges: &EdgeParameters) -> Smoothing<'a> {
    let [dz, dy, dx] = grid.spacing_mm;
    let sigma_mm = edges.sigma * f64::midpoint(dx, dy);
    let sigmas = match edges.mode {
        EdgeMode::Slice => [0.0, edges.sigma, edges.sigma],
        EdgeMode::Volume => [sigma_mm / dz, sigma_mm / dy, sigma_mm / dx],
    };
    Smoothing::new(known, sigmas)
}

/// The gradient of the counts over the known voxels: smoothed by a Gaussian (Canny), or of the counts themselves (plain operator).
pub fn gradient(volume: &Volume, known: &VoxelSet, edges: &EdgeParameters) -> Gradient {
    let smoothing = (edges.operator == EdgeOperator::Canny).then(|| smoothing(&volume.grid, known, edges));
    gradient_after(smoothing.as_ref(), volume, known, edges)
}

/// [`gradient`] with the smoothing at hand that its operator begins with.
pub fn gradient_after(smoothing: Option<&Smoothing<'_>>, volume: &Volume, known: &VoxelSet, edges: &EdgeParameters) -> Gradient {
    let grid = volume.grid;
    let [dz, dy, dx] = grid.spacing_mm;
    let smooth = smoothing.map(|smoothing| smoothing.of(&volume.counts));
    let derivative = |axis: usize, spacing: f64| match &smooth {
        Some(smooth) => central_difference(smooth, axis, spacing),
        None => plain::difference(&volume.counts, known, axis, spacing),
    };
    let along_z = match edges.mode {
        EdgeMode::Slice => Array3::zeros(grid.shape),
        EdgeMode::Volume => derivative(0, dz),
    };
    let components = [derivative(2, dx), derivative(1, dy), along_z];
    let mut magnitude = Array3::zeros(grid.shape);
    let [x, y, z] = &components;
    Zip::from(&mut magnitude).and(x).and(y).and(z).for_each(|m: &mut f32, &x, &y, &z| *m = (x * x + y * y + z * z).sqrt());
    Gradient { field: VectorField { grid, components }, magnitude }
}

/// Edges among the eligible voxels.
///
/// Canny: local maxima of the gradient along itself, at least `low` and joined (8 or 26 neighbours) to one of at least `high` times the
/// largest of them, of their slice in `slice` mode. Plain operator: every voxel of at least `threshold` times the largest, likewise.
pub fn edges(gradient: &Gradient, eligible: &VoxelSet, parameters: &EdgeParameters) -> Vec<EdgePoint> {
    match parameters.operator {
        EdgeOperator::Canny => hysteresis(thin(gradient, eligible, parameters.mode), gradient.field.grid.shape, parameters),
        EdgeOperator::Gradient => plain::edges(gradient, eligible, parameters),
    }
}

/// The candidates that pass both thresholds.
fn hysteresis(candidates: Vec<EdgePoint>, shape: [usize; 3], parameters: &EdgeParameters) -> Vec<EdgePoint> {
    let fractions = fractions(&candidates, parameters.mode, shape[0]);
    let mut index = Array3::from_elem(shape, usize::MAX);
    for (number, point) in candidates.iter().enumerate() {
        index[point.voxel] = number;
    }
    let mut kept: Vec<bool> = fractions.iter().map(|&fraction| fraction >= parameters.high).collect();
    let mut front: Vec<usize> = (0..candidates.len()).filter(|&number| kept[number]).collect();
    while let Some(number) = front.pop() {
        for neighbour in neighbours(candidates[number].voxel, shape, parameters.mode) {
            let other = index[neighbour];
            if other != usize::MAX && !kept[other] && fractions[other] >= parameters.low {
                kept[other] = true;
                front.push(other);
            }
        }
    }
    candidates.into_iter().zip(kept).filter_map(|(point, kept)| kept.then_some(point)).collect()
}

/// The strength of each point as a part of the largest: of those of its slice in `slice` mode, of all in `volume` mode.
pub(super) fn fractions(points: &[EdgePoint], mode: EdgeMode, slices: usize) -> Vec<f64> {
    let slice_of = |point: &EdgePoint| if mode == EdgeMode::Slice { point.voxel[0] } else { 0 };
    let mut largest = vec![f32::MIN_POSITIVE; slices];
    for point in points {
        let slot = &mut largest[slice_of(point)];
        *slot = slot.max(point.strength);
    }
    points.iter().map(|point| f64::from(point.strength) / f64::from(largest[slice_of(point)])).collect()
}

/// Local maxima of the gradient's length along the gradient.
fn thin(gradient: &Gradient, eligible: &VoxelSet, mode: EdgeMode) -> Vec<EdgePoint> {
    let grid = &gradient.field.grid;
    let [x, y, z] = &gradient.field.components;
    eligible
        .voxels()
        .filter_map(|voxel| {
            let strength = gradient.magnitude[voxel];
            let direction = DVec3::new(f64::from(x[voxel]), f64::from(y[voxel]), f64::from(z[voxel]));
            let uphill = direction.try_normalize()?;
            let step = step_mm(grid, uphill, mode);
            let centre = grid.position_mm(voxel);
            let at = |distance: f64| sample_scalar(grid, &gradient.magnitude, centre + uphill * distance);
            let (before, here, after) = (at(-step), f64::from(strength), at(step));
            if here < before || here <= after {
                return None;
            }
            let bend = before - 2.0 * here + after;
            let offset = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
            Some(EdgePoint { voxel, position_mm: centre + uphill * (offset * step), uphill, strength })
        })
        .collect()
}

/// The step along a direction that crosses one voxel along the axis it runs most.
fn step_mm(grid: &Grid, direction: DVec3, mode: EdgeMode) -> f64 {
    let in_voxels = (direction / grid.step_mm()).abs();
    match mode {
        EdgeMode::Slice => 1.0 / in_voxels.x.max(in_voxels.y),
        EdgeMode::Volume => 1.0 / in_voxels.max_element(),
    }
}

/// The voxels that share a corner with one, of its slice in `slice` mode.
pub(super) fn neighbours([z, y, x]: [usize; 3], shape: [usize; 3], mode: EdgeMode) -> impl Iterator<Item = [usize; 3]> {
    let reach = |centre: usize, length: usize| centre.saturating_sub(1)..=(centre + 1).min(length - 1);
    let slices = if mode == EdgeMode::Slice { z..=z } else { reach(z, shape[0]) };
    slices
        .flat_map(move |z| reach(y, shape[1]).map(move |y| (z, y)))
        .flat_map(move |(z, y)| reach(x, shape[2]).map(move |x| [z, y, x]))
        .filter(move |&voxel| voxel != [z, y, x])
}

/// Gaussian smoothing by normalised convolution: the weighted mean of the known voxels within reach.
#[derive(Debug, Clone)]
pub struct Smoothing<'a> {
    known: &'a VoxelSet,
    /// A kernel for each axis that is smoothed.
    kernels: Vec<(usize, Vec<f32>)>,
    /// Sum of the kernel's weights of the known voxels about each voxel.
    weight: Array3<f32>,
}

impl<'a> Smoothing<'a> {
    /// σ in voxels along `[z, y, x]`; an axis with σ = 0 is left alone.
    pub fn new(known: &'a VoxelSet, sigmas: [f64; 3]) -> Self {
        let smoothed = sigmas.into_iter().enumerate().filter(|(_, sigma)| *sigma > 0.0);
        let kernels: Vec<(usize, Vec<f32>)> = smoothed.map(|(axis, sigma)| (axis, gaussian_kernel(sigma))).collect();
        let weight = convolve_all(known.member.mapv(|inside| if inside { 1.0 } else { 0.0 }), &kernels);
        Self { known, kernels, weight }
    }

    /// Smooths numbers on the grid of the known voxels.
    pub fn of(&self, values: &Array3<f32>) -> Array3<f32> {
        let mut known = values.as_standard_layout().into_owned();
        known.zip_mut_with(&self.known.member, |value, &inside| *value *= if inside { 1.0 } else { 0.0 });
        let mut sum = convolve_all(known, &self.kernels);
        sum.zip_mut_with(&self.weight, |sum, &weight| *sum = if weight > 1e-6 { *sum / weight } else { 0.0 });
        sum
    }
}

fn gaussian_kernel(sigma: f64) -> Vec<f32> {
    let reach = (KERNEL_SIGMAS * sigma).ceil() as i32;
    let weights: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (f64::from(i) / sigma).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| (weight / total) as f32).collect()
}

/// Convolutions along several axes; outside the array is zero (and unknown to [`Smoothing`]).
fn convolve_all(mut values: Array3<f32>, kernels: &[(usize, Vec<f32>)]) -> Array3<f32> {
    let shape = values.raw_dim();
    let mut result = Array3::zeros(shape);
    for (axis, kernel) in kernels {
        if let (Some(from), Some(to)) = (values.as_slice(), result.as_slice_mut()) {
            let inner: usize = (axis + 1..3).map(|axis| shape[axis]).product();
            if inner == 1 {
                convolve_rows(from, to, kernel, shape[*axis]);
            } else {
                convolve_across(from, to, kernel, shape[*axis], inner);
            }
        }
        std::mem::swap(&mut values, &mut result);
    }
    values
}

/// Numbers that are summed side by side.
const ABREAST: usize = 32;

vectorised! {
    /// Convolves along the rows themselves, of `length` each.
    fn convolve_rows(from: &[f32], to: &mut [f32], kernel: &[f32], length: usize) {
        let reach = kernel.len() / 2;
        let mut padded = vec![0.0; length + 2 * reach];
        for (from, to) in from.chunks_exact(length).zip(to.chunks_exact_mut(length)) {
            padded[reach..reach + length].copy_from_slice(from);
            let (whole, rest) = to.as_chunks_mut::<ABREAST>();
            let done = whole.len() * ABREAST;
            for (number, to) in whole.iter_mut().enumerate() {
                let mut sums = [0.0; ABREAST];
                for (tap, weight) in kernel.iter().enumerate() {
                    let from = &padded[number * ABREAST + tap..][..ABREAST];
                    for i in 0..ABREAST {
                        sums[i] += from[i] * weight;
                    }
                }
                *to = sums;
            }
            for (i, to) in rest.iter_mut().enumerate() {
                *to = padded[done + i..].iter().zip(kernel).map(|(from, weight)| from * weight).sum();
            }
        }
    }
}

vectorised! {
    /// Convolves across rows of `inner` numbers, `length` of which belong together.
    fn convolve_across(from: &[f32], to: &mut [f32], kernel: &[f32], length: usize, inner: usize) {
        let reach = kernel.len() / 2;
        for (from, to) in from.chunks_exact(length * inner).zip(to.chunks_exact_mut(length * inner)) {
            for (i, to) in to.chunks_exact_mut(inner).enumerate() {
                let (first, last) = (i.saturating_sub(reach), (i + reach).min(length - 1));
                let weights = &kernel[first + reach - i..=last + reach - i];
                let (whole, rest) = to.as_chunks_mut::<ABREAST>();
                let done = whole.len() * ABREAST;
                for (number, to) in whole.iter_mut().enumerate() {
                    let mut sums = [0.0; ABREAST];
                    for (row, weight) in (first..).zip(weights) {
                        let from = &from[row * inner + number * ABREAST..][..ABREAST];
                        for i in 0..ABREAST {
                            sums[i] += from[i] * weight;
                        }
                    }
                    *to = sums;
                }
                for (i, to) in rest.iter_mut().enumerate() {
                    *to = (first..).zip(weights).map(|(row, weight)| from[row * inner + done + i] * weight).sum();
                }
            }
        }
    }
}

/// Central differences a mm, one-sided at the ends.
pub(super) fn central_difference(values: &Array3<f32>, axis: usize, spacing_mm: f64) -> Array3<f32> {
    let values = values.as_standard_layout();
    let mut result = Array3::zeros(values.raw_dim());
    let inner: usize = (axis + 1..3).map(|axis| values.shape()[axis]).product();
    if let (Some(from), Some(to)) = (values.as_slice(), result.as_slice_mut()) {
        differences(from, to, values.shape()[axis], inner, spacing_mm as f32);
    }
    result
}

vectorised! {
    fn differences(from: &[f32], to: &mut [f32], length: usize, inner: usize, step: f32) {
        for (from, to) in from.chunks_exact((length * inner).max(1)).zip(to.chunks_exact_mut((length * inner).max(1))) {
            if inner == 1 && length > 2 {
                let across = step * 2.0;
                for ((to, low), high) in to[1..length - 1].iter_mut().zip(from).zip(&from[2..]) {
                    *to = (high - low) / across;
                }
                to[0] = (from[1] - from[0]) / step;
                to[length - 1] = (from[length - 1] - from[length - 2]) / step;
                continue;
            }
            for (i, to) in to.chunks_exact_mut(inner).enumerate() {
                let (low, high) = (i.saturating_sub(1), (i + 1).min(length - 1));
                if high > low {
                    let across = step * (high - low) as f32;
                    for ((to, low), high) in to.iter_mut().zip(&from[low * inner..]).zip(&from[high * inner..]) {
                        *to = (high - low) / across;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::parameters::Parameters;

    /// A ball of radius 20 mm about the middle of a 2 mm grid, ramped over one voxel.
    fn ball() -> Volume {
        let grid = Grid { shape: [41, 41, 41], spacing_mm: [2.0; 3] };
        let counts = Array3::from_shape_fn(grid.shape, |(z, y, x)| {
            let r = grid.position_mm([z, y, x]).distance(DVec3::splat(40.0));
            (0.5 - (r - 20.0) / 2.0).clamp(0.0, 1.0) as f32 * 100.0
        });
        Volume { grid, counts }
    }

    fn all(shape: [usize; 3]) -> VoxelSet {
        VoxelSet { member: Array3::from_elem(shape, true) }
    }

    #[test]
    fn edges_of_a_ball_lie_on_its_surface() {
        let volume = ball();
        let everywhere = all(volume.grid.shape);
        for mode in [EdgeMode::Slice, EdgeMode::Volume] {
            let parameters = EdgeParameters { sigma: 1.0, mode, ..Parameters::paper().edges };
            let gradient = gradient(&volume, &everywhere, &parameters);
            let found = edges(&gradient, &everywhere, &parameters);
            assert!(found.len() > 500, "{mode:?}: {}", found.len());
            // A Gaussian moves the steepest place of a curved edge inwards by σ²/2R for each curved direction.
            let (sigma_mm, curved) = (2.0, if mode == EdgeMode::Volume { 2.0 } else { 1.0 });
            let expected = 20.0 - curved * sigma_mm * sigma_mm / (2.0 * 20.0);
            let ring: Vec<&EdgePoint> = found.iter().filter(|point| mode == EdgeMode::Volume || point.voxel[0] == 20).collect();
            let radius = |point: &EdgePoint| (point.position_mm - DVec3::splat(40.0)).length();
            let mean = ring.iter().map(|point| radius(point)).sum::<f64>() / ring.len() as f64;
            assert!((mean - expected).abs() < 0.2, "{mode:?}: {mean}, a tenth of a voxel from {expected}");
            for point in ring {
                // The parabola's three points lie up to √3 voxels apart on the gradient's interpolated length.
                assert!((radius(point) - expected).abs() < 0.6, "{mode:?} {} {point:?}", radius(point));
                let outwards = (point.position_mm - DVec3::splat(40.0)).normalize();
                assert!(point.uphill.dot(outwards) < -0.95, "counts grow inwards: {point:?}");
            }
        }
    }

    #[test]
    fn edges_turn_with_the_image_and_do_not_see_its_scale() {
        let volume = ball();
        let turned =
            Volume { counts: Array3::from_shape_fn(volume.grid.shape, |(z, y, x)| 7.0 * volume.counts[[z, x, 40 - y]]), ..volume.clone() };
        let everywhere = all(volume.grid.shape);
        let parameters = Parameters::paper().edges;
        let voxels = |volume: &Volume| {
            let mut list: Vec<[usize; 3]> =
                edges(&gradient(volume, &everywhere, &parameters), &everywhere, &parameters).iter().map(|p| p.voxel).collect();
            list.sort_unstable();
            list
        };
        let mut expected: Vec<[usize; 3]> = voxels(&volume).into_iter().map(|[z, y, x]| [z, 40 - x, y]).collect();
        expected.sort_unstable();
        let found = voxels(&turned);
        // Ties in the thinning may fall either way on an exactly symmetric image; nothing else may differ.
        let differing = found.iter().filter(|voxel| expected.binary_search(voxel).is_err()).count();
        assert!(differing * 50 < found.len(), "{differing} of {}", found.len());
    }

    #[test]
    fn the_rim_of_the_field_of_view_is_no_edge() {
        let mut volume = ball();
        volume.counts += 50.0;
        let mut known = all(volume.grid.shape);
        for ((z, y, x), inside) in known.member.indexed_iter_mut() {
            let offset = volume.grid.position_mm([z, y, x]) - DVec3::splat(40.0);
            *inside = offset.x.hypot(offset.y) < 34.0;
        }
        Zip::from(&mut volume.counts).and(&known.member).for_each(|count, &inside| {
            if !inside {
                *count = 0.0;
            }
        });
        let parameters = Parameters::paper().edges;
        let found = edges(&gradient(&volume, &known, &parameters), &known, &parameters);
        let rim = found.iter().filter(|p| p.voxel[0] == 20 && (p.position_mm - DVec3::splat(40.0)).truncate().length() > 26.0).count();
        assert_eq!(rim, 0);
    }
}
