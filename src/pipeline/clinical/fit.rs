//! The model's fit to all gates at once: Gauss-Newton steps with robust weights on the shapes of the gates and on what they share, the
//! activities, the uptake map and the width of the point-spread function.

use super::{
    basis::Spot,
    counts::Counts,
    exposure::{Activity, Rules, Scene},
    film::{Compared, with_film},
    priors::Priors,
    shape::{BASE, Shape, Volumes},
    step::{Moved, Step, accelerated},
    system::{LEAST_BLOOD, MOST_BLOOD, SHARED, System, VOLUME, WIDTH, assemble},
};
use crate::pipeline::{
    PipelineError,
    monitor::{self, Monitor},
};
use rayon::prelude::*;

/// Residuals beyond this part of the wall's activity lose weight (Cauchy): three of the standard deviations that weights assume.
pub(super) const ROBUST: f64 = 0.12;
/// Counts farther outside the epicardium, or higher above the valve plane, are not compared.
const MARGIN_MM: f64 = 9.0;
const MARGIN_ABOVE_MM: f64 = 12.0;
/// Voxels and rules of integration are chosen again when a coefficient has changed by more than this in mm, or the width by this part.
const LEFT_MM: f64 = 3.0;
const LEFT_WIDTH: f64 = 0.08;
/// Longest step of a coefficient or of the valve plane in mm, and of its slope.
const LONGEST_MM: f64 = 4.0;
const LONGEST_SLOPE: f64 = 2.0;
/// Steps before the residuals' correlation is measured.
const ROUGH_STEPS: usize = 3;
/// Parts of the diagonal that are added to it, least, first and most: what the counts hardly determine moves slowly at first, and where a
/// step made things worse. With 1e-4 the valley in which wall activity and thickness give the same counts is not walked to its end.
const DAMPING: [f64; 3] = [1e-7, 0.01, 10.0];
/// How it changes after a step that made the fit better, and after one that did not.
const LESS: f64 = 0.01;
const MORE: f64 = 10.0;
/// Damping up to which a step's direction is its own, so that the last one tells how far to follow it.
const ALMOST_FREE: f64 = 1e-5;
/// Steps end when none changes a cavity by more than this part of it: a fifth of the smallest standard errors.
const REST: f64 = 3e-3;

/// A voxel's centre in bullet coordinates, and its height over the centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct VoxelPlace {
    pub(super) spot: Spot,
    pub(super) r: f64,
    pub(super) z: f64,
}

/// All parameters.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub(super) shapes: Vec<Shape>,
    pub(super) activity: Activity,
    pub(super) sigma_mm: f64,
    /// Logarithm of the wall's volume in ml that all gates are held to.
    pub(super) log_wall_ml: f64,
}

/// How the fit is done.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub(super) steps: usize,
    pub(super) fits_map: bool,
    pub(super) fits_width: bool,
    pub(super) fits_tilt: bool,
    /// Limits of the width in mm (standard deviation).
    pub(super) sigma_limits_mm: [f64; 2],
    /// How many voxels count as one: 1 where residuals are as independent as Poisson counts.
    pub(super) correlated: f64,
}

/// The system at the last step, for the uncertainty.
pub(super) struct Solved {
    pub(super) state: State,
    pub(super) steps: usize,
    pub(super) converged: bool,
    pub(super) system: System,
    /// Voxels that count as one.
    pub(super) correlated: f64,
}

/// Fits.
pub(super) fn fit(counts: &Counts, start: State, priors: &Priors, plan: &Plan, monitor: &dyn Monitor) -> Result<Solved, PipelineError> {
    let mut state = start;
    let mut plan = plan.clone();
    let mut steps = 0;
    let mut converged = false;
    let mut damping = DAMPING[1];
    let mut best: Option<(State, System)> = None;
    let mut last: Option<Moved> = None;
    let mut vicinity = Vicinity::of(&state, counts);
    while steps < plan.steps && !converged {
        monitor::check(monitor)?;
        if vicinity.left_by(&state) {
            // Other voxels are compared from here on: there is nothing to compare the misfit with.
            vicinity = Vicinity::of(&state, counts);
            best = None;
        }
        let system = assemble(counts, &state, priors, &plan, &vicinity, monitor)?;
        steps += 1;
        match &best {
            // Beyond what the last step was good for: back, and with a shorter step on.
            Some((before, of_before)) if system.energy() > of_before.energy() => {
                state = before.clone();
                damping = (damping * MORE).min(DAMPING[2]);
                last = None;
            }
            _ => {
                damping = if steps <= ROUGH_STEPS { DAMPING[1] } else { (damping * LESS).max(DAMPING[0]) };
                best = Some((state.clone(), system));
            }
        }
        let Some((_, system)) = &best else { break };
        let Some(own) = system.step(damping, &state, &plan) else { break };
        let step = last.filter(|_| damping <= ALMOST_FREE).map_or_else(|| own.clone(), |last| accelerated(&last, &own, system));
        advance(&mut state, &step, &plan);
        last = Some(Moved { own, step });
        let change = system.cavities_ml.iter().zip(cavities_ml(&state, counts)).map(|(a, b)| ((b - a) / a).abs()).fold(0.0, f64::max);
        converged = change < REST && damping <= DAMPING[0];
        if steps == ROUGH_STEPS {
            plan.correlated = correlated(counts, &state, &vicinity);
            best = None;
        }
        monitor.advance(steps, plan.steps + 1);
    }
    let mut system = assemble(counts, &state, priors, &plan, &vicinity, monitor)?;
    if let Some((before, of_before)) = best
        && system.energy() > of_before.energy()
    {
        (state, system) = (before, of_before);
    }
    Ok(Solved { state, steps, converged, system, correlated: plan.correlated })
}

