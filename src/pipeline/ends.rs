//! Where the ventricle begins and ends along its axis: apex, valve plane, and which is which.

use super::PerSurface;
use crate::{study::Orientation, volume::Grid};
use glam::DVec3;

/// Where the wall ends along z: `low` towards slice 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ends {
    pub(super) low_mm: f64,
    pub(super) high_mm: f64,
}

/// Which end of the stack is the base.
#[derive(Debug, Clone, Copy)]
pub(super) struct Direction {
    pub(super) base_at_last_slice: bool,
    /// Neither the counts nor the patient's axes told.
    pub(super) assumed: bool,
}

/// The heights of both surfaces' apices.
#[derive(Debug, Clone, Copy)]
pub(super) struct Apices {
    pub(super) at_mm: PerSurface<f64>,
    /// Whether there is a wall at the apex.
    pub(super) seen: bool,
}

/// The centre of the base third is this much darker than that of the apical third when the counts alone are believed. Clear studies
/// differ by a factor of 2 and more.
const CLEAR_RATIO: f64 = 1.3;
/// The centre of an apical third has at least this part of its wall's uptake; an end with less is open. Measured in real and simulated studies:
/// 0.48 and more with an apex, 0.3 and less without.
const CAPPED: f64 = 0.4;
/// The apical wall stands out from the cavity by at least this part of the wall's uptake. Measured: 0.2 with half an apex, 0.03 without one.
const APEX_STANDS_OUT: f64 = 0.1;
/// The usual way from apex to base in the patient (LPS): to the right, the back and the head.
pub(super) const APEX_TO_BASE: DVec3 = DVec3::new(-0.62, 0.62, 0.48);
/// The wall ends where its uptake has fallen half way to the background: unbiased under any symmetric blur.
const END_LEVEL: f64 = 0.5;

