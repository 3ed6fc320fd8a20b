//! The model's fit to all gates at once: Gauss-Newton steps with robust weights on the shapes of the gates and on what they share, the
//! activities, the uptake map and the width of the point-spread function.

use super::{
    basis::Spot,
    counts::Counts,
    exposure::{ACTIVITY, Activity, COLUMNS, COLUMNS_WITHOUT_MAP, MAP, UPTAKE, Want, expose},
    linear::{Arrow, Block},
    priors::{LocalPrior, Priors},
    shape::{BASE, LOCAL, SURFACES, Shape, Volumes},
};
use crate::pipeline::{
    PipelineError,
    monitor::{self, Monitor},
};
use rayon::prelude::*;

/// Columns all gates share, before the map: wall, blood, background, logarithm of the point-spread function's width.
pub(super) const SHARED: usize = 4;
/// Where the width stands among them.
pub(super) const WIDTH: usize = 3;

/// Standard deviation of counts less model for the weights, as part of the wall's activity, in a volume of the paper's voxel (the
/// prototype's); counts of a larger bin are surer.
pub(super) const NOISE: f64 = 0.04;
pub(super) const NOISE_MM3: f64 = 47.3;
/// Residuals beyond this part of the wall's activity lose weight (Cauchy): three of the standard deviations above.
const ROBUST: f64 = 0.12;
/// Counts farther outside the epicardium, or higher above the valve plane, are not compared.
const MARGIN_MM: f64 = 9.0;
const MARGIN_ABOVE_MM: f64 = 12.0;
/// Longest step of a coefficient or of the valve plane in mm, and of its slope.
const LONGEST_MM: f64 = 4.0;
const LONGEST_SLOPE: f64 = 2.0;
/// Limits of the blood's activity as parts of the wall's. Perfusion tracers leave 10-20 % in the blood; filters of the reconstruction dig
/// deeper, which a model without them must not take for a wall of ever more activity.
const LEAST_BLOOD: f64 = 0.03;
const MOST_BLOOD: f64 = 0.7;
/// Relative step for the image's derivative by the width.
const WIDTH_STEP: f64 = 0.02;
/// Steps before the residuals' correlation is measured.
const ROUGH_STEPS: usize = 3;
/// Parts of the diagonal that are added to it, least, first and most: what the counts hardly determine moves slowly at first, and where a
/// step made things worse.
const DAMPING: [f64; 3] = [1e-4, 0.01, 10.0];
/// A step made things worse when the mean robust misfit grew by more than this: priors ask for a
/// part of it when correlated residuals lose their weight, steps that run away for more.
const WORSE: f64 = 1.5;
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
    while steps < plan.steps && !converged {
        monitor::check(monitor)?;
        let system = assemble(counts, &state, priors, &plan, monitor)?;
        steps += 1;
        match &best {
            // Beyond what the last step was good for: back, and with a shorter step on.
            Some((before, of_before)) if system.misfit() > WORSE * of_before.misfit() => {
                state = before.clone();
                damping = (damping * 10.0).min(DAMPING[2]);
            }
            _ => {
                damping = if steps <= ROUGH_STEPS { DAMPING[1] } else { (damping * 0.1).max(DAMPING[0]) };
                best = Some((state.clone(), system));
            }
        }
        let Some((_, system)) = &best else { break };
        let Some((gates, shared)) = system.step(damping) else { break };
        advance(&mut state, &gates, &shared, &plan);
        let change = system.cavities_ml.iter().zip(cavities_ml(&state, counts)).map(|(a, b)| ((b - a) / a).abs()).fold(0.0, f64::max);
        converged = change < REST && steps > ROUGH_STEPS && damping < DAMPING[1];
        if steps == ROUGH_STEPS {
            plan.correlated = correlated(counts, &state);
            best = None;
        }
        monitor.advance(steps, plan.steps + 1);
    }
    let mut system = assemble(counts, &state, priors, &plan, monitor)?;
    if let Some((before, of_before)) = best
        && system.misfit() > WORSE * of_before.misfit()
    {
        (state, system) = (before, of_before);
    }
    Ok(Solved { state, steps, converged, system, correlated: plan.correlated })
}

