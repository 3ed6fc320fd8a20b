//! Thickness, thickening and motion of the wall at every vertex.

use super::places::Places;
use crate::pipeline::{
    Reconstruction, Surface,
    thickness::{Thickness, ThicknessRange},
};
use rayon::prelude::*;

/// What the wall does over the cycle, each value a vertex; `None` in the lid.
#[derive(Debug, Clone, PartialEq)]
pub struct Walls {
    /// Thickness in mm, `[gates][vertices]`: the mean of the distances from the vertex on either surface to the closest point of the other
    /// surface's wall ([`crate::pipeline::thickness`]).
    pub thickness_mm: Vec<Vec<Option<f64>>>,
    /// Range of the thickness at each gate over the vertices of both surfaces; `None` where all are in a lid.
    pub thickness_range: Vec<Option<ThicknessRange>>,
    /// Thickness at end systole over that at end diastole, less 1, in percent. Empty for one gate.
    pub thickening_percent: Vec<Option<f64>>,
    /// How far the endocardial vertex moves inwards from end diastole to end systole, in mm: its way along the mean of the surface's inward
    /// normals at both. Empty for one gate.
    pub motion_mm: Vec<Option<f64>>,
}

impl Walls {
    /// Of a reconstruction with these ends of the cycle, gates counted from 0.
    pub(super) fn of(reconstruction: &Reconstruction, places: &Places, end_diastole: usize, end_systole: usize) -> Self {
        let in_wall = |vertex: usize| places.of_vertex[vertex].is_some();
        let thickness: Vec<Thickness> = reconstruction.gates.par_iter().map(|gate| Thickness::of(gate, reconstruction.to_base)).collect();
        let thickness_range = thickness.iter().map(Thickness::range).collect();
        let thickness_mm: Vec<Vec<Option<f64>>> = thickness
            .iter()
            .map(|Thickness { mm, .. }| {
                let both = mm.endocardial.iter().zip(&mm.epicardial).map(|(&inner, &outer)| f64::midpoint(inner, outer));
                both.enumerate().map(|(vertex, mm)| (in_wall(vertex) && mm.is_finite()).then_some(mm)).collect()
            })
            .collect();
        if reconstruction.gates.len() < 2 {
            return Self { thickness_mm, thickness_range, thickening_percent: Vec::new(), motion_mm: Vec::new() };
        }
        let thickening_percent = thickness_mm[end_diastole]
            .iter()
            .zip(&thickness_mm[end_systole])
            .map(|(&diastole, &systole)| diastole.zip(systole).filter(|(diastole, _)| *diastole > 0.0).map(|(d, s)| 100.0 * (s / d - 1.0)))
            .collect();
        let surface = |gate: usize| &reconstruction.gates[gate].fits.get(Surface::Endocardial).mesh;
        let (diastole, systole) = (surface(end_diastole), surface(end_systole));
        let normals = diastole.normals().into_iter().zip(systole.normals());
        let motion_mm = diastole
            .positions
            .iter()
            .zip(&systole.positions)
            .zip(normals)
            .enumerate()
            .map(|(vertex, ((from, to), (at_diastole, at_systole)))| {
                let outward = (at_diastole + at_systole).try_normalize()?;
                in_wall(vertex).then(|| (*from - *to).dot(outward))
            })
            .collect();
        Self { thickness_mm, thickness_range, thickening_percent, motion_mm }
    }
}
