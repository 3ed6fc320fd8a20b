//! One study by one method, against the truth.

use super::{
    distance,
    family::{Group, Member},
};
use crate::{
    phantom::{self, PhantomError, Simulation},
    pipeline::{
        self, PerSurface, PipelineError, Reconstruction, Surface,
        clinical::{PsfSource, Uncertainty},
        monitor::Silent,
        parameters::Parameters,
    },
    report::{Function, MYOCARDIAL_DENSITY_G_PER_ML},
};
use glam::DVec3;
use std::time::Instant;

/// A way to reconstruct a study.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Method {
    /// The preset `paper`, nothing given.
    Paper,
    /// The preset `clinical` without its model of the camera: borders at the gradient's extrema.
    Gradient,
    /// The preset `clinical`, nothing given.
    Clinical,
    /// The preset `clinical`, told the width of the (main) Gaussian of the point-spread function.
    PsfGiven,
}

impl Method {
    /// All methods, as the tables list them.
    pub const ALL: [Self; 4] = [Self::Paper, Self::Gradient, Self::Clinical, Self::PsfGiven];

    /// The name in tables and flags.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Gradient => "gradient",
            Self::Clinical => "clinical",
            Self::PsfGiven => "psf-given",
        }
    }

    /// The parameters for a study seen through a camera that shows a line source this wide.
    pub fn parameters(self, psf_fwhm_mm: Option<f64>) -> Parameters {
        let mut parameters = if self == Self::Paper { Parameters::paper() } else { Parameters::clinical() };
        match self {
            Self::Paper | Self::Clinical => {}
            Self::Gradient => parameters.refine.enabled = false,
            Self::PsfGiven => parameters.refine.psf_fwhm_mm = psf_fwhm_mm,
        }
        parameters
    }
}

/// What is reported of a study: of the truth, or of a reconstruction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Values {
    /// Ejection fraction in percent.
    pub ef_percent: f64,
    /// End-diastolic volume in ml.
    pub edv_ml: f64,
    /// End-systolic volume in ml.
    pub esv_ml: f64,
    /// 1.05 g/ml times the mean wall volume of the gates.
    pub mass_g: f64,
    /// The gate of the largest cavity, counted from 1.
    pub end_diastolic_gate: usize,
    /// The gate of the smallest cavity, counted from 1.
    pub end_systolic_gate: usize,
    /// Standard deviation of the wall's volume over the gates, in percent of its mean.
    pub wall_spread_percent: f64,
}

impl Values {
    /// From the cavity's and the whole's volume in ml at every gate; `None` where there is no cycle or a value is not finite.
    pub fn of_cycle(cavity_ml: &[f64], whole_ml: &[f64]) -> Option<Self> {
        let function = Function::of_cavity(cavity_ml)?;
        let walls: Vec<f64> = whole_ml.iter().zip(cavity_ml).map(|(whole, cavity)| whole - cavity).collect();
        let mean = walls.iter().sum::<f64>() / walls.len() as f64;
        let variance = walls.iter().map(|wall| (wall - mean).powi(2)).sum::<f64>() / walls.len() as f64;
        let values = Self {
            ef_percent: function.ef_percent,
            edv_ml: function.edv_ml,
            esv_ml: function.esv_ml,
            mass_g: MYOCARDIAL_DENSITY_G_PER_ML * mean,
            end_diastolic_gate: function.end_diastolic_gate,
            end_systolic_gate: function.end_systolic_gate,
            wall_spread_percent: 100.0 * variance.sqrt() / mean,
        };
        let all = [values.ef_percent, values.edv_ml, values.esv_ml, values.mass_g];
        all.iter().all(|value| value.is_finite()).then_some(values)
    }

    /// Of a reconstructed cycle.
    pub fn of(found: &Reconstruction) -> Option<Self> {
        let volumes = |surface| found.gates.iter().map(|gate| gate.volume_ml(surface)).collect::<Vec<f64>>();
        Self::of_cycle(&volumes(Surface::Endocardial), &volumes(Surface::Epicardial))
    }
}

/// How far a found pose lies from the true one at the mean of the gates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseError {
    /// Angle between the axes in degrees.
    pub axis_degrees: f64,
    /// Distance between the tips of the mid-wall in mm.
    pub apex_mm: f64,
    /// Along the true axis, positive where the found valve plane lies beyond the true one, in mm.
    pub base_mm: f64,
}

