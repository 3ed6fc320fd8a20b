//! Gauss-Legendre nodes and weights.

use std::f64::consts::PI;

/// Nodes and weights on 0..1 for `n` points, by Newton's method on the Legendre polynomials.
pub(super) fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    (0..n)
        .map(|i| {
            let mut x = (PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..50 {
                let (mut last, mut value) = (0.0, 1.0);
                for k in 0..n {
                    let k = k as f64;
                    (last, value) = (value, ((2.0 * k + 1.0) * x * value - k * last) / (k + 1.0));
                }
                slope = n as f64 * (x * value - last) / (x * x - 1.0);
                let step = value / slope;
                x -= step;
                if step.abs() < 1e-15 {
                    break;
                }
            }
            (0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_integrated_exactly() {
        for n in [1, 2, 3, 7, 24] {
            let nodes = gauss_legendre(n);
            for power in 0..2 * n {
                let sum: f64 = nodes.iter().map(|(x, w)| w * x.powi(power as i32)).sum();
                assert!((sum - 1.0 / (power as f64 + 1.0)).abs() < 1e-13, "{n} points, power {power}: {sum}");
            }
        }
    }
}
