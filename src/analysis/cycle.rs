//! The time-volume curve: a Fourier series through the gates' volumes, and the rates of emptying and filling.

use crate::study::Study;
use std::f64::consts::TAU;

/// Fewest gates that a curve is told from.
const FEWEST_GATES: usize = 4;
/// Harmonics of the fit at most: as many as eight gates carry, so that rates of 8 and 16 gates are of one kind.
pub const HARMONICS: usize = 3;
/// Instants at which the series is looked at: a millisecond of a second's cycle.
const INSTANTS: usize = 1000;

/// The curve of the cavity's volume over one R-R interval, from the R wave.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// The R-R interval in ms, if it is known.
    pub rr_interval_ms: Option<f64>,
    /// Middle of each gate as a part of the R-R interval.
    pub gate_phase: Vec<f64>,
    /// Volume at each gate in ml.
    pub gate_ml: Vec<f64>,
    /// Mean of the series in ml.
    pub mean_ml: f64,
    /// Amplitude in ml and phase in degrees of each harmonic: volume = mean + Σ amplitude · cos(2π k t/RR − phase).
    pub harmonics: Vec<(f64, f64)>,
    /// Root mean square of what the series leaves of the gates' volumes, in ml.
    pub residual_ml: f64,
    /// Rates of the series.
    pub rates: Rates,
}

impl Cycle {
    /// From the cavity's volume in ml at every gate; `None` for fewer than four gates.
    pub fn of(study: &Study, cavity_ml: &[f64]) -> Option<Self> {
        if cavity_ml.len() < FEWEST_GATES {
            return None;
        }
        let durations_ms: Option<Vec<f64>> = study.gates.iter().map(|gate| gate.duration_ms.filter(|ms| *ms > 0.0)).collect();
        let rr_interval_ms = study.acquisition.rr_interval_ms.filter(|ms| ms.is_finite() && *ms > 0.0);
        Some(Self::through(cavity_ml, durations_ms.as_deref(), rr_interval_ms))
    }

    /// Through volumes at gates of these durations (equal ones where not known).
    fn through(gate_ml: &[f64], durations_ms: Option<&[f64]>, rr_interval_ms: Option<f64>) -> Self {
        let gates = gate_ml.len();
        let shares: Vec<f64> = durations_ms.filter(|durations| durations.len() == gates).map_or_else(|| vec![1.0; gates], <[f64]>::to_vec);
        let whole: f64 = shares.iter().sum();
        let mut passed = 0.0;
        let gate_phase: Vec<f64> = shares
            .iter()
            .map(|share| {
                let middle = (passed + share / 2.0) / whole;
                passed += share;
                middle
            })
            .collect();
        let count = HARMONICS.min((gates - 1) / 2);
        let coefficients = least_squares(&gate_phase, gate_ml, count);
        let volume = |t: f64| series(&coefficients, t);
        let rate = |t: f64| slope(&coefficients, t);
        let residual = gate_phase.iter().zip(gate_ml).map(|(&t, ml)| (volume(t) - ml).powi(2)).sum::<f64>() / gates as f64;
        Self {
            rr_interval_ms,
            gate_ml: gate_ml.to_vec(),
            mean_ml: coefficients[0],
            harmonics: coefficients[1..]
                .chunks_exact(2)
                .map(|pair| (pair[0].hypot(pair[1]), pair[1].atan2(pair[0]).to_degrees().rem_euclid(360.0)))
                .collect(),
            residual_ml: residual.sqrt(),
            rates: Rates::of(&volume, &rate),
            gate_phase,
        }
    }

    /// Volume of the series in ml at a part of the R-R interval.
    pub fn volume_ml(&self, t: f64) -> f64 {
        let wave =
            |(index, (amplitude, degrees)): (usize, &(f64, f64))| amplitude * (TAU * (index + 1) as f64 * t - degrees.to_radians()).cos();
        self.mean_ml + self.harmonics.iter().enumerate().map(wave).sum::<f64>()
    }
}

/// Rates of emptying and filling of a curve; times are parts of the R-R interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// The largest volume in ml.
    pub largest_ml: f64,
    /// Where the volume is least, from the R wave.
    pub end_systole: f64,
    /// Peak emptying rate as a part of the largest volume a cycle; positive.
    pub peak_emptying: f64,
    /// From the R wave to the peak emptying rate.
    pub time_to_peak_emptying: f64,
    /// Peak filling rate between end systole and the largest volume after it likewise.
    pub peak_filling: f64,
    /// From end systole to the peak filling rate.
    pub time_to_peak_filling: f64,
    /// Mean filling rate over the first third of that time likewise.
    pub mean_filling_first_third: f64,
}

impl Rates {
    /// Of a volume in ml over the cycle, of period 1, and its slope.
    pub fn of(volume: &dyn Fn(f64) -> f64, rate: &dyn Fn(f64) -> f64) -> Self {
        let instants = || (0..INSTANTS).map(|step| step as f64 / INSTANTS as f64);
        let lowest =
            |of: &dyn Fn(f64) -> f64| instants().fold((0.0, f64::INFINITY), |best, t| if of(t) < best.1 { (t, of(t)) } else { best });
        let (end_systole, _) = lowest(volume);
        let largest_ml = instants().map(volume).fold(f64::NEG_INFINITY, f64::max);
        let (time_to_peak_emptying, emptying) = lowest(rate);
        let (mut end_diastole, mut end_ml, mut peak, mut peak_after) = (0.0, f64::NEG_INFINITY, f64::NEG_INFINITY, 0.0);
        for after in instants() {
            let ml = volume(end_systole + after);
            if ml > end_ml {
                (end_diastole, end_ml) = (after, ml);
            }
        }
        for after in instants().take_while(|&after| after <= end_diastole) {
            let filling = rate(end_systole + after);
            if filling > peak {
                (peak_after, peak) = (after, filling);
            }
        }
        let third = end_diastole / 3.0;
        let first_third = if third > 0.0 { (volume(end_systole + third) - volume(end_systole)) / third } else { 0.0 };
        Self {
            largest_ml,
            end_systole,
            peak_emptying: -emptying / largest_ml,
            time_to_peak_emptying,
            peak_filling: peak / largest_ml,
            time_to_peak_filling: peak_after,
            mean_filling_first_third: first_third / largest_ml,
        }
    }
}

