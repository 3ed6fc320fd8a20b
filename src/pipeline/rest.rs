//! When an evolution has ended: the definitive stopping mechanism, the first of the paper's open questions (§9).
//!
//! Freezing on border voxels stops most particles. The others, and all of them where freezing is off, swing about the border or hang on
//! springs, and slide along it without friction for ever. They have arrived when their mean distance to the border stays: when over a second
//! it is what it was over the second before, twice in a row. Measured on the paper's phantom without freezing, that distance falls for two
//! to four seconds; afterwards particles only slide together, and the mesh falls in.

use super::{
    borders::Border,
    nearest::{Centres, nearest},
};
use crate::volume::Grid;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What ended an evolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stop {
    /// Every particle froze on the border.
    AllFrozen,
    /// The mean distance to the border of the particles that are not frozen stays.
    AtRest,
    /// The most steps that were allowed have been taken.
    StepLimit,
}

/// Simulated time over which places and distances are averaged for particles of unit mass, in s. One pulled by 10 mm/s² crosses two voxels in a
/// second, so that one on its way is never taken for one at rest, and swings of a voxel take less than that. Times grow with the root of
/// the mass.
const WINDOW_S: f64 = 1.0;
/// Windows in a row that must not differ from the one before: at the turn of a swing one does not.
const STILL_WINDOWS: usize = 2;
/// Least steps in a window.
const FEWEST_STEPS: usize = 4;
/// Times a window at which distances are measured, which costs more than a step.
const SAMPLES: usize = 4;

/// Follows the particles that move.
#[derive(Debug, Clone)]
pub struct Rest {
    centres: Centres,
    steps_a_window: usize,
    /// Change of the mean distance from one window to the next below which particles are at rest, in mm; at 0 they never are.
    tolerance_mm: f64,
    still: usize,
    taken: usize,
    samples: usize,
    places: Vec<DVec3>,
    distances_mm: Vec<f64>,
    last_mm: Option<Vec<f64>>,
}

impl Rest {
    /// Nothing seen yet. At rest are particles whose mean distance changes by less than `tolerance_mm` a window; with 0 none ever are.
    pub fn new(border: &Border, grid: &Grid, particles: usize, (time_step_s, mass): (f64, f64), tolerance_mm: f64) -> Self {
        Self {
            centres: Centres::of(border, grid),
            steps_a_window: ((WINDOW_S * mass.sqrt() / time_step_s).round() as usize).max(FEWEST_STEPS),
            tolerance_mm,
            still: 0,
            taken: 0,
            samples: 0,
            places: vec![DVec3::ZERO; particles],
            distances_mm: vec![0.0; particles],
            last_mm: None,
        }
    }

    /// Takes a step in; at rest, answers with the mean place of every particle over the last window. Whether particles are at rest is their
    /// mean approach, those that are `frozen` left out.
    pub fn observe(&mut self, positions: &[DVec3], frozen: &[bool]) -> Option<Vec<DVec3>> {
        if self.tolerance_mm <= 0.0 {
            return None;
        }
        for (sum, position) in self.places.iter_mut().zip(positions) {
            *sum += *position;
        }
        self.taken += 1;
        if self.taken * SAMPLES / self.steps_a_window > self.samples {
            self.samples += 1;
            for particle in (0..positions.len()).filter(|&particle| !frozen[particle]) {
                let [_, square_mm2] = nearest(&self.centres, positions[particle].to_array());
                self.distances_mm[particle] += square_mm2.sqrt();
            }
        }
        if self.taken < self.steps_a_window {
            return None;
        }
        let places = self.places.iter().map(|sum| *sum / self.taken as f64).collect();
        let distances_mm: Vec<f64> = self.distances_mm.iter().map(|sum| *sum / self.samples as f64).collect();
        self.places.fill(DVec3::ZERO);
        self.distances_mm.fill(0.0);
        (self.taken, self.samples) = (0, 0);
        let last_mm = self.last_mm.replace(distances_mm.clone())?;
        let moving = || (0..frozen.len()).filter(|&particle| !frozen[particle]);
        let approach_mm = moving().map(|particle| last_mm[particle] - distances_mm[particle]).sum::<f64>() / moving().count().max(1) as f64;
        self.still = if approach_mm.abs() <= self.tolerance_mm { self.still + 1 } else { 0 };
        (self.still >= STILL_WINDOWS).then_some(places)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::borders::BorderPoint;

    /// One border voxel at the origin.
    fn rest(time_step_s: f64, particles: usize) -> Rest {
        let grid = Grid { shape: [4, 4, 4], spacing_mm: [3.0; 3] };
        let point = BorderPoint { voxel: [0; 3], position_mm: DVec3::ZERO, normal: DVec3::X };
        Rest::new(&Border { points: vec![point] }, &grid, particles, (time_step_s, 1.0), 0.1)
    }

    /// When a particle that moves like this is at rest, within 60 s, and where.
    fn rests_at(place: impl Fn(f64) -> DVec3) -> Option<(f64, DVec3)> {
        let mut rest = rest(0.01, 1);
        (0..6000_u32).map(|step| 0.01 * f64::from(step)).find_map(|t| rest.observe(&[place(t)], &[false]).map(|places| (t, places[0])))
    }

    #[test]
    fn who_swings_about_the_border_rests_in_the_middle() {
        let (time, place) = rests_at(|t| DVec3::X * 2.0 * (t * 7.5 * std::f64::consts::TAU).sin()).unwrap();
        assert!(time < 4.0 && place.length() < 0.1, "{time} {place}");
    }

    #[test]
    fn who_comes_nearer_does_not_rest() {
        assert_eq!(rests_at(|t| DVec3::X * (50.0 - 0.7 * t)), None);
        let (time, place) = rests_at(|t| DVec3::X * 10.0 * (-t / 2.0).exp()).unwrap();
        assert!(time > 4.0 && place.x < 1.5, "{time} {place}");
    }

    #[test]
    fn who_swings_far_and_slowly_does_not_rest() {
        // Away from the border as much as towards it.
        assert_eq!(rests_at(|t| DVec3::X * 20.0 * (0.9 * t).cos()), None);
    }

    #[test]
    fn without_tolerance_nobody_rests() {
        let mut rest = rest(0.1, 1);
        rest.tolerance_mm = 0.0;
        assert!((0..100).all(|_| rest.observe(&[DVec3::X], &[false]).is_none()));
    }

    #[test]
    fn who_only_slides_along_rests() {
        let (time, _) = rests_at(|t| DVec3::new(3.0 * (0.3 * t).cos(), 3.0 * (0.3 * t).sin(), 0.0)).unwrap();
        assert!(time < 4.0, "{time}");
    }

    #[test]
    fn frozen_particles_do_not_count() {
        let mut rest = rest(0.25, 2);
        let places = (0..12_u32).map(|step| [DVec3::X * (13.0 - f64::from(step)), DVec3::Y]);
        let observed: Vec<bool> = places.map(|places| rest.observe(&places, &[true, false]).is_some()).collect();
        assert_eq!(observed.iter().position(|rests| *rests), Some(11), "{observed:?}");
    }
}
