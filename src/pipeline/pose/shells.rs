//! Stage one: where a sphere's shell lies in the counts, with a dark inside and a dark outside. A ventricle is most of one.

use super::{
    super::{
        PipelineError,
        monitor::{self, Monitor},
    },
    prepare::Field,
};
use glam::DVec3;

/// Mid-wall radii that are tried: small hearts at end systole to dilated ones, 15-20 % apart.
pub(super) const RADII_MM: [f64; 7] = [18.0, 22.0, 26.0, 30.0, 35.0, 40.0, 46.0];
/// Grid of centres: a third of the smallest radius.
const CENTRE_STEP_MM: f64 = 8.0;
/// More centres than this are taken farther apart: a heart's study has 10 000, a whole body a million.
const MOST_CENTRES: f64 = 60_000.0;
/// From the mid-wall to where it is dark outside.
const OUTSIDE_MM: f64 = 14.0;
/// Correlation below which a place is no candidate; ventricles reach .5-.9, those cut by the field of view .35.
const LEAST_CORRELATION: f64 = 0.2;
/// Counts that differ by this part of their mean are flat: smoothed noise is 2-5 % of the background, a wall ten times it.
const NOISE: f64 = 0.15;
/// Candidates that go on to the next stage.
const MOST_CANDIDATES: usize = 14;

/// A place where a shell may be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub centre_mm: DVec3,
    pub radius_mm: f64,
    pub correlation: f64,
}

/// Weighted correlation of counts with a pattern of bright (+1) and dark (-1) points, some unknown.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Correlation {
    weight: f32,
    pattern: f32,
    value: f32,
    square: f32,
    product: f32,
}

impl Correlation {
    /// From the sums of weight, weight · pattern, weight · counts, weight · counts², weight · counts · pattern.
    pub(super) fn of_sums([weight, pattern, value, square, product]: [f32; 5]) -> Self {
        Self { weight, pattern, value, square, product }
    }

    /// Adds a point.
    pub(super) fn add(&mut self, value: f32, sign: f32, weight: f32) {
        self.weight += weight;
        self.pattern += weight * sign;
        self.value += weight * value;
        self.square += weight * value * value;
        self.product += weight * value * sign;
    }

    /// -1 to 1; 0 for constant counts.
    pub(super) fn value(&self) -> f64 {
        let [weight, pattern, value, square, product] = [self.weight, self.pattern, self.value, self.square, self.product].map(f64::from);
        if weight <= 0.0 {
            return 0.0;
        }
        let (pattern, value) = (pattern / weight, value / weight);
        let variance = square / weight - value * value;
        // Noise correlates with anything: differences must stand out from a part of the counts themselves.
        let spread = (variance.max(0.0) + (NOISE * value).powi(2)).sqrt();
        if spread > 0.0 { (product / weight - value * pattern) / ((1.0 - pattern * pattern).sqrt() * spread) } else { 0.0 }
    }
}

/// Offsets in nodes of the shell's points, and their part in the pattern.
struct Pattern {
    bright: Vec<[i32; 3]>,
    dark: Vec<([i32; 3], f32)>,
    radius_mm: f64,
}

impl Pattern {
    fn new(radius_mm: f64, step_mm: f64) -> Self {
        let ring =
            |radius: f64| lattice_directions().map(move |d| (d * (radius / step_mm)).round()).map(|d| [d.x as i32, d.y as i32, d.z as i32]);
        // Each group has one voice whatever its number of points: the wall 2.2, inside 1, outside .7.
        let inside = ring(radius_mm * 0.4).map(|offset| (offset, 1.0 / 26.0));
        let outside = ring(radius_mm + OUTSIDE_MM).map(|offset| (offset, 0.7 / 26.0));
        Self { bright: ring(radius_mm).collect(), dark: inside.chain(outside).collect(), radius_mm }
    }

    fn correlation(&self, field: &Field, [x, y, z]: [i32; 3]) -> f64 {
        let mut correlation = Correlation::default();
        let mut known = 0;
        for &[i, j, k] in &self.bright {
            let value = field.node([x + i, y + j, z + k]);
            if !value.is_nan() {
                correlation.add(value, 1.0, 2.2 / 26.0);
                known += 1;
            }
        }
        // At least half of the wall must be in the field of view.
        if known < 13 {
            return -1.0;
        }
        for &([i, j, k], weight) in &self.dark {
            let value = field.node([x + i, y + j, z + k]);
            if !value.is_nan() {
                correlation.add(value, -1.0, weight);
            }
        }
        correlation.value()
    }
}

/// The 26 directions to a node's neighbours.
fn lattice_directions() -> impl Iterator<Item = DVec3> {
    (0..27)
        .filter(|&cell| cell != 13)
        .map(|cell| DVec3::new(f64::from(cell % 3 - 1), f64::from(cell / 3 % 3 - 1), f64::from(cell / 9 - 1)).normalize())
}

/// The places where shells correlate best, best first.
pub(super) fn candidates(field: &Field, monitor: &dyn Monitor) -> Result<Vec<Candidate>, PipelineError> {
    let extent = field.last_mm() - field.origin_mm;
    let volume = (extent + CENTRE_STEP_MM).to_array().into_iter().product::<f64>();
    let step_mm = CENTRE_STEP_MM.max((volume / MOST_CENTRES).cbrt());
    let stride = (step_mm / field.step_mm).round().max(1.0) as i32;
    // From the middle node outwards, as the lattice itself.
    let half = field.nodes.map(|nodes| nodes as i32 / 2);
    let reach = half.map(|half| half / stride);
    let side = reach.map(|reach| (2 * reach + 1) as usize);
    let mut found = Vec::new();
    for radius_mm in RADII_MM {
        monitor::check(monitor)?;
        let pattern = Pattern::new(radius_mm, field.step_mm);
        let mut map = vec![-1.0_f64; side[0] * side[1] * side[2]];
        let node = |cell: usize| {
            let index = [cell % side[0], cell / side[0] % side[1], cell / (side[0] * side[1])];
            [0, 1, 2].map(|axis| half[axis] + (index[axis] as i32 - reach[axis]) * stride)
        };
        for (cell, value) in map.iter_mut().enumerate() {
            *value = pattern.correlation(field, node(cell));
        }
        for (cell, &correlation) in map.iter().enumerate() {
            if correlation >= LEAST_CORRELATION && is_peak(&map, side, cell) {
                found.push(Candidate { centre_mm: field.position_mm(node(cell)), radius_mm: pattern.radius_mm, correlation });
            }
        }
    }
    found.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    found.truncate(MOST_CANDIDATES);
    Ok(found)
}

/// Whether no neighbouring cell is larger.
fn is_peak(map: &[f64], side: [usize; 3], cell: usize) -> bool {
    let [x, y, z] = [cell % side[0], cell / side[0] % side[1], cell / (side[0] * side[1])];
    let around = |index: usize, side: usize| index.saturating_sub(1)..=(index + 1).min(side - 1);
    around(z, side[2]).all(|k| around(y, side[1]).all(|j| around(x, side[0]).all(|i| map[(k * side[1] + j) * side[0] + i] <= map[cell])))
}
