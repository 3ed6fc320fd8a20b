//! Borders along rays across the wall, without a model of the camera: where the wall lies, where its counts rise and fall most steeply,
//! where it ends at the valves, and how much it takes up. Start, fallback and referee of the model's fit.

use super::{
    basis::{Angle, Basis, HARMONICS, MAP_HARMONICS, SPLINES, order},
    frame::Frame,
    linear::solve_positive,
    shape::{STRIDE, Shape, Space, THICKNESS_HARMONICS},
};
use crate::{pipeline::simd::vectorised, study::Study, volume::Volume};
use std::f64::consts::FRAC_PI_2;

/// Rays from apex to beyond the base, and about the axis (`numerics.md`: about 28 × 32).
pub(super) const ALONG: usize = 28;
pub(super) const AROUND: usize = 32;
/// Distance of samples on a ray.
const STEP_MM: f64 = 1.0;
/// The first sample.
const FIRST_MM: f64 = 2.0;
/// How far outside the pose's mid-wall surface a wall is looked for: half a wall, and what a half-ellipsoid misses.
const BEYOND_MM: f64 = 16.0;
/// How far on either side of mid-wall the steepest slope is looked for: half a wall and a camera's blur.
const SLOPE_REACH_MM: f64 = 18.0;
/// A ray shows the wall when its largest count is at least this part of the 90th percentile of all rays'.
const SEEN: f64 = 0.3;
/// Below this part of the 90th percentile the wall's uptake is low (`numerics.md`, §4.6).
const LOW: f64 = 0.45;
/// Well perfused: above this part.
const WELL: f64 = 0.6;

/// What rays show of a gate.
#[derive(Debug, Clone)]
pub(super) struct Rays {
    /// Start of the model: the mid-wall surface and valve plane found, the thickness not yet.
    pub(super) mid: Vec<f64>,
    /// Surfaces at the steepest slopes.
    pub(super) gradient: Shape,
    /// Height of the valve plane; `None` where the wall's end was not seen.
    pub(super) base_mm: Option<f64>,
    /// The mid-wall surface of the well-perfused rays, continued smoothly over the others from the pose's half-ellipsoid.
    pub(super) continued: Vec<f64>,
    /// Largest count near mid-wall on every ray, `[ALONG × AROUND]`.
    pub(super) peak: Vec<f64>,
    /// Part of the wall with low uptake.
    pub(super) low: f64,
    /// Wall, blood and background in counts.
    pub(super) wall: f64,
    pub(super) blood: f64,
    pub(super) background: f64,
}

/// Places of the rays.
pub(super) fn places(basis: &Basis) -> impl Iterator<Item = (f64, Angle)> {
    let s_max = basis.s_max;
    (0..ALONG).flat_map(move |i| {
        let s = (i as f64 + 0.5) / ALONG as f64 * s_max;
        Angle::around(AROUND).map(move |angle| (s, angle))
    })
}

/// Coefficients of a surface's radius, and how many of them matter at a place.
const N: usize = SPLINES * HARMONICS;
const TERMS: usize = 4 * HARMONICS;

/// The rays' places and what the coefficients of a surface say there: the same for all gates.
pub(super) struct Net {
    places: Vec<(f64, Angle)>,
    rows: Vec<Row>,
}

/// What the coefficients from `start` on contribute at a place.
struct Row {
    start: usize,
    terms: [f64; TERMS],
}

impl Net {
    pub(super) fn new(basis: &Basis) -> Self {
        let row = |(s, angle): &(f64, Angle)| {
            let spot = basis.at(*s, angle);
            let terms = std::array::from_fn(|i| spot.splines[i / HARMONICS] * spot.harmonics[i % HARMONICS]);
            Row { start: spot.first * HARMONICS, terms }
        };
        let places: Vec<(f64, Angle)> = places(basis).collect();
        let rows = places.iter().map(row).collect();
        Self { places, rows }
    }

    /// A surface at all places.
    fn values(&self, coefficients: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|row| row.value(coefficients)).collect()
    }
}

impl Row {
    fn value(&self, coefficients: &[f64]) -> f64 {
        coefficients[self.start..].iter().zip(&self.terms).map(|(coefficient, term)| coefficient * term).sum()
    }
}

/// The mid-wall surface of a pose: half an ellipsoid in the cap, a cylinder above.
pub(super) fn pose_radius(frame: &Frame, s: f64) -> f64 {
    if s >= FRAC_PI_2 {
        return frame.unit_mm;
    }
    let (sin, cos) = s.sin_cos();
    1.0 / (sin / frame.unit_mm).hypot(cos / frame.apex_mm)
}

