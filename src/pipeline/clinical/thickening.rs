//! The ejection fraction by the partial-volume effect: a wall thinner than the camera's resolution gets brighter as it thickens
//! (Galt, Garcia and Robbins, IEEE Trans Med Imaging 9:144, 1990). A second opinion that needs no edge of the endocardium.

use super::{
    basis::{Angle, HARMONICS, SPLINES},
    priors::THICKNESS_MM,
    rays::{AROUND, Rays, places},
    shape::{LOCAL, STRIDE, Shape, Space, Volumes},
};
use std::f64::consts::{FRAC_2_SQRT_PI, TAU};

/// Harmonics of the cycle that thickening is reduced to: noise of single gates is left out (`numerics.md`, §1).
const CYCLE_HARMONICS: usize = 2;
/// Most of the recovery a wall may reach: beyond, thickness is not determined.
const MOST_RECOVERY: f64 = 0.97;

/// Cavity volumes in ml over the cycle, from the mid-wall surfaces and the valve planes of the gates and the brightness of the wall against
/// the first of `diastole`; `unit` are the counts of a gate that stand for the same activity. `None` for fewer than four gates.
pub(super) fn cavity_ml(space: &Space, rays: &[Rays], shapes: &[Shape], unit: &[f64], diastole: usize, sigma_mm: f64) -> Option<Vec<f64>> {
    let gates = rays.len();
    if gates < 4 {
        return None;
    }
    let scale = 2.0 * std::f64::consts::SQRT_2 * sigma_mm;
    let reference = erf(THICKNESS_MM[0] / scale);
    let nodes: Vec<(f64, Angle)> = places(&space.basis).collect();
    // Rows of the wall, averaged around it: where thickening differs around the axis, the mean still has the volume to first order.
    let rows = nodes.len() / AROUND;
    let mut thickness = vec![vec![0.0; rows]; gates];
    for (gate, of_gate) in thickness.iter_mut().enumerate() {
        for (row, value) in of_gate.iter_mut().enumerate() {
            let bright = |gate: usize| {
                let peaks = &rays[gate].peak[row * AROUND..][..AROUND];
                peaks.iter().map(|peak| (peak - rays[gate].background).max(0.0)).sum::<f64>() / unit[gate]
            };
            let ratio = bright(gate) / bright(diastole).max(f64::MIN_POSITIVE);
            *value = scale * inverse_erf((reference * ratio).clamp(0.05, MOST_RECOVERY));
        }
    }
    let series: Vec<Vec<f64>> = (0..rows).map(|row| low_pass(&thickness.iter().map(|gate| gate[row]).collect::<Vec<_>>())).collect();
    let volumes = (0..gates).map(|gate| {
        let mut values = vec![0.0; LOCAL];
        for spline in 0..SPLINES {
            values[spline * STRIDE..][..HARMONICS].copy_from_slice(&rays[gate].mid[spline * HARMONICS..][..HARMONICS]);
            // A cubic spline's coefficient is near the function's value at the middle of its support.
            let row = ((spline as f64 + 0.5) / SPLINES as f64 * rows as f64) as usize;
            values[spline * STRIDE + HARMONICS] = series[row.min(rows - 1)][gate];
        }
        values[LOCAL - 3..].copy_from_slice(&shapes[gate].values[LOCAL - 3..]);
        Volumes::of(&Shape { values }, space).ml.endocardial
    });
    Some(volumes.collect())
}

/// Mean and the first harmonics of a periodic series: the smooth part of a beat.
pub(super) fn low_pass(series: &[f64]) -> Vec<f64> {
    let n = series.len();
    let kept = CYCLE_HARMONICS.min((n - 1) / 2);
    let term = |k: usize, at: usize, from: usize| (TAU * (k * (at + n - from)) as f64 / n as f64).cos();
    (0..n)
        .map(|at| {
            let weight = |from: usize| 1.0 + (1..=kept).map(|k| 2.0 * term(k, at, from)).sum::<f64>();
            series.iter().enumerate().map(|(from, value)| value * weight(from)).sum::<f64>() / n as f64
        })
        .collect()
}

/// The error function: its series below 2.5, a continued fraction above; relative error under 1e-10.
fn erf(x: f64) -> f64 {
    let square = x * x;
    if x.abs() < 2.5 {
        let (mut term, mut sum) = (x, x);
        for n in 1..60 {
            term *= -square / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        return FRAC_2_SQRT_PI * sum;
    }
    let mut fraction = 0.0;
    for n in (1..60).rev() {
        fraction = 0.5 * f64::from(n) / (x.abs() + fraction);
    }
    let tail = 0.5 * FRAC_2_SQRT_PI * (-square).exp() / (x.abs() + fraction);
    x.signum() * (1.0 - tail)
}

/// Inverse of the error function for 0..1, by bisection.
fn inverse_erf(y: f64) -> f64 {
    let (mut low, mut high) = (0.0, 4.0);
    for _ in 0..50 {
        let middle = f64::midpoint(low, high);
        if erf(middle) < y {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_function_has_its_tabulated_values() {
        for (x, y) in [(0.0, 0.0), (0.5, 0.520_499_877_8), (1.0, 0.842_700_792_9), (2.0, 0.995_322_265_0), (3.0, 0.999_977_909_5)] {
            assert!((erf(x) - y).abs() < 1e-9, "{x}: {}", erf(x));
        }
        assert!((inverse_erf(0.842_700_792_9) - 1.0).abs() < 1e-8);
    }

    #[test]
    fn a_low_pass_keeps_two_harmonics_and_drops_the_third() {
        let wave = |k: f64| (0..8).map(|i| 3.0 + (k * TAU * f64::from(i) / 8.0).cos()).collect::<Vec<_>>();
        for (k, kept) in [(1.0, true), (2.0, true), (3.0, false)] {
            let passed = low_pass(&wave(k));
            let expected = if kept { wave(k) } else { vec![3.0; 8] };
            assert!(passed.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{k}: {passed:?}");
        }
    }
}
