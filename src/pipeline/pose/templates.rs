//! Stage two: half-ellipsoid walls, open at the base, in all directions about the candidates of stage one.

use super::{
    super::{
        PipelineError,
        monitor::{self, Monitor},
        simd::vectorised,
    },
    held::Held,
    prepare::Field,
    shape::{Shell, cube_directions, frame},
    shells::{Candidate, Correlation},
};
use glam::DVec3;
use std::f64::consts::TAU;

/// Mid-wall radii in mm.
const RADII_MM: [f64; 5] = [17.0, 22.0, 27.0, 33.0, 40.0];
/// Length over radius. Ventricles have 2.1-3.1 at mid-wall; shorter cups fit defective hearts at a right angle.
const ELONGATIONS: [f64; 3] = [2.0, 2.5, 3.0];
/// Height of the widest section as part of the length, in templates.
pub(super) const WIDEST: f64 = 0.33;
/// Where the sphere's centre may lie on the axis, as part of the length from the base.
const CENTRES: [f64; 3] = [0.3, 0.45, 0.6];
/// Directions: 6 faces of 6 x 6, 15 degrees apart.
const FACE_SIDE: usize = 6;
/// From mid-wall to where it is dark outside.
pub(super) const OUTSIDE_MM: f64 = 14.0;
/// Poses within this and [`SAME_COSINE`] are the same.
const SAME_MM: f64 = 10.0;
const SAME_COSINE: f64 = 0.8;
/// Poses that go on to the fit.
const MOST_STARTS: usize = 6;

/// A pose worth fitting.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub shell: Shell,
    pub correlation: f64,
}

/// A point on the mid-wall of an upright shell (valve plane at 0, axis along z) and its outward normal.
pub(super) fn wall_points(shell: &Shell) -> Vec<(DVec3, DVec3)> {
    let half_length = (1.0 - shell.widest) * shell.length_mm;
    // Polar angle from the tip; the last ring lies in the valve plane.
    let last = (-shell.widest / (1.0 - shell.widest)).acos();
    let mut points = Vec::new();
    for ring in 0..=8 {
        let (sine, cosine) = (last * f64::from(ring) / 8.0).sin_cos();
        let around = if sine > 0.5 {
            16
        } else if sine > 0.15 {
            8
        } else {
            1
        };
        let normal = DVec3::new(sine / shell.radius_mm, 0.0, cosine / half_length).normalize();
        let (radius, height) = (shell.radius_mm * sine, shell.widest * shell.length_mm + half_length * cosine);
        for step in 0..around {
            let (s, c) = (TAU * f64::from(step) / f64::from(around)).sin_cos();
            points.push((DVec3::new(radius * c, radius * s, height), DVec3::new(normal.x * c, normal.x * s, normal.z)));
        }
    }
    points
}

/// From mid-wall to the dark inside.
pub(super) fn inside_mm(radius_mm: f64) -> f64 {
    if radius_mm > 20.0 { 13.0 } else { 11.0 }
}

/// A template's points in nodes about its base: wall points first. Filled up to whole steps with points of no weight.
#[derive(Default)]
struct Template {
    wall: usize,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    sign: Vec<f32>,
    weight: Vec<f32>,
    /// Where the points fall in the field, and what it has there.
    places: Vec<u32>,
    values: Vec<f32>,
}

/// Points are added up so many at a time.
const STEP: usize = 16;

/// The points of an upright template with their sign and weight, wall points first.
fn upright(radius_mm: f64, length_mm: f64) -> (usize, Vec<(DVec3, f32, f32)>) {
    let shell = Shell { base_mm: DVec3::ZERO, to_apex: DVec3::Z, radius_mm, length_mm, widest: WIDEST };
    let wall = wall_points(&shell);
    let count = wall.len();
    let mut points = Vec::new();
    // Each group has one voice whatever its number of points: the wall 2.2, inside 1, outside .7, opening and what is behind it .7.
    points.extend(wall.iter().map(|&(point, _)| (point, 1.0, 2.2 / count as f32)));
    points.extend(wall.iter().map(|&(point, normal)| (point - normal * inside_mm(radius_mm), -1.0, 1.0 / count as f32)));
    points.extend(wall.iter().map(|&(point, normal)| (point + normal * OUTSIDE_MM, -1.0, 0.7 / count as f32)));
    let mut opening = Vec::new();
    for (part, z) in [(0.0, -2.0), (0.4, -2.0), (0.0, -10.0), (0.5, -10.0), (0.95, -15.0)] {
        let around = if part > 0.0 { 8 } else { 1 };
        for step in 0..around {
            let (s, c) = (TAU * f64::from(step) / f64::from(around)).sin_cos();
            opening.push(DVec3::new(part * radius_mm * c, part * radius_mm * s, z));
        }
    }
    let each = 0.7 / opening.len() as f32;
    points.extend(opening.into_iter().map(|point| (point, -1.0, each)));
    (count, points)
}