/// Casts the rays of one gate.
pub(super) fn cast(volume: &Volume, space: &Space, net: &Net) -> Rays {
    let frame = &space.frame;
    let longest = frame.unit_mm.max(frame.apex_mm) + BEYOND_MM + SLOPE_REACH_MM;
    let samples = ((longest - FIRST_MM) / STEP_MM) as usize + 1;
    let radius = |k: usize| FIRST_MM + STEP_MM * k as f64;
    let nodes = &net.places;
    let profiles = profiles(volume, frame, nodes, samples);
    let limit: Vec<usize> =
        nodes.iter().map(|&(s, _)| (((pose_radius(frame, s) + BEYOND_MM - FIRST_MM) / STEP_MM) as usize).min(samples - 1)).collect();
    let brightest: Vec<usize> = profiles.iter().zip(&limit).map(|(profile, &end)| largest(&profile[1..=end]) + 1).collect();
    let heights: Vec<f64> = profiles.iter().zip(&brightest).map(|(profile, &k)| profile[k]).collect();
    let below_base = |s: f64| s < frame.s_of_height(frame.base_mm);
    let reference = percentile(nodes.iter().zip(&heights).filter(|((s, _), _)| below_base(*s)).map(|(_, &height)| height), 0.9);
    let seen: Vec<bool> = nodes.iter().zip(&heights).map(|((s, _), &height)| below_base(*s) && height > SEEN * reference).collect();
    let found: Vec<Option<f64>> = seen.iter().zip(&brightest).map(|(&seen, &k)| seen.then(|| radius(k))).collect();
    let mid = smooth(net, &found, SMOOTHING);
    let mid_at: Vec<f64> = net.values(&mid).into_iter().map(|mm| mm.clamp(4.0, longest - SLOPE_REACH_MM)).collect();
    let index = |mm: f64| (((mm - FIRST_MM) / STEP_MM).round().max(0.0) as usize).min(samples - 1);
    let near = |profile: &[f64], centre: usize, reach: usize| {
        let (low, end) = (centre.saturating_sub(reach), (centre + reach + 1).min(samples));
        let at = low + largest(&profile[low..end]);
        (profile[at], radius(at))
    };
    let peaks: Vec<(f64, f64)> = mid_at.iter().zip(&profiles).map(|(mid_mm, profile)| near(profile, index(*mid_mm), 7)).collect();
    let peak: Vec<f64> = peaks.iter().map(|peak| peak.0).collect();
    let background = percentile(profiles.iter().flatten().copied(), 0.15);
    let blood = percentile(profiles[..profiles.len() / 2].iter().flat_map(|profile| profile[..6].iter().copied()), 0.5);
    let base_mm = base_height(space, nodes, &peak, background);
    let end = frame.s_of_height(base_mm.unwrap_or(frame.base_mm));
    let weight = |s: f64| if s < FRAC_PI_2 { s.sin() } else { 1.0 };
    let in_wall = |s: f64| s < end - 0.25;
    let high = percentile(nodes.iter().zip(&peak).filter(|((s, _), _)| in_wall(*s)).map(|(_, &value)| value), 0.9);
    let (mut low, mut all) = (0.0, f64::MIN_POSITIVE);
    for (&(s, _), &value) in nodes.iter().zip(&peak).filter(|((s, _), _)| in_wall(*s)) {
        all += weight(s);
        if value < LOW * high {
            low += weight(s);
        }
    }
    let of_pose: Vec<f64> = nodes.iter().map(|(s, _)| pose_radius(frame, *s)).collect();
    let departures: Vec<Option<f64>> = nodes
        .iter()
        .zip(peaks.iter().zip(&of_pose))
        .map(|((s, _), (&(value, at_mm), of_pose))| (in_wall(*s) && value > WELL * high).then(|| (at_mm / of_pose - 1.0) * frame.unit_mm))
        .collect();
    // In proportion to the half-ellipsoid, and as flat as the rays allow: what moved in at the base did so at the unseen apex.
    let departure = net.values(&smooth(net, &departures, CONTINUATION));
    let whole: Vec<Option<f64>> =
        departure.iter().zip(&of_pose).map(|(departure, of_pose)| Some(of_pose * (1.0 + departure / frame.unit_mm))).collect();
    let continued = smooth(net, &whole, [1e-3, 0.0]);
    let slopes = |sign: f64| -> Vec<Option<f64>> {
        nodes
            .iter()
            .zip(&mid_at)
            .zip(profiles.iter().zip(&seen))
            .map(|(((s, _), centre), (profile, &seen))| {
                let usable = seen && *s < end - 0.15;
                usable.then(|| steepest(profile, index(*centre), sign)).flatten().map(|k| FIRST_MM + STEP_MM * k)
            })
            .collect()
    };
    let (inner, outer) = (smooth(net, &slopes(1.0), SMOOTHING), smooth(net, &slopes(-1.0), SMOOTHING));
    let gradient = between(&inner, &outer, base_mm.unwrap_or(frame.base_mm));
    Rays { mid, gradient, base_mm, continued, peak, low: low / all, wall: high, blood, background }
}

