//! Borders along rays across the wall, without a model of the camera: where the wall lies, where its counts rise and fall most steeply,
//! where it ends at the valves, and how much it takes up. Start, fallback and referee of the model's fit.

use super::{
    basis::{Angle, Basis, HARMONICS, MAP_HARMONICS, SPLINES, WHOLE, order},
    frame::Frame,
    linear::solve_positive,
    shape::{STRIDE, Shape, Space, THICKNESS_HARMONICS},
};
use crate::{
    study::Study,
    volume::{Grid, Volume},
};
use glam::DVec3;
use ndarray::Array3;
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

/// The mid-wall surface of a pose: half an ellipsoid in the cap, a cylinder above.
pub(super) fn pose_radius(frame: &Frame, s: f64) -> f64 {
    if s >= FRAC_PI_2 {
        return frame.unit_mm;
    }
    let (sin, cos) = s.sin_cos();
    1.0 / (sin / frame.unit_mm).hypot(cos / frame.apex_mm)
}

/// Casts the rays of one gate.
pub(super) fn cast(volume: &Volume, space: &Space) -> Rays {
    let (frame, basis) = (&space.frame, &space.basis);
    let longest = frame.unit_mm.max(frame.apex_mm) + BEYOND_MM + SLOPE_REACH_MM;
    let samples = ((longest - FIRST_MM) / STEP_MM) as usize + 1;
    let radius = |k: usize| FIRST_MM + STEP_MM * k as f64;
    let image = Interpolated::new(volume);
    let profiles: Vec<Vec<f64>> =
        places(basis).map(|(s, angle)| (0..samples).map(|k| image.at(frame.point(s, &angle, radius(k)))).collect()).collect();
    let nodes: Vec<(f64, Angle)> = places(basis).collect();
    let limit: Vec<usize> =
        nodes.iter().map(|&(s, _)| (((pose_radius(frame, s) + BEYOND_MM - FIRST_MM) / STEP_MM) as usize).min(samples - 1)).collect();
    let brightest: Vec<usize> = profiles.iter().zip(&limit).map(|(profile, &end)| largest(&profile[1..=end]) + 1).collect();
    let heights: Vec<f64> = profiles.iter().zip(&brightest).map(|(profile, &k)| profile[k]).collect();
    let below_base = |s: f64| s < frame.s_of_height(frame.base_mm);
    let reference = percentile(nodes.iter().zip(&heights).filter(|((s, _), _)| below_base(*s)).map(|(_, &height)| height), 0.9);
    let seen: Vec<bool> = nodes.iter().zip(&heights).map(|((s, _), &height)| below_base(*s) && height > SEEN * reference).collect();
    let found: Vec<Option<f64>> = seen.iter().zip(&brightest).map(|(&seen, &k)| seen.then(|| radius(k))).collect();
    let mid = smooth(basis, &nodes, &found, SMOOTHING);
    let mid_at = |s: f64, angle: &Angle| basis.at(s, angle).value(&mid, WHOLE).clamp(4.0, longest - SLOPE_REACH_MM);
    let index = |mm: f64| (((mm - FIRST_MM) / STEP_MM).round().max(0.0) as usize).min(samples - 1);
    let near = |profile: &[f64], centre: usize, reach: usize| {
        let (low, end) = (centre.saturating_sub(reach), (centre + reach + 1).min(samples));
        let at = low + largest(&profile[low..end]);
        (profile[at], radius(at))
    };
    let peaks: Vec<(f64, f64)> =
        nodes.iter().zip(&profiles).map(|((s, angle), profile)| near(profile, index(mid_at(*s, angle)), 7)).collect();
    let peak: Vec<f64> = peaks.iter().map(|peak| peak.0).collect();
    let background = percentile(profiles.iter().flatten().copied(), 0.15);
    let blood = percentile(profiles[..profiles.len() / 2].iter().flat_map(|profile| profile[..6].iter().copied()), 0.5);
    let base_mm = base_height(space, &nodes, &peak, background);
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
    let departure = smooth(basis, &nodes, &departures, CONTINUATION);
    let whole: Vec<Option<f64>> = nodes
        .iter()
        .zip(&of_pose)
        .map(|((s, angle), of_pose)| Some(of_pose * (1.0 + basis.at(*s, angle).value(&departure, WHOLE) / frame.unit_mm)))
        .collect();
    let continued = smooth(basis, &nodes, &whole, [1e-3, 0.0]);
    let slopes = |sign: f64| -> Vec<Option<f64>> {
        nodes
            .iter()
            .zip(profiles.iter().zip(&seen))
            .map(|((s, angle), (profile, &seen))| {
                let centre = mid_at(*s, angle);
                let usable = seen && *s < end - 0.15;
                usable.then(|| steepest(profile, index(centre), sign)).flatten().map(|k| FIRST_MM + STEP_MM * k)
            })
            .collect()
    };
    let (inner, outer) = (smooth(basis, &nodes, &slopes(1.0), SMOOTHING), smooth(basis, &nodes, &slopes(-1.0), SMOOTHING));
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
fn smooth(basis: &Basis, nodes: &[(f64, Angle)], values: &[Option<f64>], [bend, slope]: [f64; 2]) -> Vec<f64> {
    const N: usize = SPLINES * HARMONICS;
    let given: Vec<(usize, f64)> = values.iter().enumerate().filter_map(|(i, value)| value.map(|value| (i, value))).collect();
    let rows: Vec<Vec<(usize, f64)>> = given.iter().map(|&(i, _)| basis.at(nodes[i].0, &nodes[i].1).terms()).collect();
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
        for ((row, &(_, value)), &weight) in rows.iter().zip(&given).zip(&weights) {
            for &(a, x) in row {
                right[a] += weight * x * value;
                for &(b, y) in row {
                    matrix[a * N + b] += weight * x * y;
                }
            }
        }
        if let Some(found) = solve_positive(matrix, right) {
            solution = found;
        }
        let errors: Vec<f64> =
            rows.iter().zip(&given).map(|(row, &(_, value))| value - row.iter().map(|&(a, x)| x * solution[a]).sum::<f64>()).collect();
        let spread = 1.48 * percentile(errors.iter().map(|error| error.abs()), 0.5) + 0.3;
        weights = errors.iter().map(|error| 1.0 / (1.0 + (error / (2.0 * spread)).powi(2))).collect();
    }
    solution
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
    let nodes: Vec<(f64, Angle)> = places(&space.basis).collect();
    let end = space.frame.s_of_height(base_mm) - 0.25;
    let values: Vec<Option<f64>> = nodes
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
    for (of_map, found) in
        map.chunks_exact_mut(MAP_HARMONICS).zip(smooth(&space.basis, &nodes, &values, [0.3, 0.0]).chunks_exact(HARMONICS))
    {
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

/// Cubic convolution (Keys 1981) of a volume; points outside take the nearest face's values.
struct Interpolated<'a> {
    grid: Grid,
    counts: &'a Array3<f32>,
}

impl<'a> Interpolated<'a> {
    fn new(volume: &'a Volume) -> Self {
        Self { grid: volume.grid, counts: &volume.counts }
    }

    fn at(&self, point_mm: DVec3) -> f64 {
        let index = self.grid.fractional_index(point_mm);
        let mut places = [[0_usize; 4]; 3];
        let mut weights = [[0.0_f64; 4]; 3];
        for axis in 0..3 {
            let last = (self.grid.shape[axis] - 1) as f64;
            let at = index[axis].clamp(0.0, last);
            let floor = at.floor();
            let t = at - floor;
            for (k, offset) in [-1.0, 0.0, 1.0, 2.0].into_iter().enumerate() {
                places[axis][k] = (floor + offset).clamp(0.0, last) as usize;
            }
            let (t2, t3) = (t * t, t * t * t);
            weights[axis] = [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2];
        }
        let mut sum = 0.0;
        for (z, wz) in places[0].iter().zip(weights[0]) {
            for (y, wy) in places[1].iter().zip(weights[1]) {
                let row: f64 = places[2].iter().zip(weights[2]).map(|(x, wx)| wx * f64::from(self.counts[[*z, *y, *x]])).sum();
                sum += wz * wy * row;
            }
        }
        sum
    }
}
