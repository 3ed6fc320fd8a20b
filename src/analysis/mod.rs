//! What follows from a reconstruction and its counts, beyond volumes: where each piece of the wall lies, how thick it is, how it moves,
//! what it takes up and when it contracts; each a value a vertex, a segment of the heart (AHA) and the whole. Definitions, with their
//! sources and formulas, are in `docs/report.md`.
//!
//! Vertex *v* is the same piece of the wall on both surfaces and at every gate (see `docs/numerics.md`): what changes over the cycle is
//! compared vertex by vertex. Vertices of the lid, in the valve plane, are no wall and have no values.

mod counts;
pub mod cycle;
mod neighbourhood;
pub mod perfusion;
pub mod phase;
pub mod places;
pub mod planes;
pub mod polar;
mod quantity;
pub mod segments;
pub mod shape;
mod walls;

pub use cycle::Cycle;
pub use perfusion::Perfusion;
pub use phase::Phase;
pub use places::{Place, Places, RotationSource};
pub use quantity::Quantity;
pub use segments::Segment;
pub use shape::Shape;
pub use walls::Walls;

use crate::{
    pipeline::{Reconstruction, Surface},
    study::Study,
};
use neighbourhood::Neighbourhoods;

/// Everything that is derived.
#[derive(Debug, Clone, PartialEq)]
pub struct Analysis {
    /// Where each vertex lies.
    pub places: Places,
    /// The gate of the largest cavity, counted from 0; the first of equals.
    pub end_diastole: usize,
    /// The gate of the smallest cavity, counted from 0; the first of equals. That of end diastole for a study of one gate.
    pub end_systole: usize,
    /// Thickness, thickening and motion.
    pub walls: Walls,
    /// What the wall takes up.
    pub perfusion: Perfusion,
    /// When the wall contracts; `None` for fewer than four gates.
    pub phase: Option<Phase>,
    /// The time-volume curve; `None` for fewer than four gates.
    pub cycle: Option<Cycle>,
    /// The cavity's shape at end diastole and, for a cycle, at end systole.
    pub shapes: Vec<Shape>,
}

/// Derives it.
pub fn analyse(study: &Study, reconstruction: &Reconstruction) -> Analysis {
    let cavity_ml: Vec<f64> = reconstruction.gates.iter().map(|gate| gate.volume_ml(Surface::Endocardial)).collect();
    let (end_diastole, end_systole) = ends(&cavity_ml);
    let places = Places::of(study, reconstruction, end_diastole);
    let walls = Walls::of(reconstruction, &places, end_diastole, end_systole);
    let neighbourhoods = Neighbourhoods::of(reconstruction, &places, end_diastole);
    let counts: Vec<_> = counts::along_the_wall(study, reconstruction, &places).iter().map(|gate| neighbourhoods.means(gate)).collect();
    let perfusion = Perfusion::of(&counts, &places, reconstruction);
    let phase = Phase::of(&counts, &places);
    let cycle = Cycle::of(study, &cavity_ml);
    let mut shapes = vec![Shape::of(reconstruction, &places, end_diastole)];
    if reconstruction.gates.len() > 1 {
        shapes.push(Shape::of(reconstruction, &places, end_systole));
    }
    Analysis { places, end_diastole, end_systole, walls, perfusion, phase, cycle, shapes }
}

/// Indices of the largest and the smallest value, each the first of equals; 0 without any.
pub fn ends(values: &[f64]) -> (usize, usize) {
    let first = |better: fn(f64, f64) -> bool| {
        values.iter().enumerate().fold(0, |best, (index, &value)| if better(value, values[best]) { index } else { best })
    };
    (first(|a, b| a > b), first(|a, b| a < b))
}
