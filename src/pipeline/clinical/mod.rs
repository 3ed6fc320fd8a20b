//! The clinical preset: the ventricle is found in any orientation, its borders are measured along its own axes at sub-voxel precision,
//! and a model of how the camera blurs a wall of this shape is fitted to the counts of all gates at once.

mod basis;
mod exposure;
mod fit;
mod frame;
mod linear;
mod priors;
mod quadrature;
mod rays;
mod shape;
mod surfaces;

use super::{
    Fit, GateReconstruction, PerSurface, PipelineError, Reconstruction,
    monitor::{Monitor, Stage},
    observed,
    parameters::Parameters,
    pose, wall,
};
use crate::study::Study;
use basis::{Angle, Basis};
use exposure::{Activity, Crop};
use fit::{Counts, Plan, State, VoxelPlace};
use frame::Frame;
use glam::DVec3;
use priors::Priors;
use rays::Rays;
use rayon::prelude::*;
use shape::{Shape, Space};
use serde::{Deserialize, Serialize};

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
    let (pose, mut warnings) = observed(monitor, Stage::Localisation, None, || pose::find(study, &parameters.pose, &parameters.region, monitor))?;
    let frame = Frame::about(&pose);
    let basis = Basis::new(frame.s_of_height(frame.base_mm + ABOVE_BASE_MM));
    let space = Space { frame, basis };
    let rays = observed(monitor, Stage::Rays, None, || Ok(study.gates.par_iter().map(|gate| rays::cast(&gate.volume, &space)).collect::<Vec<Rays>>()))?;
    let (shapes, model) = observed(monitor, Stage::ModelFit, None, || refine(study, &space, &rays, parameters, monitor))?;
    let steps = model.steps;
    let gates = observed(monitor, Stage::Wall, None, || {
        Ok(shapes
            .par_iter()
            .map(|shape| {
                let mut meshes = surfaces::meshes(shape, &space, parameters.mesh.level);
                let wall_order = wall::order(&mut meshes.endocardial, &mut meshes.epicardial);
                let fit = |mesh| Fit { mesh, steps, evolution: None };
                GateReconstruction { fits: PerSurface { endocardial: fit(meshes.endocardial), epicardial: fit(meshes.epicardial) }, wall_order }
            })
            .collect::<Vec<_>>())
    })?;
    warnings.extend(gates.iter().enumerate().filter_map(|(gate, result)| wall::warning(gate + 1, &result.wall_order)));
    Ok(Reconstruction {
        gates,
        region: None,
        to_base: pose.to_base(),
        pose: Some(pose),
        model: Some(model),
        parameters: parameters.clone(),
        warnings,
    })
}

/// How far above the pose's valve plane surfaces may reach: the plane moves by up to 15 mm over the cycle, and the pose's is its mean.
const ABOVE_BASE_MM: f64 = 14.0;
/// How far around the pose counts are looked at: half a wall, the blur, what the margin of the fit asks for.
const AROUND_MM: f64 = 30.0;

/// Voxels are binned up to this many standard deviations of the point-spread function: half a period of the highest frequency that 3 % of
/// are left of.
const BIN: f64 = 1.75;
/// And no wider than this in mm: about two thirds of a wall.
const WIDEST_BIN_MM: f64 = 6.5;

fn refine(study: &Study, space: &Space, rays: &[Rays], parameters: &Parameters, monitor: &dyn Monitor) -> Result<(Vec<Shape>, ModelFit), PipelineError> {
    let thick = rays::percentile(rays.iter().flat_map(|rays| (1..7).map(|k| rays.gradient.thickness_mm(&space.basis.at(0.25 * f64::from(k), &Angle::new(0.0))))), 0.5);
    let fwhm = parameters.refine.psf_fwhm_mm.unwrap_or(FWHM_PER_SIGMA * 0.5 * (thick * thick - 60.0).max(36.0).sqrt());
    if std::env::var("TRACE").is_ok() { eprintln!("start fwhm {fwhm} gradient distance {thick}"); }
    let counts = gather(study, space, rays, fwhm / FWHM_PER_SIGMA);
    let median = |of: &dyn Fn(&Rays) -> f64| rays::percentile(rays.iter().map(of), 0.5);
    let wall = median(&|rays| rays.wall);
    let low = median(&|rays| rays.low);
    let bases: Vec<f64> = rays.iter().map(|rays| rays.base_mm.unwrap_or(space.frame.base_mm)).collect();
    let defect = low > 0.06;
    let shapes: Vec<Shape> = rays.iter().zip(&bases).map(|(rays, &base_mm)| start(if defect { &rays.continued } else { &rays.mid }, base_mm)).collect();
    let map = if defect { rays::uptake_map(space, rays, rays::percentile(bases.iter().copied(), 0.5)) } else { vec![0.0; exposure::UPTAKE] };
    let held: Option<Vec<Vec<f64>>> = defect.then(|| rays.iter().map(|rays| rays.continued.clone()).collect());
    let state = State {
        shapes,
        activity: Activity { wall: 1.15, blood: median(&|rays| rays.blood) / wall, background: median(&|rays| rays.background) / wall, map: map.clone() },
        sigma_mm: fwhm / FWHM_PER_SIGMA,
    };
    let plan = Plan { steps: std::env::var("STEPS").ok().and_then(|s| s.parse().ok()).unwrap_or(12), fits_map: std::env::var("NOMAP").is_err() || defect, fits_width: parameters.refine.psf_fwhm_mm.is_none(), fits_tilt: parameters.refine.base_tilt, sigma_limits_mm: [6.0 / FWHM_PER_SIGMA, 24.0 / FWHM_PER_SIGMA], correlated: 1.0 };
    let mut priors = Priors::new(held.as_deref(), map, [(fwhm / FWHM_PER_SIGMA).ln(), 0.5]);
    if parameters.refine.wall_conservation { priors.wall_volume = Some(std::env::var("WALL").ok().and_then(|s| s.parse().ok()).unwrap_or(0.02)); }
    let solved = fit::fit(&counts, state, &priors, &plan, monitor)?;
    let m = ModelFit {
        refined: true,
        psf: PsfEstimate { fwhm_mm: solved.state.sigma_mm * FWHM_PER_SIGMA, source: PsfSource::Estimated, standard_error_mm: 0.0, at_bound: false, edv_percent_per_mm: 0.0 },
        residual: Residual { relative: (solved.system.misfit.iter().map(|m| m.squares).sum::<f64>() / solved.system.misfit.iter().map(|m| m.voxels).sum::<f64>()).sqrt() / solved.state.activity.wall, over_noise: 0.0 },
        uncertainty: None, low_uptake_fraction: low, extrapolated_fraction: 0.0, referee: Referee::default(), steps: solved.steps, converged: solved.converged, gates: vec![],
    };
    if parameters.refine.enabled { Ok((solved.state.shapes, m)) } else { Ok((rays.iter().map(|r| r.gradient.clone()).collect(), m)) }
}

