//! Where the ventricle is: the paper's two manual steps (§8: centre and useful slices, filtering circle), given or estimated.
//!
//! The estimate looks for a stack of rings with a dark centre in the sum of the gates, fits a straight axis through their centres,
//! and ends it where the wall's uptake has fallen half way to the background. The stack is taken to be short axis, in either order.

use super::{PerSurface, PipelineError, Region, canny::smooth_known, parameters::RegionMarks};
use crate::{
    study::{Orientation, Study, Warning},
    volume::{Grid, Volume, VoxelSet, sample_scalar},
};
use glam::{DVec2, DVec3};
use ndarray::Array3;
use std::f64::consts::TAU;

/// The ventricle's straight axis through the slices and what is known about the whole study.
#[derive(Debug, Clone)]
pub struct Location {
    /// Voxels inside the camera's field of view.
    pub known: VoxelSet,
    axis: AxisLine,
    radius_mm: f64,
    mid_wall_mm: f64,
    ends: Ends,
    direction: Direction,
    /// Marks that were given fix the ends for every gate.
    slices_given: [bool; 2],
}

/// The part of one gate in which borders are looked for.
#[derive(Debug, Clone)]
pub struct Extent {
    /// Voxels inside the camera's field of view.
    pub known: VoxelSet,
    axis: AxisLine,
    /// Radius of the filtering circle in mm.
    pub radius_mm: f64,
    /// Height (grid z in mm) of the apex of each surface.
    pub apex_mm: PerSurface<f64>,
    /// Height (grid z in mm) of the valve plane.
    pub base_mm: f64,
    spacing_z_mm: f64,
}

/// Points on the axis: `at + slope · z`.
#[derive(Debug, Clone, Copy)]
struct AxisLine {
    at_mm: DVec2,
    slope: DVec2,
}

/// Where the wall ends along z: `low` towards slice 1.
#[derive(Debug, Clone, Copy)]
struct Ends {
    low_mm: f64,
    high_mm: f64,
}

/// Which end of the stack is the base.
#[derive(Debug, Clone, Copy)]
struct Direction {
    base_at_last_slice: bool,
    /// Neither the counts nor the patient's axes told.
    assumed: bool,
}

/// The centre of the base third is this much darker than that of the apical third when the counts alone are believed. Clear studies
/// differ by a factor of 2 and more.
const CLEAR_RATIO: f64 = 1.3;
/// The usual way from apex to base in the patient (LPS): to the right, the back and the head.
const APEX_TO_BASE: DVec3 = DVec3::new(-0.62, 0.62, 0.48);
/// Smoothing of the sum of the gates, about the resolution of the camera.
const SMOOTHING_MM: f64 = 4.0;
/// Mid-wall radii tried: from a small child's end of systole to a dilated ventricle.
const RADII_MM: [f64; 10] = [12.0, 15.0, 18.0, 21.0, 24.0, 28.0, 32.0, 36.0, 41.0, 46.0];
/// From mid-wall to outside the wall: half a wall and half a camera's blur.
const BEYOND_WALL_MM: f64 = 14.0;
/// Angles on a ring.
const ANGLES: usize = 16;
/// A slice counts as a ring when its contrast is at least this part of the wall's uptake.
const LEAST_CONTRAST: f64 = 0.12;
/// The shortest stack of rings that is taken for a ventricle: half the cavity of a small one.
const LEAST_LENGTH_MM: f64 = 15.0;
/// A third and more of exact zeros is a mask of the field of view, not dark tissue.
const MASK_FRACTION: f64 = 0.25;
/// The wall ends where its uptake has fallen half way to the background: unbiased under any symmetric blur.
const END_LEVEL: f64 = 0.5;
/// The valve plane moves towards the apex by 8-16 mm in systole; a gate's end is looked for this far from the study's.
const BASE_MOTION_MM: f64 = 18.0;
/// Room left outside the mid-wall by an estimated filtering circle: half a wall, the blur, and 10 mm of motion.
const CIRCLE_MARGIN_MM: f64 = 30.0;

impl AxisLine {
    fn at(&self, z_mm: f64) -> DVec2 {
        self.at_mm + self.slope * z_mm
    }
}

impl Extent {
    /// From the axis to a point, in the plane of its slice.
    pub fn from_axis_mm(&self, point_mm: DVec3) -> DVec2 {
        point_mm.truncate() - self.axis.at(point_mm.z)
    }

