//! The normal equations of a fit: what counts and priors say of the parameters around a state.

use super::{
    basis::MAP_HARMONICS,
    counts::Counts,
    exposure::{ACTIVITY, COLUMNS, COLUMNS_WITHOUT_MAP, MAP, Scene, UPTAKE},
    film::{Derived, Film, LANES, with_film},
    fit::{Plan, ROBUST, State, Vicinity},
    gram::{self, Gram},
    linear::{Arrow, Block},
    priors::{LocalPrior, Priors},
    shape::{BASE, LOCAL, SURFACES, Volumes},
    step::Step,
};
use crate::pipeline::{
    PipelineError,
    monitor::{self, Monitor},
};
use rayon::prelude::*;

/// Columns all gates share, before the map: wall, blood, background, logarithms of the point-spread function's width and of the wall's volume.
pub(super) const SHARED: usize = 5;
/// Where blood, width and the wall's volume stand among them.
const BLOOD: usize = 1;
pub(super) const WIDTH: usize = 3;
pub(super) const VOLUME: usize = 4;

/// Standard deviation of counts less model for the weights, as part of the wall's activity, in a volume of the paper's voxel (the
/// prototype's); counts of a larger bin are surer.
const NOISE: f64 = 0.04;
const NOISE_MM3: f64 = 47.3;
/// Limits of the blood's activity as parts of the wall's. Perfusion tracers leave 10-20 % in the blood; filters of the reconstruction dig
/// deeper, which a model without them must not take for a wall of ever more activity.
pub(super) const LEAST_BLOOD: f64 = 0.03;
pub(super) const MOST_BLOOD: f64 = 0.7;

/// Relative step for the image's derivative by the width: about the steps that are made. With the exact derivative fits of ordinary hearts take a
/// step or two less, and one heart whose valley ends at too thin a wall is walked to that end.
const WIDTH_STEP: f64 = 0.02;

/// The normal equations of a state.
#[derive(Clone)]
pub(super) struct System {
    pub(super) shared: usize,
    pub(super) blocks: Vec<Block>,
    pub(super) corner: Vec<f64>,
    pub(super) gate_sides: Vec<Vec<f64>>,
    pub(super) shared_side: Vec<f64>,
    pub(super) misfit: Vec<Misfit>,
    /// What the priors add to the misfit, in halves of squared standard deviations.
    priors: f64,
    /// Cavities of the gates in ml.
    pub(super) cavities_ml: Vec<f64>,
}

/// How far a gate's counts are from the model.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Misfit {
    /// Sums over the voxels compared: of squared residuals, of weights times them, of Cauchy's misfit in halves of squared standard
    /// deviations, of the model's image, and their number.
    pub(super) squares: f64,
    pub(super) weighted: f64,
    robust: f64,
    pub(super) image: f64,
    pub(super) voxels: f64,
}

impl System {
    /// What the steps make smaller: the misfit, robustly, and what the priors add.
    pub(super) fn energy(&self) -> f64 {
        self.misfit.iter().map(|gate| gate.robust).sum::<f64>() + self.priors
    }

    /// Takes a shared parameter out of the system.
    fn hold(&mut self, index: usize) {
        self.set(index, 0.0);
    }

    /// Lets a shared parameter make a given step, whatever the others do.
    fn set(&mut self, index: usize, step: f64) {
        let shared = self.shared;
        for i in 0..shared {
            self.shared_side[i] -= self.corner[i * shared + index] * step;
            self.corner[index * shared + i] = 0.0;
            self.corner[i * shared + index] = 0.0;
        }
        self.corner[index * shared + index] = 1.0;
        self.shared_side[index] = step;
        for (block, side) in self.blocks.iter_mut().zip(&mut self.gate_sides) {
            for (side, border) in side.iter_mut().zip(block.border.chunks_exact_mut(shared)) {
                *side -= border[index] * step;
                border[index] = 0.0;
            }
        }
    }

    /// Steps of the gates' parameters and of the shared ones. What would be driven beyond a limit goes there, and the others move with it.
    pub(super) fn step(&self, damping: f64, state: &State, plan: &Plan) -> Option<Step> {
        let mut damped = self.damped(damping);
        loop {
            let arrow = damped.arrow()?;
            let (mut gates, mut shared) = (damped.gate_sides.clone(), damped.shared_side.clone());
            arrow.solve(&mut gates, &mut shared);
            let beyond = limited(state, plan).into_iter().find_map(|Limited { index, value, low, high }| {
                let allowed = (value + shared[index]).clamp(low, high) - value;
                ((allowed - shared[index]).abs() > LIMIT).then_some((index, allowed))
            });
            match beyond {
                Some((index, step)) => damped.set(index, step),
                None => return Some(Step { gates, shared }),
            }
        }
    }

