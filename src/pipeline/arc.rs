//! The long axis of a wall that is seen in part. A ring's centre is found by its contrast all round, and where a sector takes up nothing
//! that centre slides towards the wall that is left; a circle through what is left of each ring does not.

use super::{
    axis::{AxisLine, BEYOND_WALL_MM, Ring, at, directions, fit_axis},
    ends::median,
};
use crate::volume::Grid;
use glam::{DMat2, DVec2};
use ndarray::Array3;

/// Angles at which the wall is looked for: 10° each.
const ANGLES: usize = 36;
/// The least gap for which the centre is looked for again, in angles: 60°. The cold parts of real walls without a defect are narrower.
const LEAST_GAP: usize = 6;
/// The least part of a ring that tells its circle, in angles: 100°.
const LEAST_ARC: usize = 10;
/// The wall is seen where its uptake is at least this part of its typical one, over the background.
const SEEN: f64 = 0.5;
/// Radii of circles that are believed, in mm, about those of [`super::axis`].
const RADII_MM: (f64, f64) = (10.0, 55.0);
/// The centre moves by less than a millimetre after the third round (measured with a gap of 53 %).
const ROUNDS: usize = 4;

/// Axis and mid-wall radius from circles through the arcs of the rings, where at least half of the rings have a gap; else nothing.
pub(super) fn recentred(grid: &Grid, smooth: &Array3<f32>, rings: &[Ring], axis: AxisLine, mid_wall_mm: f64) -> Option<(AxisLine, f64)> {
    let mut values: Vec<f32> = smooth.iter().copied().collect();
    let twentieth = values.len() / 20;
    let background = f64::from(*values.select_nth_unstable_by(twentieth, f32::total_cmp).1);
    let mut found = None;
    let (mut axis, mut mid_wall_mm) = (axis, mid_wall_mm);
    for _ in 0..ROUNDS {
        let arcs: Vec<(&Ring, Vec<Option<DVec2>>)> = rings
            .iter()
            .map(|ring| (ring, arc(grid, smooth, axis.at(ring.z_mm), ring.z_mm, mid_wall_mm + BEYOND_WALL_MM, background)))
            .collect();
        let gapped = arcs.iter().filter(|(_, arc)| largest_gap(arc) >= LEAST_GAP).count();
        if found.is_none() && 2 * gapped < rings.len() {
            return None;
        }
        let circles: Vec<Ring> = arcs
            .iter()
            .filter_map(|(ring, arc)| {
                let points: Vec<DVec2> = arc.iter().flatten().copied().collect();
                let (centre_mm, radius_mm) = (points.len() >= LEAST_ARC).then(|| circle(&points)).flatten()?;
                (RADII_MM.0..=RADII_MM.1).contains(&radius_mm).then_some(Ring { centre_mm, radius_mm, ..**ring })
            })
            .collect();
        if 2 * circles.len() < rings.len() {
            return found;
        }
        axis = fit_axis(&circles);
        let mut radii: Vec<f64> = circles.iter().map(|ring| ring.radius_mm).collect();
        mid_wall_mm = median(&mut radii);
        found = Some((axis, mid_wall_mm));
    }
    found
}

/// Where the wall's uptake is largest in each direction from a centre, where it is seen.
fn arc(grid: &Grid, smooth: &Array3<f32>, centre_mm: DVec2, z_mm: f64, reach_mm: f64, background: f64) -> Vec<Option<DVec2>> {
    let steps = reach_mm as usize;
    let maxima: Vec<(f64, DVec2)> = directions(ANGLES)
        .map(|out| {
            (1..=steps).fold((0.0, centre_mm), |best, step| {
                let point = centre_mm + out * step as f64;
                let value = at(grid, smooth, point, z_mm);
                if value > best.0 { (value, point) } else { best }
            })
        })
        .collect();
    let mut sorted: Vec<f64> = maxima.iter().map(|(value, _)| *value).collect();
    sorted.sort_by(f64::total_cmp);
    // The upper quartile, so that half a ring that takes up nothing does not set the level.
    let level = background + SEEN * (sorted[ANGLES * 3 / 4] - background);
    maxima.into_iter().map(|(value, point)| (value >= level).then_some(point)).collect()
}

/// The longest run of nothing around the ring.
fn largest_gap<T>(around: &[Option<T>]) -> usize {
    let missing: Vec<bool> = around.iter().map(Option::is_none).collect();
    longest_run(&missing).map_or(0, |(_, length)| length)
}

/// Start and length of the longest run of members around a circle.
pub(super) fn longest_run(members: &[bool]) -> Option<(usize, usize)> {
    let count = members.len();
    let run = |start: usize| (0..count).take_while(|shift| members[(start + shift) % count]).count();
    // The first of equals, so that a whole circle starts at 0.
    (0..count).map(|start| (start, run(start))).rev().max_by_key(|(_, length)| *length).filter(|(_, length)| *length > 0)
}

/// The circle through points by linear least squares (Kåsa 1976): centre and radius.
fn circle(points: &[DVec2]) -> Option<(DVec2, f64)> {
    let count = points.len() as f64;
    let mean = points.iter().sum::<DVec2>() / count;
    let (mut second, mut third, mut squares) = (DMat2::ZERO, DVec2::ZERO, 0.0);
    for point in points {
        let from_mean = *point - mean;
        let square = from_mean.length_squared();
        second += DMat2::from_cols(from_mean * from_mean.x, from_mean * from_mean.y);
        third += from_mean * square;
        squares += square;
    }
    if second.determinant() <= 1e-6 * squares * squares {
        return None;
    }
    let centre = second.inverse() * third / 2.0;
    Some((mean + centre, (squares / count + centre.length_squared()).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_third_of_a_circle_tells_the_circle() {
        let (centre, radius) = (DVec2::new(31.0, -7.0), 24.0);
        let points: Vec<DVec2> = (0..13).map(|i| centre + DVec2::from_angle(f64::from(i) * 10.0_f64.to_radians()) * radius).collect();
        let (found, found_radius) = circle(&points).unwrap();
        assert!(found.distance(centre) < 1e-9 && (found_radius - radius).abs() < 1e-9, "{found} {found_radius}");
        assert!(circle(&[DVec2::ZERO, DVec2::X, DVec2::X * 2.0]).is_none(), "a line has no circle");
    }

    #[test]
    fn the_largest_gap_runs_over_the_end() {
        let seen = |missing: &[usize]| (0..8).map(|i| (!missing.contains(&i)).then_some(())).collect::<Vec<_>>();
        assert_eq!(largest_gap(&seen(&[])), 0);
        assert_eq!(largest_gap(&seen(&[7, 0, 1, 4])), 3);
        assert_eq!(largest_gap(&seen(&[0, 1, 2, 3, 4, 5, 6, 7])), 8);
    }
}
