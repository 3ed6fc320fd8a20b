//! Perfusion, phase and shape of the whole ventricle.

use super::regional::RegionalSummary;
use crate::analysis::{Analysis, Perfusion, Phase, Shape};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Perfusion against the wall's own maximum. No normal database is used: what is below the threshold may be normal for this camera and
/// patient (attenuation), and a wall that is dark everywhere has no defect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PerfusionSummary {
    /// Below this part of the maximum the wall is a defect, in percent.
    pub threshold_percent: f64,
    /// Defect in percent of the wall's area.
    pub extent_percent: f64,
    /// How far the defect is below the threshold: the mean of 1 − value/threshold over it, in percent.
    pub severity_percent: f64,
    /// The defect's area in cm².
    pub area_cm2: f64,
    /// Segments whose mean is below the threshold.
    pub defect_segments: Vec<usize>,
    /// Area of the wall that was placed by its surroundings more than by its own border, in cm²; null with the preset `paper`.
    #[schema(required)]
    pub without_border_cm2: Option<f64>,
    /// The maximum in counts of a gate.
    pub maximum_counts: f64,
}

/// When the wall contracts: phases of the first harmonic of its counts over the cycle, in degrees of the R-R interval. Widths differ between
/// packages, so that cut-offs published for one do not hold for another, nor here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PhaseSummary {
    /// Circular mean in degrees: when the wall is thickest, on the whole.
    pub mean_degrees: f64,
    /// Standard deviation in degrees.
    pub sd_degrees: f64,
    /// Width of the shortest arc that holds 95 % of the wall's area, in degrees.
    pub bandwidth_95_degrees: f64,
    /// Entropy of the histogram in percent: 0 if all contracts at once, 100 if evenly over the cycle.
    pub entropy_percent: f64,
    /// Part of the wall's area in each bin of 6°, from 0°, in percent; 60 values.
    pub histogram_percent: Vec<f64>,
    /// Part of the wall that has a phase, in percent of its area: the rest hardly changes.
    pub counted_percent: f64,
}

/// Length and width of the cavity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ShapeReport {
    /// The gate, counted from 1.
    pub gate: usize,
    /// From the cavity's tip to the valve plane along the long axis, in mm.
    pub long_axis_mm: f64,
    /// Diameter of the circle whose area the widest cross-section has, in mm.
    pub short_axis_mm: f64,
    /// Short over long axis.
    pub sphericity_index: f64,
    /// Volume over that of a ball whose diameter is the long axis.
    pub volume_sphericity: f64,
    /// √(1 − (short/long)²); 0: a ball.
    pub eccentricity: f64,
}

/// The shape at both ends of the cycle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ShapeSummary {
    /// At end diastole; at the one gate of an ungated study.
    pub end_diastole: ShapeReport,
    /// At end systole; null for one gate.
    #[schema(required)]
    pub end_systole: Option<ShapeReport>,
}

impl PerfusionSummary {
    /// Of the whole wall, with the segments that are below.
    pub(super) fn of(perfusion: &Perfusion, regional: &RegionalSummary) -> Self {
        let below = |percent: Option<f64>| percent.is_some_and(|percent| percent < perfusion.threshold_percent);
        Self {
            threshold_percent: perfusion.threshold_percent,
            extent_percent: perfusion.extent_percent,
            severity_percent: perfusion.severity_percent,
            area_cm2: perfusion.area_cm2,
            defect_segments: regional
                .segments
                .iter()
                .filter(|segment| below(segment.values.perfusion_percent))
                .map(|segment| segment.segment)
                .collect(),
            without_border_cm2: perfusion.without_border_cm2,
            maximum_counts: perfusion.maximum_counts,
        }
    }
}

impl PhaseSummary {
    /// Of the whole wall.
    pub(super) fn of(phase: &Phase, analysis: &Analysis) -> Self {
        let counted: f64 = phase
            .degrees
            .iter()
            .zip(&analysis.places.of_vertex)
            .filter_map(|(degrees, place)| degrees.and(place.as_ref()))
            .map(|place| place.area_mm2)
            .sum();
        Self {
            mean_degrees: phase.mean_degrees,
            sd_degrees: phase.sd_degrees,
            bandwidth_95_degrees: phase.bandwidth_degrees,
            entropy_percent: phase.entropy_percent,
            histogram_percent: phase.histogram_percent.clone(),
            counted_percent: 100.0 * counted / analysis.places.area_mm2(),
        }
    }
}

impl ShapeSummary {
    /// Of both ends; `None` without any.
    pub(super) fn of(shapes: &[Shape]) -> Option<Self> {
        Some(Self { end_diastole: shapes.first()?.into(), end_systole: shapes.get(1).map(ShapeReport::from) })
    }
}

impl From<&Shape> for ShapeReport {
    fn from(shape: &Shape) -> Self {
        let Shape { gate, long_axis_mm, short_axis_mm, sphericity_index, volume_sphericity, eccentricity } = *shape;
        Self { gate: gate + 1, long_axis_mm, short_axis_mm, sphericity_index, volume_sphericity, eccentricity }
    }
}
