//! Smooth functions over the wall: cubic B-splines from apex to base times harmonics about the axis.
//!
//! Harmonic `m` fades as `s^m` towards the apex, where all directions meet in one point.

/// Splines from apex to base: their knots lie 12-15 mm apart on a normal ventricle, about the width of a camera's blur.
pub(super) const SPLINES: usize = 8;
/// Constant, cosine and sine of φ, cosine and sine of 2φ: round, shifted, oval.
pub(super) const HARMONICS: usize = 5;
/// The `s` above which harmonics are whole.
const FADES_BELOW: f64 = 0.7;

/// Splines over `0..=s_max`, clamped at both ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Basis {
    pub(super) s_max: f64,
}

/// The splines that are not zero at a place: the first one's number and the four values.
pub(super) type Support = (usize, [f64; 4]);

impl Basis {
    fn knot(&self, index: usize) -> f64 {
        let intervals = SPLINES - 3;
        self.s_max * (index.saturating_sub(3).min(intervals)) as f64 / intervals as f64
    }

    /// Spline values at `s` (clamped to the range), by de Boor's recurrence.
    pub(super) fn splines(&self, s: f64) -> Support {
        let intervals = SPLINES - 3;
        let s = s.clamp(0.0, self.s_max * (1.0 - 1e-12));
        let interval = ((s / self.s_max * intervals as f64) as usize).min(intervals - 1);
        let at = interval + 3;
        let mut values = [1.0, 0.0, 0.0, 0.0];
        for degree in 1..4 {
            let mut saved = 0.0;
            for j in 0..degree {
                let (right, left) = (self.knot(at + j + 1) - s, s - self.knot(at + 1 + j - degree));
                let part = values[j] / (right + left);
                values[j] = saved + right * part;
                saved = left * part;
            }
            values[degree] = saved;
        }
        (interval, values)
    }

    /// The harmonics at a place.
    pub(super) fn harmonics(s: f64, phi: f64) -> [f64; HARMONICS] {
        let fade = (s / FADES_BELOW).clamp(0.0, 1.0);
        let (sin, cos) = phi.sin_cos();
        let second = fade * fade;
        [1.0, fade * cos, fade * sin, second * (cos * cos - sin * sin), second * 2.0 * sin * cos]
    }

    /// A function of `stride` coefficients a spline, of which those from `first` on belong to the first `harmonics`.
    pub(super) fn value(&self, coefficients: &[f64], (stride, first, count): (usize, usize, usize), s: f64, phi: f64) -> f64 {
        let (spline, values) = self.splines(s);
        let harmonics = Self::harmonics(s, phi);
        let mut sum = 0.0;
        for (k, value) in values.iter().enumerate() {
            let of_spline = &coefficients[(spline + k) * stride + first..][..count];
            sum += value * of_spline.iter().zip(&harmonics).map(|(c, h)| c * h).sum::<f64>();
        }
        sum
    }
}

/// Order of a harmonic's index: 0, 1, 1, 2, 2.
pub(super) fn order(harmonic: usize) -> usize {
    harmonic.div_ceil(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splines_sum_to_one_and_reproduce_lines() {
        let basis = Basis { s_max: 3.1 };
        // Greville abscissae: coefficients of the identity.
        let greville = |i: usize| (1..4).map(|k| basis.knot(i + k)).sum::<f64>() / 3.0;
        for s in [0.0, 0.3, 1.55, 2.2, 3.05, 3.1] {
            let (first, values) = basis.splines(s);
            assert!((values.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let line: f64 = values.iter().enumerate().map(|(k, v)| v * greville(first + k)).sum();
            assert!((line - s).abs() < 1e-9, "{s}: {line}");
        }
    }

    #[test]
    fn harmonics_vanish_at_the_apex() {
        assert_eq!(Basis::harmonics(0.0, 1.0), [1.0, 0.0, 0.0, 0.0, 0.0]);
        let [one, c, s, c2, s2] = Basis::harmonics(1.0, 0.3);
        assert!((one - 1.0).abs() < 1e-15 && (c - 0.3_f64.cos()).abs() < 1e-15 && (s - 0.3_f64.sin()).abs() < 1e-15);
        assert!((c2 - 0.6_f64.cos()).abs() < 1e-15 && (s2 - 0.6_f64.sin()).abs() < 1e-15);
    }
}