impl Template {
    /// Takes the points of an upright template, turned.
    fn turn(&mut self, wall: usize, upright: &[(DVec3, f32, f32)], to_apex: DVec3, step_mm: f64) {
        let turn = frame(to_apex);
        self.wall = wall;
        let count = upright.len().next_multiple_of(STEP);
        for list in [&mut self.x, &mut self.y, &mut self.z, &mut self.sign, &mut self.weight] {
            list.clear();
            list.resize(count, 0.0);
        }
        for (index, &(point, sign, weight)) in upright.iter().enumerate() {
            let place = turn * point / step_mm;
            (self.x[index], self.y[index], self.z[index]) = (place.x as f32, place.y as f32, place.z as f32);
            (self.sign[index], self.weight[index]) = (sign, weight);
        }
        self.places.resize(count, 0);
    }

    /// Correlation with the counts at a base (in nodes); -1 where less than three quarters of the wall is in the field of view.
    fn correlation(&mut self, field: &Field, base: DVec3) -> f64 {
        let base = [base.x as f32, base.y as f32, base.z as f32];
        let nodes = field.nodes.map(|nodes| nodes as u32);
        find_places([&self.x, &self.y, &self.z], base, nodes, field.nowhere(), &mut self.places);
        field.gather(&self.places, &mut self.values);
        let known = self.values[..self.wall].iter().filter(|value| !value.is_nan()).count();
        if 4 * known < 3 * self.wall {
            return -1.0;
        }
        Correlation::of_sums(add_up(&self.values, &self.sign, &self.weight)).value()
    }
}

/// 1.5 · 2²³: a number added to it is rounded to a whole one, which then stands in its last bits.
const ROUNDS: f32 = 12_582_912.0;

vectorised! {
    /// Places in memory of points about a base, all in nodes; those outside are `nowhere`.
    fn find_places(points: [&[f32]; 3], base: [f32; 3], nodes: [u32; 3], nowhere: u32, places: &mut [u32]) {
        let [x, y, z] = points;
        // Negative indices become huge ones.
        let index = |base: f32, offset: f32| (base + offset + ROUNDS).to_bits().wrapping_sub(ROUNDS.to_bits());
        for ((place, x), (y, z)) in places.iter_mut().zip(x).zip(y.iter().zip(z)) {
            let (x, y, z) = (index(base[0], *x), index(base[1], *y), index(base[2], *z));
            let at = z.wrapping_mul(nodes[1]).wrapping_add(y).wrapping_mul(nodes[0]).wrapping_add(x);
            *place = if x < nodes[0] && y < nodes[1] && z < nodes[2] { at } else { nowhere };
        }
    }
}

vectorised! {
    /// The sums of [`Correlation::of_sums`] over the known values, in lanes of their own.
    fn add_up(values: &[f32], sign: &[f32], weight: &[f32]) -> [f32; 5] {
        let mut lanes = [[0.0_f32; STEP]; 5];
        let shapes = sign.as_chunks::<STEP>().0.iter().zip(weight.as_chunks::<STEP>().0);
        for (values, (sign, weight)) in values.as_chunks::<STEP>().0.iter().zip(shapes) {
            for i in 0..STEP {
                let known = !values[i].is_nan();
                let (value, weight) = (if known { values[i] } else { 0.0 }, if known { weight[i] } else { 0.0 });
                let weighted = weight * value;
                lanes[0][i] += weight;
                lanes[1][i] += weight * sign[i];
                lanes[2][i] += weighted;
                lanes[3][i] += weighted * value;
                lanes[4][i] += weighted * sign[i];
            }
        }
        lanes.map(|lanes| lanes.iter().sum())
    }
}

/// The best poses about the candidates, best first, no two alike.
pub(super) fn starts(field: &Field, candidates: &[Candidate], held: &Held, monitor: &dyn Monitor) -> Result<Vec<Start>, PipelineError> {
    let directions = cube_directions(FACE_SIDE);
    let mut found: Vec<Start> = Vec::new();
    let mut template = Template::default();
    for radius_mm in RADII_MM {
        for elongation in ELONGATIONS {
            let length_mm = radius_mm * elongation;
            if !(40.0..=125.0).contains(&length_mm) {
                continue;
            }
            let near: Vec<&Candidate> =
                candidates.iter().filter(|c| radius_mm > 0.75 * c.radius_mm && radius_mm < 1.25 * c.radius_mm + 3.0).collect();
            let (wall, upright) = upright(radius_mm, length_mm);
            for &to_apex in &directions {
                monitor::check(monitor)?;
                template.turn(wall, &upright, to_apex, field.step_mm);
                let mut best: Option<Start> = None;
                for candidate in &near {
                    for part in CENTRES {
                        let base_mm = candidate.centre_mm - to_apex * (part * length_mm);
                        let shell = held.placed(Shell { base_mm, to_apex, radius_mm, length_mm, widest: WIDEST });
                        let correlation = template.correlation(field, field.index_of(shell.base_mm));
                        if best.is_none_or(|best| correlation > best.correlation) {
                            best = Some(Start { shell, correlation });
                        }
                    }
                }
                found.extend(best);
            }
        }
    }
    found.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    let mut different: Vec<Start> = Vec::new();
    for start in found {
        if different.len() >= MOST_STARTS {
            break;
        }
        if start.correlation > 0.0 && different.iter().all(|other| !alike(&other.shell, &start.shell)) {
            different.push(start);
        }
    }
    Ok(different)
}

/// Whether two shells are about the same pose.
pub(super) fn alike(a: &Shell, b: &Shell) -> bool {
    a.middle_mm().distance(b.middle_mm()) <= SAME_MM && a.to_apex.dot(b.to_apex) >= SAME_COSINE
}
