//! The paper's measure of a volume without a surface (§7.4): the voxels of at least a fraction of the largest count.

use crate::volume::{Volume, VoxelSet, sample_scalar};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Voxels of at least a fraction of the largest count.
pub fn at_least(volume: &Volume, fraction: f64) -> VoxelSet {
    let least = fraction * f64::from(volume.maximum());
    VoxelSet { member: volume.counts.mapv(|count| f64::from(count) >= least) }
}

/// A set with the holes of every slice filled: what no path over voxel faces joins to the slice's rim.
pub fn filled(set: &VoxelSet) -> VoxelSet {
    let mut filled = set.clone();
    for mut slice in filled.member.outer_iter_mut() {
        let (rows, columns) = slice.dim();
        let rim = |y: usize, x: usize| y == 0 || x == 0 || y + 1 == rows || x + 1 == columns;
        let mut outside = slice.mapv(|_| false);
        let mut front: Vec<(usize, usize)> =
            slice.indexed_iter().filter(|&((y, x), &inside)| rim(y, x) && !inside).map(|(at, _)| at).collect();
        for &at in &front {
            outside[at] = true;
        }
        while let Some((y, x)) = front.pop() {
            for at in [(y.wrapping_sub(1), x), (y + 1, x), (y, x.wrapping_sub(1)), (y, x + 1)] {
                if slice.get(at) == Some(&false) && !outside[at] {
                    outside[at] = true;
                    front.push(at);
                }
            }
        }
        slice.zip_mut_with(&outside, |inside, &outside| *inside = !outside);
    }
    filled
}

/// Volume of a set's voxels in mm³.
pub fn volume_mm3(set: &VoxelSet, volume: &Volume) -> f64 {
    set.len() as f64 * volume.grid.voxel_mm3()
}

/// The level, as a fraction of the largest count, whose filled voxels have a volume nearest to the given one.
pub fn level_of_volume(volume: &Volume, wanted_mm3: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..30 {
        let middle = f64::midpoint(low, high);
        if volume_mm3(&filled(&at_least(volume, middle)), volume) > wanted_mm3 {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

/// Mean distance in mm from an axis (parallel to z through `centre_mm`) to where the counts fall below a fraction of the largest count, seen
/// from outside, in one slice: 360 directions, linear between voxels.
pub fn outer_radius_mm(volume: &Volume, centre_mm: DVec2, slice: usize, fraction: f64) -> f64 {
    const DIRECTIONS: u32 = 360;
    const STEP_MM: f64 = 0.05;
    let level = fraction * f64::from(volume.maximum());
    let z_mm = slice as f64 * volume.grid.spacing_mm[0];
    let [_, rows, columns] = volume.grid.shape;
    let reach_mm = 0.5 * (rows.min(columns) as f64 - 1.0) * volume.grid.spacing_mm[1].min(volume.grid.spacing_mm[2]);
    let radius = |direction: u32| {
        let out = DVec2::from_angle(TAU * f64::from(direction) / f64::from(DIRECTIONS));
        let at = |radius: f64| sample_scalar(&volume.grid, &volume.counts, DVec3::from((centre_mm + out * radius, z_mm)));
        let mut radius = reach_mm;
        while radius > 0.0 && at(radius) < level {
            radius -= STEP_MM;
        }
        radius
    };
    (0..DIRECTIONS).map(radius).sum::<f64>() / f64::from(DIRECTIONS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Grid;
    use ndarray::Array3;

    /// A tube of inner radius 12 and outer radius 30 mm whose wall falls to zero over 4 mm on either side, along all of z.
    fn tube() -> Volume {
        let grid = Grid { shape: [3, 41, 41], spacing_mm: [5.0, 2.0, 2.0] };
        let counts = Array3::from_shape_fn(grid.shape, |(z, y, x)| {
            let r = (grid.position_mm([z, y, x]).truncate() - DVec2::splat(40.0)).length();
            (0.5 - (r - 30.0) / 4.0).clamp(0.0, 1.0).min((0.5 + (r - 12.0) / 4.0).clamp(0.0, 1.0)) as f32
        });
        Volume { grid, counts }
    }

    #[test]
    fn holes_are_filled_slice_by_slice() {
        let volume = tube();
        let ring = volume_mm3(&at_least(&volume, 0.5), &volume);
        let disc = volume_mm3(&filled(&at_least(&volume, 0.5)), &volume);
        let exact = |radius: f64| std::f64::consts::PI * radius * radius * 15.0;
        assert!((disc / exact(30.0) - 1.0).abs() < 0.01, "{disc}");
        assert!((ring / (exact(30.0) - exact(12.0)) - 1.0).abs() < 0.02, "{ring}");
        assert!((level_of_volume(&volume, exact(30.0)) - 0.5).abs() < 0.05);
    }

    #[test]
    fn the_outer_radius_is_where_the_level_is_crossed() {
        let volume = tube();
        for (level, radius) in [(0.5, 30.0), (0.2, 31.2), (0.8, 28.8)] {
            let found = outer_radius_mm(&volume, DVec2::splat(40.0), 1, level);
            assert!((found - radius).abs() < 0.15, "{level}: {found}");
        }
    }
}
