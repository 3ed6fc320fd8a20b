//! Condition functions of deformable surfaces (Baraff & Witkin 1998, "Large steps in cloth simulation", §4): each is a number C of a few
//! particles that is zero at rest, and pulls its particles with −k C ∇C − kd Ċ ∇C. Values, gradients and second derivatives in closed form.
//!
//! Baraff & Witkin weigh stretch and shear by the triangle's area a. Here the weight is √a: the energy k C²/2 is then area × strain², the
//! same for a surface however finely it is divided, and all conditions but bend are lengths in mm, so that the paper's one constant K = 10
//! means the same for a spring and for a triangle.

use glam::{DMat3, DVec3};
use std::array;

/// A condition of `N` particles.
pub trait Condition<const N: usize> {
    /// C and ∇C where the particles are.
    fn slope(&self, places: [DVec3; N]) -> Slope<N>;

    /// ∂²C/∂x∂x of each pair of particles, symmetric.
    fn curvature(&self, places: [DVec3; N]) -> [[DMat3; N]; N];
}

/// A condition at one place.
#[derive(Debug, Clone, Copy)]
pub struct Slope<const N: usize> {
    /// C, zero at rest.
    pub value: f64,
    /// ∂C/∂x of each particle.
    pub gradient: [DVec3; N],
}

/// Elongation of a spring in mm: |x₁ − x₀| − rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spring {
    /// Length at rest in mm.
    pub rest_mm: f64,
}

impl Condition<2> for Spring {
    fn slope(&self, [a, b]: [DVec3; 2]) -> Slope<2> {
        let length = a.distance(b).max(f64::MIN_POSITIVE);
        let unit = (b - a) / length;
        Slope { value: length - self.rest_mm, gradient: [-unit, unit] }
    }

    fn curvature(&self, [a, b]: [DVec3; 2]) -> [[DMat3; 2]; 2] {
        let across = of_length(b - a);
        [[across, -across], [-across, across]]
    }
}

/// Stretch of a triangle in one direction, √a (|w| − 1) in mm with w = Σ weightᵢ xᵢ, the image of a unit vector of the triangle at rest
/// (equations 9 and 10).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    weights: [f64; 3],
    root_area_mm: f64,
}

/// Shear of a triangle, `√a w_u·w_v` in mm (§4.2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shear {
    u: [f64; 3],
    v: [f64; 3],
    root_area_mm: f64,
}

/// The conditions of a triangle that is at rest with these corners: stretch along its first edge, stretch across it, shear. `None` for one
/// without area.
pub fn triangle([a, b, c]: [DVec3; 3]) -> Option<([Stretch; 2], Shear)> {
    let along = (b - a).try_normalize()?;
    let twice_area = (b - a).cross(c - a).length();
    let (b_u, c_u) = ((b - a).length(), (c - a).dot(along));
    if twice_area <= 1e-9 * b_u * b_u {
        return None;
    }
    let of_edges = |b: f64, c: f64| [-b - c, b, c];
    let (u, v) = (of_edges(1.0 / b_u, 0.0), of_edges(-c_u / twice_area, b_u / twice_area));
    let root_area_mm = (twice_area / 2.0).sqrt();
    Some(([u, v].map(|weights| Stretch { weights, root_area_mm }), Shear { u, v, root_area_mm }))
}

impl Condition<3> for Stretch {
    fn slope(&self, corners: [DVec3; 3]) -> Slope<3> {
        let w = combine(self.weights, corners);
        let length = w.length().max(f64::MIN_POSITIVE);
        let unit = w / length;
        Slope { value: self.root_area_mm * (length - 1.0), gradient: self.weights.map(|weight| unit * (self.root_area_mm * weight)) }
    }

    fn curvature(&self, corners: [DVec3; 3]) -> [[DMat3; 3]; 3] {
        let across = of_length(combine(self.weights, corners)) * self.root_area_mm;
        self.weights.map(|first| self.weights.map(|second| across * (first * second)))
    }
}

impl Condition<3> for Shear {
    fn slope(&self, corners: [DVec3; 3]) -> Slope<3> {
        let (w_u, w_v) = (combine(self.u, corners), combine(self.v, corners));
        let gradient = array::from_fn(|i| (w_v * self.u[i] + w_u * self.v[i]) * self.root_area_mm);
        Slope { value: self.root_area_mm * w_u.dot(w_v), gradient }
    }

    fn curvature(&self, _: [DVec3; 3]) -> [[DMat3; 3]; 3] {
        let pair = |i: usize, j: usize| self.root_area_mm * (self.u[i] * self.v[j] + self.v[i] * self.u[j]);
        array::from_fn(|i| array::from_fn(|j| DMat3::IDENTITY * pair(i, j)))
    }
}

fn combine(weights: [f64; 3], corners: [DVec3; 3]) -> DVec3 {
    corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2]
}

/// Bend about the edge x₀x₁ of the triangles (x₀, x₁, x₂) and (x₁, x₀, x₃): their dihedral angle minus the one at rest, in radians (§4.3;
/// there the surface is flat at rest, here it is an ellipsoid).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bend {
    /// Angle at rest, see [`dihedral_rad`].
    pub rest_rad: f64,
}

