//! A quick look for rings at all places of all slices, in f32: how much contrast there may be at most.
//!
//! The mean of a circle of interpolated points about a voxel is a weighted sum of the voxels around it, with weights that are the same for
//! every voxel. So whole rows are summed at once, each by its weight.

use super::{axis::Circle, simd::vectorised};
use crate::volume::Grid;
use glam::DVec2;
use ndarray::Array3;

/// Distance in mm between the places that are looked at, unless voxels are farther apart.
const STRIDE_MM: f64 = 4.0;
/// Places that are summed at once.
const ABREAST: usize = 32;
/// What f32 may take from the contrast of a ring whose brightest voxel is 1, by far.
const ROUNDING: f32 = 2e-5;

/// A bound on the sum over the slices of the best ring's contrast.
pub(super) struct Scan {
    stride: usize,
    /// Places along a row, to whole vectors.
    width: usize,
    places: usize,
    bounds: Vec<f32>,
    brightest: f32,
}

impl Scan {
    pub(super) fn of(grid: &Grid, smooth: &Array3<f32>, circles: &[Circle]) -> Self {
        let [slices, rows, columns] = grid.shape;
        let [_, dy, dx] = grid.spacing_mm;
        let stride = ((STRIDE_MM / dx.min(dy)).round() as usize).max(1);
        let places = columns.div_ceil(stride);
        let width = places.next_multiple_of(ABREAST);
        let lines = rows.div_ceil(stride);
        let brightest = smooth.iter().copied().fold(0.0, f32::max);
        let mut scan = Self { stride, width, places, bounds: vec![0.0; lines * width], brightest };
        if brightest <= 0.0 {
            return scan;
        }
        let farthest_mm = circles.iter().flat_map(|circle| &circle.outside).map(|point| point.length()).fold(0.0, f64::max);
        let margin = [dy, dx].map(|spacing| (farthest_mm / spacing).ceil() as usize + 2);
        let padded = Padded { margin, stride, length: (width * stride + 2 * margin[1]).div_ceil(stride) };
        let sums: Vec<[Sum; 3]> = circles.iter().map(|circle| padded.sums(grid, circle)).collect();
        let mut image = vec![0.0; (rows + 2 * margin[0]) * stride * padded.length];
        for z in 0..slices {
            padded.fill(&mut image, grid, smooth, z, brightest);
            for line in 0..lines {
                let start = line * stride * stride * padded.length;
                best_rings(&image[start..], &sums, &mut scan.bounds[line * width..(line + 1) * width]);
            }
        }
        scan
    }

    /// The places `[y, x]` that are looked at, each with the most that its contrasts may sum up to.
    pub(super) fn bounds(&self) -> impl Iterator<Item = (f64, [usize; 2])> {
        let place = |line: usize, column: usize| [line * self.stride, column * self.stride];
        self.bounds.chunks_exact(self.width).enumerate().flat_map(move |(line, bounds)| {
            let found = bounds[..self.places].iter().enumerate();
            found.map(move |(column, &bound)| (f64::from(bound) * f64::from(self.brightest), place(line, column)))
        })
    }
}

/// A slice with its rim repeated outwards. Of a row, every `stride`-th voxel follows the one before: a row of the slice is `stride` rows here.
struct Padded {
    margin: [usize; 2],
    stride: usize,
    length: usize,
}

/// Voxels to be summed, by their distance in the image, with their weights.
type Sum = Vec<(usize, f32)>;

impl Padded {
    fn fill(&self, image: &mut [f32], grid: &Grid, smooth: &Array3<f32>, z: usize, brightest: f32) {
        let [_, rows, columns] = grid.shape;
        for (number, line) in image.chunks_exact_mut(self.length).enumerate() {
            let y = (number / self.stride).saturating_sub(self.margin[0]).min(rows - 1);
            for (i, value) in line.iter_mut().enumerate() {
                let x = (i * self.stride + number % self.stride).saturating_sub(self.margin[1]).min(columns - 1);
                *value = smooth[[z, y, x]] / brightest;
            }
        }
    }

    /// Wall, cavity and outside of a circle.
    fn sums(&self, grid: &Grid, circle: &Circle) -> [Sum; 3] {
        let cavity = self.sum(grid, &circle.cavity, &[DVec2::ZERO]);
        [self.sum(grid, &circle.wall, &[]), cavity, self.sum(grid, &circle.outside, &[])]
    }

    /// The mean over points, or that of the means of two sets of them.
    fn sum(&self, grid: &Grid, points: &[DVec2], others: &[DVec2]) -> Sum {
        let [_, dy, dx] = grid.spacing_mm;
        let parts = if others.is_empty() { 1.0 } else { 2.0 };
        let mut weights = std::collections::BTreeMap::<usize, f64>::new();
        for set in [points, others] {
            for point in set {
                let index = [point.y / dy + self.margin[0] as f64, point.x / dx + self.margin[1] as f64];
                let part = index.map(|index| index - index.floor());
                for (down, along) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let (y, x) = (index[0] as usize + down, index[1] as usize + along);
                    let weight = [(down, part[0]), (along, part[1])].map(|(far, part)| if far == 1 { part } else { 1.0 - part });
                    let place = (y * self.stride + x % self.stride) * self.length + x / self.stride;
                    *weights.entry(place).or_default() += weight[0] * weight[1] / (parts * set.len() as f64);
                }
            }
        }
        weights.into_iter().filter(|(_, weight)| *weight > 0.0).map(|(place, weight)| (place, weight as f32)).collect()
    }
}

vectorised! {
    /// Adds to the bound of each place of a line the contrast of the best ring about it.
    fn best_rings(image: &[f32], circles: &[[Sum; 3]], bounds: &mut [f32]) {
        for (number, bounds) in bounds.as_chunks_mut::<ABREAST>().0.iter_mut().enumerate() {
            let mut best = [0.0_f32; ABREAST];
            for sums in circles {
                let mut means = [[0.0_f32; ABREAST]; 3];
                for (mean, sum) in means.iter_mut().zip(sums) {
                    let mut total = [0.0_f32; ABREAST];
                    for &(place, weight) in sum {
                        let from = &image[place + number * ABREAST..][..ABREAST];
                        for i in 0..ABREAST {
                            total[i] += from[i] * weight;
                        }
                    }
                    *mean = total;
                }
                let [wall, cavity, outside] = &means;
                for i in 0..ABREAST {
                    let contrast = wall[i] - 0.5 * (cavity[i] + outside[i]) + ROUNDING;
                    let most = if cavity[i] < wall[i] + ROUNDING { contrast } else { 0.0 };
                    best[i] = if most > best[i] { most } else { best[i] };
                }
            }
            for (bound, best) in bounds.iter_mut().zip(best) {
                *bound += best;
            }
        }
    }
}
