//! What the wall takes up.

use super::places::Places;
use crate::pipeline::Reconstruction;

/// Perfusion, normalised to the maximum.
#[derive(Debug, Clone, PartialEq)]
pub struct Perfusion {
    /// Counts in percent of the largest of the wall, the mean over the gates, `[vertices]`; `None` in the lid.
    pub percent: Vec<Option<f64>>,
    /// The largest, in counts of one gate.
    pub maximum_counts: f64,
    /// The threshold in percent.
    pub threshold_percent: f64,
    /// Part of the wall's area below the threshold, in percent.
    pub extent_percent: f64,
    /// How far that part is below: the mean of 1 − value / threshold over it, in percent; 0 where nothing is below.
    pub severity_percent: f64,
    /// The area below the threshold in cm².
    pub area_cm2: f64,
    /// Area of the wall that was placed by its surroundings more than by its own border, in cm².
    pub without_border_cm2: Option<f64>,
}

impl Perfusion {
    /// From the counts at every gate.
    pub(super) fn of(counts: &[Vec<Option<f64>>], places: &Places, reconstruction: &Reconstruction) -> Self {
        let vertices = places.of_vertex.len();
        let gates = counts.len().max(1) as f64;
        let mean: Vec<Option<f64>> =
            (0..vertices).map(|vertex| counts.iter().map(|gate| gate[vertex]).sum::<Option<f64>>().map(|sum| sum / gates)).collect();
        let maximum_counts = mean.iter().flatten().copied().fold(0.0, f64::max);
        let percent: Vec<Option<f64>> = mean
            .iter()
            .map(|counts| counts.map(|counts| if maximum_counts > 0.0 { 100.0 * counts.max(0.0) / maximum_counts } else { 0.0 }))
            .collect();
        let threshold_percent = reconstruction.parameters.analysis.perfusion_threshold_percent;
        let (mut below_mm2, mut missing) = (0.0, 0.0);
        for (percent, place) in percent.iter().zip(&places.of_vertex) {
            if let (Some(percent), Some(place)) = (percent, place)
                && *percent < threshold_percent
            {
                below_mm2 += place.area_mm2;
                missing += place.area_mm2 * (1.0 - percent / threshold_percent);
            }
        }
        let whole_mm2 = places.area_mm2();
        let part = |of: f64, whole: f64| if whole > 0.0 { 100.0 * of / whole } else { 0.0 };
        Self {
            percent,
            maximum_counts,
            threshold_percent,
            extent_percent: part(below_mm2, whole_mm2),
            severity_percent: part(missing, below_mm2),
            area_cm2: below_mm2 / 100.0,
            without_border_cm2: reconstruction.model.as_ref().map(|model| model.extrapolated_fraction * whole_mm2 / 100.0),
        }
    }
}
