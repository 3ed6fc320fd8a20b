//! What is known of a ventricle before its counts are looked at: smooth surfaces, a wall about a centimetre thick, a valve plane nearly
//! across the axis; a wall that keeps its volume and a shape that changes smoothly over the cycle.

use super::{
    basis::{HARMONICS, MAP_HARMONICS, SPLINES, order},
    exposure::UPTAKE,
    fit::{Plan, SHARED, State, WIDTH},
    rays::roughness,
    shape::{BASE, LOCAL, STRIDE, THICKNESS_HARMONICS, Volumes},
};

/// Thickness of the wall: mean and standard deviation in mm (`numerics.md`, §4.4).
pub(super) const THICKNESS_MM: [f64; 2] = [10.0, 8.0];
/// Height of the valve plane about the one that rays show, smoothed over the cycle: standard deviation in mm.
const BASE_MM: f64 = 4.0;
/// Slope of the valve plane: standard deviation in mm at 30 mm from the axis, 7.6 degrees.
const SLOPE_MM: f64 = 4.0;
/// Roughness of the mid-wall and of the thickness, an mm² of the penalties below.
const MID_ROUGHNESS: f64 = 0.6;
const THICKNESS_BEND: f64 = 60.0;
const THICKNESS_SHIFT: f64 = 20.0;
/// Of the uptake map: roughness, and distance from the rays' map.
const MAP_ROUGHNESS: f64 = 0.5;
const MAP_SIZE: f64 = 400.0;
/// How strongly the shape under a defect is held to its surroundings' continuation, and by how much stiffer it is there (the prototype's).
pub(super) const HELD: f64 = 0.2;
pub(super) const STIFFER: [f64; 2] = [10.0, 20.0];

/// Everything that pulls at the parameters besides the counts.
pub(super) struct Priors {
    /// Constant part: matrix `[LOCAL × LOCAL]`, and the values it pulls to, a set a gate.
    matrix: Vec<f64>,
    centres: Vec<Vec<f64>>,
    /// The map the uptake is held to.
    pub(super) map: Vec<f64>,
    /// Logarithm of the width: mean and standard deviation.
    pub(super) width: [f64; 2],
    /// Relative standard deviation of the wall's volume over the cycle; `None`: not held.
    pub(super) wall_volume: Option<f64>,
    /// Standard deviation in mm of what makes a gate's wall uneven, its harmonics and its valve plane's slope, from the mean of the gates
    /// before and after; `None`: not held. Mean radius, thickness and the valve plane's height are free: they are the beat.
    pub(super) temporal_mm: Option<f64>,
}

impl Priors {
    pub(super) fn new(held: Option<&[Vec<f64>]>, bases_mm: &[f64], map: Vec<f64>, width: [f64; 2]) -> Self {
        let mut matrix = vec![0.0; LOCAL * LOCAL];
        let mut centre = vec![0.0; LOCAL];
        let [mid_stiffer, thickness_stiffer] = held.map_or([1.0; 2], |_| STIFFER);
        let rough = roughness(HARMONICS, 1.0, 0.5);
        let n = SPLINES * HARMONICS;
        let mid = |index: usize| index / HARMONICS * STRIDE + index % HARMONICS;
        for a in 0..n {
            for b in 0..n {
                matrix[mid(a) * LOCAL + mid(b)] += MID_ROUGHNESS * mid_stiffer * rough[a * n + b];
            }
        }
        let mut add = |terms: &[(usize, f64)], weight: f64| {
            for &(a, x) in terms {
                for &(b, y) in terms {
                    matrix[a * LOCAL + b] += weight * x * y;
                }
            }
        };
        for h in 0..THICKNESS_HARMONICS {
            let at = |spline: usize| spline * STRIDE + HARMONICS + h;
            let m = order(h) as f64;
            if h == 0 {
                add(&[(at(0), 1.0), (at(1), -1.0)], THICKNESS_BEND);
                for i in 0..SPLINES - 2 {
                    add(&[(at(i), 1.0), (at(i + 1), -2.0), (at(i + 2), 1.0)], THICKNESS_BEND * thickness_stiffer);
                }
                for i in 0..SPLINES {
                    add(&[(at(i), 1.0)], 1.0 / (THICKNESS_MM[1] * THICKNESS_MM[1]));
                    centre[at(i)] = THICKNESS_MM[0];
                }
            } else {
                for i in 0..SPLINES - 1 {
                    add(&[(at(i), -1.0), (at(i + 1), 1.0)], THICKNESS_SHIFT * m * m * thickness_stiffer);
                }
                for i in 0..SPLINES {
                    add(&[(at(i), 1.0)], 0.3 * m * m * thickness_stiffer);
                }
            }
        }
        add(&[(BASE, 1.0)], 1.0 / (BASE_MM * BASE_MM));
        for slope in [BASE + 1, BASE + 2] {
            add(&[(slope, 1.0)], 1.0 / (SLOPE_MM * SLOPE_MM));
        }
        if held.is_some() {
            for index in 0..n {
                add(&[(mid(index), 1.0)], HELD);
            }
        }
        let centres = bases_mm
            .iter()
            .enumerate()
            .map(|(gate, base_mm)| {
                let mut centre = centre.clone();
                centre[BASE] = *base_mm;
                for (index, value) in held.into_iter().flat_map(|held| held[gate].iter().enumerate()) {
                    centre[mid(index)] = *value;
                }
                centre
            })
            .collect();
        Self { matrix, centres, map, width, wall_volume: None, temporal_mm: None }
    }