    pub(super) fn diagonal(&self) -> Step {
        let of = |matrix: &[f64], n: usize| (0..n).map(|i| matrix[i * n + i]).collect();
        Step { gates: self.blocks.iter().map(|block| of(&block.own, LOCAL)).collect(), shared: of(&self.corner, self.shared) }
    }

    /// A little more on the diagonal: what nothing determines stays where it is.
    fn damped(&self, damping: f64) -> Self {
        let damp = |matrix: &mut [f64], n: usize| {
            for i in 0..n {
                matrix[i * n + i] = (1.0 + damping) * matrix[i * n + i] + 1e-6;
            }
        };
        let mut damped = self.clone();
        for block in &mut damped.blocks {
            damp(&mut block.own, LOCAL);
        }
        damp(&mut damped.corner, self.shared);
        damped
    }

    /// The factorised system without damping.
    pub(super) fn arrow(&self) -> Option<Arrow> {
        Arrow::factorise(LOCAL, self.blocks.clone(), self.corner.clone(), self.shared)
    }
}

/// A gate's share of the normal equations: `[n × n]` over local and shared columns, and the right side.
struct Normal {
    n: usize,
    matrix: Vec<f64>,
    side: Vec<f64>,
    misfit: Misfit,
}

/// Adds up what the counts of all gates and the priors say around a state.
///
/// Errors: cancelled.
pub(super) fn assemble(
    counts: &Counts,
    state: &State,
    priors: &Priors,
    plan: &Plan,
    vicinity: &Vicinity,
    monitor: &dyn Monitor,
) -> Result<System, PipelineError> {
    let shared = SHARED + if plan.fits_map { UPTAKE } else { 0 };
    let normals: Vec<Result<Normal, PipelineError>> = (0..state.shapes.len())
        .into_par_iter()
        .map(|gate| {
            monitor::check(monitor)?;
            Ok(with_film(|film| with_film(|wider| normal_of_gate(counts, state, gate, plan, vicinity, [film, wider]))))
        })
        .collect();
    let normals = normals.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut corner = vec![0.0; shared * shared];
    let mut shared_side = vec![0.0; shared];
    let (mut blocks, mut gate_sides, mut misfit) = (Vec::new(), Vec::new(), Vec::new());
    let mut energy = 0.0;
    let volumes: Vec<Volumes> = state.shapes.par_iter().map(|shape| Volumes::of(shape, &counts.space)).collect();
    for (gate, normal) in normals.into_iter().enumerate() {
        let n = normal.n;
        let mut own = vec![0.0; LOCAL * LOCAL];
        let mut border = vec![0.0; LOCAL * shared];
        for i in 0..LOCAL {
            own[i * LOCAL..][..LOCAL].copy_from_slice(&normal.matrix[i * n..][..LOCAL]);
            border[i * shared..][..shared].copy_from_slice(&normal.matrix[i * n + LOCAL..][..shared]);
        }
        let mut side = normal.side[..LOCAL].to_vec();
        for i in 0..shared {
            shared_side[i] += normal.side[LOCAL + i];
            for j in 0..shared {
                corner[i * shared + j] += normal.matrix[(LOCAL + i) * n + LOCAL + j];
            }
        }
        let prior: LocalPrior<'_> = priors.of_gate(gate, state, &volumes);
        energy += prior.add(&state.shapes[gate].values, &mut own, &mut side);
        if let Some((gradient, off, weight)) = &prior.wall {
            for (border, x) in border.chunks_exact_mut(shared).zip(gradient) {
                border[VOLUME] -= weight * x;
            }
            corner[VOLUME * shared + VOLUME] += weight;
            shared_side[VOLUME] -= weight * off;
        }
        if !plan.fits_tilt {
            for index in BASE + 1..LOCAL {
                freeze(&mut own, &mut border, &mut side, index, shared);
            }
        }
        misfit.push(normal.misfit);
        blocks.push(Block { own, border });
        gate_sides.push(side);
    }
    energy += priors.add_shared(state, plan, shared, &mut corner, &mut shared_side);
    let cavities_ml = volumes.iter().map(|volumes| volumes.ml.endocardial).collect();
    let mut system = System { shared, blocks, corner, gate_sides, shared_side, misfit, priors: energy, cavities_ml };
    if priors.wall_volume.is_none() {
        system.hold(VOLUME);
    }
    if !plan.fits_width {
        system.hold(WIDTH);
    }
    // At a limit and pulled beyond it: not free.
    for Limited { index, value, low, high } in limited(state, plan) {
        let pull = system.shared_side[index];
        if (value <= low + LIMIT && pull < 0.0) || (value >= high - LIMIT && pull > 0.0) {
            system.hold(index);
        }
    }
    Ok(system)
}

