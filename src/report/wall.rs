//! The wall of a gate as tetrahedra: whether it is in order, and how thick it is.

use super::fits::Extremes;
use crate::{
    mesh::wall::Wall,
    pipeline::{
        GateReconstruction,
        thickness::{self, ThicknessRange},
    },
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The wall between the surfaces of a gate as tetrahedra (`gates/{n}/wall.vtu`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WallSummary {
    /// Number of tetrahedra, three for each triangle of a surface.
    pub tetrahedra: usize,
    /// Tetrahedra that are flat or inside out. Not 0: `wall_inverted` is among the warnings.
    pub inverted: usize,
    /// Tetrahedra that were, when the surfaces had evolved and before the wall was put in order.
    pub inverted_before: usize,
    /// Triangles of both surfaces that face the wrong way, seen from the surface's centre.
    pub turned_triangles: usize,
    /// The longest way a vertex was moved to put the wall in order, in mm.
    pub largest_move_mm: f64,
    /// The mean way over the vertices of both surfaces, in mm.
    pub mean_move_mm: f64,
    /// Thickness over the vertices of both surfaces outside the valve plane, in mm; null if there are none.
    #[schema(required)]
    pub thickness_mm: Option<Extremes>,
    /// How thickness is defined. `closest_point`: the distance from a vertex to the closest point of the other surface's wall.
    #[schema(example = "closest_point")]
    pub thickness_definition: String,
}

impl WallSummary {
    /// Of a gate whose thickness has this range.
    pub(super) fn of(gate: &GateReconstruction, range: Option<&ThicknessRange>) -> Self {
        let wall = gate.wall();
        Self {
            tetrahedra: wall.as_ref().map_or(0, |wall| wall.tetrahedra.len()),
            inverted: wall.as_ref().map_or(0, Wall::inverted),
            inverted_before: gate.wall_order.inverted_before,
            turned_triangles: gate.wall_order.turned,
            largest_move_mm: gate.wall_order.largest_move_mm,
            mean_move_mm: gate.wall_order.mean_move_mm,
            thickness_mm: range.map(|range| Extremes { mean: range.mean_mm, max: range.max_mm, min: range.min_mm }),
            thickness_definition: thickness::DEFINITION.to_owned(),
        }
    }
}