    /// What holds one gate.
    pub(super) fn of_gate(&self, gate: usize, state: &State, volumes: &[Volumes]) -> LocalPrior<'_> {
        let gates = state.shapes.len();
        let wall = self.wall_volume.filter(|_| gates > 1).map(|relative| {
            let mean_ml = volumes.iter().map(Volumes::wall_ml).sum::<f64>() / gates as f64;
            let off_ml = mean_ml - volumes[gate].wall_ml();
            (volumes[gate].wall_gradient(), off_ml, 1.0 / (relative * mean_ml).powi(2))
        });
        let temporal = self.temporal_mm.filter(|_| gates > 3).map(|mm| {
            let at = |offset: usize| &state.shapes[(gate + offset) % gates].values;
            let (before, after) = (at(gates - 1), at(1));
            let around = before.iter().zip(after).map(|(a, b)| f64::midpoint(*a, *b)).collect();
            (around, 1.0 / (mm * mm))
        });
        LocalPrior { constant: self, centre: &self.centres[gate], wall, temporal }
    }

    /// What holds what all gates share.
    pub(super) fn add_shared(&self, state: &State, plan: &Plan, n: usize, corner: &mut [f64], side: &mut [f64]) {
        if plan.fits_width {
            let [mean, deviation] = self.width;
            corner[WIDTH * n + WIDTH] += 1.0 / (deviation * deviation);
            side[WIDTH] += (mean - state.sigma_mm.ln()) / (deviation * deviation);
        }
        if !plan.fits_map {
            return;
        }
        let rough = roughness(MAP_HARMONICS, 1.0, 0.3);
        let map = &state.activity.map;
        for a in 0..UPTAKE {
            corner[(SHARED + a) * n + SHARED + a] += MAP_SIZE;
            side[SHARED + a] += MAP_SIZE * (self.map[a] - map[a]);
            for b in 0..UPTAKE {
                corner[(SHARED + a) * n + SHARED + b] += MAP_ROUGHNESS * rough[a * UPTAKE + b];
                side[SHARED + a] -= MAP_ROUGHNESS * rough[a * UPTAKE + b] * map[b];
            }
        }
    }
}

/// What holds one gate: the constant part, the wall's volume, the gates before and after.
pub(super) struct LocalPrior<'a> {
    constant: &'a Priors,
    centre: &'a [f64],
    /// Gradient of the wall's volume, how much is missing to the mean, weight.
    wall: Option<(Vec<f64>, f64, f64)>,
    temporal: Option<(Vec<f64>, f64)>,
}

impl LocalPrior<'_> {
    pub(super) fn add(&self, values: &[f64], own: &mut [f64], side: &mut [f64]) {
        let off: Vec<f64> = self.centre.iter().zip(values).map(|(centre, value)| centre - value).collect();
        for (row, (line, side)) in self.constant.matrix.chunks_exact(LOCAL).zip(side.iter_mut()).enumerate() {
            for (entry, own) in line.iter().zip(&mut own[row * LOCAL..][..LOCAL]) {
                *own += entry;
            }
            *side += line.iter().zip(&off).map(|(a, b)| a * b).sum::<f64>();
        }
        if let Some((gradient, off_ml, weight)) = &self.wall {
            for (a, x) in gradient.iter().enumerate() {
                side[a] += weight * x * off_ml;
                for (b, y) in gradient.iter().enumerate() {
                    own[a * LOCAL + b] += weight * x * y;
                }
            }
        }
        if let Some((around, weight)) = &self.temporal {
            let held = |index: usize| index > BASE || (index < BASE && ![0, HARMONICS].contains(&(index % STRIDE)));
            for (index, (target, value)) in around.iter().zip(values).enumerate().filter(|(index, _)| held(*index)) {
                own[index * LOCAL + index] += weight;
                side[index] += weight * (target - value);
            }
        }
    }
}
