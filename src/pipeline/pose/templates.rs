//! Stage two: half-ellipsoid walls, open at the base, in all directions about the candidates of stage one.

use super::{
    super::{
        PipelineError,
        monitor::{self, Monitor},
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

/// A template's points in nodes about its base: wall points first.
struct Template {
    wall: usize,
    points: Vec<([f32; 3], f32, f32)>,
}

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
    fn turned(wall: usize, upright: &[(DVec3, f32, f32)], to_apex: DVec3, step_mm: f64) -> Self {
        let turn = frame(to_apex);
        let points = upright
            .iter()
            .map(|&(point, sign, weight)| {
                let place = turn * point / step_mm;
                ([place.x as f32, place.y as f32, place.z as f32], sign, weight)
            })
            .collect();
        Self { wall, points }
    }

    /// Correlation with the counts at a base (in nodes); -1 where less than three quarters of the wall is in the field of view.
    fn correlation(&self, field: &Field, base: DVec3) -> f64 {
        let base = [base.x as f32, base.y as f32, base.z as f32];
        let mut correlation = Correlation::default();
        let mut known = 0;
        for (index, &(offset, sign, weight)) in self.points.iter().enumerate() {
            // Truncation after a large shift is rounding.
            let value = field.node([0, 1, 2].map(|axis| (base[axis] + offset[axis] + 1024.5) as i32 - 1024));
            if !value.is_nan() {
                correlation.add(value, sign, weight);
                known += usize::from(index < self.wall);
            }
            if index + 1 == self.wall && 4 * known < 3 * self.wall {
                return -1.0;
            }
        }
        correlation.value()
    }
}

/// The best poses about the candidates, best first, no two alike.
pub(super) fn starts(field: &Field, candidates: &[Candidate], held: &Held, monitor: &dyn Monitor) -> Result<Vec<Start>, PipelineError> {
    let directions = cube_directions(FACE_SIDE);
    let mut found: Vec<Start> = Vec::new();
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
                let template = Template::turned(wall, &upright, to_apex, field.step_mm);
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
