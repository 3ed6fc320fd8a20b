//! The ventricle's long axis, from the rings with a dark centre that short-axis slices show.

use super::{PipelineError, ring_scan::Scan};
use crate::volume::{Grid, VoxelSet, sample_scalar};
use glam::DVec2;
use ndarray::Array3;
use std::f64::consts::TAU;

/// Points on the axis: `at + slope · z`.
#[derive(Debug, Clone, Copy)]
pub(super) struct AxisLine {
    pub(super) at_mm: DVec2,
    pub(super) slope: DVec2,
}

/// Mid-wall radii tried: from a small child's end of systole to a dilated ventricle.
const RADII_MM: [f64; 10] = [12.0, 15.0, 18.0, 21.0, 24.0, 28.0, 32.0, 36.0, 41.0, 46.0];
/// From mid-wall to outside the wall: half a wall and half a camera's blur.
pub(super) const BEYOND_WALL_MM: f64 = 14.0;
/// Where the cavity is looked at, as part of the mid-wall radius.
const CAVITY_OF_RADIUS: f64 = 0.3;
/// Angles on a ring.
pub(super) const ANGLES: usize = 16;
/// A slice counts as a ring when its contrast is at least this part of the wall's uptake.
const LEAST_CONTRAST: f64 = 0.12;
/// The shortest stack of rings that is taken for a ventricle: half the cavity of a small one.
const LEAST_LENGTH_MM: f64 = 15.0;

impl AxisLine {
    pub(super) fn at(&self, z_mm: f64) -> DVec2 {
        self.at_mm + self.slope * z_mm
    }
}

/// A ring with a dark centre in one slice.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ring {
    pub(super) z_mm: f64,
    pub(super) centre_mm: DVec2,
    pub(super) radius_mm: f64,
    /// How much brighter the wall is than the mean of the cavity and what lies outside.
    pub(super) contrast: f64,
    pub(super) wall: f64,
}

/// Points of the circles about a centre that are looked at: on the wall, in the cavity and outside of the wall.
#[derive(Debug)]
pub(super) struct Circle {
    pub(super) radius_mm: f64,
    pub(super) wall: [DVec2; ANGLES],
    pub(super) cavity: [DVec2; ANGLES / 2],
    pub(super) outside: [DVec2; ANGLES / 2],
}

/// A circle for each of the radii.
pub(super) fn circles() -> [Circle; RADII_MM.len()] {
    fn around<const COUNT: usize>(radius_mm: f64) -> [DVec2; COUNT] {
        let mut points = [DVec2::ZERO; COUNT];
        for (point, out) in points.iter_mut().zip(directions(COUNT)) {
            *point = out * radius_mm;
        }
        points
    }
    RADII_MM.map(|radius_mm| Circle {
        radius_mm,
        wall: around(radius_mm),
        cavity: around(radius_mm * CAVITY_OF_RADIUS),
        outside: around(radius_mm + BEYOND_WALL_MM),
    })
}

/// The best of the radii at a centre of a slice: the wall is the mean of the ring, so that a defect costs its part of
/// the contrast and no more.
fn ring_at(circles: &[Circle], slice: &Slice<'_>, centre_mm: DVec2) -> Ring {
    let mut best = Ring { z_mm: slice.z_mm, centre_mm, radius_mm: RADII_MM[0], contrast: f64::NEG_INFINITY, wall: 0.0 };
    let middle = slice.at(centre_mm);
    for circle in circles {
        let mean = |points: &[DVec2]| points.iter().map(|point| slice.at(centre_mm + point)).sum::<f64>() / points.len() as f64;
        let (wall, cavity) = (mean(&circle.wall), f64::midpoint(middle, mean(&circle.cavity)));
        let contrast = wall - f64::midpoint(cavity, mean(&circle.outside));
        if cavity < wall && contrast > best.contrast {
            best = Ring { radius_mm: circle.radius_mm, contrast, wall, ..best };
        }
    }
    best
}

/// Numbers of one slice, read between the voxels.
struct Slice<'a> {
    grid: &'a Grid,
    values: &'a Array3<f32>,
    z_mm: f64,
    /// The slice's own numbers, where its height is exactly that of its voxels.
    flat: Option<&'a [f32]>,
}

impl<'a> Slice<'a> {
    fn new(grid: &'a Grid, values: &'a Array3<f32>, number: usize) -> Self {
        let z_mm = number as f64 * grid.spacing_mm[0];
        let voxels = grid.shape[1] * grid.shape[2];
        let exact = (z_mm / grid.spacing_mm[0]).total_cmp(&(number as f64)).is_eq();
        let flat = values.as_slice().filter(|_| exact).and_then(|flat| flat.get(number * voxels..(number + 1) * voxels));
        Self { grid, values, z_mm, flat }
    }

    /// What [`at`] answers, to the last bit.
    fn at(&self, point_mm: DVec2) -> f64 {
        let Some(flat) = self.flat else { return at(self.grid, self.values, point_mm, self.z_mm) };
        let ([_, rows, columns], [_, dy, dx]) = (self.grid.shape, self.grid.spacing_mm);
        let place = |index: f64, length: usize| {
            let clamped = index.clamp(0.0, (length - 1) as f64);
            let floor = clamped as usize;
            (floor, (floor + 1).min(length - 1), clamped - floor as f64)
        };
        let ((y, next_y, part_y), (x, next_x, part_x)) = (place(point_mm.y / dy, rows), place(point_mm.x / dx, columns));
        let linear = |low: f64, high: f64, part: f64| low * (1.0 - part) + high * part;
        let row = |y: usize| linear(f64::from(flat[y * columns + x]), f64::from(flat[y * columns + next_x]), part_x);
        linear(row(y), row(next_y), part_y)
    }
}

