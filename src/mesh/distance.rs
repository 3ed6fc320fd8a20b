//! The distance from a point to the closest point of a surface's triangles.

use super::Mesh;
use glam::DVec3;

/// Triangles in a block. Those of an icosphere follow each other as they were split, so four in a row are one triangle a level up and lie
/// together; on other meshes blocks are larger and the search slower, not wrong.
const BLOCK: usize = 4;

/// Triangles in blocks with a sphere about each, so that most are passed over.
#[derive(Debug, Clone)]
pub struct Triangles {
    corners: Vec<[DVec3; 3]>,
    /// Centre and radius of the sphere about each block of [`BLOCK`] triangles.
    spheres: Vec<(DVec3, f64)>,
}

impl Triangles {
    /// The triangles of a mesh for which `keep` says so.
    pub fn of(mesh: &Mesh, keep: impl Fn([u32; 3]) -> bool) -> Self {
        let kept = mesh.triangles.iter().zip(mesh.corners()).filter(|(triangle, _)| keep(**triangle));
        let corners: Vec<[DVec3; 3]> = kept.map(|(_, corners)| corners).collect();
        let spheres = corners.chunks(BLOCK).map(|block| sphere_about(block.as_flattened())).collect();
        Self { corners, spheres }
    }

    /// Distance from a point to the closest point of the triangles, in the unit of the mesh; `None` if there are none or the point is not
    /// finite.
    pub fn distance(&self, point: DVec3) -> Option<f64> {
        // The nearest block first: what it holds rules most of the others out.
        let squares = self.spheres.iter().map(|(centre, _)| point.distance_squared(*centre));
        let (nearest, _) = squares.clone().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let mut best = self.square_in_block(nearest, point);
        for (block, (square, (_, radius))) in squares.zip(&self.spheres).enumerate() {
            if block != nearest && square < (best.sqrt() + radius).powi(2) {
                best = best.min(self.square_in_block(block, point));
            }
        }
        best.is_finite().then(|| best.sqrt())
    }

    fn square_in_block(&self, block: usize, point: DVec3) -> f64 {
        let first = block * BLOCK;
        let last = (first + BLOCK).min(self.corners.len());
        self.corners[first..last].iter().map(|&corners| point.distance_squared(closest(point, corners))).fold(f64::INFINITY, f64::min)
    }
}

fn sphere_about(points: &[DVec3]) -> (DVec3, f64) {
    let centre = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    (centre, points.iter().map(|point| point.distance(centre)).fold(0.0, f64::max))
}

/// The point of a triangle closest to a point, by the region of the triangle's plane it projects into (Ericson, Real-Time Collision
/// Detection, 2005, §5.1.5). A degenerate triangle gives one of its points.
fn closest(point: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(point - a), ac.dot(point - a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let (d3, d4) = (ab.dot(point - b), ac.dot(point - b));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let (d5, d6) = (ab.dot(point - c), ac.dot(point - c));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let on_ab = d1 * d4 - d3 * d2;
    if on_ab <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let on_ac = d5 * d2 - d1 * d6;
    if on_ac <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let on_bc = d3 * d6 - d5 * d4;
    if on_bc <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    a + (ab * on_ac + ac * on_ab) / (on_ab + on_ac + on_bc)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [DVec3; 3] = [DVec3::ZERO, DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 3.0, 0.0)];

    #[test]
    fn the_closest_point_of_a_triangle_is_in_the_right_region() {
        for (point, expected) in [
            ([1.0, 1.0, 2.0], [1.0, 1.0, 0.0]),
            ([-1.0, -1.0, 1.0], [0.0, 0.0, 0.0]),
            ([6.0, -1.0, 0.0], [4.0, 0.0, 0.0]),
            ([-1.0, 5.0, 0.0], [0.0, 3.0, 0.0]),
            ([2.0, -3.0, 0.0], [2.0, 0.0, 0.0]),
            ([-3.0, 2.0, 1.0], [0.0, 2.0, 0.0]),
            // The foot of (3.5, 4.5) on the hypotenuse: beyond (2, 1.5) along its normal (3, 4).
            ([3.5, 3.5, 5.0], [2.0, 1.5, 0.0]),
        ] {
            let found = closest(DVec3::from_array(point), CORNERS);
            assert!(found.distance(DVec3::from_array(expected)) < 1e-12, "{point:?}: {found}");
        }
    }

    #[test]
    fn passing_blocks_over_changes_no_distance() {
        let mesh = Mesh::icosphere(3).map(|p| p * DVec3::new(20.0, 25.0, 40.0) + DVec3::new(3.0, -8.0, 5.0));
        let triangles = Triangles::of(&mesh, |_| true);
        for from in Mesh::icosphere(2).positions.iter().flat_map(|p| [p * 3.0, p * 24.0, p * 90.0]) {
            let every = mesh.corners().map(|corners| from.distance(closest(from, corners))).fold(f64::INFINITY, f64::min);
            assert!((triangles.distance(from).unwrap() - every).abs() < 1e-12, "{from}");
        }
    }

    #[test]
    fn between_spheres_it_is_the_difference_of_their_radii() {
        let triangles = Triangles::of(&Mesh::icosphere(4).map(|p| p * 30.0), |_| true);
        for point in Mesh::icosphere(4).map(|p| p * 20.0).positions {
            let distance = triangles.distance(point).unwrap();
            // A triangle's middle lies e²/(6·r) = .03 mm inside the sphere at an edge of 2.2 mm.
            assert!(distance <= 10.0 + 1e-9 && distance > 9.96, "{distance}");
        }
    }

    #[test]
    fn where_there_is_nothing_there_is_no_distance() {
        let none = Triangles::of(&Mesh::icosphere(1), |_| false);
        assert_eq!(none.distance(DVec3::ZERO), None);
        assert_eq!(Triangles::of(&Mesh::icosphere(1), |_| true).distance(DVec3::NAN), None);
        let point = Triangles { corners: vec![[DVec3::X; 3]], spheres: vec![(DVec3::X, 0.0)] };
        assert_eq!(point.distance(DVec3::ZERO), Some(1.0));
    }
}