/// Where the wall's uptake falls half way to the background on either side of the middle, to a fraction of a slice. A wall that does
/// not end inside the grid ends at its last slice's outer face.
pub(super) fn wall_ends(grid: &Grid, profile: &[f64], about: &Ends) -> Option<Ends> {
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
pub(super) fn direction(grid: &Grid, axial: &[f64], wall: &[f64], ends: &Ends, orientation: Option<&Orientation>) -> Direction {
    let dz = grid.spacing_mm[0];
    let third = (ends.high_mm - ends.low_mm) / 3.0;
    let ratio = |from: f64, to: f64| {
        let slices: Vec<f64> =
            (0..wall.len()).filter(|&i| (from..=to).contains(&(i as f64 * dz)) && wall[i] > 0.0).map(|i| axial[i] / wall[i]).collect();
        slices.iter().sum::<f64>() / slices.len().max(1) as f64
    };
    let (high, low) = (ratio(ends.high_mm - third, ends.high_mm), ratio(ends.low_mm, ends.low_mm + third));
    let capped = high.max(low) >= CAPPED;
    if capped && (high * CLEAR_RATIO < low || low * CLEAR_RATIO < high) {
        return Direction { base_at_last_slice: high < low, assumed: false };
    }
    let along = orientation.map_or(0.0, |orientation| orientation.slices.dot(APEX_TO_BASE));
    if along.abs() >= 0.5 {
        return Direction { base_at_last_slice: along > 0.0, assumed: false };
    }
    Direction { base_at_last_slice: true, assumed: true }
}

/// The apex of both surfaces on the axis: where the counts change most on either side of the apical wall's maximum. Where there is no
/// such wall (a defect at the apex; `wall` is the uptake of the wall around) the outer one is where the wall around ends and the inner one a
/// wall's thickness above.
pub(super) fn apices(grid: &Grid, axial: &[f64], wall: f64, end_mm: f64, base_mm: f64) -> Apices {
    /// A normal wall, for the apex that is not seen.
    const WALL_MM: f64 = 10.0;
    let dz = grid.spacing_mm[0];
    let towards_base = (base_mm - end_mm).signum();
    let unseen = Apices { at_mm: PerSurface { endocardial: end_mm + towards_base * WALL_MM, epicardial: end_mm }, seen: false };
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
    let cavity =
        samples.iter().filter(|height| (peak..=peak + 25.0).contains(*height)).map(|&height| value(height)).fold(f64::INFINITY, f64::min);
    if value(peak) - cavity < APEX_STANDS_OUT * wall {
        return unseen;
    }
    match (steepest(peak, peak + 25.0, -1.0), steepest(peak - 25.0, peak, 1.0)) {
        (Some(inner), Some(outer)) if inner - outer > 4.0 => Apices {
            at_mm: PerSurface { endocardial: end_mm + towards_base * inner, epicardial: end_mm + towards_base * outer },
            seen: true,
        },
        _ => unseen,
    }
}

/// Linear interpolation, the end values outside.
fn linear(values: &[f64], index: f64) -> f64 {
    let clamped = index.clamp(0.0, (values.len() - 1) as f64);
    let (low, high) = (clamped.floor() as usize, clamped.ceil() as usize);
    values[low] + (values[high] - values[low]) * (clamped - clamped.floor())
}

/// The upper median; the values are sorted.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    const GRID: Grid = Grid { shape: [24, 1, 1], spacing_mm: [4.0, 3.0, 3.0] };

    /// A wall of uptake 100 over a background of 10 between two heights in mm, ramped over a slice.
    fn wall(low: f64, high: f64) -> Vec<f64> {
        let inside = |z: f64| (0.5 + (z - low) / 4.0).clamp(0.0, 1.0).min((0.5 + (high - z) / 4.0).clamp(0.0, 1.0));
        (0..24).map(|slice| 10.0 + 90.0 * inside(f64::from(slice) * 4.0)).collect()
    }

    #[test]
    fn ends_are_found_between_the_slices() {
        let found = wall_ends(&GRID, &wall(17.0, 74.5), &Ends { low_mm: 44.0, high_mm: 44.0 }).unwrap();
        assert!((found.low_mm - 17.0).abs() < 0.5 && (found.high_mm - 74.5).abs() < 0.5, "{found:?}");
    }

    #[test]
    fn a_wall_cut_by_the_grid_ends_at_its_outer_face() {
        let found = wall_ends(&GRID, &wall(17.0, 500.0), &Ends { low_mm: 60.0, high_mm: 60.0 }).unwrap();
        assert!((found.high_mm - 94.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn a_flat_profile_has_no_ends() {
        assert!(wall_ends(&GRID, &[10.0; 24], &Ends { low_mm: 44.0, high_mm: 44.0 }).is_none());
    }

    #[test]
    fn the_base_is_told_by_the_counts_then_by_the_patient_then_assumed() {
        let ends = Ends { low_mm: 10.0, high_mm: 80.0 };
        let walls = [100.0; 24];
        let falling: Vec<f64> = (0..24).map(|slice| 100.0 - 3.0 * f64::from(slice)).collect();
        let rising: Vec<f64> = falling.iter().rev().copied().collect();
        let tell = |axial: &[f64], orientation: Option<&Orientation>| {
            let found = direction(&GRID, axial, &walls, &ends, orientation);
            (found.base_at_last_slice, found.assumed)
        };
        assert_eq!(tell(&falling, None), (true, false));
        assert_eq!(tell(&rising, None), (false, false));
        // Open at both ends, the darker one is darker by chance.
        let open: Vec<f64> = falling.iter().map(|value| value / 10.0).collect();
        assert_eq!(tell(&open, None), (true, true));
        assert_eq!(tell(&[50.0; 24], None), (true, true));
        let towards_apex = Orientation { columns: DVec3::X, rows: DVec3::Y, slices: -APEX_TO_BASE.normalize(), origin_mm: DVec3::ZERO };
        assert_eq!(tell(&[50.0; 24], Some(&towards_apex)), (false, false));
    }

    #[test]
    fn both_apices_are_where_the_counts_change_most() {
        // An apical wall of 100 between 20 and 30 mm, blurred by its neighbours, a cavity of 30 above it.
        let axial: Vec<f64> = (0..24)
            .map(|slice| {
                let z = f64::from(slice) * 4.0;
                let edge = |at: f64| 1.0 / (1.0 + (-(z - at) / 2.5).exp());
                100.0 * (edge(18.0) - edge(30.0)) + 30.0 * edge(30.0)
            })
            .collect();
        let Apices { at_mm: found, seen } = apices(&GRID, &axial, 100.0, 17.0, 80.0);
        assert!(seen);
        assert!((found.epicardial - 18.0).abs() < 2.5 && (found.endocardial - 30.0).abs() < 2.5, "{found:?}");
        // Without an apical wall the wall around says where it would be.
        let Apices { at_mm: unseen, seen } = apices(&GRID, &[30.0; 24], 100.0, 17.0, 80.0);
        assert!(!seen);
        assert!((unseen.epicardial - 17.0).abs() < 1e-9 && (unseen.endocardial - 27.0).abs() < 1e-9, "{unseen:?}");
    }
}