fn cavities_ml(state: &State, counts: &Counts) -> Vec<f64> {
    state.shapes.iter().map(|shape| Volumes::of(shape, &counts.space).ml.endocardial).collect()
}

/// Moves the parameters.
fn advance(state: &mut State, gates: &[Vec<f64>], shared: &[f64], plan: &Plan) {
    for (shape, step) in state.shapes.iter_mut().zip(gates) {
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
    if plan.fits_map {
        for (value, step) in activity.map.iter_mut().zip(&shared[SHARED..]) {
            *value += step.clamp(-0.2, 0.2);
        }
    }
}

/// The normal equations of a state.
pub(super) struct System {
    pub(super) shared: usize,
    pub(super) blocks: Vec<Block>,
    pub(super) corner: Vec<f64>,
    pub(super) gate_sides: Vec<Vec<f64>>,
    pub(super) shared_side: Vec<f64>,
    pub(super) misfit: Vec<Misfit>,
    /// Cavities of the gates in ml.
    cavities_ml: Vec<f64>,
}

/// How far a gate's counts are from the model.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Misfit {
    /// Sums over the voxels compared: of squared residuals, of weights times them, of what is left of them robustly, of the
    /// model's image, and their number.
    pub(super) squares: f64,
    pub(super) weighted: f64,
    pub(super) robust: f64,
    pub(super) image: f64,
    pub(super) voxels: f64,
}

impl System {
    /// Mean robust squared residual.
    fn misfit(&self) -> f64 {
        let (robust, voxels) = self.misfit.iter().fold((0.0, 0.0), |(robust, voxels), gate| (robust + gate.robust, voxels + gate.voxels));
        robust / f64::max(voxels, 1.0)
    }

    /// Takes a shared parameter out of the system.
    fn hold(&mut self, index: usize) {
        for i in 0..self.shared {
            self.corner[index * self.shared + i] = 0.0;
            self.corner[i * self.shared + index] = 0.0;
        }
        self.corner[index * self.shared + index] = 1.0;
        self.shared_side[index] = 0.0;
        for block in &mut self.blocks {
            for i in 0..LOCAL {
                block.border[i * self.shared + index] = 0.0;
            }
        }
    }

    fn step(&self, damping: f64) -> Option<(Vec<Vec<f64>>, Vec<f64>)> {
        let (blocks, corner) = self.damped(damping);
        let arrow = Arrow::factorise(LOCAL, blocks, corner, self.shared)?;
        let (mut gates, mut shared) = (self.gate_sides.clone(), self.shared_side.clone());
        arrow.solve(&mut gates, &mut shared);
        Some((gates, shared))
    }

