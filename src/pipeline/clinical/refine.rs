//! From what rays show to the fitted model and what is said of it.

use super::{
    GateFit, ModelFit, PsfEstimate, PsfSource, Referee, Residual,
    basis::{Angle, HARMONICS},
    counts::{Counts, gather},
    exposure::{Activity, UPTAKE},
    fit::{self, Plan, Solved, State},
    priors::{self, Priors},
    rays::{self, Rays},
    shape::{BASE, LOCAL, SLOPE_AT_MM, Shape, Space, Volumes},
    system::Misfit,
    thickening::{self, low_pass},
    uncertainty::{self, Errors},
};
use crate::{
    pipeline::{PipelineError, monitor::Monitor, parameters::RefineParameters},
    study::Study,
};

/// Standard deviations in a full width at half maximum: 2√(2 ln 2).
pub(super) const FWHM_PER_SIGMA: f64 = 2.354_820_045_030_949_3;
/// Limits of the search for the width, full width at half maximum in mm, and the upper one in voxels (`numerics.md`, §4.5).
const FWHM_LIMITS_MM: [f64; 2] = [6.0, 24.0];
const FWHM_LIMIT_VOXELS: f64 = 7.0;
/// Standard deviation of the logarithm of the width from the rays' guess: wide, since the guess takes all walls to be alike.
const WIDTH_PRIOR: f64 = 0.5;
/// What a wall adds to the square of the distance of its steepest slopes, 2σ for a thin one, in mm² (phantoms of 8 to 14 mm, walls of 8 to
/// 14 mm), and the least square of 2σ.
const WALL_MM2: f64 = 60.0;
const LEAST_MM2: f64 = 36.0;
/// Part of the wall with low uptake above which shapes are held (`numerics.md`, §4.6).
const DEFECT: f64 = 0.06;
/// Relative standard deviation of the wall's volume over the cycle (`numerics.md`, §4.7).
const WALL_VOLUME: f64 = 0.03;
/// Standard deviation in mm of the wall's unevenness from that of the gates before and after.
const TEMPORAL_MM: f64 = 1.5;
/// Wall activity over the brightness of the rays to start from: what the blur of a normal camera takes.
const START_ACTIVITY: f64 = 1.15;
/// Most Gauss-Newton steps; phantoms take 5 to 12.
const STEPS: usize = 20;

/// Fits the model, or only measures by rays where it is not enabled.
pub(super) fn refine(
    study: &Study,
    space: &Space,
    rays: &[Rays],
    chosen: &RefineParameters,
    monitor: &dyn Monitor,
) -> Result<(Vec<Shape>, ModelFit), PipelineError> {
    let unseen = rays::unseen(study, space, rays);
    let guess_mm = guess_fwhm_mm(space, rays);
    let given = chosen.psf_fwhm_mm;
    if !chosen.enabled {
        let psf = PsfEstimate {
            fwhm_mm: given.unwrap_or(guess_mm),
            source: if given.is_some() { PsfSource::Given } else { PsfSource::Estimated },
            standard_error_mm: 0.0,
            at_bound: false,
            edv_percent_per_mm: 0.0,
        };
        let model = ModelFit {
            refined: false,
            psf,
            residual: Residual { relative: 0.0, over_noise: 0.0 },
            uncertainty: None,
            low_uptake_fraction: unseen.low,
            extrapolated_fraction: unseen.low + unseen.outside,
            referee: Referee::default(),
            steps: 0,
            converged: true,
            gates: Vec::new(),
        };
        return Ok((rays.iter().map(|rays| rays.gradient.clone()).collect(), model));
    }
    let counts = gather(study, space, rays, given.unwrap_or(guess_mm) / FWHM_PER_SIGMA);
    let widest_mm = study.grid.spacing_mm.iter().copied().fold(0.0, f64::max) * FWHM_LIMIT_VOXELS;
    let limits = [FWHM_LIMITS_MM[0], FWHM_LIMITS_MM[1].min(widest_mm.max(2.0 * FWHM_LIMITS_MM[0]))].map(|fwhm| fwhm / FWHM_PER_SIGMA);
    let plan = Plan {
        steps: STEPS,
        fits_map: chosen.uptake_map,
        fits_width: given.is_none(),
        fits_tilt: chosen.base_tilt,
        sigma_limits_mm: limits,
        correlated: 1.0,
    };
    let (state, priors) = start(space, rays, chosen, given.unwrap_or(guess_mm) / FWHM_PER_SIGMA, unseen.low > DEFECT);
    let state = State { sigma_mm: if plan.fits_width { state.sigma_mm.clamp(limits[0], limits[1]) } else { state.sigma_mm }, ..state };
    let solved = fit::fit(&counts, state, &priors, &plan, monitor)?;
    let model = describe(&counts, &solved, &plan, (space, rays), unseen);
    Ok((solved.state.shapes, model))
}

