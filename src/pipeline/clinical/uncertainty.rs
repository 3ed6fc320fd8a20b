//! What is not known of a result: from the curvature of the fit, the width of the point-spread function among its parameters, and what
//! phantoms show that the model itself gets wrong.

use super::{
    Uncertainty,
    fit::Solved,
    linear::Arrow,
    refine::FWHM_PER_SIGMA,
    shape::{Shape, Space, Volumes},
    system::WIDTH,
};
use crate::pipeline::measure::MYOCARDIAL_DENSITY_G_PER_ML;

/// Standard deviations of what the model leaves wrong however good the counts are, relative (ejection fraction: points): what is left on the
/// phantoms of `docs/accuracy.md` when the fit's own error is taken away.
const MODEL_EDV: f64 = 0.006;
const MODEL_ESV: f64 = 0.011;
const MODEL_EF: f64 = 0.3;
const MODEL_MASS: f64 = 0.010;
/// How much more a wall that is not seen adds, a part of it: likewise, from the phantoms with defects.
const UNSEEN_EDV: f64 = 0.12;
const UNSEEN_ESV: f64 = 0.25;
const UNSEEN_EF: f64 = 9.0;
const UNSEEN_MASS: f64 = 0.30;
/// What a point-spread function that is not one Gaussian makes of the estimated width, in mm: tails and widths that change over the field
/// move it by 0.4 ± 0.4 on phantoms.
const MODEL_FWHM_MM: f64 = 0.20;

/// Standard errors, and what hangs on the width.
pub(super) struct Errors {
    pub(super) uncertainty: Uncertainty,
    /// Of the logarithm of the width; 0 where it was given.
    pub(super) log_width: f64,
    /// Relative change of the end-diastolic volume with the logarithm of the width, everything else following.
    pub(super) edv_by_log_width: f64,
}

/// A quantity's derivative by all parameters: of the gates and of what they share.
type Gradient = (Vec<Vec<f64>>, Vec<f64>);

/// Standard errors of the volumes; `None` where the counts do not determine the parameters.
pub(super) fn errors(solved: &Solved, space: &Space, fits_width: bool, unseen: f64) -> Option<Errors> {
    let arrow = solved.system.arrow()?;
    let shapes: &[Shape] = &solved.state.shapes;
    let volumes: Vec<Volumes> = shapes.iter().map(|shape| Volumes::of(shape, space)).collect();
    let cavity = |gate: &usize| volumes[*gate].ml.endocardial;
    let (mut largest, mut smallest) = (0, 0);
    for gate in 1..volumes.len() {
        if cavity(&gate) > cavity(&largest) {
            largest = gate;
        }
        if cavity(&gate) < cavity(&smallest) {
            smallest = gate;
        }
    }
    let shared = solved.system.shared;
    let nothing = || -> Gradient { (shapes.iter().map(|shape| vec![0.0; shape.values.len()]).collect(), vec![0.0; shared]) };
    let of = |terms: &[(usize, f64)]| -> Gradient {
        let mut gradient = nothing();
        for &(gate, by) in terms {
            for (to, value) in gradient.0[gate].iter_mut().zip(&volumes[gate].gradient.endocardial) {
                *to += by * value;
            }
        }
        gradient
    };
    let (edv, esv) = (cavity(&largest), cavity(&smallest));
    let scatter = scatter(solved);
    // How all parameters follow the width, a unit of its logarithm; what a point-spread function of another form makes of it comes on top.
    let fwhm_mm = FWHM_PER_SIGMA * solved.state.sigma_mm;
    let mut along = nothing();
    let mut own_width = 0.0;
    if fits_width {
        along.1[WIDTH] = 1.0;
        arrow.solve(&mut along.0, &mut along.1);
        own_width = along.1[WIDTH].max(f64::MIN_POSITIVE);
    }
    let by_log_width = |gradient: &Gradient| if fits_width { dot(gradient, &along) / own_width } else { 0.0 };
    let fitted =
        |gradient: &Gradient| (variance(&arrow, gradient) * scatter).max(0.0) + (by_log_width(gradient) * MODEL_FWHM_MM / fwhm_mm).powi(2);
    let with = |fitted: f64, model: f64, unseen_part: f64| (fitted + model * model + (unseen * unseen_part).powi(2)).sqrt();
    let edv_gradient = of(&[(largest, 1.0)]);
    let gated = volumes.len() > 1;
    let mut wall = nothing();
    for (to, volumes) in wall.0.iter_mut().zip(&volumes) {
        for (to, value) in to.iter_mut().zip(volumes.wall_gradient()) {
            *to += MYOCARDIAL_DENSITY_G_PER_ML * value / shapes.len() as f64;
        }
    }
    let mass = MYOCARDIAL_DENSITY_G_PER_ML * volumes.iter().map(Volumes::wall_ml).sum::<f64>() / volumes.len() as f64;
    let uncertainty = Uncertainty {
        edv_ml: with(fitted(&edv_gradient), MODEL_EDV * edv, UNSEEN_EDV * edv),
        esv_ml: gated.then(|| with(fitted(&of(&[(smallest, 1.0)])), MODEL_ESV * esv, UNSEEN_ESV * esv)),
        ef_percent: gated.then(|| {
            let ef = of(&[(smallest, -100.0 / edv), (largest, 100.0 * esv / (edv * edv))]);
            with(fitted(&ef), MODEL_EF, UNSEEN_EF)
        }),
        mass_g: with(fitted(&wall), MODEL_MASS * mass, UNSEEN_MASS * mass),
    };
    let log_width = if fits_width { (own_width * scatter + (MODEL_FWHM_MM / fwhm_mm).powi(2)).sqrt() } else { 0.0 };
    Some(Errors { uncertainty, log_width, edv_by_log_width: by_log_width(&edv_gradient) / edv.max(f64::MIN_POSITIVE) })
}

/// Variance of the residuals over that which the weights assume.
fn scatter(solved: &Solved) -> f64 {
    let (mut weighted, mut voxels) = (0.0, f64::MIN_POSITIVE);
    for misfit in &solved.system.misfit {
        weighted += misfit.weighted;
        voxels += misfit.voxels;
    }
    weighted * solved.correlated / voxels
}

fn variance(arrow: &Arrow, gradient: &Gradient) -> f64 {
    let mut solution = gradient.clone();
    arrow.solve(&mut solution.0, &mut solution.1);
    dot(gradient, &solution)
}

fn dot(a: &Gradient, b: &Gradient) -> f64 {
    let of_gates: f64 = a.0.iter().zip(&b.0).map(|(a, b)| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>()).sum();
    of_gates + a.1.iter().zip(&b.1).map(|(x, y)| x * y).sum::<f64>()
}
