//! When a callback that failed is tried again.

use sha2::{Digest as _, Sha256};
use std::time::Duration;
use uuid::Uuid;

/// How often and when a callback is tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Schedule {
    /// Attempts in all.
    pub attempts: u32,
    /// Pause after the first.
    pub first: Duration,
    /// How many times longer each pause is than the one before.
    pub factor: f64,
    /// Longest pause, also where the receiver asks for a longer one.
    pub longest: Duration,
}

impl Default for Schedule {
    /// Eleven attempts over 25 hours: a receiver that is down for a day still hears. `docs/operations.md` has the table.
    fn default() -> Self {
        Self { attempts: 11, first: Duration::from_secs(10), factor: 3.0, longest: Duration::from_hours(8) }
    }
}

/// Part of a pause by which it is made longer or shorter, so that what failed together does not come again together.
const JITTER: f64 = 0.2;

impl Schedule {
    /// The pause after an attempt (from 1), or `None` after the last. `wanted` is what the receiver asked for by `Retry-After`: it can make the
    /// pause longer, not shorter.
    pub(super) fn pause(&self, delivery: Uuid, attempt: i64, wanted: Option<Duration>) -> Option<Duration> {
        if attempt >= i64::from(self.attempts) {
            return None;
        }
        let power = i32::try_from(attempt - 1).unwrap_or(i32::MAX).max(0);
        let plain_s = (self.first.as_secs_f64() * self.factor.powi(power)).min(self.longest.as_secs_f64());
        let own = Duration::from_secs_f64(plain_s * (1.0 + JITTER * spread(delivery, attempt)));
        Some(own.max(wanted.unwrap_or_default().min(self.longest)))
    }
}

/// A number from -1 to 1 that belongs to this attempt: the same on every node, other for every delivery.
fn spread(delivery: Uuid, attempt: i64) -> f64 {
    let digest = Sha256::new().chain_update(delivery.as_bytes()).chain_update(attempt.to_le_bytes()).finalize();
    let number = u32::from_le_bytes([digest[0], digest[1], digest[2], digest[3]]);
    f64::from(number) / f64::from(u32::MAX) * 2.0 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_over_about_a_day_and_then_end() {
        let (schedule, id) = (Schedule::default(), Uuid::from_u128(7));
        let pauses: Vec<f64> = (1..).map_while(|attempt| schedule.pause(id, attempt, None)).map(|pause| pause.as_secs_f64()).collect();
        let plain = [10.0, 30.0, 90.0, 270.0, 810.0, 2430.0, 7290.0, 21870.0, 28800.0, 28800.0];
        assert_eq!(pauses.len(), plain.len());
        assert!(pauses.iter().zip(plain).all(|(pause, plain)| (pause / plain - 1.0).abs() <= JITTER), "{pauses:?}");
        let day_s = 86400.0;
        assert!((0.8 * day_s..1.3 * day_s).contains(&pauses.iter().sum::<f64>()), "{pauses:?}");
        assert_eq!(schedule.pause(id, 3, None), schedule.pause(id, 3, None));
        assert_ne!(schedule.pause(id, 3, None), schedule.pause(Uuid::from_u128(8), 3, None));
        assert_eq!(schedule.pause(id, i64::MAX, None), None);
    }

    #[test]
    fn a_receiver_can_ask_for_more_time_within_the_longest() {
        let (schedule, id) = (Schedule::default(), Uuid::from_u128(7));
        assert_eq!(schedule.pause(id, 1, Some(Duration::from_mins(10))), Some(Duration::from_mins(10)));
        assert_eq!(schedule.pause(id, 1, Some(Duration::from_hours(99))), Some(Duration::from_hours(8)));
        assert_eq!(schedule.pause(id, 1, Some(Duration::from_secs(1))), schedule.pause(id, 1, None));
        assert_eq!(schedule.pause(id, 11, Some(Duration::from_secs(1))), None);
    }
}