/// Constant, then cosine and sine of each harmonic.
fn series(coefficients: &[f64], t: f64) -> f64 {
    terms(t, coefficients.len()).iter().zip(coefficients).map(|(term, c)| term * c).sum()
}

fn slope(coefficients: &[f64], t: f64) -> f64 {
    let of = |k: usize| {
        let (sine, cosine) = (TAU * k as f64 * t).sin_cos();
        TAU * k as f64 * (coefficients[2 * k] * cosine - coefficients[2 * k - 1] * sine)
    };
    (1..=(coefficients.len() - 1) / 2).map(of).sum()
}

fn terms(t: f64, count: usize) -> Vec<f64> {
    (0..count)
        .map(|index| {
            let (sine, cosine) = (TAU * index.div_ceil(2) as f64 * t).sin_cos();
            if index % 2 == 1 || index == 0 { cosine } else { sine }
        })
        .collect()
}

/// The series that fits best, by the normal equations: a handful of unknowns, nearly orthogonal.
fn least_squares(phases: &[f64], values: &[f64], harmonics: usize) -> Vec<f64> {
    let size = 2 * harmonics + 1;
    let rows: Vec<Vec<f64>> = phases.iter().map(|&t| terms(t, size)).collect();
    let mut matrix: Vec<Vec<f64>> = (0..size)
        .map(|i| {
            let with = |other: &dyn Fn(usize) -> f64| rows.iter().enumerate().map(|(row, terms)| terms[i] * other(row)).sum::<f64>();
            let mut line: Vec<f64> = (0..size).map(|j| with(&|row| rows[row][j])).collect();
            line.push(with(&|row| values[row]));
            line
        })
        .collect();
    // Gauss-Jordan with pivots.
    for column in 0..size {
        let pivot =
            (column..size).fold(column, |best, row| if matrix[row][column].abs() > matrix[best][column].abs() { row } else { best });
        matrix.swap(column, pivot);
        let lead = matrix[column].clone();
        if lead[column].abs() < f64::EPSILON {
            continue;
        }
        for (row, line) in matrix.iter_mut().enumerate() {
            let factor = if row == column { 1.0 - 1.0 / lead[column] } else { line[column] / lead[column] };
            for (value, of_lead) in line.iter_mut().zip(&lead) {
                *value -= factor * of_lead;
            }
        }
    }
    matrix.iter().map(|line| line[size]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(t: f64) -> f64 {
        90.0 + 30.0 * (TAU * t - 0.2).cos() + 6.0 * (2.0 * TAU * t + 1.0).cos() + 2.0 * (3.0 * TAU * t).cos()
    }

    #[test]
    fn a_curve_of_three_harmonics_is_found_whole() {
        for gates in [8_u32, 16] {
            let ml: Vec<f64> = (0..gates).map(|gate| curve((f64::from(gate) + 0.5) / f64::from(gates))).collect();
            let cycle = Cycle::through(&ml, None, Some(800.0));
            assert!((cycle.mean_ml - 90.0).abs() < 1e-9 && (cycle.harmonics[0].0 - 30.0).abs() < 1e-9, "{cycle:?}");
            assert!(cycle.residual_ml < 1e-9);
            assert!((0..50).all(|step| (cycle.volume_ml(f64::from(step) / 50.0) - curve(f64::from(step) / 50.0)).abs() < 1e-9));
        }
    }

    #[test]
    fn rates_of_one_wave_are_those_of_the_cosine() {
        let ml: Vec<f64> = (0..16).map(|gate| 100.0 + 40.0 * (TAU * (f64::from(gate) + 0.5) / 16.0).cos()).collect();
        let cycle = Cycle::through(&ml, None, None);
        // Steepest a quarter after either end: 2π · 40 of 140 ml a cycle.
        let steepest = TAU * 40.0 / 140.0;
        assert!((cycle.rates.peak_emptying - steepest).abs() < 1e-4 && (cycle.rates.peak_filling - steepest).abs() < 1e-4, "{cycle:?}");
        assert!((cycle.rates.end_systole - 0.5).abs() < 2e-3 && (cycle.rates.time_to_peak_filling - 0.25).abs() < 2e-3);
        // A third of half a cycle: 40 · (1 − cos 60°) in a sixth of the cycle.
        assert!((cycle.rates.mean_filling_first_third - 20.0 * 6.0 / 140.0).abs() < 5e-3, "{cycle:?}");
    }

    #[test]
    fn gates_of_unequal_length_lie_where_they_lie() {
        let durations = [100.0, 100.0, 100.0, 100.0, 100.0, 100.0, 100.0, 300.0];
        let middles: Vec<f64> = (0..8).map(|gate| if gate < 7 { (f64::from(gate) + 0.5) / 10.0 } else { 0.85 }).collect();
        let ml: Vec<f64> = middles.iter().map(|&t| curve(t)).collect();
        let cycle = Cycle::through(&ml, Some(&durations), None);
        assert!((cycle.harmonics[1].0 - 6.0).abs() < 1e-6, "{cycle:?}");
    }
}
