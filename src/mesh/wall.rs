//! The space between two closed meshes of one topology as tetrahedra.
//!
//! Vertex `v` of the inner mesh belongs to vertex `v` of the outer one, so every triangle spans a prism between the surfaces. A prism is
//! cut into three tetrahedra along one diagonal of each of its three sides. The diagonal goes from the inner vertex of smaller number to
//! the outer one of larger number: two prisms that share a side cut it alike, and no prism gets the three diagonals that run in a ring and
//! leave no tetrahedra.

use super::Mesh;
use glam::DVec3;

/// Tetrahedra over the vertices of two surfaces.
#[derive(Debug, Clone, PartialEq)]
pub struct Wall {
    /// Vertices of the inner surface, then those of the outer one, in the same order, in mm.
    pub positions: Vec<DVec3>,
    /// Vertex indices; seen from the fourth vertex the first three run counter-clockwise, so that a sound tetrahedron's volume is positive.
    pub tetrahedra: Vec<[u32; 4]>,
}

/// Size and shape of the tetrahedra, each as mean, largest and smallest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TetrahedronQuality {
    /// Signed volume in mm³.
    pub volume_mm3: [f64; 3],
    /// Mean ratio, 12·∛(3V)² over the sum of the squared edges (Liu and Joe, BIT 34:268, 1994): 1 if regular, 0 if flat or inverted.
    pub mean_ratio: [f64; 3],
}

impl Wall {
    /// The wall between two meshes of one topology; `None` if their triangles differ.
    pub fn between(inner: &Mesh, outer: &Mesh) -> Option<Self> {
        if inner.triangles != outer.triangles || inner.positions.len() != outer.positions.len() {
            return None;
        }
        let across = inner.positions.len() as u32;
        let tetrahedra = inner.triangles.iter().flat_map(|&triangle| prism(triangle, across)).collect();
        Some(Self { positions: inner.positions.iter().chain(&outer.positions).copied().collect(), tetrahedra })
    }

    /// The corners of every tetrahedron.
    pub fn corners(&self) -> impl Iterator<Item = [DVec3; 4]> + '_ {
        self.tetrahedra.iter().map(|tetrahedron| tetrahedron.map(|vertex| self.positions[vertex as usize]))
    }

    /// Signed volume of every tetrahedron in mm³. Their sum is the outer mesh's volume less the inner one's, inverted or not: every side
    /// of a prism is met twice, from either side.
    pub fn volumes_mm3(&self) -> impl Iterator<Item = f64> + '_ {
        self.corners().map(signed_volume_mm3)
    }

    /// Tetrahedra that are flat or inside out.
    pub fn inverted(&self) -> usize {
        // `!(v > 0)` counts a volume that is not a number as well.
        self.volumes_mm3().filter(|&volume| !matches!(volume.partial_cmp(&0.0), Some(std::cmp::Ordering::Greater))).count()
    }

    /// Volumes and shapes over all tetrahedra.
    pub fn quality(&self) -> TetrahedronQuality {
        let summary = |of: fn([DVec3; 4]) -> f64| {
            let (sum, max, min) = self.corners().map(of).fold((0.0, f64::NEG_INFINITY, f64::INFINITY), |(sum, max, min), value| {
                (sum + value, f64::max(max, value), f64::min(min, value))
            });
            [sum / self.tetrahedra.len().max(1) as f64, max, min]
        };
        TetrahedronQuality { volume_mm3: summary(signed_volume_mm3), mean_ratio: summary(mean_ratio) }
    }
}

/// The tetrahedra of the prism over an outward triangle.
fn prism(triangle: [u32; 3], across: u32) -> [[u32; 4]; 3] {
    let [a, b, c] = triangle;
    let mut sorted = triangle;
    sorted.sort_unstable();
    let [i, j, k] = sorted;
    let staircase = [[i, j, k, k + across], [i, j, k + across, j + across], [i, j + across, k + across, i + across]];
    // Sorting by an odd permutation turns the triangle over, and its tetrahedra with it.
    let even = [i, j, k] == [a, b, c] || [i, j, k] == [b, c, a] || [i, j, k] == [c, a, b];
    if even { staircase } else { staircase.map(|[a, b, c, d]| [b, a, c, d]) }
}

