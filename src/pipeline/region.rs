//! Where the ventricle is: the paper's two manual steps (§8: centre and useful slices, filtering circle), given or estimated.
//!
//! The estimate looks for a stack of rings with a dark centre in the sum of the gates, fits a straight axis through their centres,
//! and ends it where the wall's uptake has fallen half way to the background. The stack is taken to be short axis, in either order.

use super::{
    PerSurface, PipelineError, Region,
    arc::recentred,
    axis::{ANGLES, AxisLine, BEYOND_WALL_MM, at, best_centre, directions, fit_axis, follow_rings, middle_mm, significant},
    canny::Smoothing,
    ends::{Apices, Direction, Ends, apices, direction, median, wall_ends},
    parameters::RegionMarks,
};
use crate::{
    study::{Study, Warning},
    volume::{Grid, Volume, VoxelSet},
};
use glam::{DVec2, DVec3};
use ndarray::Array3;

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
    /// Whether there is a wall at the apex.
    pub apex_seen: bool,
    /// Height (grid z in mm) of the valve plane.
    pub base_mm: f64,
    spacing_z_mm: f64,
}

/// Smoothing of the sum of the gates, about the resolution of the camera.
const SMOOTHING_MM: f64 = 4.0;
/// More than a quarter of exact zeros is a mask of the field of view, not dark tissue.
const MASK_FRACTION: f64 = 0.25;
/// Counts at the rim of a mask, as part of the maximum: soft tissue has 5 % and more of the wall's uptake.
const MASK_RIM: f64 = 0.02;
/// The valve plane moves towards the apex by 8-16 mm in systole; a gate's end is looked for this far from the study's.
const BASE_MOTION_MM: f64 = 18.0;
/// Room left outside the mid-wall by an estimated filtering circle: half a wall, the blur, and 10 mm of motion.
pub(super) const CIRCLE_MARGIN_MM: f64 = 30.0;

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
    /// Voxels inside the camera's field of view.
    pub(super) fn known(&self) -> &VoxelSet {
        &self.known
    }

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
        let smoothing = smoothing(&self.known, &study.grid);
        let single: Vec<Extent> = study.gates.iter().map(|gate| self.extent(&gate.volume, &smoothing)).collect();
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
                apex_seen: typical(gate, |extent| f64::from(u8::from(extent.apex_seen))) > 0.5,
                ..single[gate].clone()
            })
            .collect()
    }

    /// Where the ventricle of one gate begins and ends, from that gate alone.
    fn extent(&self, gate: &Volume, smoothing: &Smoothing<'_>) -> Extent {
        let grid = gate.grid;
        let smooth = smoothing.of(&gate.counts);
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
        let dz = grid.spacing_mm[0];
        let between = |slice: usize| (low_mm..=high_mm).contains(&(slice as f64 * dz));
        // The brightest slice: with half the wall emptied the middle one may be dark.
        let wall = (0..profile.len()).filter(|&slice| between(slice)).map(|slice| profile[slice]).fold(0.0, f64::max);
        let Apices { at_mm: mut apex_mm, seen: apex_seen } = apices(&grid, &axial, wall, apex, base_mm);
        if apex_given {
            apex_mm.epicardial = apex;
        }
        Extent {
            known: self.known.clone(),
            axis: self.axis,
            radius_mm: self.radius_mm,
            apex_mm,
            apex_seen,
            base_mm,
            spacing_z_mm: grid.spacing_mm[0],
        }
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
    let smooth = smoothing(&known, &grid).of(&sum.counts);
    let start = match marks.centre_mm {
        Some(centre) => DVec2::from_array(centre),
        None => best_centre(&grid, &smooth, &known)?,
    };
    let rings = follow_rings(&grid, &smooth, start, marks.centre_mm.is_some());
    let rings = significant(&grid, rings)?;
    let mut radii: Vec<f64> = rings.iter().map(|ring| ring.radius_mm).collect();
    let mut mid_wall_mm = median(&mut radii);
    let mut axis = if marks.centre_mm.is_some() { AxisLine { at_mm: start, slope: DVec2::ZERO } } else { fit_axis(&rings) };
    if let Some((of_arcs, radius_mm)) = recentred(&grid, &smooth, &rings, axis, mid_wall_mm) {
        mid_wall_mm = radius_mm;
        if marks.centre_mm.is_none() {
            axis = of_arcs;
        }
    }
    let dz = grid.spacing_mm[0];
    let middle = middle_mm(&rings);
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
    location.direction = direction(&grid, &location.axial_profile(&grid, &smooth), &profile, &location.ends, study.orientation.as_ref());
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

/// All voxels, less those that no gate has counts in when a mask must have made them: they are many, and counts end at them abruptly.
/// Where counts fade to zero, as without background, zero was measured.
fn field_of_view(sum: &Volume) -> VoxelSet {
    let dark = sum.counts.iter().filter(|&&count| count == 0.0).count();
    let many = dark as f64 > MASK_FRACTION * sum.grid.voxels() as f64;
    let masked = many && rim_mean(sum) > MASK_RIM * f64::from(sum.maximum());
    VoxelSet { member: sum.counts.mapv(|count| !masked || count > 0.0) }
}

/// Mean count of the voxels that have counts next to a voxel of their slice that has none.
fn rim_mean(sum: &Volume) -> f64 {
    let (mut total, mut rim) = (0.0, 0_usize);
    for ((z, y, x), &count) in sum.counts.indexed_iter().filter(|(_, count)| **count > 0.0) {
        let is_dark = |y: usize, x: usize| sum.counts.get([z, y, x]) == Some(&0.0);
        if is_dark(y + 1, x) || is_dark(y, x + 1) || (y > 0 && is_dark(y - 1, x)) || (x > 0 && is_dark(y, x - 1)) {
            total += f64::from(count);
            rim += 1;
        }
    }
    total / rim.max(1) as f64
}

fn smoothing<'a>(known: &'a VoxelSet, grid: &Grid) -> Smoothing<'a> {
    Smoothing::new(known, grid.spacing_mm.map(|spacing| SMOOTHING_MM / spacing))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Activity that falls from the middle of the slices outwards, cut to zero beyond 30 mm.
    fn cut_disc(fall: impl Fn(f64) -> f64) -> Volume {
        let grid = Grid { shape: [4, 40, 40], spacing_mm: [4.0, 3.0, 3.0] };
        let radius = |voxel| (grid.position_mm(voxel).truncate() - DVec2::splat(58.5)).length();
        let counts = Array3::from_shape_fn(grid.shape, |(z, y, x)| {
            let radius = radius([z, y, x]);
            if radius < 30.0 { fall(radius) as f32 } else { 0.0 }
        });
        Volume { grid, counts }
    }

    #[test]
    fn zeros_are_a_mask_only_where_counts_end_abruptly() {
        let masked = field_of_view(&cut_disc(|radius| 100.0 - 2.0 * radius));
        assert!(masked.len() < 40 * 40 * 4 / 2, "{}", masked.len());
        let faded = field_of_view(&cut_disc(|radius| 100.0 * (-0.5 * (radius / 8.0).powi(2)).exp()));
        assert_eq!(faded.len(), 40 * 40 * 4);
    }
}
