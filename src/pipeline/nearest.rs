//! The border voxel nearest to a particle, by comparing with all of them: a few thousand at once are faster than a search.

use super::{
    borders::{Border, BorderPoint},
    simd::vectorised,
};
use crate::volume::Grid;

/// Points that are compared at once.
const ABREAST: usize = 8;

/// The centres of a border's voxels in grid mm, x, y and z apart. The last one is repeated to fill the last place.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Centres {
    places: [Vec<[f64; ABREAST]>; 3],
    /// Voxels a mm along x, y, z.
    per_step: [f64; 3],
}

impl Centres {
    pub(super) fn of(border: &Border, grid: &Grid) -> Self {
        let of_chunk =
            |points: &[BorderPoint], axis: usize| std::array::from_fn(|i| grid.position_mm(points[i.min(points.len() - 1)].voxel)[axis]);
        let along = |axis: usize| border.points.chunks(ABREAST).map(|points| of_chunk(points, axis)).collect();
        Self { places: [0, 1, 2].map(along), per_step: grid.step_mm().recip().to_array() }
    }
}

vectorised! {
    /// Squared distances to the nearest border voxel's centre, in voxels (each axis by its own spacing) and in mm.
    pub(super) fn nearest(centres: &Centres, position: [f64; 3]) -> [f64; 2] {
        let [xs, ys, zs] = &centres.places;
        let [x, y, z] = position;
        let [per_x, per_y, per_z] = centres.per_step;
        let mut best = [[f64::INFINITY; ABREAST]; 2];
        for ((xs, ys), zs) in xs.iter().zip(ys).zip(zs) {
            for i in 0..ABREAST {
                let (x, y, z) = (x - xs[i], y - ys[i], z - zs[i]);
                let mm = x * x + y * y + z * z;
                let (x, y, z) = (x * per_x, y * per_y, z * per_z);
                let voxels = x * x + y * y + z * z;
                best[0][i] = if voxels < best[0][i] { voxels } else { best[0][i] };
                best[1][i] = if mm < best[1][i] { mm } else { best[1][i] };
            }
        }
        best.map(|lanes| lanes.into_iter().fold(f64::INFINITY, f64::min))
    }
}