    /// A little more on the diagonal: what nothing determines stays where it is.
    fn damped(&self, damping: f64) -> (Vec<Block>, Vec<f64>) {
        let damp = |matrix: &mut [f64], n: usize| {
            for i in 0..n {
                matrix[i * n + i] = (1.0 + damping) * matrix[i * n + i] + 1e-6;
            }
        };
        let mut blocks = self.blocks.clone();
        for block in &mut blocks {
            damp(&mut block.own, LOCAL);
        }
        let mut corner = self.corner.clone();
        damp(&mut corner, self.shared);
        (blocks, corner)
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

fn assemble(counts: &Counts, state: &State, priors: &Priors, plan: &Plan, monitor: &dyn Monitor) -> Result<System, PipelineError> {
    let shared = SHARED + if plan.fits_map { UPTAKE } else { 0 };
    let normals: Vec<Result<Normal, PipelineError>> = (0..state.shapes.len())
        .into_par_iter()
        .map(|gate| {
            monitor::check(monitor)?;
            Ok(normal_of_gate(counts, state, gate, plan))
        })
        .collect();
    let normals = normals.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut corner = vec![0.0; shared * shared];
    let mut shared_side = vec![0.0; shared];
    let (mut blocks, mut gate_sides, mut misfit) = (Vec::new(), Vec::new(), Vec::new());
    let volumes: Vec<Volumes> = state.shapes.iter().map(|shape| Volumes::of(shape, &counts.space)).collect();
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
        prior.add(&state.shapes[gate].values, &mut own, &mut side);
        if !plan.fits_tilt {
            for index in BASE + 1..LOCAL {
                freeze(&mut own, &mut border, &mut side, index, shared);
            }
        }
        misfit.push(normal.misfit);
        blocks.push(Block { own, border });
        gate_sides.push(side);
    }
    priors.add_shared(state, plan, shared, &mut corner, &mut shared_side);
    let cavities_ml = volumes.iter().map(|volumes| volumes.ml.endocardial).collect();
    let mut system = System { shared, blocks, corner, gate_sides, shared_side, misfit, cavities_ml };
    if !plan.fits_width {
        system.hold(WIDTH);
    }
    // At a limit and pulled beyond it: the others move as if it were known.
    let [low, high] = plan.sigma_limits_mm;
    let log = state.sigma_mm.ln();
    let blood = [LEAST_BLOOD * state.activity.wall, MOST_BLOOD * state.activity.wall];
    for (index, value, [low, high]) in [(1, state.activity.blood, blood), (WIDTH, log, [low.ln(), high.ln()])] {
        let pull = system.shared_side[index];
        if (value <= low + 1e-9 && pull < 0.0) || (value >= high - 1e-9 && pull > 0.0) {
            system.hold(index);
        }
    }
    Ok(system)
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

/// Correlation of neighbouring residuals beyond which they are taken for this.
const MOST_CORRELATION: f64 = 0.8;

/// How many voxels say as much as one independent one: residuals of a smoothed reconstruction, and those of a wrong model, come in patches.
/// From the correlation ρ of neighbours along each axis, (1 + ρ) / (1 − ρ) an axis, as for a first-order autoregression.
pub(super) fn correlated(counts: &Counts, state: &State) -> f64 {
    let sums: Vec<[[f64; 2]; 3]> = (0..state.shapes.len())
        .into_par_iter()
        .map(|gate| {
            let shape = &state.shapes[gate];
            let image = expose(&counts.crop, &counts.space, shape, &state.activity, state.sigma_mm, Want::Image).image;
            let residual: Vec<Option<f64>> = counts
                .places
                .iter()
                .enumerate()
                .map(|(voxel, place)| {
                    let usable = counts.known[voxel] && compared(place, shape);
                    usable.then(|| f64::from(counts.gates[gate][voxel] - image[voxel]).clamp(-2.0 * ROBUST, 2.0 * ROBUST))
                })
                .collect();
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
pub(super) fn compared(place: &VoxelPlace, shape: &Shape) -> bool {
    place.z < shape.base_mm() + MARGIN_ABOVE_MM && place.r < shape.radii(&place.spot).epicardial + MARGIN_MM
}

fn normal_of_gate(counts: &Counts, state: &State, gate: usize, plan: &Plan) -> Normal {
    let (shape, space, crop) = (&state.shapes[gate], &counts.space, &counts.crop);
    let columns = if plan.fits_map { COLUMNS } else { COLUMNS_WITHOUT_MAP };
    let exposure = expose(crop, space, shape, &state.activity, state.sigma_mm, Want::Derivatives(columns));
    let wider = plan.fits_width.then(|| expose(crop, space, shape, &state.activity, state.sigma_mm * (1.0 + WIDTH_STEP), Want::Image));
    // Order of the packed columns: local, wall, blood, background, width, map.
    let n = LOCAL + SHARED + columns - MAP;
    let mut gram = Gram::new(n + 1);
    let mut misfit = Misfit::default();
    let noise = NOISE * (plan.correlated * NOISE_MM3 / crop.spacing_mm.iter().product::<f64>()).sqrt();
    let mut row = vec![0.0_f32; (n + 1).next_multiple_of(TILE)];
    for (voxel, (&count, place)) in counts.gates[gate].iter().zip(&counts.places).enumerate() {
        if !counts.known[voxel] || !compared(place, shape) {
            continue;
        }
        let residual = f64::from(count) - f64::from(exposure.image[voxel]);
        let weight = 1.0 / ((1.0 + (residual / ROBUST).powi(2)) * noise * noise);
        misfit.squares += residual * residual;
        misfit.robust += residual * residual / (1.0 + (residual / ROBUST).powi(2));
        misfit.weighted += weight * residual * residual;
        misfit.image += f64::from(exposure.image[voxel]);
        misfit.voxels += 1.0;
        let root = weight.sqrt() as f32;
        let derivatives = &exposure.jacobian[voxel * columns..][..columns];
        for (to, from) in row[..ACTIVITY + WIDTH].iter_mut().zip(derivatives) {
            *to = root * from;
        }
        row[LOCAL + WIDTH] = match &wider {
            Some(wider) => root * (wider.image[voxel] - exposure.image[voxel]) / (1.0 + WIDTH_STEP).ln() as f32,
            None => 0.0,
        };
        for (to, from) in row[LOCAL + SHARED..n].iter_mut().zip(&derivatives[MAP..]) {
            *to = root * from;
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

/// Sum of the outer products of rows, lower triangle: single precision within a batch of rows, double between batches.
struct Gram {
    n: usize,
    /// Tiles of a row.
    tiles: usize,
    /// `[rows × tiles]`.
    batch: Vec<Tile>,
    /// `[tiles · TILE × tiles · TILE]`.
    sum: Vec<f64>,
}

/// Rows of a batch.
const BATCH: usize = 64;
/// Side of the tiles a batch is multiplied in.
const TILE: usize = 8;
type Tile = [f32; TILE];

impl Gram {
    fn new(n: usize) -> Self {
        let tiles = n.div_ceil(TILE);
        Self { n, tiles, batch: Vec::with_capacity(BATCH * tiles), sum: vec![0.0; (tiles * TILE).pow(2)] }
    }

    /// Adds a row, filled up with zeros to whole tiles.
    fn push(&mut self, row: &[f32]) {
        self.batch.extend_from_slice(row.as_chunks().0);
        if self.batch.len() == BATCH * self.tiles {
            self.flush();
        }
    }

    fn flush(&mut self) {
        let Self { tiles, batch, sum, .. } = self;
        add_outer_products(batch, *tiles, sum);
        batch.clear();
    }

    /// `[n × n]`, lower triangle.
    fn finish(mut self) -> Vec<f64> {
        self.flush();
        (0..self.n).flat_map(|i| self.sum[i * self.tiles * TILE..][..self.n].to_vec()).collect()
    }
}

/// Adds the lower triangle of `batchᵀ · batch`, tile by tile. Compiled for the widest instructions of the machine at hand; an entry is always
/// the sum in the order of the rows, multiplied and added in two steps, so that all machines have the same.
#[inline(always)]
fn add_outer_products(batch: &[Tile], tiles: usize, sum: &mut [f64]) {
    for a in 0..tiles {
        for b in 0..=a {
            let mut products = [[0.0_f32; TILE]; TILE];
            for row in batch.chunks_exact(tiles) {
                let (left, right) = (row[a], row[b]);
                for i in 0..TILE {
                    for j in 0..TILE {
                        products[i][j] += left[i] * right[j];
                    }
                }
            }
            for (i, line) in products.iter().enumerate() {
                for (to, &value) in sum[((a * TILE + i) * tiles + b) * TILE..][..TILE].iter_mut().zip(line) {
                    *to += f64::from(value);
                }
            }
        }
    }
}

const _: () = assert!(SURFACES < LOCAL && ACTIVITY == LOCAL);