/// Standard deviations in a full width at half maximum: 2√(2 ln 2).
const FWHM_PER_SIGMA: f64 = 2.354_820_045_030_949_3;

fn start(mid: &[f64], base_mm: f64) -> Shape {
    let mut values = Vec::with_capacity(shape::LOCAL);
    for mid in mid.chunks_exact(basis::HARMONICS) {
        values.extend_from_slice(mid);
        values.extend([priors::THICKNESS_MM[0], 0.0, 0.0]);
    }
    values.extend([base_mm, 0.0, 0.0]);
    Shape { values }
}

/// The counts around the ventricle, each gate scaled to the mean total, as parts of the wall's counts.
fn gather(study: &Study, space: &Space, rays: &[Rays], sigma_mm: f64) -> Counts {
    let grid = study.grid;
    let frame = &space.frame;
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (point, reach) in [(DVec3::ZERO, frame.unit_mm.max(frame.apex_mm) + AROUND_MM), (DVec3::Z * frame.base_mm, frame.unit_mm + AROUND_MM)] {
        let point = frame.grid(point);
        low = low.min(point - reach);
        high = high.max(point + reach);
    }
    let (from, to) = (grid.fractional_index(low), grid.fractional_index(high));
    let first: [usize; 3] = std::array::from_fn(|axis| (from[axis].floor().max(0.0) as usize).min(grid.shape[axis] - 1));
    let end: [usize; 3] = std::array::from_fn(|axis| (to[axis].ceil().max(0.0) as usize + 1).min(grid.shape[axis]).max(first[axis] + 1));
    let bin: [usize; 3] = std::array::from_fn(|axis| (((BIN * sigma_mm).min(WIDEST_BIN_MM) / grid.spacing_mm[axis]) as usize).clamp(1, end[axis] - first[axis]));
    let crop = Crop {
        origin_mm: std::array::from_fn(|axis| (first[axis] as f64 + (bin[axis] - 1) as f64 / 2.0) * grid.spacing_mm[axis]),
        spacing_mm: std::array::from_fn(|axis| bin[axis] as f64 * grid.spacing_mm[axis]),
        shape: std::array::from_fn(|axis| (end[axis] - first[axis]) / bin[axis]),
    };
    let totals: Vec<f64> = study.gates.iter().map(|gate| gate.volume.total()).collect();
    let mean = totals.iter().sum::<f64>() / totals.len() as f64;
    let wall = rays::percentile(rays.iter().map(|rays| rays.wall), 0.5);
    let members = |voxel: usize| {
        let [_, ny, nx] = crop.shape;
        let at = [voxel / (ny * nx), voxel / nx % ny, voxel % nx];
        let start: [usize; 3] = std::array::from_fn(|axis| first[axis] + at[axis] * bin[axis]);
        (0..bin[0]).flat_map(move |z| {
            (0..bin[1]).flat_map(move |y| (0..bin[2]).map(move |x| [start[0] + z, start[1] + y, start[2] + x]))
        })
    };
    let size = bin.iter().product::<usize>() as f64;
    let gates: Vec<Vec<f32>> = study
        .gates
        .iter()
        .zip(&totals)
        .map(|(gate, total)| {
            let scale = mean / total.max(f64::MIN_POSITIVE) / wall / size;
            (0..crop.voxels())
                .map(|voxel| (members(voxel).map(|member| f64::from(gate.volume.counts[member])).sum::<f64>() * scale) as f32)
                .collect()
        })
        .collect();
    let known =
        (0..crop.voxels()).map(|voxel| members(voxel).all(|member| study.gates.iter().any(|gate| gate.volume.counts[member] > 0.0))).collect();
    let places = crop
        .centres_mm()
        .map(|centre| {
            let local = frame.local(centre);
            let (s, phi, r) = frame.bullet(local);
            VoxelPlace { spot: space.basis.at(s, &Angle::new(phi)), r, z: local.z }
        })
        .collect();
    Counts { crop, space: *space, gates, known, places }
}
