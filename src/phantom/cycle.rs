//! The time-volume curve of a heart at rest.
//!
//! From the R wave: ejection over about a third of R-R, rapid filling, diastasis, atrial kick. Between the knots the curve is the
//! smoothstep 3s² − 2s³, so that the flow is zero at end systole, in diastasis and at end diastole.

/// Knots `(phase of R-R, volume as a fraction of the stroke above end systole)`.
///
/// The durations are those of a resting heart near 70 beats a minute: systole 35 %, rapid filling 25 %, diastasis 22 % and atrial
/// contraction 18 % of R-R; the atria add about a fifth of the stroke.
const KNOTS: [(f64, f64); 5] = [(0.0, 1.0), (0.35, 0.0), (0.60, 0.72), (0.82, 0.78), (1.0, 1.0)];

/// Volume at a phase of the cycle (R wave 0, next R wave 1) as a fraction of the stroke: 1 at end diastole, 0 at end systole.
pub fn filling(phase: f64) -> f64 {
    let phase = phase.rem_euclid(1.0);
    for pair in KNOTS.windows(2) {
        let ((start, from), (end, to)) = (pair[0], pair[1]);
        if phase <= end {
            let s = (phase - start) / (end - start);
            return from + (to - from) * s * s * (3.0 - 2.0 * s);
        }
    }
    KNOTS[KNOTS.len() - 1].1
}

/// The phases at which one gate is sampled: `samples` points, evenly spread over the gate; one sample is the gate's centre.
///
/// `gate` counts from 0; the first gate starts at the R wave.
pub fn gate_phases(gate: usize, gates: usize, samples: usize) -> impl ExactSizeIterator<Item = f64> + Clone {
    (0..samples).map(move |sample| (gate as f64 + (sample as f64 + 0.5) / samples as f64) / gates as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_passes_its_landmarks_and_is_periodic() {
        assert!((filling(0.0) - 1.0).abs() < 1e-12);
        assert!(filling(0.35).abs() < 1e-12);
        assert!((filling(1.0) - filling(0.0)).abs() < 1e-12);
        assert!((filling(0.2) - filling(1.2)).abs() < 1e-12);
    }

    #[test]
    fn it_falls_in_systole_and_never_falls_after() {
        let values: Vec<f64> = (0..=1000).map(|i| filling(f64::from(i) / 1000.0 - f64::from(i / 1000) * 1e-12)).collect();
        assert!(values[..350].windows(2).all(|pair| pair[1] <= pair[0]));
        assert!(values[350..].windows(2).all(|pair| pair[1] >= pair[0]));
        assert!(values.iter().all(|value| (0.0..=1.0).contains(value)));
    }

    #[test]
    fn one_sample_is_the_centre_of_the_gate() {
        assert_eq!(gate_phases(0, 8, 1).collect::<Vec<_>>(), [0.0625]);
        let many: Vec<f64> = gate_phases(7, 8, 4).collect();
        assert!(many[0] > 0.875 && many[3] < 1.0);
        assert!((many.iter().sum::<f64>() / 4.0 - 0.9375).abs() < 1e-12);
    }
}
