//! Stage three: nine parameters of a half-ellipsoid's shell, with uptake that varies over it, fitted to the counts around it.
//!
//! The shell's counts are a Gaussian of the distance to the mid-wall times an uptake that is a low polynomial over the wall; inside, outside
//! and behind the valve plane have a level each. All these enter linearly and are solved for at every step (variable projection); position,
//! direction, radius, length, width of the Gaussian and height of the widest section move by damped Gauss-Newton steps.

use super::{
    super::{
        PipelineError,
        monitor::{self, Monitor},
    },
    held::Held,
    prepare::Field,
    shape::{Place, Shell},
    shell_sums::{LANES, Lanes, MOVES, Moved, STEP, Samples, Slopes, Sums, TERMS, add_slopes, add_up, predict_all, total_weight},
    solve,
};
use glam::{DMat3, DVec3};

/// Soft limits of the shape, see [`soft_limits`].
const LIMITS: usize = 6;
/// Standard deviation of the wall's counts across it when a fit begins: 10 mm of wall, 10 mm of camera and our smoothing.
const WALL_SIGMA_MM: f64 = 6.5;
/// Its range: a thin wall in a sharp camera to 22 mm of blur.
const WALL_SIGMAS_MM: (f64, f64) = (4.5, 10.0);
/// Points up to here outside the mid-wall are fitted.
pub(super) const OUTSIDE_MM: f64 = 15.0;
/// And up to here behind the valve plane.
pub(super) const BEHIND_MM: f64 = 16.0;
/// Range of the height of the widest section.
const WIDEST: (f64, f64) = (0.12, 0.5);
/// Elongation under which a shell is a cup rather than a ventricle: mid-wall length over radius is 2.1-3.1.
pub(super) const LEAST_ELONGATION: f64 = 2.0;
/// Points a fit needs at least: four for each of nine plus twelve parameters.
const LEAST_POINTS: usize = 80;
/// Counts over this many times the wall's are another organ's: they are cut to it.
const BRIGHTEST: f64 = 1.5;
/// Gauss-Newton steps a round.
const MOST_STEPS: usize = 8;

/// Which nodes are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Density {
    /// Every fourth (a body-centred lattice, 7 mm apart).
    Quarter,
    /// Every second (a face-centred lattice, 5.7 mm apart): what the blur leaves needs no more.
    Half,
}

/// A fitted shell.
#[derive(Debug, Clone, Copy)]
pub(super) struct ShellFit {
    pub shell: Shell,
    /// Standard deviation of the wall's counts across it.
    pub sigma_mm: f64,
}

/// One round's problem: samples and what the moves are counted from.
struct Round<'a> {
    samples: Vec<Samples>,
    /// Points with a voice at first.
    count: usize,
    from: Moved,
    frame: DMat3,
    held: &'a Held,
    total_weight: f64,
}

/// The linear part solved.
struct Solved {
    coefficients: [f64; TERMS],
    factor: [[f64; TERMS]; TERMS],
    cost: f64,
}

/// Fits a shell from a start; `None` where too little is known around it or it degenerates.
pub(super) fn fit(
    field: &Field,
    start: &Shell,
    held: &Held,
    (density, rounds): (Density, usize),
    monitor: &dyn Monitor,
) -> Result<Option<ShellFit>, PipelineError> {
    fit_from(field, ShellFit::starting(*start), held, (density, rounds), monitor)
}

impl ShellFit {
    /// A shell that was not fitted yet.
    pub(super) fn starting(shell: Shell) -> Self {
        Self { shell, sigma_mm: WALL_SIGMA_MM }
    }
}

/// Goes on from an earlier fit.
pub(super) fn fit_from(
    field: &Field,
    start: ShellFit,
    held: &Held,
    (density, rounds): (Density, usize),
    monitor: &dyn Monitor,
) -> Result<Option<ShellFit>, PipelineError> {
    let mut fit = ShellFit { shell: held.placed(start.shell), ..start };
    for _ in 0..rounds {
        let Some(mut round) = Round::new(field, &fit, held, density) else { return Ok(None) };
        let Some(solved) = round.solve(&round.from) else { return Ok(None) };
        round.doubt(&solved);
        match round.descend(monitor)? {
            Some(better) => fit = better,
            None => return Ok(None),
        }
    }
    Ok(Some(fit))
}

/// A point's squared residual, counts and voice.
struct Explained {
    square: f64,
    value: f64,
    weight: f64,
}

