//! Closed triangle meshes: the icosphere every surface starts from, and what is measured on a mesh.

pub mod distance;
pub mod wall;

use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::{collections::HashMap, sync::Arc};

/// Triangles over shared vertices. The topology is fixed for a whole cycle and shared by all its meshes.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Vertex positions in grid mm.
    pub positions: Vec<DVec3>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Arc<[[u32; 3]]>,
}

/// Areas in mm² and aspect ratios in mm (area over longest edge, the measure of the paper's Tables 2 and 3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TriangleQuality {
    /// Mean, largest and smallest area in mm².
    pub area_mm2: [f64; 3],
    /// Mean, largest and smallest area over longest edge in mm.
    pub aspect_mm: [f64; 3],
}

impl Mesh {
    /// The unit icosphere after `level` subdivisions: 10·4^level + 2 vertices (levels 2, 3, 4: 162, 642, 2562, the paper's Table 2).
    pub fn icosphere(level: u32) -> Self {
        let (mut positions, mut triangles) = icosahedron();
        for _ in 0..level {
            triangles = subdivide(&mut positions, &triangles);
        }
        Self { positions, triangles: triangles.into() }
    }

    /// The same topology with every vertex mapped.
    #[must_use]
    pub fn map(&self, f: impl FnMut(DVec3) -> DVec3) -> Self {
        Self { positions: self.positions.iter().copied().map(f).collect(), triangles: Arc::clone(&self.triangles) }
    }

    /// The same topology with every vertex formed of this mesh's and another's of the same topology.
    #[must_use]
    pub fn map_with(&self, other: &Self, mut f: impl FnMut(DVec3, DVec3) -> DVec3) -> Self {
        let positions = self.positions.iter().zip(&other.positions).map(|(&here, &there)| f(here, there)).collect();
        Self { positions, triangles: Arc::clone(&self.triangles) }
    }

    /// The corners of every triangle.
    pub fn corners(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        self.triangles.iter().map(|triangle| triangle.map(|vertex| self.positions[vertex as usize]))
    }

    /// Enclosed volume in mm³ by the divergence theorem: a sixth of the sum of a·(b × c). Positive for outward triangles.
    pub fn signed_volume_mm3(&self) -> f64 {
        // About the centroid, not the origin: the sum then does not cancel for meshes far from it.
        let centre = self.centroid();
        self.corners().map(|[a, b, c]| (a - centre).dot((b - centre).cross(c - centre))).sum::<f64>() / 6.0
    }

    /// Enclosed volume in ml.
    pub fn volume_ml(&self) -> f64 {
        self.signed_volume_mm3() / 1000.0
    }

    /// Surface area in mm².
    pub fn area_mm2(&self) -> f64 {
        self.corners().map(triangle_area).sum()
    }

    /// Each vertex's share of the area in mm²: a third of its triangles.
    pub fn vertex_areas_mm2(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.positions.len()];
        for (triangle, corners) in self.triangles.iter().zip(self.corners()) {
            let third = triangle_area(corners) / 3.0;
            for &vertex in triangle {
                areas[vertex as usize] += third;
            }
        }
        areas
    }

    /// Area in mm² of the cut by the plane through a point, across a unit vector.
    pub fn section_mm2(&self, through: DVec3, normal: DVec3) -> f64 {
        let mut twice = 0.0;
        for corners in self.corners() {
            let heights = corners.map(|corner| (corner - through).dot(normal));
            let mut crossings = (0..3).filter_map(|edge| {
                let (from, to) = (heights[edge], heights[(edge + 1) % 3]);
                // Half open, so that a vertex in the plane is crossed once.
                ((from < 0.0) != (to < 0.0)).then(|| corners[edge].lerp(corners[(edge + 1) % 3], from / (from - to)) - through)
            });
            let (Some(a), Some(b)) = (crossings.next(), crossings.next()) else { continue };
            let outward = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            // Counter-clockwise about the normal, with the outside to the right.
            let along = normal.cross(outward);
            let area = normal.dot(a.cross(b));
            twice += if (b - a).dot(along) < 0.0 { -area } else { area };
        }
        twice / 2.0
    }

    /// Mean of the vertices.
    pub fn centroid(&self) -> DVec3 {
        self.positions.iter().sum::<DVec3>() / self.positions.len().max(1) as f64
    }

    /// Unit vertex normals, weighted by area, outward.
    pub fn normals(&self) -> Vec<DVec3> {
        let mut normals = vec![DVec3::ZERO; self.positions.len()];
        for triangle in self.triangles.iter() {
            let [a, b, c] = triangle.map(|vertex| self.positions[vertex as usize]);
            let normal = (b - a).cross(c - a);
            for &vertex in triangle {
                normals[vertex as usize] += normal;
            }
        }
        normals.into_iter().map(|normal| normal.try_normalize().unwrap_or(DVec3::Z)).collect()
    }

    /// The vertices joined to each vertex by an edge, ascending.
    pub fn neighbours(&self) -> Vec<Vec<u32>> {
        let mut neighbours = vec![Vec::new(); self.positions.len()];
        for &[a, b, c] in self.triangles.iter() {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                neighbours[from as usize].push(to);
                neighbours[to as usize].push(from);
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        neighbours
    }

    /// Whether every edge is shared by exactly two triangles that run through it in opposite directions.
    pub fn is_closed(&self) -> bool {
        let mut directed = HashMap::new();
        for &[a, b, c] in self.triangles.iter() {
            for edge in [(a, b), (b, c), (c, a)] {
                *directed.entry(edge).or_insert(0_u32) += 1;
            }
        }
        directed.iter().all(|(&(a, b), &count)| count == 1 && directed.get(&(b, a)) == Some(&1))
    }

    /// Triangles that face the wrong way seen from `inside_mm`, a point from which the whole surface is seen (ventricles are star-shaped).
    pub fn inverted_triangles(&self, inside_mm: DVec3) -> usize {
        self.corners().filter(|[a, b, c]| (a - inside_mm).dot((b - inside_mm).cross(c - inside_mm)) <= 0.0).count()
    }

    /// Areas and aspect ratios over all triangles.
    pub fn quality(&self) -> TriangleQuality {
        let measured: Vec<(f64, f64)> = self
            .corners()
            .map(|corners @ [a, b, c]| {
                let area = triangle_area(corners);
                (area, area / a.distance(b).max(b.distance(c)).max(c.distance(a)).max(f64::MIN_POSITIVE))
            })
            .collect();
        let summary = |pick: fn(&(f64, f64)) -> f64| {
            let values = measured.iter().map(pick);
            let mean = values.clone().sum::<f64>() / measured.len().max(1) as f64;
            [mean, values.clone().fold(f64::NEG_INFINITY, f64::max), values.fold(f64::INFINITY, f64::min)]
        };
        TriangleQuality { area_mm2: summary(|pair| pair.0), aspect_mm: summary(|pair| pair.1) }
    }
}

