//! The normal distribution function to about 1e-15; the standard library has no error function.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// Probability that a standard normal variable is below `x`.
pub(super) fn normal_cdf(x: f64) -> f64 {
    let t = x.abs() * FRAC_1_SQRT_2;
    // Abramowitz & Stegun 7.1.6 (series) and 7.1.14 (continued fraction); they meet where both have converged.
    let upper_tail = if t < 2.5 { 0.5 - erf_series(t) / 2.0 } else { erfc_fraction(t) / 2.0 };
    if x < 0.0 { upper_tail } else { 1.0 - upper_tail }
}

fn erf_series(t: f64) -> f64 {
    let mut term = t;
    let mut sum = t;
    let mut n = 0.0;
    while term > 1e-17 * sum {
        n += 1.0;
        term *= 2.0 * t * t / (2.0 * n + 1.0);
        sum += term;
    }
    2.0 / PI.sqrt() * (-t * t).exp() * sum
}

fn erfc_fraction(t: f64) -> f64 {
    let fraction = (1..=60).rev().fold(t, |tail, k| t + f64::from(k) / 2.0 / tail);
    (-t * t).exp() / PI.sqrt() / fraction
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        // Abramowitz & Stegun, table 26.1.
        for (x, p) in [(0.0, 0.5), (1.0, 0.841_344_746_068_543), (2.0, 0.977_249_868_051_821), (4.0, 0.999_968_328_758_167)] {
            assert!((normal_cdf(x) - p).abs() < 1e-14, "{x}: {}", normal_cdf(x));
            assert!((normal_cdf(-x) - (1.0 - p)).abs() < 1e-14);
        }
    }

    #[test]
    fn series_and_fraction_meet() {
        assert!((1.0 - erf_series(2.5) - erfc_fraction(2.5)).abs() < 1e-15);
    }
}