/// The width by the distance of the steepest slopes on both sides of the wall, in mm FWHM.
fn guess_fwhm_mm(space: &Space, rays: &[Rays]) -> f64 {
    let distances =
        rays.iter().flat_map(|rays| (1..7).map(|k| rays.gradient.thickness_mm(&space.basis.at(0.25 * f64::from(k), &Angle::new(0.0)))));
    let distance = rays::percentile(distances, 0.5);
    FWHM_PER_SIGMA * 0.5 * (distance * distance - WALL_MM2).max(LEAST_MM2).sqrt()
}

/// Where the fit begins, and what holds it.
fn start(space: &Space, rays: &[Rays], chosen: &RefineParameters, sigma_mm: f64, defect: bool) -> (State, Priors) {
    let median = |of: &dyn Fn(&Rays) -> f64| rays::percentile(rays.iter().map(of), 0.5);
    let wall = median(&|rays| rays.wall).max(f64::MIN_POSITIVE);
    let usual_mm = rays::percentile(rays.iter().map(|rays| rays.base_mm.unwrap_or(space.frame.base_mm)), 0.5);
    // Where the grid cuts a gate's base off, the others know better than nothing.
    let bases = low_pass(&rays.iter().map(|rays| rays.base_mm.unwrap_or(usual_mm)).collect::<Vec<_>>());
    let held = defect && chosen.shape_prior;
    let shape = |(rays, base_mm): (&Rays, &f64)| {
        let mid = if held { &rays.continued } else { &rays.mid };
        let mut values = Vec::with_capacity(LOCAL);
        for mid in mid.chunks_exact(HARMONICS) {
            values.extend_from_slice(mid);
            values.extend([priors::THICKNESS_MM[0], 0.0, 0.0]);
        }
        values.extend([*base_mm, 0.0, 0.0]);
        Shape { values }
    };
    let map = if chosen.uptake_map { rays::uptake_map(space, rays, usual_mm) } else { vec![0.0; UPTAKE] };
    let shapes: Vec<Shape> = rays.iter().zip(&bases).map(shape).collect();
    let log_wall_ml = shapes.iter().map(|shape| Volumes::of(shape, space).wall_ml().ln()).sum::<f64>() / shapes.len() as f64;
    let state = State {
        log_wall_ml,
        shapes,
        activity: Activity {
            wall: START_ACTIVITY,
            blood: median(&|rays| rays.blood) / wall,
            background: median(&|rays| rays.background) / wall,
            map: map.clone(),
        },
        sigma_mm,
    };
    let continued: Option<Vec<Vec<f64>>> = held.then(|| rays.iter().map(|rays| rays.continued.clone()).collect());
    let mut priors = Priors::new(continued.as_deref(), &bases, map, [sigma_mm.ln(), WIDTH_PRIOR]);
    priors.wall_volume = chosen.wall_conservation.then_some(WALL_VOLUME);
    priors.temporal_mm = chosen.temporal_prior.then_some(TEMPORAL_MM);
    (state, priors)
}