/// What the model of the camera said of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelSaid {
    /// Estimated (or given) full width at half maximum less that of a line source's section, in mm.
    pub psf_error_mm: f64,
    /// Whether it was estimated.
    pub psf_estimated: bool,
    /// Whether it ran into a limit of the search.
    pub psf_at_bound: bool,
    /// Residual over what noise would leave.
    pub residual_over_noise: f64,
    /// Part of the wall that rests on its surroundings.
    pub extrapolated_fraction: f64,
    /// Errors over their standard errors: EDV, ESV, EF, mass.
    pub over_standard_error: Option<[f64; 4]>,
}

/// A study that was reconstructed.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// What was found.
    pub found: Values,
    /// What is true.
    pub truth: Values,
    /// Mean surface distances over all gates.
    pub distance: Option<PerSurface<distance::Distances>>,
    /// How the pose was met.
    pub pose: Option<PoseError>,
    /// What the model said.
    pub model: Option<ModelSaid>,
    /// Codes of the warnings, in order, each once.
    pub warnings: Vec<String>,
}

impl Score {
    /// Found less true ejection fraction in points.
    pub fn ef_points(&self) -> f64 {
        self.found.ef_percent - self.truth.ef_percent
    }

    /// Error of the end-diastolic volume in percent of it.
    pub fn edv_percent(&self) -> f64 {
        100.0 * (self.found.edv_ml / self.truth.edv_ml - 1.0)
    }

    /// Error of the end-systolic volume in percent of it.
    pub fn esv_percent(&self) -> f64 {
        100.0 * (self.found.esv_ml / self.truth.esv_ml - 1.0)
    }

    /// Error of the mass in percent of it.
    pub fn mass_percent(&self) -> f64 {
        100.0 * (self.found.mass_g / self.truth.mass_g - 1.0)
    }

    /// Mean distance of a surface in mm; NaN where there is none.
    pub fn distance_mm(&self, surface: Surface) -> f64 {
        self.distance.as_ref().map_or(f64::NAN, |distance| distance.get(surface).closed_mm)
    }
}

/// What came of a study.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// A ventricle was found.
    Found(Box<Score>),
    /// Nothing was: the code and the sentence of the error.
    Failed {
        /// The stable code.
        code: &'static str,
        /// Why.
        why: String,
    },
}

impl Outcome {
    /// The score of what was found.
    pub fn score(&self) -> Option<&Score> {
        match self {
            Self::Found(score) => Some(score),
            Self::Failed { .. } => None,
        }
    }
}

/// A study by one method.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// The study's name.
    pub name: String,
    /// Its family.
    pub family: &'static str,
    /// Its group.
    pub group: Group,
    /// By what it was reconstructed.
    pub method: Method,
    /// What came of it.
    pub outcome: Outcome,
    /// Seconds it took on one thread.
    pub seconds: f64,
}

/// Simulates a study once and reconstructs it by every method.
///
/// Errors: a phantom that cannot be made.
pub fn run(member: &Member, methods: &[Method]) -> Result<Vec<Run>, PhantomError> {
    let simulation = simulated(member)?;
    let of = |&method: &Method| {
        let parameters = method.parameters(Some(member.phantom.imaging.psf.line_source_fwhm_mm()));
        let (outcome, seconds) = outcome(member, &simulation, &parameters);
        Run { name: member.name.clone(), family: member.family, group: member.group, method, outcome, seconds }
    };
    Ok(methods.iter().map(of).collect())
}

/// The study of a member, and its truth.
///
/// Errors: a phantom that cannot be made.
pub fn simulated(member: &Member) -> Result<Simulation, PhantomError> {
    let Simulation { study, truth } = phantom::simulate(&member.phantom)?;
    Ok(Simulation { study: member.dressed(study), truth })
}

/// What comes of a simulated study with some parameters, and the seconds it takes.
pub fn outcome(member: &Member, simulation: &Simulation, parameters: &Parameters) -> (Outcome, f64) {
    let start = Instant::now();
    let result = pipeline::reconstruct(&simulation.study, parameters, &Silent);
    let seconds = start.elapsed().as_secs_f64();
    let outcome = match result {
        Ok(found) => scored(member, simulation, &found),
        Err(error) => failed(&error),
    };
    (outcome, seconds)
}