    /// The point at an offset from the axis at a height.
    pub fn at_axis_mm(&self, offset_mm: DVec2, z_mm: f64) -> DVec3 {
        (self.axis.at(z_mm) + offset_mm).extend(z_mm)
    }

    /// Whether a slice (from 0) lies between the epicardial apex and the valve plane, by half its thickness at least.
    pub fn is_useful(&self, slice: usize) -> bool {
        let z = slice as f64 * self.spacing_z_mm;
        let (low, high) = self.limits_mm();
        z >= low - 1e-9 && z <= high + 1e-9
    }

    /// The heights between which the ventricle lies.
    pub fn limits_mm(&self) -> (f64, f64) {
        (self.base_mm.min(self.apex_mm.epicardial), self.base_mm.max(self.apex_mm.epicardial))
    }

    /// +1 where z grows towards the base, −1 where it falls.
    pub fn towards_base(&self) -> f64 {
        if self.base_mm >= self.apex_mm.epicardial { 1.0 } else { -1.0 }
    }
}

impl Location {
    /// The region as the report tells it.
    pub fn region(&self, grid: &Grid) -> Region {
        let middle = self.axis.at(f64::midpoint(self.ends.low_mm, self.ends.high_mm));
        let dz = grid.spacing_mm[0];
        let slice = |z: f64| ((z / dz).round().max(0.0) as usize).min(grid.shape[0] - 1) + 1;
        Region {
            centre_mm: middle.to_array(),
            axis_slope: self.axis.slope.to_array(),
            radius_mm: self.radius_mm,
            first_slice: slice(self.ends.low_mm + dz / 2.0 - 1e-6),
            last_slice: slice(self.ends.high_mm - dz / 2.0 + 1e-6),
            base_at_last_slice: self.direction.base_at_last_slice,
        }
    }

    /// What was assumed about the study for want of a sign.
    pub fn warnings(&self) -> Vec<Warning> {
        let assumed = "Neither the counts nor an orientation tell the apex from the base; the first slice is taken to be the apex.";
        if self.direction.assumed { vec![Warning::new("slice_order_assumed", assumed)] } else { Vec::new() }
    }

    /// Where the ventricle of each gate begins and ends; each end is the median of its own and the neighbouring gates', since the valve plane
    /// moves smoothly and one gate's counts are few.
    pub fn extents(&self, study: &Study) -> Vec<Extent> {
        let single: Vec<Extent> = study.gates.iter().map(|gate| self.extent(&gate.volume)).collect();
        let gates = single.len();
        let typical = |gate: usize, end: fn(&Extent) -> f64| {
            if gates < 3 { end(&single[gate]) } else { median(&mut [gates - 1, 0, 1].map(|shift| end(&single[(gate + shift) % gates]))) }
        };
        (0..gates)
            .map(|gate| Extent {
                base_mm: typical(gate, |extent| extent.base_mm),
                apex_mm: PerSurface {
                    endocardial: typical(gate, |extent| extent.apex_mm.endocardial),
                    epicardial: typical(gate, |extent| extent.apex_mm.epicardial),
                },
                ..single[gate].clone()
            })
            .collect()
    }

    /// Where the ventricle of one gate begins and ends, from that gate alone.
    fn extent(&self, gate: &Volume) -> Extent {
        let grid = gate.grid;
        let smooth = smooth(&gate.counts, &self.known, &grid);
        let profile = self.wall_profile(&grid, &smooth);
        let near = |end: f64, given: bool, found: Option<f64>| match found {
            Some(found) if !given && (found - end).abs() <= BASE_MOTION_MM => found,
            _ => end,
        };
        let found = wall_ends(&grid, &profile, &self.ends);
        let low_mm = near(self.ends.low_mm, self.slices_given[0], found.map(|ends| ends.low_mm));
        let high_mm = near(self.ends.high_mm, self.slices_given[1], found.map(|ends| ends.high_mm));
        let (apex, base_mm) = if self.direction.base_at_last_slice { (low_mm, high_mm) } else { (high_mm, low_mm) };
        let (axial, apex_given) = (self.axial_profile(&grid, &smooth), self.slices_given[usize::from(!self.direction.base_at_last_slice)]);
        let mut apex_mm = apex_of(&grid, &axial, apex, base_mm);
        if apex_given {
            apex_mm.epicardial = apex;
        }
        Extent { known: self.known.clone(), axis: self.axis, radius_mm: self.radius_mm, apex_mm, base_mm, spacing_z_mm: grid.spacing_mm[0] }
    }