/// The column of the image that has the most ring contrast over the slices.
///
/// All columns are judged by a bound first ([`Scan`]), and those that may be the best by the contrast itself.
pub(super) fn best_centre(grid: &Grid, smooth: &Array3<f32>, known: &VoxelSet) -> Result<DVec2, PipelineError> {
    let circles = circles();
    let slices: Vec<Slice<'_>> = (0..grid.shape[0]).map(|slice| Slice::new(grid, smooth, slice)).collect();
    let scan = Scan::of(grid, smooth, &circles);
    let is_known = |[y, x]: [usize; 2]| (0..grid.shape[0]).any(|z| known.member[[z, y, x]]);
    let mut columns: Vec<(f64, [usize; 2])> = scan.bounds().filter(|(_, column)| is_known(*column)).collect();
    columns.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut best: Option<(f64, [usize; 2])> = None;
    for (bound, column @ [y, x]) in columns {
        if bound <= 0.0 || best.is_some_and(|(most, _)| bound < most) {
            break;
        }
        let centre = grid.position_mm([0, y, x]).truncate();
        let score: f64 = slices.iter().map(|slice| ring_at(&circles, slice, centre).contrast.max(0.0)).sum();
        // Of equal ones the first in the order of rows.
        if score > 0.0 && best.is_none_or(|(most, at)| score.total_cmp(&most).then(at.cmp(&column)).is_gt()) {
            best = Some((score, column));
        }
    }
    let centre = best.map(|(_, [y, x])| grid.position_mm([0, y, x]).truncate());
    centre.ok_or_else(|| PipelineError::NoLeftVentricle { why: "no slice shows a ring with a dark centre".into() })
}

/// The best ring of each slice within 12 mm of the start (at the start itself where it was given).
pub(super) fn follow_rings(grid: &Grid, smooth: &Array3<f32>, start: DVec2, fixed: bool) -> Vec<Ring> {
    let reach = if fixed { 0 } else { 4 };
    let circles = circles();
    (0..grid.shape[0])
        .filter_map(|slice| {
            let slice = Slice::new(grid, smooth, slice);
            let mut best: Option<Ring> = None;
            for v in -reach..=reach {
                for u in -reach..=reach {
                    let ring = ring_at(&circles, &slice, start + DVec2::new(f64::from(u), f64::from(v)) * 3.0);
                    if ring.contrast > 0.0 && best.is_none_or(|best| ring.contrast > best.contrast) {
                        best = Some(ring);
                    }
                }
            }
            best
        })
        .collect()
}

/// The rings that stand out, if they are enough for a ventricle.
pub(super) fn significant(grid: &Grid, rings: Vec<Ring>) -> Result<Vec<Ring>, PipelineError> {
    let brightest = rings.iter().map(|ring| ring.wall).fold(0.0, f64::max);
    let kept: Vec<Ring> = rings.into_iter().filter(|ring| ring.contrast >= LEAST_CONTRAST * brightest).collect();
    let length = kept.len() as f64 * grid.spacing_mm[0];
    if length < LEAST_LENGTH_MM {
        let why =
            format!("rings with a dark centre reach over {length:.0} mm of the stack, a ventricle's over {LEAST_LENGTH_MM:.0} mm and more");
        return Err(PipelineError::NoLeftVentricle { why });
    }
    Ok(kept)
}

/// Height of the rings' middle, weighted by their contrast.
pub(super) fn middle_mm(rings: &[Ring]) -> f64 {
    let total: f64 = rings.iter().map(|ring| ring.contrast).sum();
    rings.iter().map(|ring| ring.contrast * ring.z_mm).sum::<f64>() / total
}

/// Line through the rings' centres by weighted least squares, twice: the second time those more than 6 mm off count for nothing.
pub(super) fn fit_axis(rings: &[Ring]) -> AxisLine {
    let fit = |weights: &[f64]| {
        let total: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let mean_z = rings.iter().zip(weights).map(|(ring, w)| w * ring.z_mm).sum::<f64>() / total;
        let mean_c = rings.iter().zip(weights).map(|(ring, w)| ring.centre_mm * *w).sum::<DVec2>() / total;
        let spread: f64 = rings.iter().zip(weights).map(|(ring, w)| w * (ring.z_mm - mean_z).powi(2)).sum();
        let shared: DVec2 = rings.iter().zip(weights).map(|(ring, w)| (ring.centre_mm - mean_c) * (w * (ring.z_mm - mean_z))).sum();
        let slope = if spread > 0.0 { shared / spread } else { DVec2::ZERO };
        AxisLine { at_mm: mean_c - slope * mean_z, slope }
    };
    let weights: Vec<f64> = rings.iter().map(|ring| ring.contrast).collect();
    let first = fit(&weights);
    let near: Vec<f64> =
        rings.iter().map(|ring| if ring.centre_mm.distance(first.at(ring.z_mm)) < 6.0 { ring.contrast } else { 0.0 }).collect();
    if near.iter().filter(|&&weight| weight > 0.0).count() >= 3 { fit(&near) } else { first }
}

/// Unit vectors all round.
pub(super) fn directions(count: usize) -> impl Iterator<Item = DVec2> {
    (0..count).map(move |i| DVec2::from_angle(TAU * i as f64 / count as f64))
}

/// The value at a point of a slice.
pub(super) fn at(grid: &Grid, values: &Array3<f32>, point_mm: DVec2, z_mm: f64) -> f64 {
    sample_scalar(grid, values, point_mm.extend(z_mm))
}