/// Parts of the variance around a shell that it explains: of all points, and without the tenth that is explained worst.
pub(super) fn explained(field: &Field, fit: &ShellFit, held: &Held) -> Option<[f64; 2]> {
    let round = Round::new(field, fit, held, Density::Half)?;
    let solved = round.solve(&round.from)?;
    let mut points: Vec<Explained> = round
        .predictions(&solved)
        .iter()
        .zip(&round.samples)
        .flat_map(|(predicted, samples)| {
            std::array::from_fn::<_, LANES, _>(|i| Explained {
                square: (samples.value[i] - predicted[i]).powi(2),
                value: samples.value[i],
                weight: samples.weight[i],
            })
        })
        .take(round.count)
        .collect();
    points.sort_by(|a, b| a.square.total_cmp(&b.square));
    let part = |points: &[Explained]| {
        let weight: f64 = points.iter().map(|point| point.weight).sum();
        let mean = points.iter().map(|point| point.weight * point.value).sum::<f64>() / weight;
        let variance: f64 = points.iter().map(|point| point.weight * (point.value - mean).powi(2)).sum();
        let residual: f64 = points.iter().map(|point| point.weight * point.square).sum();
        if variance > 0.0 { 1.0 - residual / variance } else { 0.0 }
    };
    Some([part(&points), part(&points[..points.len() * 9 / 10])])
}

/// The counts that the wall has: their 85th percentile near the mid-wall; `None` where nothing is known.
pub(super) fn wall_level(field: &Field, shell: &Shell) -> Option<f64> {
    let mut near = Vec::new();
    each_near(field, shell, Density::Half, |_, place, value| {
        if place.outside_mm.abs() < 6.0 && place.height_mm > 4.0 {
            near.push(value);
        }
    });
    let level = quantile(&mut near, 0.85)?;
    (level > 0.0).then_some(level)
}