/// What is done in the same way for all states near one: which voxels are compared, and how their images are integrated.
pub(super) struct Vicinity {
    shapes: Vec<Shape>,
    sigma_mm: f64,
    pub(super) rules: Vec<Rules>,
    pub(super) compared: Vec<Compared>,
}

impl Vicinity {
    fn of(state: &State, counts: &Counts) -> Self {
        let rules = state.shapes.iter().map(|shape| Rules::of(shape, &counts.space, &counts.crop, state.sigma_mm)).collect();
        let of_gate =
            |shape: &Shape| Compared::of(counts.crop.voxels(), |voxel| counts.known[voxel] && is_compared(&counts.places[voxel], shape));
        let compared = state.shapes.par_iter().map(of_gate).collect();
        Self { shapes: state.shapes.clone(), sigma_mm: state.sigma_mm, rules, compared }
    }

    fn left_by(&self, state: &State) -> bool {
        let farthest = |a: &Shape, b: &Shape| a.values.iter().zip(&b.values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        (state.sigma_mm / self.sigma_mm).ln().abs() > LEFT_WIDTH
            || state.shapes.iter().zip(&self.shapes).any(|(a, b)| farthest(a, b) > LEFT_MM)
    }
}

fn cavities_ml(state: &State, counts: &Counts) -> Vec<f64> {
    state.shapes.par_iter().map(|shape| Volumes::cavity_ml(shape, &counts.space)).collect()
}

/// Moves the parameters.
fn advance(state: &mut State, step: &Step, plan: &Plan) {
    let shared = &step.shared;
    for (shape, step) in state.shapes.iter_mut().zip(&step.gates) {
        for (index, (value, step)) in shape.values.iter_mut().zip(step).enumerate() {
            let limit = if index > BASE { LONGEST_SLOPE } else { LONGEST_MM };
            *value += step.clamp(-limit, limit);
        }
    }
    let activity = &mut state.activity;
    activity.wall = (activity.wall + shared[0].clamp(-0.15 * activity.wall, 0.15 * activity.wall)).max(0.05);
    activity.blood = (activity.blood + shared[1]).clamp(LEAST_BLOOD * activity.wall, MOST_BLOOD * activity.wall);
    activity.background = (activity.background + shared[2]).clamp(0.0, 0.7 * activity.wall);
    if plan.fits_width {
        let [low, high] = plan.sigma_limits_mm;
        let width = state.sigma_mm * shared[WIDTH].clamp(-0.15, 0.15).exp();
        state.sigma_mm = width.clamp(low, high);
    }
    state.log_wall_ml += shared[VOLUME];
    if plan.fits_map {
        for (value, step) in activity.map.iter_mut().zip(&shared[SHARED..]) {
            *value += step.clamp(-0.2, 0.2);
        }
    }
}

/// Correlation of neighbouring residuals beyond which they are taken for this.
const MOST_CORRELATION: f64 = 0.8;

/// How many voxels say as much as one independent one: residuals of a smoothed reconstruction, and those of a wrong model, come in patches.
/// From the correlation ρ of neighbours along each axis, (1 + ρ) / (1 − ρ) an axis, as for a first-order autoregression.
fn correlated(counts: &Counts, state: &State, vicinity: &Vicinity) -> f64 {
    let sums: Vec<[[f64; 2]; 3]> = (0..state.shapes.len())
        .into_par_iter()
        .map(|gate| {
            let shape = &state.shapes[gate];
            let scene = Scene { space: &counts.space, shape, activity: &state.activity, sigma_mm: state.sigma_mm };
            let residual: Vec<Option<f64>> = with_film(|film| {
                scene.expose(&counts.crop, &vicinity.rules[gate], None, film);
                let compared = counts.places.iter().enumerate().map(|(voxel, place)| {
                    let usable = counts.known[voxel] && is_compared(place, shape);
                    usable.then(|| f64::from(counts.gates[gate][voxel] - film.image[voxel]).clamp(-2.0 * ROBUST, 2.0 * ROBUST))
                });
                compared.collect()
            });
            let [_, ny, nx] = counts.crop.shape;
            [ny * nx, nx, 1].map(|stride| {
                let (mut shared, mut own) = (0.0, 0.0);
                for (a, b) in residual.iter().zip(&residual[stride.min(residual.len())..]) {
                    if let (Some(a), Some(b)) = (a, b) {
                        shared += a * b;
                        own += 0.5 * (a * a + b * b);
                    }
                }
                [shared, own]
            })
        })
        .collect();
    (0..3)
        .map(|axis| {
            let total = |which: usize| sums.iter().map(|gate| gate[axis][which]).sum::<f64>();
            let rho = (total(0) / total(1).max(f64::MIN_POSITIVE)).clamp(0.0, MOST_CORRELATION);
            (1.0 + rho) / (1.0 - rho)
        })
        .product()
}

/// Whether a voxel is compared: around the wall and below the valve plane.
fn is_compared(place: &VoxelPlace, shape: &Shape) -> bool {
    place.z < shape.base_mm() + MARGIN_ABOVE_MM && place.r < shape.radii(&place.spot).epicardial + MARGIN_MM
}
