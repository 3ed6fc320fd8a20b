//! Poisson counts that are the same on every run for the same seed.
//!
//! `rand_distr` would do, but its streams may change between releases and a phantom's voxels are compared byte by byte.

use rand::Rng;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Below this mean the sampler searches the distribution from 0 (exact, one uniform number); above it rejects from a hat.
const SEARCH_BELOW: f64 = 12.0;

/// The random stream of one gate: gates of one seed are independent, and adding gates changes none of the others.
pub(super) fn stream(seed: u64, gate: usize) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(gate as u64);
    random
}

/// A Poisson variable of the given mean (0 for a mean that is not positive).
pub(super) fn poisson(random: &mut impl Rng, mean: f64) -> f64 {
    if mean > SEARCH_BELOW {
        by_rejection(random, mean)
    } else if mean > 0.0 {
        by_search(random, mean)
    } else {
        0.0
    }
}

/// Uniform in the open interval (0, 1).
fn uniform(random: &mut impl Rng) -> f64 {
    ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}

fn by_search(random: &mut impl Rng, mean: f64) -> f64 {
    let mut left = uniform(random);
    let mut probability = (-mean).exp();
    let mut count = 0.0;
    // At 200 the remaining probability is far below the resolution of `left`.
    while left > probability && count < 200.0 {
        left -= probability;
        count += 1.0;
        probability *= mean / count;
    }
    count
}

/// Hörmann, "The transformed rejection method for generating Poisson random variables" (1993), algorithm PTRS; for means of 10 and more.
fn by_rejection(random: &mut impl Rng, mean: f64) -> f64 {
    let b = 0.931 + 2.53 * mean.sqrt();
    let a = -0.059 + 0.02483 * b;
    let inverse_alpha = 1.1239 + 1.1328 / (b - 3.4);
    let v_r = 0.9277 - 3.6224 / (b - 2.0);
    loop {
        let u = uniform(random) - 0.5;
        let v = uniform(random);
        let u_s = 0.5 - u.abs();
        let count = ((2.0 * a / u_s + b) * u + mean + 0.43).floor();
        if u_s >= 0.07 && v <= v_r {
            return count;
        }
        if count < 0.0 || (u_s < 0.013 && v > u_s) {
            continue;
        }
        if (v * inverse_alpha / (a / (u_s * u_s) + b)).ln() <= count * mean.ln() - mean - ln_factorial(count) {
            return count;
        }
    }
}

/// ln n! for whole n ≥ 0: the product for small n, Stirling's series (relative error under 1e-14) above.
fn ln_factorial(n: f64) -> f64 {
    if n < 16.0 {
        return (2..=n as u32).map(f64::from).product::<f64>().ln();
    }
    let x = n + 1.0;
    let series = 1.0 / (12.0 * x) - 1.0 / (360.0 * x.powi(3)) + 1.0 / (1260.0 * x.powi(5)) - 1.0 / (1680.0 * x.powi(7));
    (x - 0.5) * x.ln() - x + 0.5 * std::f64::consts::TAU.ln() + series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ln_factorial_is_continuous_with_its_product() {
        let direct = |n: u32| (2..=n).map(|k| f64::from(k).ln()).sum::<f64>();
        for n in [0, 1, 2, 15, 16, 17, 40, 170] {
            assert!((ln_factorial(f64::from(n)) - direct(n)).abs() < 1e-11, "{n}");
        }
    }

    /// Mean and variance of a Poisson variable are both its mean; 100 000 draws give the mean to √(λ/n) and the variance to about
    /// √((2λ² + λ)/n). Five standard errors are allowed.
    #[test]
    fn moments_on_both_sides_of_the_switch() {
        for mean in [0.3, 4.0, 11.9, 12.1, 60.0, 900.0] {
            let mut random = stream(7, 0);
            let draws = 100_000;
            let counts: Vec<f64> = (0..draws).map(|_| poisson(&mut random, mean)).collect();
            let n = f64::from(draws);
            let average = counts.iter().sum::<f64>() / n;
            let variance = counts.iter().map(|count| (count - average).powi(2)).sum::<f64>() / n;
            assert!((average - mean).abs() < 5.0 * (mean / n).sqrt(), "mean {mean}: {average}");
            assert!((variance - mean).abs() < 5.0 * ((2.0 * mean * mean + mean) / n).sqrt(), "variance {mean}: {variance}");
        }
    }

    /// The whole distribution at the switch: χ² of 20 000 draws against the probabilities, 20 degrees of freedom, limit at p ≈ 1e-4.
    #[test]
    fn frequencies_follow_the_distribution() {
        let (mean, draws) = (14.0_f64, 20_000);
        let mut random = stream(11, 3);
        let mut seen = [0.0; 21];
        for _ in 0..draws {
            let class = (poisson(&mut random, mean) - 4.0).clamp(0.0, 20.0);
            seen[class as usize] += 1.0;
        }
        let probability = |count: f64| (count * mean.ln() - mean - ln_factorial(count)).exp();
        let mut expected: Vec<f64> = (0..21).map(|class| probability(f64::from(class) + 4.0)).collect();
        expected[0] = (0..=4).map(|count| probability(f64::from(count))).sum();
        expected[20] = 1.0 - expected[..20].iter().sum::<f64>();
        let chi: f64 = seen.iter().zip(&expected).map(|(seen, p)| (seen - p * f64::from(draws)).powi(2) / (p * f64::from(draws))).sum();
        assert!(chi < 52.4, "{chi}");
    }

    #[test]
    fn a_mean_of_nothing_is_nothing() {
        assert_eq!(poisson(&mut stream(1, 0), 0.0).to_bits(), 0.0_f64.to_bits());
        assert_eq!(poisson(&mut stream(1, 0), -3.0).to_bits(), 0.0_f64.to_bits());
    }
}
