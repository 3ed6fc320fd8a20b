//! What the model of the camera says of a study.

use crate::pipeline::clinical::{GateFit, ModelFit, PsfEstimate, PsfSource, Referee, Residual};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The model of how the camera blurs a wall of this shape, fitted to the counts of all gates at once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelSummary {
    /// Whether the surfaces are the fitted model's. `false`: those at the gradient's extrema, because `refine.enabled` is false or the fit failed.
    pub refined: bool,
    /// The camera's point-spread function.
    pub psf: PsfSummary,
    /// How well the model explains the counts.
    pub residual: ResidualSummary,
    /// Part of the wall with low uptake, in percent.
    pub low_uptake_percent: f64,
    /// Part of the wall whose place rests on its surroundings more than on its own counts, in percent.
    pub extrapolated_percent: f64,
    /// Ejection fractions by other means.
    pub referee: RefereeSummary,
    /// Gauss-Newton steps.
    pub steps: usize,
    /// Whether the steps came to rest.
    pub converged: bool,
}

/// The point-spread function the surfaces were fitted with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PsfSummary {
    /// Full width at half maximum in mm.
    pub fwhm_mm: f64,
    /// Where it comes from: `given` by the request or `estimated` from the counts.
    #[schema(value_type = String, example = "estimated")]
    pub source: PsfSource,
    /// Its standard error in mm; 0 where it was given.
    pub standard_error_mm: f64,
    /// Whether the estimate ran into a limit of its search.
    pub at_bound: bool,
    /// How the end-diastolic volume (the volume, for one gate) changes with the width, in percent a mm.
    pub edv_percent_per_mm: f64,
}

/// How well the model explains the counts around the wall. The wall's activity is the unit: 0.1 is a tenth of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ResidualSummary {
    /// Root mean square of counts less model.
    pub relative: f64,
    /// The same over what Poisson noise of these counts would leave; 1: the model explains all but noise.
    pub over_noise: f64,
    /// What noise does not explain of it: the root of the difference of the squares; 0 where noise explains all.
    pub unexplained: f64,
}

/// Ejection fractions by other means, in percent; null for one gate or where they cannot be had.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RefereeSummary {
    /// From the surfaces at the gradient's extrema.
    #[schema(required)]
    pub gradient_ef_percent: Option<f64>,
    /// From the rise of the wall's counts as it thickens.
    #[schema(required)]
    pub counts_ef_percent: Option<f64>,
}

/// The model's numbers for one gate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GateModel {
    /// Root mean square of counts less model, as part of the wall's activity.
    pub relative_residual: f64,
    /// The wall's activity in counts a voxel.
    pub activity: f64,
    /// Slope of the valve plane against the long axis, in degrees; 0: across it.
    pub base_tilt_degrees: f64,
    /// From the tip to the valve plane along the axis, in mm.
    pub length_mm: f64,
}

impl From<&ModelFit> for ModelSummary {
    fn from(fit: &ModelFit) -> Self {
        Self {
            refined: fit.refined,
            psf: fit.psf.into(),
            residual: fit.residual.into(),
            low_uptake_percent: 100.0 * fit.low_uptake_fraction,
            extrapolated_percent: 100.0 * fit.extrapolated_fraction,
            referee: fit.referee.into(),
            steps: fit.steps,
            converged: fit.converged,
        }
    }
}

impl From<PsfEstimate> for PsfSummary {
    fn from(psf: PsfEstimate) -> Self {
        let PsfEstimate { fwhm_mm, source, standard_error_mm, at_bound, edv_percent_per_mm } = psf;
        Self { fwhm_mm, source, standard_error_mm, at_bound, edv_percent_per_mm }
    }
}

impl From<Residual> for ResidualSummary {
    fn from(Residual { relative, over_noise }: Residual) -> Self {
        let noise = if over_noise > 0.0 { relative / over_noise } else { relative };
        Self { relative, over_noise, unexplained: (relative * relative - noise * noise).max(0.0).sqrt() }
    }
}

impl From<Referee> for RefereeSummary {
    fn from(Referee { gradient_ef_percent, counts_ef_percent }: Referee) -> Self {
        Self { gradient_ef_percent, counts_ef_percent }
    }
}

impl From<&GateFit> for GateModel {
    fn from(fit: &GateFit) -> Self {
        let GateFit { relative_residual, activity, base_tilt_degrees, length_mm } = *fit;
        Self { relative_residual, activity, base_tilt_degrees, length_mm }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_noise_explains_of_a_residual_is_not_held_against_the_model() {
        let unexplained = |relative, over_noise| ResidualSummary::from(Residual { relative, over_noise }).unexplained;
        assert!((unexplained(0.05, 5.0 / 3.0) - 0.04).abs() < 1e-12);
        for (relative, over_noise) in [(0.2, 1.0), (0.2, 0.9), (0.0, 0.0)] {
            assert!(unexplained(relative, over_noise).abs() < 1e-12, "{relative} {over_noise}");
        }
        assert!((unexplained(0.2, 1e6) - 0.2).abs() < 1e-9);
    }
}
