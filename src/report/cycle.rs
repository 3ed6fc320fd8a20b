//! The time-volume curve and its rates.

use crate::analysis::Cycle;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The cavity's volume over the R-R interval, from the R wave: a Fourier series through the gates, and the rates of emptying and filling that
/// follow from it. Definitions are in `docs/report.md`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CycleSummary {
    /// Mean R-R interval in ms; null where the study does not tell it. What is in seconds is then null too.
    #[schema(required)]
    pub rr_interval_ms: Option<f64>,
    /// Volume at every gate.
    pub gates: Vec<CyclePoint>,
    /// The series: volume = `mean_ml` + Σ `amplitude_ml` · cos(360° · k · t/RR − `phase_degrees`), k counted from 1.
    pub mean_ml: f64,
    /// Its harmonics, the first one first: three, or as many as the gates carry.
    pub harmonics: Vec<Harmonic>,
    /// Root mean square of the gates' volumes about the series, in ml.
    pub residual_ml: f64,
    /// The largest volume of the series in ml. Rates are parts of it.
    pub fitted_edv_ml: f64,
    /// The smallest volume of the series in ml.
    pub fitted_esv_ml: f64,
    /// End systole, where the series is smallest, in percent of the R-R interval.
    pub end_systole_percent: f64,
    /// Peak emptying rate (PER) in EDV/s.
    #[schema(required)]
    pub peak_emptying_rate_edv_per_s: Option<f64>,
    /// Peak filling rate (PFR) after end systole in EDV/s.
    #[schema(required)]
    pub peak_filling_rate_edv_per_s: Option<f64>,
    /// Mean filling rate over the first third of diastole (MFR/3) in EDV/s.
    #[schema(required)]
    pub mean_filling_rate_first_third_edv_per_s: Option<f64>,
    /// Time from the R wave to the peak emptying rate (TTPE) in ms.
    #[schema(required)]
    pub time_to_peak_emptying_ms: Option<f64>,
    /// Time from end systole to the peak filling rate (TTPF) in ms.
    #[schema(required)]
    pub time_to_peak_filling_ms: Option<f64>,
    /// Whether the gates are too few for the rates to be relied on (fewer than 16).
    pub coarse: bool,
    /// What to beware of, in a sentence, where the gates are too few; else null.
    #[serde(default)]
    #[schema(required)]
    pub caution: Option<String>,
}

/// A gate on the curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CyclePoint {
    /// Counted from 1.
    pub gate: usize,
    /// Middle of the gate in percent of the R-R interval.
    pub rr_percent: f64,
    /// Volume of the cavity in ml.
    pub endocardial_ml: f64,
    /// The series there in ml.
    pub fitted_ml: f64,
}

/// A wave of the series.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Harmonic {
    /// Its amplitude in ml.
    pub amplitude_ml: f64,
    /// Where its maximum lies, 0 to 360, in degrees of its own period.
    pub phase_degrees: f64,
}

/// Fewest gates that resolve the filling: 16 are usually asked for, since each of 8 averages over an eighth of R-R.
pub(super) const GATES_FOR_RATES: usize = 16;

impl From<&Cycle> for CycleSummary {
    fn from(cycle: &Cycle) -> Self {
        let per_s = |per_cycle: f64| cycle.rr_interval_ms.map(|ms| per_cycle * 1000.0 / ms);
        let in_ms = |part: f64| cycle.rr_interval_ms.map(|ms| part * ms);
        let gates = cycle.gate_ml.len();
        Self {
            rr_interval_ms: cycle.rr_interval_ms,
            gates: (1..)
                .zip(cycle.gate_phase.iter().zip(&cycle.gate_ml))
                .map(|(gate, (&phase, &ml))| CyclePoint {
                    gate,
                    rr_percent: 100.0 * phase,
                    endocardial_ml: ml,
                    fitted_ml: cycle.volume_ml(phase),
                })
                .collect(),
            mean_ml: cycle.mean_ml,
            harmonics: cycle.harmonics.iter().map(|&(amplitude_ml, phase_degrees)| Harmonic { amplitude_ml, phase_degrees }).collect(),
            residual_ml: cycle.residual_ml,
            fitted_edv_ml: cycle.rates.largest_ml,
            fitted_esv_ml: cycle.volume_ml(cycle.rates.end_systole),
            end_systole_percent: 100.0 * cycle.rates.end_systole,
            peak_emptying_rate_edv_per_s: per_s(cycle.rates.peak_emptying),
            peak_filling_rate_edv_per_s: per_s(cycle.rates.peak_filling),
            mean_filling_rate_first_third_edv_per_s: per_s(cycle.rates.mean_filling_first_third),
            time_to_peak_emptying_ms: in_ms(cycle.rates.time_to_peak_emptying),
            time_to_peak_filling_ms: in_ms(cycle.rates.time_to_peak_filling),
            coarse: gates < GATES_FOR_RATES,
            caution: (gates < GATES_FOR_RATES).then(|| {
                format!(
                    "{gates} gates do not resolve how fast the ventricle empties and fills: each is an average over {:.0} % of R-R, so that rates and \
                     times are coarse (docs/accuracy.md); {GATES_FOR_RATES} gates or more are asked for.",
                    100.0 / gates as f64
                )
            }),
        }
    }
}