/// What is said of a fit.
fn describe(counts: &Counts, solved: &Solved, plan: &Plan, (space, rays): (&Space, &[Rays]), unseen: rays::Unseen) -> ModelFit {
    let State { shapes, activity, sigma_mm, .. } = &solved.state;
    let fwhm_mm = FWHM_PER_SIGMA * sigma_mm;
    let hidden = unseen.low + unseen.outside;
    let errors = uncertainty::errors(solved, space, plan.fits_width, hidden);
    let of_width = |of: &dyn Fn(&Errors) -> f64| errors.as_ref().map_or(0.0, of);
    let relative = |misfit: &Misfit| (misfit.squares / misfit.voxels.max(1.0)).sqrt() / activity.wall;
    let mut total = Misfit::default();
    let mut noise = 0.0;
    for (misfit, variance) in solved.system.misfit.iter().zip(&counts.noise) {
        total.squares += misfit.squares;
        total.voxels += misfit.voxels;
        noise += misfit.image * variance;
    }
    let gates = shapes
        .iter()
        .zip(solved.system.misfit.iter().zip(&counts.unit))
        .map(|(shape, (misfit, unit))| GateFit {
            relative_residual: relative(misfit),
            activity: activity.wall * unit,
            base_tilt_degrees: (shape.values[BASE + 1].hypot(shape.values[BASE + 2]) / SLOPE_AT_MM).atan().to_degrees(),
            length_mm: shape.mid_mm(&space.basis.at(0.0, &Angle::new(0.0))) + shape.base_mm(),
        })
        .collect();
    ModelFit {
        refined: true,
        psf: PsfEstimate {
            fwhm_mm,
            source: if plan.fits_width { PsfSource::Estimated } else { PsfSource::Given },
            standard_error_mm: fwhm_mm * of_width(&|errors| errors.log_width),
            at_bound: plan.fits_width && plan.sigma_limits_mm.iter().any(|limit| (limit / sigma_mm).ln().abs() < 1e-6),
            edv_percent_per_mm: 100.0 * of_width(&|errors| errors.edv_by_log_width) / fwhm_mm,
        },
        residual: Residual { relative: relative(&total), over_noise: (total.squares / noise.max(f64::MIN_POSITIVE)).sqrt() },
        uncertainty: errors.map(|errors| errors.uncertainty),
        low_uptake_fraction: unseen.low,
        extrapolated_fraction: hidden,
        referee: referee(counts, solved, space, rays),
        steps: solved.steps,
        converged: solved.converged,
        gates,
    }
}

/// Ejection fractions of the gradient's surfaces and of the counts' rise.
fn referee(counts: &Counts, solved: &Solved, space: &Space, rays: &[Rays]) -> Referee {
    let fraction = |cavity: &[f64]| {
        let (high, low) = cavity.iter().fold((0.0_f64, f64::INFINITY), |(high, low), &ml| (high.max(ml), low.min(ml)));
        (cavity.len() > 1 && high > 0.0 && low >= 0.0).then(|| 100.0 * (high - low) / high)
    };
    let inside = |shape: &Shape| Volumes::cavity_ml(shape, space);
    let by_gradient: Vec<f64> = rays.iter().map(|rays| inside(&rays.gradient)).collect();
    let fitted: Vec<f64> = solved.state.shapes.iter().map(inside).collect();
    let diastole = fitted.iter().enumerate().fold(0, |best, (gate, &ml)| if ml > fitted[best] { gate } else { best });
    let by_counts = thickening::cavity_ml(space, rays, &solved.state.shapes, &counts.unit, diastole, solved.state.sigma_mm);
    Referee { gradient_ef_percent: fraction(&by_gradient), counts_ef_percent: by_counts.and_then(|cavity| fraction(&cavity)) }
}