impl Condition<4> for Bend {
    /// ∇θ at the apex of a triangle is −|e| n/|n|²; the edge's ends share the opposite as on a lever, by the foot of the apex's height.
    fn slope(&self, corners: [DVec3; 4]) -> Slope<4> {
        let [x0, x1, x2, x3] = corners;
        let edge = x1 - x0;
        let length = edge.length().max(f64::MIN_POSITIVE);
        let (first, second) = (level(edge.cross(x2 - x0)), level((x3 - x0).cross(edge)));
        let foot_mm = |apex: DVec3| (apex - x0).dot(edge) / length;
        let end = first * foot_mm(x2) + second * foot_mm(x3);
        let (at_x2, at_x3) = (first * -length, second * -length);
        Slope { value: dihedral_rad(corners) - self.rest_rad, gradient: [-end - at_x2 - at_x3, end, at_x2, at_x3] }
    }

    /// The gradient differentiated once more. The rows of the apices come first; those of the edge's ends follow, since a common shift
    /// changes nothing and the matrix is symmetric.
    fn curvature(&self, [x0, x1, x2, x3]: [DVec3; 4]) -> [[DMat3; 4]; 4] {
        let edge = x1 - x0;
        let length = edge.length().max(f64::MIN_POSITIVE);
        let along = edge / length;
        let sides = [(x2, edge.cross(x2 - x0), 1.0), (x3, (x3 - x0).cross(edge), -1.0)].map(|(apex, normal, turn)| {
            let square = normal.length_squared().max(f64::MIN_POSITIVE);
            let flip = (DMat3::IDENTITY - outer(normal, normal) * (2.0 / square)) * (turn / square);
            let foot_mm = (apex - x0).dot(along);
            Side {
                level: level(normal),
                by_start: flip * cross_matrix(apex - x1),
                by_end: flip * -cross_matrix(apex - x0),
                by_apex: flip * cross_matrix(edge),
                foot_mm,
                foot_by_end: (apex - x0 - along * foot_mm) / length,
            }
        });
        let apex_by_start = sides.each_ref().map(|side| outer(side.level, along) - side.by_start * length);
        let apex_by_end = sides.each_ref().map(|side| -outer(side.level, along) - side.by_end * length);
        let apex_by_apex = sides.each_ref().map(|side| side.by_apex * -length);
        let end_by_end = sides.each_ref().map(|side| outer(side.level, side.foot_by_end) + side.by_end * side.foot_mm);
        let end_by_end = end_by_end[0] + end_by_end[1];
        let end_by_start = -end_by_end - apex_by_end[0].transpose() - apex_by_end[1].transpose();
        let start_by_start = -end_by_start.transpose() - apex_by_start[0].transpose() - apex_by_start[1].transpose();
        [
            [start_by_start, end_by_start.transpose(), apex_by_start[0].transpose(), apex_by_start[1].transpose()],
            [end_by_start, end_by_end, apex_by_end[0].transpose(), apex_by_end[1].transpose()],
            [apex_by_start[0], apex_by_end[0], apex_by_apex[0], DMat3::ZERO],
            [apex_by_start[1], apex_by_end[1], DMat3::ZERO, apex_by_apex[1]],
        ]
    }
}

/// What one of two triangles at an edge adds to the bend.
struct Side {
    /// The triangle's normal (twice its area long) over its length squared, in 1/mm².
    level: DVec3,
    by_start: DMat3,
    by_end: DMat3,
    by_apex: DMat3,
    /// Where the height of the apex meets the edge, from its start, in mm.
    foot_mm: f64,
    foot_by_end: DVec3,
}

/// Angle between the normals of the triangles (x₀, x₁, x₂) and (x₁, x₀, x₃), positive where the surface is convex, in radians.
pub fn dihedral_rad([x0, x1, x2, x3]: [DVec3; 4]) -> f64 {
    let edge = x1 - x0;
    let (first, second) = (edge.cross(x2 - x0), (x3 - x0).cross(edge));
    (first.cross(second).dot(edge) / edge.length().max(f64::MIN_POSITIVE)).atan2(first.dot(second))
}

/// n/|n|².
fn level(normal: DVec3) -> DVec3 {
    normal / normal.length_squared().max(f64::MIN_POSITIVE)
}

/// Second derivative of a vector's length: (1 − w wᵀ/|w|²)/|w|.
fn of_length(vector: DVec3) -> DMat3 {
    let length = vector.length().max(f64::MIN_POSITIVE);
    (DMat3::IDENTITY - outer(vector, vector) / (length * length)) / length
}