    /// The wall's uptake in each slice: the median over the angles of the maximum from the axis to outside the wall.
    fn wall_profile(&self, grid: &Grid, smooth: &Array3<f32>) -> Vec<f64> {
        let reach = self.mid_wall_mm + BEYOND_WALL_MM;
        (0..grid.shape[0])
            .map(|slice| {
                let z = slice as f64 * grid.spacing_mm[0];
                let mut maxima: Vec<f64> = directions(ANGLES)
                    .map(|out| {
                        let steps = (reach / 2.0) as usize;
                        (0..=steps).map(|i| at(grid, smooth, self.axis.at(z) + out * (2.0 * i as f64), z)).fold(0.0, f64::max)
                    })
                    .collect();
                median(&mut maxima)
            })
            .collect()
    }

    /// Mean counts within 5 mm of the axis in each slice.
    fn axial_profile(&self, grid: &Grid, smooth: &Array3<f32>) -> Vec<f64> {
        (0..grid.shape[0])
            .map(|slice| {
                let z = slice as f64 * grid.spacing_mm[0];
                let ring = directions(8).map(|out| at(grid, smooth, self.axis.at(z) + out * 4.0, z)).sum::<f64>();
                (ring + at(grid, smooth, self.axis.at(z), z)) / 9.0
            })
            .collect()
    }
}

/// Finds the ventricle in a study; marks that are given win.
pub fn locate(study: &Study, marks: &RegionMarks) -> Result<Location, PipelineError> {
    let grid = study.grid;
    check_marks(&grid, marks)?;
    let mut sum = Volume::zeros(grid);
    for gate in &study.gates {
        sum.counts += &gate.volume.counts;
    }
    if sum.maximum() <= 0.0 {
        return Err(PipelineError::NoLeftVentricle { why: "all counts are zero".into() });
    }
    let known = field_of_view(&sum);
    let smooth = smooth(&sum.counts, &known, &grid);
    let start = match marks.centre_mm {
        Some(centre) => DVec2::from_array(centre),
        None => best_centre(&grid, &smooth, &known)?,
    };
    let rings = follow_rings(&grid, &smooth, start, marks.centre_mm.is_some());
    let rings = significant(&grid, rings)?;
    let axis = if marks.centre_mm.is_some() { AxisLine { at_mm: start, slope: DVec2::ZERO } } else { fit_axis(&rings) };
    let mut radii: Vec<f64> = rings.iter().map(|ring| ring.radius_mm).collect();
    let mid_wall_mm = median(&mut radii);
    let dz = grid.spacing_mm[0];
    let middle = ring_middle(&rings);
    let mut location = Location {
        known,
        axis,
        radius_mm: marks.radius_mm.unwrap_or(mid_wall_mm + CIRCLE_MARGIN_MM),
        mid_wall_mm,
        ends: Ends { low_mm: middle, high_mm: middle },
        direction: Direction { base_at_last_slice: true, assumed: true },
        slices_given: [marks.first_slice.is_some(), marks.last_slice.is_some()],
    };
    let profile = location.wall_profile(&grid, &smooth);
    let found = wall_ends(&grid, &profile, &location.ends)
        .ok_or_else(|| PipelineError::NoLeftVentricle { why: "the wall's uptake does not stand out from the background".into() })?;
    location.ends = Ends {
        low_mm: marks.first_slice.map_or(found.low_mm, |slice| (slice as f64 - 1.5) * dz),
        high_mm: marks.last_slice.map_or(found.high_mm, |slice| (slice as f64 - 0.5) * dz),
    };
    location.direction = base_is_high(&grid, &location.axial_profile(&grid, &smooth), &profile, &location.ends, study.orientation.as_ref());
    Ok(location)
}

