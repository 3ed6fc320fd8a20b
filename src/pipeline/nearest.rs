//! How far particles are from the border: the least distance to any of its voxels, looked for a block of neighbours at a time.

use super::{
    borders::{Border, BorderPoint},
    simd::vectorised,
};
use crate::volume::Grid;

/// Points that are compared at once.
const ABREAST: usize = 8;
/// Vectors of points whose box is looked at first: neighbours in the list are neighbours in space.
const BLOCK: usize = 4;
/// What rounding may add to the distance of a box.
const ROUNDING: f64 = 1.0 + 1e-12;

/// The centres of a border's voxels in grid mm, x, y and z apart. The last one is repeated to fill the last place.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Centres {
    places: Vec<[[f64; ABREAST]; 3]>,
    /// Least and greatest place of each block.
    boxes: Vec<[[f64; 3]; 2]>,
    /// Voxels a mm along x, y, z.
    per_step: [f64; 3],
}

impl Centres {
    pub(super) fn of(border: &Border, grid: &Grid) -> Self {
        let centres = |points: &[BorderPoint]| -> [[f64; 3]; ABREAST] {
            std::array::from_fn(|i| grid.position_mm(points[i.min(points.len() - 1)].voxel).to_array())
        };
        let apart = |points: &[BorderPoint]| {
            let centres = centres(points);
            [0, 1, 2].map(|axis| centres.map(|centre| centre[axis]))
        };
        let places: Vec<_> = border.points.chunks(ABREAST).map(apart).collect();
        let extreme = |block: &[[[f64; ABREAST]; 3]], axis: usize, pick: fn(f64, f64) -> f64, from: f64| {
            block.iter().flat_map(|places| places[axis]).fold(from, pick)
        };
        let surround = |block: &[[[f64; ABREAST]; 3]]| {
            let low = [0, 1, 2].map(|axis| extreme(block, axis, f64::min, f64::INFINITY));
            [low, [0, 1, 2].map(|axis| extreme(block, axis, f64::max, f64::NEG_INFINITY))]
        };
        let boxes = places.chunks(BLOCK).map(surround).collect();
        Self { places, boxes, per_step: grid.step_mm().recip().to_array() }
    }
}

vectorised! {
    /// Squared distances to the nearest border voxel's centre, in voxels (each axis by its own spacing) and in mm.
    pub(super) fn nearest(centres: &Centres, position: [f64; 3]) -> [f64; 2] {
        let [x, y, z] = position;
        let [per_x, per_y, per_z] = centres.per_step;
        let both = |x: f64, y: f64, z: f64| {
            let (u, v, w) = (x * per_x, y * per_y, z * per_z);
            [u * u + v * v + w * w, x * x + y * y + z * z]
        };
        let mut least = [f64::INFINITY; 2];
        for ([low, high], block) in centres.boxes.iter().zip(centres.places.chunks(BLOCK)) {
            let outside = |axis: usize| (low[axis] - position[axis]).max(position[axis] - high[axis]).max(0.0);
            let [voxels, mm] = both(outside(0), outside(1), outside(2));
            if voxels > least[0] * ROUNDING && mm > least[1] * ROUNDING {
                continue;
            }
            let mut best = [[f64::INFINITY; ABREAST]; 2];
            for [xs, ys, zs] in block {
                for i in 0..ABREAST {
                    let [voxels, mm] = both(x - xs[i], y - ys[i], z - zs[i]);
                    best[0][i] = if voxels < best[0][i] { voxels } else { best[0][i] };
                    best[1][i] = if mm < best[1][i] { mm } else { best[1][i] };
                }
            }
            for (least, best) in least.iter_mut().zip(best) {
                *least = best.into_iter().fold(*least, f64::min);
            }
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn the_nearest_is_the_least_of_all_distances() {
        let grid = Grid { shape: [20, 30, 30], spacing_mm: [5.74, 2.87, 2.87] };
        let number = |i: usize, step: usize, length: usize| (i * step + i * i / 7) % length;
        for count in [0, 1, 7, 8, 33, 500] {
            let voxels = (0..count).map(|i| [i * 20 / count.max(1), number(i, 11, 30), number(i, 17, 30)]);
            let point = |voxel| BorderPoint { voxel, position_mm: DVec3::ZERO, normal: DVec3::X };
            let border = Border { points: voxels.map(point).collect() };
            let centres = Centres::of(&border, &grid);
            for i in 0..200 {
                let position = DVec3::new(number(i, 7, 97) as f64, number(i, 29, 101) as f64, number(i, 13, 123) as f64) * 0.97;
                let offsets = || border.points.iter().map(|point| position - grid.position_mm(point.voxel));
                let least = |square: fn(DVec3, DVec3) -> f64| {
                    offsets().map(|offset| square(offset, grid.step_mm().recip())).fold(f64::INFINITY, f64::min)
                };
                let expected = [least(|offset, per_step| (offset * per_step).length_squared()), least(|offset, _| offset.length_squared())];
                let found = nearest(&centres, position.to_array());
                assert_eq!(found.map(f64::to_bits), expected.map(f64::to_bits), "{count} points, {position}");
            }
        }
    }
}