/// A quantile, by the nearest rank; `None` of nothing.
pub(super) fn quantile(values: &mut [f64], part: f64) -> Option<f64> {
    let rank = ((values.len().checked_sub(1)?) as f64 * part).round() as usize;
    Some(*values.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// Calls for every known node around a shell: inside it, up to [`OUTSIDE_MM`] + 1 outside and [`BEHIND_MM`] + 2 behind.
pub(super) fn each_near(field: &Field, shell: &Shell, density: Density, mut visit: impl FnMut(DVec3, &Place, f64)) {
    let reach = DVec3::splat(shell.radius_mm + OUTSIDE_MM + 6.0);
    let behind = shell.base_mm - shell.to_apex * BEHIND_MM;
    let low = field.index_of(behind.min(shell.apex_mm()) - reach).floor();
    let high = field.index_of(behind.max(shell.apex_mm()) + reach).ceil();
    let range = |axis: usize| {
        let last = field.nodes[axis] as i32 - 1;
        (low[axis].max(0.0) as i32).min(last)..=(high[axis].min(f64::from(last)) as i32).max(0)
    };
    for z in range(2) {
        for y in range(1) {
            for x in range(0) {
                // Counted from the middle, as the lattice: all even or all odd; an even sum.
                let parity = |index: i32, axis: usize| (index - field.nodes[axis] as i32 / 2) & 1;
                let [i, j, k] = [parity(x, 0), parity(y, 1), parity(z, 2)];
                let skipped = match density {
                    Density::Quarter => i != j || j != k,
                    Density::Half => (i + j + k) & 1 == 1,
                };
                if skipped {
                    continue;
                }
                let value = field.node([x, y, z]);
                if value.is_nan() {
                    continue;
                }
                let at = field.position_mm([x, y, z]);
                let place = shell.place(at);
                if place.outside_mm < OUTSIDE_MM + 1.0 && place.height_mm > -BEHIND_MM - 2.0 {
                    visit(at, &place, f64::from(value));
                }
            }
        }
    }
}

impl<'a> Round<'a> {
    fn new(field: &Field, fit: &ShellFit, held: &'a Held, density: Density) -> Option<Self> {
        let level = wall_level(field, &fit.shell)?;
        let mut samples: Vec<Samples> = Vec::new();
        let mut count = 0;
        each_near(field, &fit.shell, density, |at_mm, place, value| {
            // The voice fades over the borders of the selection, so that no node enters with a jump.
            let fade = |from: f64, to: f64, at: f64| ((at - from) / (to - from)).clamp(0.0, 1.0);
            let outside = place.outside_mm;
            let weight = (1.0 - 0.5 * fade(6.0, 10.0, outside))
                * (1.0 - fade(OUTSIDE_MM - 3.0, OUTSIDE_MM + 1.0, outside))
                * fade(-BEHIND_MM - 2.0, -BEHIND_MM + 3.0, place.height_mm);
            if weight > 0.0 {
                let lane = count % LANES;
                if lane == 0 {
                    samples.push(Samples::default());
                }
                if let Some(last) = samples.last_mut() {
                    (last.x[lane], last.y[lane], last.z[lane]) = at_mm.into();
                    (last.value[lane], last.weight[lane]) = ((value / level).min(BRIGHTEST), weight);
                }
                count += 1;
            }
        });
        let enough = if density == Density::Half { LEAST_POINTS } else { LEAST_POINTS / 2 };
        if count < enough {
            return None;
        }
        let total_weight = total_weight(&samples);
        let from = Moved { shell: fit.shell, sigma_mm: fit.sigma_mm };
        Some(Self { samples, count, from, frame: fit.shell.frame(), held, total_weight })
    }

    /// Turns down points that the model does not explain: other organs, noise.
    fn doubt(&mut self, solved: &Solved) {
        let residuals: Vec<Lanes> = self
            .predictions(solved)
            .iter()
            .zip(&self.samples)
            .map(|(predicted, samples)| std::array::from_fn(|i| (samples.value[i] - predicted[i]).abs()))
            .collect();
        // 1.48 x the median of absolute residuals is their standard deviation; 2 % of the wall's counts are always allowed.
        let spread = 1.48 * quantile(&mut residuals.as_flattened()[..self.count].to_vec(), 0.5).unwrap_or(0.0) + 0.02;
        for (samples, residuals) in self.samples.iter_mut().zip(&residuals) {
            for (weight, residual) in samples.weight.iter_mut().zip(residuals) {
                *weight /= 1.0 + ((residual - spread).max(0.0) / (2.0 * spread)).powi(2);
            }
        }
        self.total_weight = total_weight(&self.samples);
    }

    /// The counts that the model has at the samples where the round began.
    fn predictions(&self, solved: &Solved) -> Vec<Lanes> {
        let mut predicted = vec![[0.0; LANES]; self.samples.len()];
        predict_all(&self.samples, &self.from, &self.frame, &solved.coefficients, &mut predicted);
        predicted
    }

    /// The parameters after moves from where the round began.
    fn moved(&self, moves: &[f64; MOVES]) -> Moved {
        let from = &self.from;
        let mut shell = from.shell;
        shell.base_mm += 5.0 * DVec3::new(moves[0], moves[1], moves[2]);
        shell.to_apex = (shell.to_apex + self.frame.x_axis * (0.15 * moves[3]) + self.frame.y_axis * (0.15 * moves[4])).normalize();
        shell.radius_mm *= (0.12 * moves[5]).exp();
        shell.length_mm *= (0.12 * moves[6]).exp();
        shell.widest = (shell.widest + 0.06 * moves[8]).clamp(WIDEST.0, WIDEST.1);
        let sigma_mm = (from.sigma_mm * (0.12 * moves[7]).exp()).clamp(WALL_SIGMAS_MM.0, WALL_SIGMAS_MM.1);
        Moved { shell: self.held.placed(shell), sigma_mm }
    }

    /// The best linear part; `None` if it cannot be solved.
    fn solve(&self, moved: &Moved) -> Option<Solved> {
        let Sums { mut normal, right, square } = add_up(&self.samples, moved, &self.frame);
        for (i, ridge) in RIDGE.into_iter().enumerate() {
            normal[i][i] += (0.3 * ridge + 1e-6) * self.total_weight;
        }
        if !solve::factor(&mut normal) {
            return None;
        }
        let coefficients = solve::solve(&normal, right);
        // With the best coefficients, squared residual and ridge together are what the right side does not explain.
        let explained: f64 = coefficients.iter().zip(&right).map(|(c, r)| c * r).sum();
        let limits: f64 = soft_limits(&moved.shell).iter().map(|limit| limit * limit).sum();
        Some(Solved { coefficients, factor: normal, cost: (square - explained).max(0.0) / self.total_weight + limits })
    }

    /// Damped Gauss-Newton from where the round began.
    fn descend(&self, monitor: &dyn Monitor) -> Result<Option<ShellFit>, PipelineError> {
        let mut moves = [0.0; MOVES];
        let mut at = self.from;
        let Some(mut solved) = self.solve(&at) else { return Ok(None) };
        let mut damping = 1e-2;
        for _ in 0..MOST_STEPS {
            monitor::check(monitor)?;
            let (matrix, downhill) = self.linearised(&moves, &solved);
            let mut improved = false;
            for _ in 0..4 {
                let mut damped = matrix;
                for (i, row) in damped.iter_mut().enumerate() {
                    // The floor stills moves that the marks take back.
                    row[i] += damping * row[i] + 1e-9;
                }
                if !solve::factor(&mut damped) {
                    damping *= 10.0;
                    continue;
                }
                let step = solve::solve(&damped, downhill).map(|step| step.clamp(-2.0, 2.0));
                let mut next = moves;
                for (next, step) in next.iter_mut().zip(step) {
                    *next += step;
                }
                let there = self.moved(&next);
                match self.solve(&there).filter(|next| next.cost < solved.cost) {
                    Some(better) => {
                        improved = solved.cost - better.cost > 1e-4 * solved.cost;
                        (moves, at, solved) = (next, there, better);
                        damping = f64::max(damping * 0.2, 1e-6);
                        break;
                    }
                    None => damping *= 8.0,
                }
            }
            if !improved {
                break;
            }
        }
        let sane = at.shell.base_mm.is_finite() && at.shell.to_apex.is_finite() && (5.0..200.0).contains(&at.shell.length_mm);
        Ok(sane.then_some(ShellFit { shell: at.shell, sigma_mm: at.sigma_mm }))
    }

    /// The Gauss-Newton matrix (lower triangle) and the downhill direction of the projected problem, per unit of weight (Kaufman's
    /// approximation: coefficients follow the moves, their own derivative's second part is left out).
    fn linearised(&self, moves: &[f64; MOVES], solved: &Solved) -> ([[f64; MOVES]; MOVES], [f64; MOVES]) {
        let here = self.moved(moves);
        let there: [Moved; MOVES] = std::array::from_fn(|k| {
            let mut moves = *moves;
            moves[k] += STEP;
            self.moved(&moves)
        });
        let Slopes { mut matrix, mut downhill, overlap } = add_slopes(&self.samples, &here, &there, &self.frame, &solved.coefficients);
        let projected = overlap.map(|column| solve::solve(&solved.factor, column));
        for k in 0..MOVES {
            for l in 0..=k {
                let seen: f64 = overlap[k].iter().zip(&projected[l]).map(|(a, b)| a * b).sum();
                matrix[k][l] = (matrix[k][l] - seen) / self.total_weight;
            }
            downhill[k] /= self.total_weight;
        }
        let limits = soft_limits(&here.shell);
        let slopes = there.map(|there| {
            let moved = soft_limits(&there.shell);
            std::array::from_fn::<f64, LIMITS, _>(|i| (moved[i] - limits[i]) / STEP)
        });
        for k in 0..MOVES {
            for l in 0..=k {
                matrix[k][l] += slopes[k].iter().zip(&slopes[l]).map(|(a, b)| a * b).sum::<f64>();
            }
            downhill[k] -= slopes[k].iter().zip(&limits).map(|(a, b)| a * b).sum::<f64>();
        }
        (matrix, downhill)
    }
}

/// Ridge on the coefficients: uptake varies little over the wall.
const RIDGE: [f64; TERMS] = [0.0, 0.05, 0.05, 0.05, 0.1, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0.05];

/// How far a shape is from a ventricle's, in root mean squares of the wall's counts: radius 16-50 mm, elongation from 2 to 3.2, both
/// weakly drawn to the middle, and the widest section at .3 of the length.
fn soft_limits(shell: &Shell) -> [f64; LIMITS] {
    let (radius, elongation) = (shell.radius_mm, shell.elongation());
    [
        0.03 * ((16.0 - radius) / 4.0).max(0.0),
        0.03 * ((radius - 50.0) / 5.0).max(0.0),
        0.48 * (LEAST_ELONGATION - elongation).max(0.0),
        0.15 * (shell.widest - 0.3),
        0.16 * (elongation - 3.2).max(0.0),
        0.01 * (elongation - 2.35),
    ]
}