/// The shape between two surfaces given as `[SPLINES × HARMONICS]` radii. Thickness keeps the harmonics it has; the mid-wall the rest.
fn between(inner: &[f64], outer: &[f64], base_mm: f64) -> Shape {
    let mut values = Vec::with_capacity(SPLINES * STRIDE + 3);
    for (inner, outer) in inner.chunks_exact(HARMONICS).zip(outer.chunks_exact(HARMONICS)) {
        values.extend(inner.iter().zip(outer).map(|(a, b)| f64::midpoint(*a, *b)));
        values.extend(inner.iter().zip(outer).take(THICKNESS_HARMONICS).map(|(a, b)| b - a));
    }
    values.extend([base_mm, 0.0, 0.0]);
    Shape { values }
}

/// Place, in samples, of the steepest rise (`sign` 1, inside of mid-wall) or fall (−1, outside), by a parabola through three slopes.
fn steepest(profile: &[f64], centre: usize, sign: f64) -> Option<f64> {
    let reach = (SLOPE_REACH_MM / STEP_MM) as usize;
    let (low, high) =
        if sign > 0.0 { (centre.saturating_sub(reach).max(2), centre) } else { (centre, (centre + reach).min(profile.len() - 3)) };
    let slope = |k: usize| sign * (profile[k + 1] - profile[k - 1]);
    let best = (low..=high).filter(|&k| k >= 2 && k + 3 <= profile.len()).max_by(|&a, &b| slope(a).total_cmp(&slope(b)))?;
    if slope(best) <= 0.0 || best == low || best == high {
        return None;
    }
    let (before, at, after) = (slope(best - 1), slope(best), slope(best + 1));
    let bend = before - 2.0 * at + after;
    Some(best as f64 + if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 })
}

/// Height over the centre at which the wall's counts have fallen half way to the background: the median over the angles.
fn base_height(space: &Space, nodes: &[(f64, Angle)], peak: &[f64], background: f64) -> Option<f64> {
    let largest = peak.iter().copied().fold(0.0, f64::max);
    let mut heights = Vec::new();
    for j in 0..AROUND {
        let column: Vec<(f64, f64)> = (0..ALONG).map(|i| (nodes[i * AROUND + j].0, peak[i * AROUND + j])).collect();
        let middle = column.iter().filter(|(s, _)| (FRAC_PI_2 - 0.3..FRAC_PI_2 + 0.5).contains(s)).map(|pair| pair.1);
        let reference = percentile(middle, 0.5);
        if reference < 0.35 * largest {
            continue;
        }
        let half = background + 0.5 * (reference - background);
        let crossing = column.windows(2).find(|pair| pair[0].0 > FRAC_PI_2 + 0.2 && pair[0].1 >= half && half > pair[1].1);
        if let Some([(s, above), (next, below)]) = crossing {
            heights.push((s + (above - half) / (above - below) * (next - s) - FRAC_PI_2) * space.frame.unit_mm);
        }
    }
    (heights.len() > AROUND / 4).then(|| percentile(heights.into_iter(), 0.5))
}

/// Roughness allowed against the rays' scatter (bend, and slope of the round part), and how often outliers are weighed down (the prototype's values).
const SMOOTHING: [f64; 2] = [2.0, 0.0];
const ROUNDS: usize = 3;
/// Roughness where half of the wall may be missing: a departure from the half-ellipsoid has to be seen on many rays.
const CONTINUATION: [f64; 2] = [20.0, 5.0];

