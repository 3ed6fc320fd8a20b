//! The thickness of the wall at every vertex of both surfaces.
//!
//! Definition `closest_point`: the distance from the vertex to the closest point of the other surface's wall, exact on its triangles. Of
//! the usual definitions it is the one that needs no correspondence across the wall; it takes the shortest way.
//!
//! In the valve plane both surfaces end in a lid that no wall stands behind. A vertex faces the base where its outward normal is within 45° of
//! the direction that leads from apex to base; the lid's height is the median of the vertices that do. To the lid belong the
//! vertices that face the base and those that reach to less than 4 mm below that height: the rim, and what is crumpled in the lid.
//! Triangles that touch the other surface's lid are not part of its wall. At vertices of the lid itself the distance is to the whole
//! other surface, nominal and near zero. Just below the rim of a wall that leans inwards the closest point would lie beyond the valve plane;
//! the value is then the distance to what is left of the wall: up to 15 % too much on spheres of 20 and 30 mm cut 15 mm above their centre.

use super::{GateReconstruction, PerSurface, Surface};
use crate::mesh::{Mesh, distance::Triangles};
use glam::DVec3;

/// The name of the definition in reports and files.
pub const DEFINITION: &str = "closest_point";

/// Cosine of the largest angle between the direction to the base and a normal that faces it: lid and side wall meet at about a right angle.
const FACING_COSINE: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// How far the rim reaches down from the lid's height: about an edge at 642 vertices, which is what smoothing rounds.
const RIM_MM: f64 = 4.0;

/// Thickness and lid, a value a vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct Thickness {
    /// Distance to the other surface in mm.
    pub mm: PerSurface<Vec<f64>>,
    /// Whether the vertex belongs to the lid, where the thickness is nominal.
    pub in_lid: PerSurface<Vec<bool>>,
}

/// Thickness over the vertices outside the lids, in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThicknessRange {
    /// Mean over the vertices of both surfaces.
    pub mean_mm: f64,
    /// The largest.
    pub max_mm: f64,
    /// The smallest.
    pub min_mm: f64,
}

impl Thickness {
    /// The thickness of a gate's wall; `to_base` is [`super::Reconstruction::to_base`].
    pub fn of(gate: &GateReconstruction, to_base: DVec3) -> Self {
        let mesh = |surface: Surface| &gate.fits.get(surface).mesh;
        let in_lid = PerSurface::of(|surface| lid(mesh(surface), to_base));
        let mm = PerSurface::of(|surface| {
            let other = match surface {
                Surface::Endocardial => Surface::Epicardial,
                Surface::Epicardial => Surface::Endocardial,
            };
            let others_lid: &Vec<bool> = in_lid.get(other);
            let whole = Triangles::of(mesh(other), |_| true);
            let wall = Triangles::of(mesh(other), |triangle| !triangle.iter().any(|&vertex| others_lid[vertex as usize]));
            mesh(surface)
                .positions
                .iter()
                .zip(in_lid.get(surface))
                .map(|(&position, &in_lid)| if in_lid { &whole } else { &wall }.distance(position).unwrap_or(f64::NAN))
                .collect()
        });
        Self { mm, in_lid }
    }

    /// Mean, largest and smallest thickness outside the lids; `None` if nothing is.
    pub fn range(&self) -> Option<ThicknessRange> {
        let values: Vec<f64> = Surface::BOTH
            .into_iter()
            .flat_map(|surface| self.mm.get(surface).iter().zip(self.in_lid.get(surface)))
            .filter_map(|(&mm, &in_lid)| (!in_lid && mm.is_finite()).then_some(mm))
            .collect();
        (!values.is_empty()).then(|| ThicknessRange {
            mean_mm: values.iter().sum::<f64>() / values.len() as f64,
            max_mm: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            min_mm: values.iter().copied().fold(f64::INFINITY, f64::min),
        })
    }
}

/// Whether each vertex of a surface belongs to its lid; `base` is the direction from apex to base.
pub fn lid(mesh: &Mesh, base: DVec3) -> Vec<bool> {
    let facing: Vec<bool> = mesh.normals().into_iter().map(|normal| normal.dot(base) > FACING_COSINE).collect();
    let heights = mesh.positions.iter().map(|position| position.dot(base));
    let mut of_facing: Vec<f64> = heights.clone().zip(&facing).filter_map(|(height, &facing)| facing.then_some(height)).collect();
    of_facing.sort_by(f64::total_cmp);
    let Some(&lid) = of_facing.get(of_facing.len() / 2) else { return facing };
    heights.zip(facing).map(|(height, facing)| facing || height > lid - RIM_MM).collect()
}