fn triangle_area([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}

fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let phi = f64::midpoint(1.0, 5.0_f64.sqrt());
    let positions = [
        [-1.0, phi, 0.0],
        [1.0, phi, 0.0],
        [-1.0, -phi, 0.0],
        [1.0, -phi, 0.0],
        [0.0, -1.0, phi],
        [0.0, 1.0, phi],
        [0.0, -1.0, -phi],
        [0.0, 1.0, -phi],
        [phi, 0.0, -1.0],
        [phi, 0.0, 1.0],
        [-phi, 0.0, -1.0],
        [-phi, 0.0, 1.0],
    ]
    .map(|corner| DVec3::from_array(corner).normalize());
    let triangles = [
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    (positions.to_vec(), triangles.to_vec())
}

/// Splits every triangle into four, new vertices pushed out to the unit sphere.
fn subdivide(positions: &mut Vec<DVec3>, triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut midpoints: HashMap<(u32, u32), u32> = HashMap::new();
    let mut midpoint = |a: u32, b: u32| {
        *midpoints.entry((a.min(b), a.max(b))).or_insert_with(|| {
            positions.push((positions[a as usize] + positions[b as usize]).normalize());
            positions.len() as u32 - 1
        })
    };
    triangles
        .iter()
        .flat_map(|&[a, b, c]| {
            let (ab, bc, ca) = (midpoint(a, b), midpoint(b, c), midpoint(c, a));
            [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn icospheres_are_the_meshes_of_table_2() {
        for (level, vertices, triangles) in [(2, 162, 320), (3, 642, 1280), (4, 2562, 5120)] {
            let sphere = Mesh::icosphere(level);
            assert_eq!((sphere.positions.len(), sphere.triangles.len()), (vertices, triangles));
            assert!(sphere.is_closed());
            assert_eq!(sphere.inverted_triangles(DVec3::ZERO), 0);
        }
    }

    #[test]
    fn volume_and_area_converge_to_the_ellipsoid_from_below() {
        let axes = DVec3::new(20.0, 30.0, 50.0);
        let exact = 4.0 / 3.0 * PI * axes.x * axes.y * axes.z;
        let error = |level| 1.0 - Mesh::icosphere(level).map(|p| p * axes + DVec3::new(500.0, -300.0, 900.0)).signed_volume_mm3() / exact;
        assert!(error(4) > 0.0 && error(4) < 0.003, "{}", error(4));
        // Second order in the edge length: each subdivision quarters the error.
        assert!((error(3) / error(4) - 4.0).abs() < 0.2, "{}", error(3) / error(4));
        let area = Mesh::icosphere(4).area_mm2();
        assert!((area / (4.0 * PI) - 1.0).abs() < 0.003, "{area}");
    }

    #[test]
    fn a_missing_or_turned_triangle_is_noticed() {
        let sphere = Mesh::icosphere(1);
        let open = Mesh { triangles: sphere.triangles[1..].to_vec().into(), ..sphere.clone() };
        assert!(!open.is_closed());
        let mut turned = sphere.triangles.to_vec();
        turned[3].swap(0, 1);
        let turned = Mesh { triangles: turned.into(), ..sphere };
        assert!(!turned.is_closed());
        assert_eq!(turned.inverted_triangles(DVec3::ZERO), 1);
    }

    #[test]
    fn normals_of_a_sphere_are_its_positions() {
        let sphere = Mesh::icosphere(3);
        for (normal, position) in sphere.normals().iter().zip(&sphere.positions) {
            assert!(normal.dot(*position) > 0.999);
        }
        assert!(sphere.neighbours().iter().all(|list| list.len() == 5 || list.len() == 6));
    }
}
