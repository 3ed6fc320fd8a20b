//! Means over the neighbourhood of a vertex in the wall.

use super::places::Places;
use crate::{
    mesh::Mesh,
    pipeline::{Reconstruction, Surface},
};
use glam::DVec3;

/// Standard deviation of the weights in mm: about a camera's blur (a FWHM of 14 mm). What is smaller is noise.
const SIGMA_MM: f64 = 6.0;
/// Weights beyond this many standard deviations are left out.
const REACH: f64 = 2.5;

/// For every vertex those of its neighbourhood with their weights, which sum to 1: the vertex's area times a Gaussian of the distance half way
/// through the wall at end diastole. Empty in the lid.
pub(super) struct Neighbourhoods(Vec<Vec<(u32, f64)>>);

impl Neighbourhoods {
    /// Of a reconstruction, at the gate of end diastole (counted from 0).
    pub(super) fn of(reconstruction: &Reconstruction, places: &Places, end_diastole: usize) -> Self {
        let mesh = |surface: Surface| -> &Mesh { &reconstruction.gates[end_diastole].fits.get(surface).mesh };
        let middle = mesh(Surface::Endocardial).map_with(mesh(Surface::Epicardial), |a, b| (a + b) / 2.0);
        Self::among(&middle.positions, places)
    }

    fn among(positions: &[DVec3], places: &Places) -> Self {
        let of_wall: Vec<(u32, DVec3, f64)> = (0..)
            .zip(positions.iter().zip(&places.of_vertex))
            .filter_map(|(vertex, (&position, place))| Some((vertex, position, place.as_ref()?.area_mm2)))
            .collect();
        let near = |from: DVec3| -> Vec<(u32, f64)> {
            let mut list: Vec<(u32, f64)> = of_wall
                .iter()
                .filter_map(|&(vertex, position, area)| {
                    let squared = from.distance_squared(position) / (SIGMA_MM * SIGMA_MM);
                    (squared < REACH * REACH).then(|| (vertex, area * (-squared / 2.0).exp()))
                })
                .collect();
            let whole: f64 = list.iter().map(|(_, weight)| weight).sum();
            for (_, weight) in &mut list {
                *weight /= whole;
            }
            list
        };
        Self(positions.iter().zip(&places.of_vertex).map(|(&from, place)| if place.is_some() { near(from) } else { Vec::new() }).collect())
    }

    /// The means of values; of those that there are, and `None` in the lid and where there are none.
    pub(super) fn means(&self, values: &[Option<f64>]) -> Vec<Option<f64>> {
        let mean = |list: &Vec<(u32, f64)>| {
            let known = list.iter().filter_map(|&(vertex, weight)| Some((values[vertex as usize]?, weight)));
            let (sum, whole) = known.fold((0.0, 0.0), |(sum, whole), (value, weight)| (sum + value * weight, whole + weight));
            (whole > 0.0).then(|| sum / whole)
        };
        self.0.iter().map(mean).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{Place, RotationSource};

    #[test]
    fn a_mean_is_weighted_by_area_and_distance_and_stays_out_of_the_lid() {
        let place = |area_mm2| Some(Place { segment: 1, degrees: 0.0, radius: 0.5, area_mm2 });
        let places = Places {
            of_vertex: vec![place(1.0), place(2.0), None, place(1.0)],
            axes: [DVec3::X, DVec3::Y, DVec3::Z],
            centre_mm: DVec3::ZERO,
            rotation: RotationSource::Patient,
        };
        let positions = [DVec3::ZERO, DVec3::X * SIGMA_MM, DVec3::X, DVec3::X * 100.0];
        let means = Neighbourhoods::among(&positions, &places).means(&[Some(1.0), Some(3.0), Some(50.0), Some(7.0)]);
        let weight = 2.0 * (-0.5_f64).exp();
        assert!((means[0].unwrap() - (1.0 + 3.0 * weight) / (1.0 + weight)).abs() < 1e-12);
        assert_eq!((means[2], means[3]), (None, Some(7.0)));
    }
}