/// a bᵀ.
pub(super) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// The matrix M with M x = a × x.
fn cross_matrix(a: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, a.z, -a.y), DVec3::new(-a.z, 0.0, a.x), DVec3::new(a.y, -a.x, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_MM: f64 = 1e-5;
    const RELATIVE: f64 = 1e-6;

    /// Corners of two triangles, bent, stretched and sheared, in mm; the others are turned copies.
    fn places() -> impl Iterator<Item = [DVec3; 4]> {
        let corners = [DVec3::new(0.3, -0.2, 0.1), DVec3::new(8.1, 0.7, -0.5), DVec3::new(3.2, 7.9, 1.6), DVec3::new(4.9, -6.4, 2.3)];
        (0..6).map(move |turn| {
            let turn = f64::from(turn);
            let rotation = DMat3::from_rotation_z(turn) * DMat3::from_rotation_x(0.7 * turn);
            corners.map(|corner| rotation * (corner + DVec3::new(0.3 * turn * corner.y.sin(), 0.0, 0.4 * turn * corner.x.cos())))
        })
    }

    fn rest() -> ([Stretch; 2], Shear) {
        triangle([DVec3::ZERO, DVec3::new(7.0, 1.0, 0.0), DVec3::new(2.5, 6.0, 1.0)]).unwrap()
    }

    /// Gradient and curvature against central differences of the value and of the gradient.
    fn check<const N: usize>(places: [DVec3; N], condition: &impl Condition<N>) {
        let (here, curvature) = (condition.slope(places), condition.curvature(places));
        let moved = |particle: usize, axis: usize, by: f64| {
            let mut places = places;
            places[particle][axis] += by;
            condition.slope(places)
        };
        let scale: f64 = here.gradient.iter().map(|g| g.length()).fold(0.0, f64::max);
        let steepest: f64 = curvature.iter().flatten().flat_map(DMat3::to_cols_array).map(f64::abs).fold(0.0, f64::max);
        for (particle, axis) in (0..N).flat_map(|particle| (0..3).map(move |axis| (particle, axis))) {
            let (low, high) = (moved(particle, axis, -STEP_MM), moved(particle, axis, STEP_MM));
            let slope = (high.value - low.value) / (2.0 * STEP_MM);
            assert!((here.gradient[particle][axis] - slope).abs() < RELATIVE * scale, "gradient {particle} {axis}");
            for (other, row) in curvature.iter().enumerate() {
                let slope = (high.gradient[other] - low.gradient[other]) / (2.0 * STEP_MM);
                let error = (row[particle].col(axis) - slope).length();
                assert!(error < RELATIVE * steepest, "second derivative {other} by {particle} {axis}: {error} of {steepest}");
            }
        }
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        for [a, b, c, d] in places() {
            let ([along, across], shear) = rest();
            check([a, b], &Spring { rest_mm: 5.0 });
            check([a, b, c], &along);
            check([a, b, c], &across);
            check([a, b, c], &shear);
            check([a, b, c, d], &Bend { rest_rad: 0.1 });
        }
    }

    #[test]
    fn conditions_vanish_at_rest_and_do_not_see_rigid_motion() {
        let corners = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(9.0, 1.0, 4.0), DVec3::new(4.0, 8.0, 2.0), DVec3::new(5.0, -5.0, 1.0)];
        let [a, b, c, _] = corners;
        let ([along, across], shear) = triangle([a, b, c]).unwrap();
        let (spring, bend) = (Spring { rest_mm: a.distance(b) }, Bend { rest_rad: dihedral_rad(corners) });
        let rotation = DMat3::from_rotation_y(1.1) * DMat3::from_rotation_z(-0.4);
        let [a, b, c, d] = corners.map(|corner| rotation * corner + DVec3::new(-30.0, 12.0, 7.0));
        for value in [
            along.slope([a, b, c]).value,
            across.slope([a, b, c]).value,
            shear.slope([a, b, c]).value,
            spring.slope([a, b]).value,
            bend.slope([a, b, c, d]).value,
        ] {
            assert!(value.abs() < 1e-12, "{value}");
        }
    }

    #[test]
    fn stretch_and_shear_are_the_strains_they_are_named_for() {
        let flat = [DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 2.0];
        let ([along, across], shear) = triangle(flat).unwrap();
        // Area 4: the weight is 2.
        let stretched = flat.map(|corner| corner * DVec3::new(1.1, 0.8, 1.0));
        assert!((along.slope(stretched).value - 0.2).abs() < 1e-12 && (across.slope(stretched).value + 0.4).abs() < 1e-12);
        let sheared = flat.map(|corner| DVec3::new(corner.x + 0.3 * corner.y, corner.y, 0.0));
        assert!((shear.slope(sheared).value - 0.6).abs() < 1e-12);
        let folded = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::new(0.5, 0.0, -1.0)];
        assert!((dihedral_rad(folded) - std::f64::consts::FRAC_PI_2).abs() < 1e-12, "convex is positive: {}", dihedral_rad(folded));
        assert!(triangle([DVec3::ZERO, DVec3::X, DVec3::X * 2.0]).is_none());
    }

    #[test]
    fn bending_pushes_nothing_away_and_turns_nothing() {
        for corners in places() {
            let gradient = Bend { rest_rad: 0.0 }.slope(corners).gradient;
            let total: DVec3 = gradient.iter().sum();
            let turning: DVec3 = corners.iter().zip(gradient).map(|(corner, gradient)| corner.cross(gradient)).sum();
            assert!(total.length() < 1e-12 && turning.length() < 1e-10, "neither force nor torque: {total} {turning}");
        }
    }
}