/// A sixth of (b − a) × (c − a) · (d − a), in mm³.
pub fn signed_volume_mm3([a, b, c, d]: [DVec3; 4]) -> f64 {
    (b - a).cross(c - a).dot(d - a) / 6.0
}

fn mean_ratio(corners @ [a, b, c, d]: [DVec3; 4]) -> f64 {
    let edges = [b - a, c - a, d - a, c - b, d - b, d - c];
    let squares: f64 = edges.iter().map(|edge| edge.length_squared()).sum();
    let volume = signed_volume_mm3(corners).max(0.0);
    12.0 * (3.0 * volume).cbrt().powi(2) / squares.max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    fn shell() -> (Mesh, Mesh) {
        // Neither concentric nor alike, far from the origin.
        let inner = Mesh::icosphere(3).map(|p| p * DVec3::new(20.0, 24.0, 40.0) + DVec3::new(300.0, -120.0, 80.0));
        let outer = Mesh::icosphere(3).map(|p| p * DVec3::new(32.0, 33.0, 52.0) + DVec3::new(302.0, -121.0, 83.0));
        (inner, outer)
    }

    #[test]
    fn the_volumes_sum_to_the_difference_of_the_surfaces() {
        let (inner, outer) = shell();
        let wall = Wall::between(&inner, &outer).unwrap();
        assert_eq!(wall.tetrahedra.len(), 3 * inner.triangles.len());
        assert_eq!(wall.inverted(), 0);
        let between = outer.signed_volume_mm3() - inner.signed_volume_mm3();
        assert!((wall.volumes_mm3().sum::<f64>() / between - 1.0).abs() < 1e-9);
        // Also where they cross: what is inverted is subtracted.
        let across = inner.map(|p| p + DVec3::X * 25.0);
        let wall = Wall::between(&across, &outer).unwrap();
        assert!(wall.inverted() > 0);
        assert!((wall.volumes_mm3().sum::<f64>() / between - 1.0).abs() < 1e-9);
    }

    #[test]
    fn neighbours_share_whole_faces_and_only_the_surfaces_are_outside() {
        let (inner, outer) = shell();
        let wall = Wall::between(&inner, &outer).unwrap();
        let mut faces: HashMap<[u32; 3], u32> = HashMap::new();
        for &[a, b, c, d] in &wall.tetrahedra {
            for mut face in [[a, b, c], [a, b, d], [a, c, d], [b, c, d]] {
                face.sort_unstable();
                *faces.entry(face).or_default() += 1;
            }
        }
        let across = inner.positions.len() as u32;
        let mut outside = 0;
        for (face, count) in faces {
            let on_a_surface = face.iter().all(|&vertex| vertex < across) || face.iter().all(|&vertex| vertex >= across);
            assert_eq!(count, if on_a_surface { 1 } else { 2 }, "{face:?}");
            outside += usize::from(on_a_surface);
        }
        assert_eq!(outside, 2 * inner.triangles.len());
    }

    #[test]
    fn other_topologies_have_no_wall_between_them() {
        assert_eq!(Wall::between(&Mesh::icosphere(1), &Mesh::icosphere(2)), None);
    }

    #[test]
    fn quality_is_1_for_a_regular_tetrahedron_and_0_for_a_flat_one() {
        let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(DVec3::from_array);
        let [a, b, c, d] = corners;
        let regular = if signed_volume_mm3(corners) > 0.0 { corners } else { [b, a, c, d] };
        assert!((signed_volume_mm3(regular) - 8.0 / 3.0).abs() < 1e-12);
        let wall = |last: DVec3| Wall { positions: vec![regular[0], regular[1], regular[2], last], tetrahedra: vec![[0, 1, 2, 3]] };
        assert!((wall(regular[3]).quality().mean_ratio[0] - 1.0).abs() < 1e-12);
        let flat = wall((regular[0] + regular[1]) / 2.0);
        assert!(flat.quality().mean_ratio[0] < 1e-9 && flat.inverted() == 1);
        let not_a_number = wall(DVec3::NAN);
        assert_eq!(not_a_number.inverted(), 1);
    }
}
