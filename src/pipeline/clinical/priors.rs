//! What is known of a ventricle before its counts are looked at: smooth surfaces, a wall about a centimetre thick, a valve plane nearly
//! across the axis; a wall that keeps its volume and a shape that changes smoothly over the cycle.

use super::{
    basis::{HARMONICS, MAP_HARMONICS, SPLINES, order},
    exposure::UPTAKE,
    fit::{Plan, State},
    rays::roughness,
    shape::{BASE, LOCAL, STRIDE, THICKNESS_HARMONICS, Volumes},
    system::{SHARED, WIDTH},
};

/// Thickness of the wall: mean and standard deviation in mm (`numerics.md`, §4.4).
pub(super) const THICKNESS_MM: [f64; 2] = [10.0, 4.0];
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
/// How strongly the map's mean is held to the rays': wall activity times map is one number, and it is the activity that tells it.
const MAP_MEAN: f64 = 1e6;
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
    pub(super) fn of_gate<'a>(&'a self, gate: usize, state: &'a State, volumes: &[Volumes]) -> LocalPrior<'a> {
        let gates = state.shapes.len();
        let wall = self.wall_volume.filter(|_| gates > 1).map(|relative| {
            let wall_ml = volumes[gate].wall_ml();
            let gradient = volumes[gate].wall_gradient().into_iter().map(|by| by / wall_ml).collect();
            (gradient, state.log_wall_ml - wall_ml.ln(), 1.0 / (relative * relative))
        });
        let temporal = self.temporal_mm.filter(|_| gates > 3).map(|mm| {
            let at = |offset: usize| state.shapes[(gate + offset) % gates].values.as_slice();
            ([at(gates - 1), at(1)], 1.0 / (mm * mm))
        });
        LocalPrior { constant: self, centre: &self.centres[gate], wall, temporal }
    }

    /// What holds what all gates share; returns half the squared standard deviations off.
    pub(super) fn add_shared(&self, state: &State, plan: &Plan, n: usize, corner: &mut [f64], side: &mut [f64]) -> f64 {
        let mut energy = 0.0;
        if plan.fits_width {
            let [mean, deviation] = self.width;
            let off = mean - state.sigma_mm.ln();
            corner[WIDTH * n + WIDTH] += 1.0 / (deviation * deviation);
            side[WIDTH] += off / (deviation * deviation);
            energy += 0.5 * (off / deviation).powi(2);
        }
        if !plan.fits_map {
            return energy;
        }
        let rough = roughness(MAP_HARMONICS, 1.0, 0.3);
        let map = &state.activity.map;
        let constants = || (0..UPTAKE).step_by(MAP_HARMONICS);
        let mean_off = constants().map(|a| self.map[a] - map[a]).sum::<f64>() / SPLINES as f64;
        let weight = MAP_MEAN / SPLINES as f64;
        for a in constants() {
            side[SHARED + a] += weight * mean_off;
            for b in constants() {
                corner[(SHARED + a) * n + SHARED + b] += weight / SPLINES as f64;
            }
        }
        energy += 0.5 * MAP_MEAN * mean_off * mean_off;
        for a in 0..UPTAKE {
            corner[(SHARED + a) * n + SHARED + a] += MAP_SIZE;
            side[SHARED + a] += MAP_SIZE * (self.map[a] - map[a]);
            energy += 0.5 * MAP_SIZE * (self.map[a] - map[a]).powi(2);
            for b in 0..UPTAKE {
                corner[(SHARED + a) * n + SHARED + b] += MAP_ROUGHNESS * rough[a * UPTAKE + b];
                side[SHARED + a] -= MAP_ROUGHNESS * rough[a * UPTAKE + b] * map[b];
                energy += 0.5 * MAP_ROUGHNESS * rough[a * UPTAKE + b] * map[a] * map[b];
            }
        }
        energy
    }
}

/// What holds one gate: the constant part, the wall's volume, the gates before and after.
pub(super) struct LocalPrior<'a> {
    constant: &'a Priors,
    centre: &'a [f64],
    /// Gradient of the logarithm of the wall's volume, what is missing to the common one, weight.
    pub(super) wall: Option<(Vec<f64>, f64, f64)>,
    /// The gates before and after, weight.
    temporal: Option<([&'a [f64]; 2], f64)>,
}

impl LocalPrior<'_> {
    /// Adds to a gate's own part of the normal equations; returns half the squared standard deviations off.
    pub(super) fn add(&self, values: &[f64], own: &mut [f64], side: &mut [f64]) -> f64 {
        let mut energy = 0.0;
        let off: Vec<f64> = self.centre.iter().zip(values).map(|(centre, value)| centre - value).collect();
        for (row, (line, side)) in self.constant.matrix.chunks_exact(LOCAL).zip(side.iter_mut()).enumerate() {
            for (entry, own) in line.iter().zip(&mut own[row * LOCAL..][..LOCAL]) {
                *own += entry;
            }
            let pull = line.iter().zip(&off).map(|(a, b)| a * b).sum::<f64>();
            *side += pull;
            energy += 0.5 * pull * off[row];
        }
        if let Some((gradient, off, weight)) = &self.wall {
            for (a, x) in gradient.iter().enumerate() {
                side[a] += weight * x * off;
                for (b, y) in gradient.iter().enumerate() {
                    own[a * LOCAL + b] += weight * x * y;
                }
            }
            energy += 0.5 * weight * off * off;
        }
        if let Some(([before, after], weight)) = self.temporal {
            let held = |index: usize| index > BASE || (index < BASE && ![0, HARMONICS].contains(&(index % STRIDE)));
            for index in (0..LOCAL).filter(|index| held(*index)) {
                let (to_before, to_after) = (before[index] - values[index], after[index] - values[index]);
                own[index * LOCAL + index] += weight;
                side[index] += weight * 0.5 * (to_before + to_after);
                // Each of the two stands for half of what both gates are apart.
                energy += 0.125 * weight * (to_before * to_before + to_after * to_after);
            }
        }
        energy
    }
}