/// A smooth function through values at the nodes where there are any: penalised least squares, robust (Cauchy weights).
fn smooth(net: &Net, values: &[Option<f64>], [bend, slope]: [f64; 2]) -> Vec<f64> {
    let given: Vec<(&Row, f64)> = net.rows.iter().zip(values).filter_map(|(row, value)| value.map(|value| (row, value))).collect();
    let penalty = roughness(HARMONICS, 1.0, 1.0);
    let mut weights = vec![1.0; given.len()];
    let mut solution = vec![0.0; N];
    for _ in 0..ROUNDS {
        let mut matrix = vec![0.0; N * N];
        let mut right = vec![0.0; N];
        for (entry, place) in matrix.iter_mut().zip(&penalty) {
            *entry = bend * place;
        }
        for spline in 0..SPLINES - 1 {
            let (a, b) = (spline * HARMONICS, (spline + 1) * HARMONICS);
            for (i, j, sign) in [(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)] {
                matrix[i * N + j] += slope * sign;
            }
        }
        for i in 0..N {
            matrix[i * N + i] += 1e-6;
        }
        add_rows(&given, &weights, &mut matrix, &mut right);
        if let Some(found) = solve_positive(matrix, right) {
            solution = found;
        }
        let errors: Vec<f64> = given.iter().map(|(row, value)| value - row.value(&solution)).collect();
        let spread = 1.48 * percentile(errors.iter().map(|error| error.abs()), 0.5) + 0.3;
        weights = errors.iter().map(|error| 1.0 / (1.0 + (error / (2.0 * spread)).powi(2))).collect();
    }
    solution
}

vectorised! {
    /// Adds what weighted values say of the coefficients to normal equations `[N × N]`.
    fn add_rows(given: &[(&Row, f64)], weights: &[f64], matrix: &mut [f64], right: &mut [f64]) {
        for ((Row { start, terms }, value), weight) in given.iter().zip(weights) {
            let weighted: [f64; TERMS] = std::array::from_fn(|i| weight * terms[i]);
            for (a, x) in weighted.iter().enumerate() {
                right[start + a] += x * value;
                for (to, y) in matrix[(start + a) * N + start..][..TERMS].iter_mut().zip(terms) {
                    *to += x * y;
                }
            }
        }
    }
}

/// How much more a slope at the apex counts than a bend elsewhere.
const APEX: f64 = 5.0;

/// Penalty on roughness, `[N × N]` for `SPLINES × count` coefficients: second differences of the round part, first differences and size of
/// the harmonics, the more the higher.
pub(super) fn roughness(count: usize, round: f64, harmonic: f64) -> Vec<f64> {
    let n = SPLINES * count;
    let mut matrix = vec![0.0; n * n];
    let mut add = |terms: &[(usize, f64)]| {
        for &(a, x) in terms {
            for &(b, y) in terms {
                matrix[a * n + b] += x * y;
            }
        }
    };
    for h in 0..count {
        let at = |spline: usize| spline * count + h;
        if h == 0 {
            // Level at the apex, where all directions meet: a slope there is a cone.
            add(&[(at(0), APEX), (at(1), -APEX)]);
            for i in 0..SPLINES - 2 {
                add(&[(at(i), round), (at(i + 1), -2.0 * round), (at(i + 2), round)]);
            }
        } else {
            let m = order(h) as f64;
            for i in 0..SPLINES - 1 {
                add(&[(at(i), -harmonic * m), (at(i + 1), harmonic * m)]);
            }
            for i in 0..SPLINES {
                add(&[(at(i), 0.3 * harmonic * m * m)]);
            }
        }
    }
    matrix
}

fn largest(values: &[f64]) -> usize {
    values.iter().enumerate().fold(0, |best, (i, &value)| if value > values[best] { i } else { best })
}

/// A percentile, `part` in 0-1; 0 of nothing.
pub(super) fn percentile(values: impl Iterator<Item = f64>, part: f64) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    if sorted.is_empty() {
        return 0.0;
    }
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * part).round() as usize]
}

/// Uptake above which the wall counts as normal, and the typical relative uptake of such a wall (the prototype's).
const NORMAL: f64 = 0.7;
const TYPICAL: f64 = 0.85;