/// That the marks that are given lie inside a grid.
pub fn check_marks(grid: &Grid, marks: &RegionMarks) -> Result<(), PipelineError> {
    let fail = |why: String| Err(PipelineError::RegionOutside { why });
    let [slices, rows, columns] = grid.shape;
    let [_, dy, dx] = grid.spacing_mm;
    let (width, height) = ((columns - 1) as f64 * dx, (rows - 1) as f64 * dy);
    if let Some([x, y]) = marks.centre_mm
        && !((0.0..=width).contains(&x) && (0.0..=height).contains(&y))
    {
        return fail(format!("`centre_mm` is [{x:?}, {y:?}], but the slices reach from [0, 0] to [{width:.1}, {height:.1}] mm"));
    }
    let (first, last) = (marks.first_slice.unwrap_or(1), marks.last_slice.unwrap_or(slices));
    if first < 1 || last > slices || first >= last {
        return fail(format!("`first_slice` {first} to `last_slice` {last} is no range of two or more within its slices 1 to {slices}"));
    }
    Ok(())
}

/// All voxels, less those that no gate has counts in when these are so many that a mask must have been applied.
fn field_of_view(sum: &Volume) -> VoxelSet {
    let dark = sum.counts.iter().filter(|&&count| count == 0.0).count();
    let masked = dark as f64 > MASK_FRACTION * sum.grid.voxels() as f64;
    VoxelSet { member: sum.counts.mapv(|count| !masked || count > 0.0) }
}

fn smooth(counts: &Array3<f32>, known: &VoxelSet, grid: &Grid) -> Array3<f32> {
    smooth_known(counts, known, grid.spacing_mm.map(|spacing| SMOOTHING_MM / spacing))
}

/// A ring with a dark centre in one slice.
#[derive(Debug, Clone, Copy)]
struct Ring {
    z_mm: f64,
    centre_mm: DVec2,
    radius_mm: f64,
    /// How much brighter the wall is than the mean of the cavity and what lies outside.
    contrast: f64,
    wall: f64,
}

