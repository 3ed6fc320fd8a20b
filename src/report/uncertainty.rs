//! Standard errors of what is reported.

use super::report::{Function, Myocardium};
use crate::pipeline::clinical;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Half the width of a 95 % interval, in standard errors: the normal distribution's.
pub const HALF_WIDTH_95: f64 = 1.96;

/// How uncertain the volumes, the ejection fraction and the mass are: noise of the counts and the uncertain width of the point-spread function,
/// by the fitted model. What the model does not know of (motion between gates, a wrong pose) is not in it; the flags tell of that. How often
/// the intervals hold the truth on simulated hearts is published (`docs/accuracy.md`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UncertaintySummary {
    /// Of the end-diastolic volume in ml; of the cavity's volume for one gate.
    pub edv_ml: ErrorSummary,
    /// Of the end-systolic volume in ml; null for one gate.
    #[schema(required)]
    pub esv_ml: Option<ErrorSummary>,
    /// Of the ejection fraction in points of percent; null for one gate.
    #[schema(required)]
    pub ef_percent: Option<ErrorSummary>,
    /// Of the mass in g.
    pub mass_g: ErrorSummary,
}

/// The uncertainty of one value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ErrorSummary {
    /// Its standard error, in its own unit.
    pub standard_error: f64,
    /// Lower end of its 95 % interval: the value less 1.96 standard errors; not below 0.
    pub low_95: f64,
    /// Upper end of its 95 % interval: the value and 1.96 standard errors; of an ejection fraction not above 100.
    pub high_95: f64,
}

impl UncertaintySummary {
    /// Of a reconstruction's values; `cavity_ml` is the cavity's volume at the first gate, which is all there is where `function` is `None`.
    pub(super) fn of(errors: &clinical::Uncertainty, function: Option<&Function>, cavity_ml: f64, myocardium: &Myocardium) -> Self {
        let about = |value: f64, standard_error: f64, most: f64| ErrorSummary {
            standard_error,
            low_95: (value - HALF_WIDTH_95 * standard_error).max(0.0),
            high_95: (value + HALF_WIDTH_95 * standard_error).min(most),
        };
        Self {
            edv_ml: about(function.map_or(cavity_ml, |function| function.edv_ml), errors.edv_ml, f64::INFINITY),
            esv_ml: function.zip(errors.esv_ml).map(|(function, error)| about(function.esv_ml, error, f64::INFINITY)),
            ef_percent: function.zip(errors.ef_percent).map(|(function, error)| about(function.ef_percent, error, 100.0)),
            mass_g: about(myocardium.mass_g, errors.mass_g, f64::INFINITY),
        }
    }
}

impl ErrorSummary {
    /// Half the width of the 95 % interval, as people write it after ±.
    pub fn half_width_95(&self) -> f64 {
        HALF_WIDTH_95 * self.standard_error
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::clinical::Uncertainty;

    #[test]
    fn intervals_are_about_the_values_and_end_where_values_must() {
        let errors = Uncertainty { edv_ml: 4.0, esv_ml: Some(3.0), ef_percent: Some(2.0), mass_g: 5.0 };
        let function = Function::of_cavity(&[100.0, 3.0]);
        let myocardium = Myocardium { mass_g: 105.0, mean_ml: 100.0, variation_percent: None };
        let told = UncertaintySummary::of(&errors, function.as_ref(), 100.0, &myocardium);
        assert!((told.edv_ml.low_95 - 92.16).abs() < 1e-9 && (told.edv_ml.high_95 - 107.84).abs() < 1e-9, "{told:?}");
        let (esv, ef) = (told.esv_ml.unwrap(), told.ef_percent.unwrap());
        assert!(esv.low_95.abs() < 1e-12 && (esv.high_95 - 8.88).abs() < 1e-9, "{esv:?}");
        assert!((ef.low_95 - 93.08).abs() < 1e-9 && (ef.high_95 - 100.0).abs() < 1e-12, "{ef:?}");
        assert!((told.mass_g.half_width_95() - 9.8).abs() < 1e-9);
        let one = Uncertainty { esv_ml: None, ef_percent: None, ..errors };
        let told = UncertaintySummary::of(&one, None, 80.0, &myocardium);
        assert_eq!((told.esv_ml, told.ef_percent), (None, None));
        assert!((told.edv_ml.high_95 - 87.84).abs() < 1e-9);
    }
}
