//! Random numbers that are the same on every run: what makes the studies of a family differ.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// A stream of numbers for one study.
pub(super) struct Draw(ChaCha8Rng);

impl Draw {
    /// The stream of a seed.
    pub(super) fn of(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Uniform between two ends.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        let part = ((self.0.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
        low + (high - low) * part
    }

    /// As [`Self::between`], even on a logarithmic scale.
    pub(super) fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// −1 or 1.
    pub(super) fn sign(&mut self) -> f64 {
        if self.between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_gives_its_numbers_and_they_lie_between_the_ends() {
        let numbers = |seed| (0..100).map(|_| Draw::of(seed).between(2.0, 3.0)).collect::<Vec<_>>();
        assert_eq!(numbers(5), numbers(5));
        let mut draw = Draw::of(1);
        let many: Vec<f64> = (0..1000).map(|_| draw.log_between(1.0, 100.0)).collect();
        assert!(many.iter().all(|value| (1.0..100.0).contains(value)));
        let below = many.iter().filter(|&&value| value < 10.0).count();
        assert!((440..560).contains(&below), "{below}");
    }
}