fn failed(error: &PipelineError) -> Outcome {
    Outcome::Failed { code: error.code(), why: error.to_string() }
}

/// Compares a reconstruction with the truth.
fn scored(member: &Member, simulation: &Simulation, found: &Reconstruction) -> Outcome {
    let Some(values) = Values::of(found) else {
        return Outcome::Failed { code: "no_volumes", why: "A volume is not a finite number.".to_owned() };
    };
    let gates = &simulation.truth.gates;
    let cavity: Vec<f64> = gates.iter().map(|gate| gate.endocardial_ml).collect();
    let whole: Vec<f64> = gates.iter().map(|gate| gate.epicardial_ml).collect();
    // A negative control has no truth: everything found in it is in excess of nothing.
    let truth = Values::of_cycle(&cavity, &whole).unwrap_or(Values {
        ef_percent: 0.0,
        edv_ml: 0.0,
        esv_ml: 0.0,
        mass_g: 0.0,
        end_diastolic_gate: 1,
        end_systolic_gate: 1,
        wall_spread_percent: 0.0,
    });
    let mut warnings: Vec<String> = found.warnings.iter().map(|warning| warning.code.clone()).collect();
    warnings.sort_unstable();
    warnings.dedup();
    Outcome::Found(Box::new(Score {
        found: values,
        truth,
        distance: distance::over_the_cycle(found, |gate| member.phantom.exact_surfaces(gate)),
        pose: pose_error(member, found),
        model: model_said(member, found, &values, &truth),
        warnings,
    }))
}

fn pose_error(member: &Member, found: &Reconstruction) -> Option<PoseError> {
    let pose = found.pose?;
    let exact: Vec<_> = (0..found.gates.len()).map_while(|gate| member.phantom.exact_surfaces(gate)).collect();
    let count = exact.len().max(1) as f64;
    let tip = exact.iter().map(|exact| exact.mid_wall_tip_mm).sum::<DVec3>() / count;
    let base = exact.iter().map(|exact| exact.base_mm).sum::<DVec3>() / count;
    let axis = (base - tip).try_normalize()?;
    Some(PoseError {
        axis_degrees: pose.to_base().dot(axis).clamp(-1.0, 1.0).acos().to_degrees(),
        apex_mm: pose.apex_mm.distance(tip),
        base_mm: (pose.base_mm - base).dot(axis),
    })
}

fn model_said(member: &Member, found: &Reconstruction, values: &Values, truth: &Values) -> Option<ModelSaid> {
    let model = found.model.as_ref()?;
    let over_standard_error = model.uncertainty.as_ref().and_then(|&Uncertainty { edv_ml, esv_ml, ef_percent, mass_g }| {
        Some([
            (values.edv_ml - truth.edv_ml) / edv_ml,
            (values.esv_ml - truth.esv_ml) / esv_ml?,
            (values.ef_percent - truth.ef_percent) / ef_percent?,
            (values.mass_g - truth.mass_g) / mass_g,
        ])
    });
    Some(ModelSaid {
        psf_error_mm: model.psf.fwhm_mm - member.phantom.imaging.psf.line_source_fwhm_mm(),
        psf_estimated: model.psf.source == PsfSource::Estimated,
        psf_at_bound: model.psf.at_bound,
        residual_over_noise: model.residual.over_noise,
        extrapolated_fraction: model.extrapolated_fraction,
        over_standard_error,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_follow_from_the_cycle() {
        let values = Values::of_cycle(&[100.0, 40.0, 80.0], &[200.0, 150.0, 190.0]).unwrap();
        assert_eq!((values.edv_ml, values.esv_ml, values.ef_percent), (100.0, 40.0, 60.0));
        assert_eq!((values.end_diastolic_gate, values.end_systolic_gate), (1, 2));
        // Walls of 100, 110 and 110 ml: mean 320/3, variance (44.4 + 11.1 + 11.1)/3 = 22.2.
        assert!((values.mass_g - 112.0).abs() < 1e-9);
        assert!((values.wall_spread_percent - 100.0 * (200.0_f64 / 9.0).sqrt() / (320.0 / 3.0)).abs() < 1e-9);
        assert_eq!(Values::of_cycle(&[100.0], &[200.0]), None);
        assert_eq!(Values::of_cycle(&[100.0, f64::NAN], &[200.0, 100.0]), None);
    }
}