/// The best of the radii at a centre of a slice: the wall is the lower quartile of the ring, so that three quarters must be bright.
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
fn best_centre(grid: &Grid, smooth: &Array3<f32>, known: &VoxelSet) -> Result<DVec2, PipelineError> {
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
fn follow_rings(grid: &Grid, smooth: &Array3<f32>, start: DVec2, fixed: bool) -> Vec<Ring> {
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
fn significant(grid: &Grid, rings: Vec<Ring>) -> Result<Vec<Ring>, PipelineError> {
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

fn ring_middle(rings: &[Ring]) -> f64 {
    let total: f64 = rings.iter().map(|ring| ring.contrast).sum();
    rings.iter().map(|ring| ring.contrast * ring.z_mm).sum::<f64>() / total
}

/// Line through the rings' centres by weighted least squares, twice: the second time those more than 6 mm off count for nothing.
fn fit_axis(rings: &[Ring]) -> AxisLine {
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

/// Where the wall's uptake falls half way to the background on either side of the middle, to a fraction of a slice. A wall that does
/// not end inside the grid ends at its last slice's outer face.
fn wall_ends(grid: &Grid, profile: &[f64], about: &Ends) -> Option<Ends> {
    let dz = grid.spacing_mm[0];
    let last = profile.len() - 1;
    let middle = ((f64::midpoint(about.low_mm, about.high_mm) / dz).round().max(0.0) as usize).min(last);
    let mut sorted = profile.to_vec();
    sorted.sort_by(f64::total_cmp);
    let background = sorted[sorted.len() / 20];
    // The level of the wall: the median of the slices about the middle, so that neither a hot spot nor a cold apex sets it.
    let reach = (15.0 / dz).ceil() as usize;
    let mut about_middle = profile[middle.saturating_sub(reach)..=(middle + reach).min(last)].to_vec();
    let wall = median(&mut about_middle);
    let level = background + END_LEVEL * (wall - background);
    if wall <= background * 1.05 || profile[middle] <= level {
        return None;
    }
    let crossing = |inside: usize, outside: usize| {
        let part = (profile[inside] - level) / (profile[inside] - profile[outside]);
        (inside as f64 + part * (outside as f64 - inside as f64)) * dz
    };
    let low = (1..=middle).rev().find(|&i| profile[i - 1] < level).map_or(-0.5 * dz, |i| crossing(i, i - 1));
    let high = (middle..last).find(|&i| profile[i + 1] < level).map_or((last as f64 + 0.5) * dz, |i| crossing(i, i + 1));
    Some(Ends { low_mm: low, high_mm: high })
}

/// Whether the base is at the high end of z. The base is the end whose centre is darker against its wall; where both ends look alike (a
/// defect at the apex) the patient's axes tell, and without them the stack is taken to begin at the apex, as most do.
fn base_is_high(grid: &Grid, axial: &[f64], wall: &[f64], ends: &Ends, orientation: Option<&Orientation>) -> Direction {
    let dz = grid.spacing_mm[0];
    let third = (ends.high_mm - ends.low_mm) / 3.0;
    let ratio = |from: f64, to: f64| {
        let slices: Vec<f64> =
            (0..wall.len()).filter(|&i| (from..=to).contains(&(i as f64 * dz)) && wall[i] > 0.0).map(|i| axial[i] / wall[i]).collect();
        slices.iter().sum::<f64>() / slices.len().max(1) as f64
    };
    let (high, low) = (ratio(ends.high_mm - third, ends.high_mm), ratio(ends.low_mm, ends.low_mm + third));
    if high * CLEAR_RATIO < low || low * CLEAR_RATIO < high {
        return Direction { base_at_last_slice: high < low, assumed: false };
    }
    let along = orientation.map_or(0.0, |orientation| orientation.slices.dot(APEX_TO_BASE));
    if along.abs() >= 0.5 {
        return Direction { base_at_last_slice: along > 0.0, assumed: false };
    }
    Direction { base_at_last_slice: true, assumed: true }
}

/// The apex of both surfaces on the axis: where the counts change most on either side of the apical wall's maximum. Where there is no
/// such wall (a defect at the apex) the outer one is where the wall around ends and the inner one a wall's thickness above.
fn apex_of(grid: &Grid, axial: &[f64], end_mm: f64, base_mm: f64) -> PerSurface<f64> {
    /// A normal wall, for the apex that is not seen.
    const WALL_MM: f64 = 10.0;
    let dz = grid.spacing_mm[0];
    let towards_base = (base_mm - end_mm).signum();
    let unseen = PerSurface { endocardial: end_mm + towards_base * WALL_MM, epicardial: end_mm };
    // Heights above the end, every half millimetre, from 20 mm outside to the middle of the ventricle.
    let value = |height: f64| linear(axial, (end_mm + towards_base * height) / dz);
    let length = (base_mm - end_mm).abs();
    let count = ((length * 0.6 + 20.0) / 0.5).floor().max(0.0) as u32;
    let samples: Vec<f64> = (0..=count).map(|i| -20.0 + 0.5 * f64::from(i)).collect();
    let inside = |height: f64| {
        let index = (end_mm + towards_base * height) / dz;
        index >= 0.0 && index <= (axial.len() - 1) as f64
    };
    let samples: Vec<f64> = samples.into_iter().filter(|&height| inside(height)).collect();
    let Some(&peak) =
        samples.iter().filter(|height| (-4.0..=length * 0.45).contains(*height)).max_by(|a, b| value(**a).total_cmp(&value(**b)))
    else {
        return unseen;
    };
    let slope = |height: f64| value(height + 1.0) - value(height - 1.0);
    let steepest = |from: f64, to: f64, sign: f64| {
        samples
            .iter()
            .copied()
            .filter(|height| (from..=to).contains(height))
            .max_by(|a, b| (sign * slope(*a)).total_cmp(&(sign * slope(*b))))
            .filter(|&height| sign * slope(height) > 0.0)
    };
    match (steepest(peak, peak + 25.0, -1.0), steepest(peak - 25.0, peak, 1.0)) {
        (Some(inner), Some(outer)) if inner - outer > 4.0 => {
            PerSurface { endocardial: end_mm + towards_base * inner, epicardial: end_mm + towards_base * outer }
        }
        _ => unseen,
    }
}

fn linear(values: &[f64], index: f64) -> f64 {
    let clamped = index.clamp(0.0, (values.len() - 1) as f64);
    let (low, high) = (clamped.floor() as usize, clamped.ceil() as usize);
    values[low] + (values[high] - values[low]) * (clamped - clamped.floor())
}

fn directions(count: usize) -> impl Iterator<Item = DVec2> {
    (0..count).map(move |i| DVec2::from_angle(TAU * i as f64 / count as f64))
}

fn at(grid: &Grid, values: &Array3<f32>, point_mm: DVec2, z_mm: f64) -> f64 {
    sample_scalar(grid, values, point_mm.extend(z_mm))
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