/// How near a limit is at it, as part of the wall's activity and of the width.
const LIMIT: f64 = 1e-9;

/// A shared parameter that has limits.
struct Limited {
    index: usize,
    value: f64,
    low: f64,
    high: f64,
}

fn limited(state: &State, plan: &Plan) -> [Limited; 2] {
    let [low, high] = plan.sigma_limits_mm;
    let wall = state.activity.wall;
    [
        Limited { index: BLOOD, value: state.activity.blood, low: LEAST_BLOOD * wall, high: MOST_BLOOD * wall },
        Limited { index: WIDTH, value: state.sigma_mm.ln(), low: low.ln(), high: high.ln() },
    ]
}

/// Takes a parameter of a gate out of the system.
fn freeze(own: &mut [f64], border: &mut [f64], side: &mut [f64], index: usize, shared: usize) {
    for i in 0..LOCAL {
        own[index * LOCAL + i] = 0.0;
        own[i * LOCAL + index] = 0.0;
    }
    own[index * LOCAL + index] = 1.0;
    border[index * shared..][..shared].fill(0.0);
    side[index] = 0.0;
}

fn normal_of_gate(counts: &Counts, state: &State, gate: usize, plan: &Plan, vicinity: &Vicinity, films: [&mut Film; 2]) -> Normal {
    let [film, wider] = films;
    let crop = &counts.crop;
    let compared = &vicinity.compared[gate];
    let columns = if plan.fits_map { COLUMNS } else { COLUMNS_WITHOUT_MAP };
    let scene = Scene { space: &counts.space, shape: &state.shapes[gate], activity: &state.activity, sigma_mm: state.sigma_mm };
    scene.expose(crop, &vicinity.rules[gate], Some(Derived { columns, at: compared }), film);
    if plan.fits_width {
        Scene { sigma_mm: state.sigma_mm * (1.0 + WIDTH_STEP), ..scene }.expose(crop, &vicinity.rules[gate], None, wider);
    }
    // Order of the packed columns: local, wall, blood, background, width, wall's volume, map.
    let n = LOCAL + SHARED + if plan.fits_map { UPTAKE } else { 0 };
    let mut gram = Gram::new(n + 1);
    let mut misfit = Misfit::default();
    let noise = NOISE * (plan.correlated * NOISE_MM3 / crop.spacing_mm.iter().product::<f64>()).sqrt();
    let mut row = vec![0.0_f32; (n + 1).next_multiple_of(gram::WIDTH)];
    for (&voxel, derivatives) in compared.voxels.iter().zip(film.jacobian.chunks_exact(columns)) {
        let residual = f64::from(counts.gates[gate][voxel]) - f64::from(film.image[voxel]);
        let weight = 1.0 / ((1.0 + (residual / ROBUST).powi(2)) * noise * noise);
        misfit.squares += residual * residual;
        misfit.robust += 0.5 * (ROBUST / noise).powi(2) * (residual / ROBUST).powi(2).ln_1p();
        misfit.weighted += weight * residual * residual;
        misfit.image += f64::from(film.image[voxel]);
        misfit.voxels += 1.0;
        let root = weight.sqrt() as f32;
        for (to, from) in row[..ACTIVITY + WIDTH].iter_mut().zip(derivatives) {
            *to = root * from;
        }
        if plan.fits_width {
            row[LOCAL + WIDTH] = root * (wider.image[voxel] - film.image[voxel]) / (1.0 + WIDTH_STEP).ln() as f32;
        }
        let (splines, _) = row[LOCAL + SHARED..n].as_chunks_mut::<MAP_HARMONICS>();
        for (to, from) in splines.iter_mut().zip(derivatives[MAP..].as_chunks::<LANES>().0) {
            for (to, from) in to.iter_mut().zip(from) {
                *to = root * from;
            }
        }
        row[n] = root * residual as f32;
        gram.push(&row);
    }
    let full = gram.finish();
    let side = (0..n).map(|i| full[n * (n + 1) + i]).collect();
    let mut matrix = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            matrix[i * n + j] = full[i * (n + 1) + j];
            matrix[j * n + i] = full[i * (n + 1) + j];
        }
    }
    Normal { n, matrix, side, misfit }
}

const _: () = assert!(SURFACES < LOCAL && ACTIVITY == LOCAL);
