//! The ventricle's long axis, from the rings with a dark centre that short-axis slices show.

use super::PipelineError;
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

/// The best of the radii at a centre of a slice: the wall is the mean of the ring, so that a defect costs its part of
/// the contrast and no more.
fn ring_at(grid: &Grid, smooth: &Array3<f32>, centre_mm: DVec2, z_mm: f64) -> Ring {
    let mut best = Ring { z_mm, centre_mm, radius_mm: RADII_MM[0], contrast: f64::NEG_INFINITY, wall: 0.0 };
    for radius_mm in RADII_MM {
        let wall: Vec<f64> = directions(ANGLES).map(|out| at(grid, smooth, centre_mm + out * radius_mm, z_mm)).collect();
        let wall = wall.iter().sum::<f64>() / ANGLES as f64;
        let mean = |radius: f64| directions(8).map(|out| at(grid, smooth, centre_mm + out * radius, z_mm)).sum::<f64>() / 8.0;
        let cavity = f64::midpoint(at(grid, smooth, centre_mm, z_mm), mean(radius_mm * 0.3));
        let contrast = wall - f64::midpoint(cavity, mean(radius_mm + BEYOND_WALL_MM));
        if cavity < wall && contrast > best.contrast {
            best = Ring { radius_mm, contrast, wall, ..best };
        }
    }
    best
}

/// The column of the image that has the most ring contrast over the slices.
pub(super) fn best_centre(grid: &Grid, smooth: &Array3<f32>, known: &VoxelSet) -> Result<DVec2, PipelineError> {
    let [dz, dy, dx] = grid.spacing_mm;
    let stride = ((4.0 / dx.min(dy)).round() as usize).max(1);
    let mut best: Option<(f64, DVec2)> = None;
    for y in (0..grid.shape[1]).step_by(stride) {
        for x in (0..grid.shape[2]).step_by(stride) {
            if !(0..grid.shape[0]).any(|z| known.member[[z, y, x]]) {
                continue;
            }
            let centre = DVec2::new(x as f64 * dx, y as f64 * dy);
            let score: f64 = (0..grid.shape[0]).map(|z| ring_at(grid, smooth, centre, z as f64 * dz).contrast.max(0.0)).sum();
            if score > 0.0 && best.is_none_or(|(most, _)| score > most) {
                best = Some((score, centre));
            }
        }
    }
    best.map(|(_, centre)| centre).ok_or_else(|| PipelineError::NoLeftVentricle { why: "no slice shows a ring with a dark centre".into() })
}

/// The best ring of each slice within 12 mm of the start (at the start itself where it was given).
pub(super) fn follow_rings(grid: &Grid, smooth: &Array3<f32>, start: DVec2, fixed: bool) -> Vec<Ring> {
    let reach = if fixed { 0 } else { 4 };
    (0..grid.shape[0])
        .filter_map(|slice| {
            let z = slice as f64 * grid.spacing_mm[0];
            let mut best: Option<Ring> = None;
            for v in -reach..=reach {
                for u in -reach..=reach {
                    let ring = ring_at(grid, smooth, start + DVec2::new(f64::from(u), f64::from(v)) * 3.0, z);
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