/// The uptake map that rays of all gates show, as coefficients of α − 1: 0 where the wall takes up normally, the ratio measured elsewhere.
pub(super) fn uptake_map(space: &Space, rays: &[Rays], base_mm: f64) -> Vec<f64> {
    let net = Net::new(&space.basis);
    let end = space.frame.s_of_height(base_mm) - 0.25;
    let values: Vec<Option<f64>> = net
        .places
        .iter()
        .enumerate()
        .map(|(node, (s, _))| {
            let of_gates =
                rays.iter().map(|rays| (rays.peak[node] - rays.background) / (rays.wall - rays.background).max(f64::MIN_POSITIVE));
            let uptake = (of_gates.sum::<f64>() / rays.len() as f64).clamp(0.0, 1.0);
            (*s < end).then(|| if uptake > NORMAL { 0.0 } else { uptake / TYPICAL - 1.0 })
        })
        .collect();
    let mut map = vec![0.0; SPLINES * MAP_HARMONICS];
    for (of_map, found) in map.chunks_exact_mut(MAP_HARMONICS).zip(smooth(&net, &values, [0.3, 0.0]).chunks_exact(HARMONICS)) {
        of_map[..HARMONICS].copy_from_slice(found);
    }
    map
}

/// Parts of the wall that counts say little of, 0-1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unseen {
    /// With low uptake.
    pub(super) low: f64,
    /// Outside the grid or the field of view.
    pub(super) outside: f64,
}

/// How much of the wall has low uptake (the median over the gates) or lies where nothing was counted.
pub(super) fn unseen(study: &Study, space: &Space, rays: &[Rays]) -> Unseen {
    let low = percentile(rays.iter().map(|rays| rays.low), 0.5);
    let base_mm = percentile(rays.iter().map(|rays| rays.base_mm.unwrap_or(space.frame.base_mm)), 0.5);
    let end = space.frame.s_of_height(base_mm);
    let (mut outside, mut all) = (0.0, f64::MIN_POSITIVE);
    for (s, angle) in places(&space.basis).filter(|(s, _)| *s < end) {
        let weight = if s < FRAC_PI_2 { s.sin() } else { 1.0 };
        all += weight;
        let point_mm = space.frame.point(s, &angle, pose_radius(&space.frame, s));
        let counted = |voxel: [usize; 3]| study.gates.iter().any(|gate| gate.volume.counts[voxel] > 0.0);
        if !study.grid.voxel_at(point_mm).is_some_and(counted) {
            outside += weight;
        }
    }
    Unseen { low: low.min(1.0 - outside / all), outside: outside / all }
}

/// Counts along the ray of every node, so many samples each.
fn profiles(volume: &Volume, frame: &Frame, nodes: &[(f64, Angle)], samples: usize) -> Vec<Vec<f64>> {
    let step = volume.grid.step_mm();
    let counts = volume.counts.as_standard_layout();
    let Some(counts) = counts.as_slice() else { return Vec::new() };
    nodes
        .iter()
        .map(|(s, angle)| {
            let from = frame.point(*s, angle, FIRST_MM) / step;
            let by = (frame.point(*s, angle, FIRST_MM + STEP_MM) / step) - from;
            let mut profile = vec![0.0; samples];
            sample_along(counts, volume.grid.shape, [from.z, from.y, from.x], [by.z, by.y, by.x], &mut profile);
            profile
        })
        .collect()
}

vectorised! {
    /// Cubic convolution (Keys 1981) of counts at points `from`, `from + by` and so on, in voxels `[z, y, x]`; points outside take the nearest
    /// face's values.
    fn sample_along(counts: &[f32], shape: [usize; 3], from: [f64; 3], by: [f64; 3], samples: &mut [f64]) {
        let [_, ny, nx] = shape;
        for (k, sample) in samples.iter_mut().enumerate() {
            let mut places = [[0_usize; 4]; 3];
            let mut weights = [[0.0_f64; 4]; 3];
            for axis in 0..3 {
                let last = shape[axis] - 1;
                let at = (from[axis] + by[axis] * k as f64).clamp(0.0, last as f64);
                let floor = at as usize;
                let t = at - floor as f64;
                places[axis] = [floor.saturating_sub(1), floor, (floor + 1).min(last), (floor + 2).min(last)];
                let (t2, t3) = (t * t, t * t * t);
                weights[axis] =
                    [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2];
            }
            let mut sum = 0.0;
            for (z, wz) in places[0].iter().zip(weights[0]) {
                for (y, wy) in places[1].iter().zip(weights[1]) {
                    let line = &counts[(z * ny + y) * nx..][..nx];
                    let row: f64 = places[2].iter().zip(weights[2]).map(|(x, wx)| wx * f64::from(line[*x])).sum();
                    sum += wz * wy * row;
                }
            }
            *sample = sum;
        }
    }
}
