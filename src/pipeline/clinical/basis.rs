//! Smooth functions over the wall: cubic B-splines from apex to base times harmonics about the axis.
//!
//! Harmonic `m` fades as `s^m` towards the apex, where all directions meet in one point.

use std::f64::consts::TAU;

/// Splines from apex to base: their knots lie 12-15 mm apart on a normal ventricle, about the width of a camera's blur.
pub(super) const SPLINES: usize = 8;
/// Constant, cosine and sine of φ, cosine and sine of 2φ: round, shifted, oval.
pub(super) const HARMONICS: usize = 5;
/// The uptake map has those up to 5φ: a defect of a tenth of the wall is a sector of 36 degrees.
pub(super) const MAP_HARMONICS: usize = 11;
/// The `s` above which harmonics are whole.
const FADES_BELOW: f64 = 0.7;

/// Knots of the splines.
const KNOTS: usize = SPLINES + 4;
/// Intervals between different knots.
const INTERVALS: usize = SPLINES - 3;

/// Splines over `0..=s_max`, clamped at both ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Basis {
    pub(super) s_max: f64,
    knots: [f64; KNOTS],
}

/// An angle about the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Angle {
    pub(super) phi: f64,
    pub(super) sin: f64,
    pub(super) cos: f64,
}

impl Angle {
    pub(super) fn new(phi: f64) -> Self {
        let (sin, cos) = phi.sin_cos();
        Self { phi, sin, cos }
    }

    /// So many angles all round.
    pub(super) fn around(count: usize) -> impl Iterator<Item = Self> {
        (0..count).map(move |i| Self::new(TAU * i as f64 / count as f64))
    }
}

/// A place on the wall: the splines that are not zero there (the first one's number and the four values) and the harmonics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    pub(super) first: usize,
    pub(super) splines: [f64; 4],
    pub(super) harmonics: [f64; MAP_HARMONICS],
}

impl Basis {
    pub(super) fn new(s_max: f64) -> Self {
        Self { s_max, knots: std::array::from_fn(|index| s_max * index.saturating_sub(3).min(INTERVALS) as f64 / INTERVALS as f64) }
    }

    /// The basis at a place; `s` is clamped to the range.
    pub(super) fn at(&self, s: f64, angle: &Angle) -> Spot {
        let (first, splines) = self.splines(s);
        Spot { first, splines, harmonics: harmonics(s, angle) }
    }

    /// Spline values at `s`, by de Boor's recurrence.
    pub(super) fn splines(&self, s: f64) -> (usize, [f64; 4]) {
        let s = s.clamp(0.0, self.s_max * (1.0 - 1e-12));
        let first = ((s / self.s_max * INTERVALS as f64) as usize).min(INTERVALS - 1);
        let mut values = [1.0, 0.0, 0.0, 0.0];
        for degree in 1..4 {
            let mut saved = 0.0;
            for (j, value) in values[..degree].iter_mut().enumerate() {
                let (right, left) = (self.knots[first + 4 + j] - s, s - self.knots[first + 4 + j - degree]);
                let part = *value / (right + left);
                *value = saved + right * part;
                saved = left * part;
            }
            values[degree] = saved;
        }
        (first, values)
    }
}

/// The harmonics at a place.
fn harmonics(s: f64, angle: &Angle) -> [f64; MAP_HARMONICS] {
    let fade = (s / FADES_BELOW).clamp(0.0, 1.0);
    // Powers of fade · e^(iφ).
    let (x, y) = (fade * angle.cos, fade * angle.sin);
    let (mut re, mut im) = (1.0, 0.0);
    let mut values = [1.0; MAP_HARMONICS];
    for pair in values[1..].chunks_exact_mut(2) {
        (re, im) = (re * x - im * y, re * y + im * x);
        pair.copy_from_slice(&[re, im]);
    }
    values
}

impl Spot {
    /// A function of `stride` coefficients a spline, of which those from `first` on belong to the first `count` harmonics.
    pub(super) fn value(&self, coefficients: &[f64], (stride, first, count): (usize, usize, usize)) -> f64 {
        let mut sum = 0.0;
        for (k, value) in self.splines.iter().enumerate() {
            let of_spline = &coefficients[(self.first + k) * stride + first..][..count];
            sum += value * of_spline.iter().zip(&self.harmonics).map(|(c, h)| c * h).sum::<f64>();
        }
        sum
    }
}

/// Strides of the uptake map.
pub(super) const MAP_WHOLE: (usize, usize, usize) = (MAP_HARMONICS, 0, MAP_HARMONICS);

/// Order of a harmonic's index: 0, 1, 1, 2, 2 and so on.
pub(super) fn order(harmonic: usize) -> usize {
    harmonic.div_ceil(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splines_sum_to_one_and_reproduce_lines() {
        let basis = Basis::new(3.1);
        // Greville abscissae: coefficients of the identity.
        let greville = |i: usize| (1..4).map(|k| basis.knots[i + k]).sum::<f64>() / 3.0;
        for s in [0.0, 0.3, 1.55, 2.2, 3.05, 3.1] {
            let (first, values) = basis.splines(s);
            assert!((values.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let line: f64 = values.iter().enumerate().map(|(k, v)| v * greville(first + k)).sum();
            assert!((line - s).abs() < 1e-9, "{s}: {line}");
        }
    }

    #[test]
    fn harmonics_vanish_at_the_apex() {
        let [round, rest @ ..] = harmonics(0.0, &Angle::new(1.0));
        assert!(round.to_bits() == 1.0_f64.to_bits() && rest.iter().all(|value| value.abs() < 1e-300));
        let [one, c, s, c2, s2, c3, s3, ..] = harmonics(1.0, &Angle::new(0.3));
        assert!((one - 1.0).abs() < 1e-15 && (c - 0.3_f64.cos()).abs() < 1e-15 && (s - 0.3_f64.sin()).abs() < 1e-15);
        assert!((c3 - 0.9_f64.cos()).abs() < 1e-15 && (s3 - 0.9_f64.sin()).abs() < 1e-15);
        assert!((c2 - 0.6_f64.cos()).abs() < 1e-15 && (s2 - 0.6_f64.sin()).abs() < 1e-15);
    }
}
