//! When an evolution has ended: the definitive stopping mechanism, the first of the paper's open questions (§9).
//!
//! Freezing on border voxels stops most particles. The others, and all of them where freezing is off, swing about the border or hang on
//! springs; they have arrived when their mean places no longer shift: the displacement of the mean over a second against that over the
//! second before. An oscillation of whatever size passes as rest, a drift does not.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What ended an evolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stop {
    /// Every particle froze on the border.
    AllFrozen,
    /// The particles that are not frozen no longer get anywhere.
    AtRest,
    /// The most steps that were allowed have been taken.
    StepLimit,
}

/// Simulated time over which places are averaged, in s. A particle pulled by 10 mm/s² crosses two voxels in a second, so that one on its
/// way is never taken for one at rest, and swings of a voxel take less than that.
const WINDOW_S: f64 = 1.0;
/// Least steps in a window.
const FEWEST_STEPS: usize = 4;

/// Follows the places of the particles that move.
#[derive(Debug, Clone)]
pub struct Rest {
    steps_a_window: usize,
    /// Root of the mean square shift below which particles are at rest, in mm.
    tolerance_mm: f64,
    taken: usize,
    sums: Vec<DVec3>,
    last: Option<Vec<DVec3>>,
}

impl Rest {
    /// Nothing seen yet.
    pub fn new(particles: usize, time_step_s: f64, tolerance_mm: f64) -> Self {
        let steps_a_window = ((WINDOW_S / time_step_s).round() as usize).max(FEWEST_STEPS);
        Self { steps_a_window, tolerance_mm, taken: 0, sums: vec![DVec3::ZERO; particles], last: None }
    }

    /// Takes a step in; at rest, answers with the mean place of every particle over the last window.
    pub fn observe(&mut self, positions: &[DVec3], frozen: &[bool]) -> Option<Vec<DVec3>> {
        for (sum, position) in self.sums.iter_mut().zip(positions) {
            *sum += *position;
        }
        self.taken += 1;
        if self.taken < self.steps_a_window {
            return None;
        }
        let means: Vec<DVec3> = self.sums.iter().map(|sum| *sum / self.taken as f64).collect();
        self.sums.fill(DVec3::ZERO);
        self.taken = 0;
        let last = self.last.replace(means.clone())?;
        let moving = || frozen.iter().zip(means.iter().zip(&last)).filter(|(frozen, _)| !**frozen);
        let square = moving().map(|(_, (mean, last))| mean.distance_squared(*last)).sum::<f64>() / moving().count().max(1) as f64;
        (square.sqrt() <= self.tolerance_mm).then_some(means)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The step at which a particle that moves like this is at rest, within 60 s.
    fn rests_at(place: impl Fn(f64) -> f64) -> Option<(usize, f64)> {
        let mut rest = Rest::new(1, 0.01, 0.05);
        (0..6000).find_map(|step| rest.observe(&[DVec3::X * place(0.01 * step as f64)], &[false]).map(|means| (step, means[0].x)))
    }

    #[test]
    fn an_oscillation_rests_at_its_middle_and_a_drift_does_not() {
        let (step, middle) = rests_at(|t| 7.0 + 2.0 * (t * 25.0).sin()).unwrap();
        assert!(step < 300 && (middle - 7.0).abs() < 0.05, "{step} {middle}");
        assert_eq!(rests_at(|t| 0.2 * t), None);
        let (step, place) = rests_at(|t| 10.0 * (1.0 - (-t / 2.0).exp())).unwrap();
        assert!(step > 800 && place > 9.8, "{step} {place}");
    }

    #[test]
    fn frozen_particles_do_not_count() {
        let mut rest = Rest::new(2, 0.25, 0.01);
        let observed: Vec<bool> =
            (0..8_i32).map(|step| rest.observe(&[DVec3::X * f64::from(step), DVec3::Y], &[true, false]).is_some()).collect();
        assert_eq!(observed, [false, false, false, false, false, false, false, true]);
    }
}
