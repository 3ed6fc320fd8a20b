//! The clinical preset: the ventricle is found in any orientation, its borders are measured along its own axes at sub-voxel precision,
//! and a model of how the camera blurs a wall of this shape is fitted to the counts of all gates at once.

mod basis;
mod camera;
mod counts;
mod exposure;
mod film;
mod fit;
mod frame;
mod gram;
mod linear;
mod priors;
mod quadrature;
mod rays;
mod refine;
mod shape;
mod step;
mod surfaces;
mod system;
mod thickening;
mod uncertainty;

use super::{
    Fit, GateReconstruction, PerSurface, PipelineError, Reconstruction,
    monitor::{Monitor, Stage},
    observed,
    parameters::Parameters,
    pose, wall,
};
use crate::study::{Study, Warning};
use basis::Basis;
use frame::Frame;
use rayon::prelude::*;
use rays::{Net, Rays};
use serde::{Deserialize, Serialize};
use shape::Space;
use surfaces::Layout;

/// Gives back the memory that the calling thread keeps from one study to the next.
pub(super) fn forget() {
    film::forget();
}

/// What the model of the camera says of a study.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelFit {
    /// Whether the surfaces are the fitted model's (`false`: the gradient's, because the parameters say so or the fit failed).
    pub refined: bool,
    /// The camera's point-spread function.
    pub psf: PsfEstimate,
    /// How well the model explains the counts.
    pub residual: Residual,
    /// What is not known of the result, and from what it is known.
    pub uncertainty: Option<Uncertainty>,
    /// Part of the wall with low uptake, 0-1.
    pub low_uptake_fraction: f64,
    /// Part of the wall whose place rests on its surroundings more than on its own counts, 0-1.
    pub extrapolated_fraction: f64,
    /// Second opinions on the ejection fraction.
    pub referee: Referee,
    /// Gauss-Newton steps.
    pub steps: usize,
    /// Whether the steps came to rest.
    pub converged: bool,
    /// The model's numbers a gate.
    pub gates: Vec<GateFit>,
}

/// The point-spread function the surfaces were fitted with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PsfEstimate {
    /// Full width at half maximum in mm.
    pub fwhm_mm: f64,
    /// Where it comes from.
    pub source: PsfSource,
    /// Its standard error in mm; 0 where it was given.
    pub standard_error_mm: f64,
    /// Whether it ran into a limit of the search.
    pub at_bound: bool,
    /// How the end-diastolic volume changes with it, in percent a mm.
    pub edv_percent_per_mm: f64,
}

/// Where a point-spread function comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PsfSource {
    /// The request.
    Given,
    /// The counts.
    Estimated,
}

/// How well the model explains the counts around the wall.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// Root mean square of counts less model, as part of the wall's activity.
    pub relative: f64,
    /// The same over what Poisson noise of these counts would leave; 1: the model explains all but noise.
    pub over_noise: f64,
}

/// Standard errors of what is reported.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Of the end-diastolic volume, in ml (of the volume, for one gate).
    pub edv_ml: f64,
    /// Of the end-systolic volume, in ml; `None` for one gate.
    pub esv_ml: Option<f64>,
    /// Of the ejection fraction, in points; `None` for one gate.
    pub ef_percent: Option<f64>,
    /// Of the mass, in g.
    pub mass_g: f64,
}

/// Ejection fractions by other means, in percent; `None` for one gate or where they cannot be had.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Referee {
    /// From the surfaces at the gradient's extrema.
    pub gradient_ef_percent: Option<f64>,
    /// From the rise of the wall's counts as it thickens (partial-volume effect).
    pub counts_ef_percent: Option<f64>,
}

/// The model's numbers for a gate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GateFit {
    /// Root mean square of counts less model, as part of the wall's activity.
    pub relative_residual: f64,
    /// Wall activity in counts a voxel.
    pub activity: f64,
    /// Slope of the valve plane against the long axis, in degrees.
    pub base_tilt_degrees: f64,
    /// From the mid-wall tip to the valve plane along the axis, in mm.
    pub length_mm: f64,
}

/// Reconstructs every gate of a study.
///
/// Errors: no left ventricle, marks outside the study, or cancelled.
pub fn reconstruct(study: &Study, parameters: &Parameters, monitor: &dyn Monitor) -> Result<Reconstruction, PipelineError> {
    let (mut pose, mut warnings) =
        observed(monitor, Stage::Localisation, None, || pose::find(study, &parameters.pose, &parameters.region, monitor))?;
    if parameters.pose.apex_mm.is_none() && pose.length_mm() < SHORTEST * pose.radius_mm {
        warnings.push(Warning::new("apex_not_seen", APEX_NOT_SEEN));
        pose.apex_mm = pose.base_mm - pose.to_base() * (USUAL * pose.radius_mm);
    }
    let frame = Frame::about(&pose);
    let basis = Basis::new(frame.s_of_height(frame.base_mm + ABOVE_BASE_MM));
    let space = Space { frame, basis };
    let rays = observed(monitor, Stage::Rays, None, || {
        let net = Net::new(&space.basis);
        Ok(study.gates.par_iter().map(|gate| rays::cast(&gate.volume, &space, &net)).collect::<Vec<Rays>>())
    })?;
    let (shapes, model) = observed(monitor, Stage::ModelFit, None, || refine::refine(study, &space, &rays, &parameters.refine, monitor))?;
    let steps = model.steps;
    let gates = observed(monitor, Stage::Wall, None, || {
        let layout = Layout::of(&shapes, &space, parameters.mesh.level);
        Ok(shapes
            .par_iter()
            .map(|shape| {
                let mut meshes = surfaces::meshes(shape, &space, &layout);
                let wall_order = wall::order(&mut meshes.endocardial, &mut meshes.epicardial);
                let fit = |mesh| Fit { mesh, steps, evolution: None };
                GateReconstruction {
                    fits: PerSurface { endocardial: fit(meshes.endocardial), epicardial: fit(meshes.epicardial) },
                    wall_order,
                }
            })
            .collect::<Vec<_>>())
    })?;
    warnings.extend(gates.iter().enumerate().filter_map(|(gate, result)| wall::warning(gate + 1, &result.wall_order)));
    Ok(Reconstruction {
        gates,
        region: pose.region(&study.grid),
        to_base: pose.to_base(),
        pose: Some(pose),
        model: Some(model),
        parameters: parameters.clone(),
        warnings,
    })
}

/// Length over largest radius of the mid-wall surface below which the tip is taken to be missing: even the dilated phantom has 2.45, and a
/// defect that takes the tip away leaves 2.0 to 2.25.
const SHORTEST: f64 = 2.35;
/// The same ratio of usual ventricles: the phantoms' 2.45 to 2.8, and 3 of healthy adults by magnetic resonance.
const USUAL: f64 = 2.7;
const APEX_NOT_SEEN: &str =
    "The ventricle that is seen is too short for its width, as with a defect of the whole apex; a usual length was assumed to begin with.";
/// How far above the pose's valve plane surfaces may reach: the plane moves by up to 15 mm over the cycle, and the pose's is its mean.
const ABOVE_BASE_MM: f64 = 14.0;
