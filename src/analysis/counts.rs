//! Counts of the wall at every vertex and gate.

use super::places::Places;
use crate::{
    pipeline::{Reconstruction, Surface},
    study::Study,
    volume::sample_scalar,
};
use rayon::prelude::*;

/// Distance of the samples along a line through the wall, in mm: well below any camera's blur.
const STEP_MM: f64 = 1.0;

/// The total of each gate over the mean of all; 1 for a gate without counts.
pub(super) fn levels(study: &Study) -> Vec<f64> {
    let totals: Vec<f64> = study.gates.iter().map(|gate| gate.volume.total()).collect();
    let usual = totals.iter().sum::<f64>() / totals.len() as f64;
    totals.into_iter().map(|total| if total > 0.0 { total / usual } else { 1.0 }).collect()
}

/// The mean of the counts between the vertex on the endocardial and the one on the epicardial surface, `[gates][vertices]`, each gate's on its
/// own surfaces, so that the heart's motion does not blur it. `None` in the lid.
///
/// All of the profile, as Germano et al. (J Nucl Med 2000;41:712), not its maximum: of noisy counts the maximum is too high. Where the wall is
/// thinner than the camera's blur its counts rise with its thickness (Galt et al., IEEE Trans Med Imaging 1990;9:144), which is what phase
/// analysis uses.
///
/// Each gate is brought to the mean total of the gates: what beats and moves keeps its counts, and a gate with fewer has fewer beats.
pub(super) fn along_the_wall(study: &Study, reconstruction: &Reconstruction, places: &Places) -> Vec<Vec<Option<f64>>> {
    study
        .gates
        .par_iter()
        .zip(&reconstruction.gates)
        .zip(&levels(study))
        .map(|((gate, result), level)| {
            let mesh = |surface: Surface| &result.fits.get(surface).mesh.positions;
            let lines = mesh(Surface::Endocardial).iter().zip(mesh(Surface::Epicardial));
            lines
                .zip(&places.of_vertex)
                .map(|((&inner, &outer), place)| {
                    place.as_ref()?;
                    let steps = (inner.distance(outer) / STEP_MM).ceil().max(1.0) as usize;
                    let at = |step: usize| {
                        let point = inner.lerp(outer, step as f64 / steps as f64);
                        sample_scalar(&gate.volume.grid, &gate.volume.counts, point)
                    };
                    Some((0..=steps).map(at).sum::<f64>() / (steps + 1) as f64 / level)
                })
                .collect()
        })
        .collect()
}
