//! The wall by segments and territories: perfusion, thickness, thickening, motion, phase.

use crate::analysis::{
    Analysis, Place, Places, RotationSource,
    segments::{self, Average, Territory},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The wall by the seventeen segments of the American Heart Association (Cerqueira et al. 2002). Values are means over each segment's
/// vertices, weighted by area; null where it has none, and for one gate where a cycle is needed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RegionalSummary {
    /// How the anterior wall was told from the others.
    pub rotation: Rotation,
    /// Segments 1 to 17.
    pub segments: Vec<SegmentReport>,
    /// Territories of the coronary arteries, as the statement assigns segments to them: LAD, RCA, LCX.
    pub territories: Vec<TerritoryReport>,
    /// All of the wall.
    pub whole: RegionalValues,
}

/// How the wall's sides were told.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Rotation {
    /// `given` by the request, from the `patient`'s axes (the anterior wall is the one towards the head), or `assumed`: the study says
    /// nothing of it, and the first row was taken for anterior and the first column for septal. Segments then may be others, and the
    /// warning `rotation_unknown` says so.
    #[schema(value_type = String, example = "patient")]
    pub source: RotationSource,
    /// Unit vector in the grid from the long axis to the anterior wall.
    pub anterior: [f64; 3],
    /// Unit vector in the grid from the long axis to the septal wall.
    pub septal: [f64; 3],
}

/// One segment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SegmentReport {
    /// 1 to 17.
    pub segment: usize,
    /// Its name in the statement.
    #[schema(example = "basal anterior")]
    pub name: String,
    /// The artery it is assigned to: `LAD`, `RCA` or `LCX`.
    #[schema(example = "LAD")]
    pub territory: String,
    /// What was measured.
    #[serde(flatten)]
    pub values: RegionalValues,
}

/// One territory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TerritoryReport {
    /// `LAD`, `RCA` or `LCX`.
    #[schema(example = "LAD")]
    pub territory: String,
    /// What was measured.
    #[serde(flatten)]
    pub values: RegionalValues,
}

/// Means over a part of the wall.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RegionalValues {
    /// Its area half way through the wall at end diastole, in cm².
    pub area_cm2: f64,
    /// Mean counts through the wall and its surroundings, the mean over the gates, in percent of the wall's maximum.
    #[schema(required)]
    pub perfusion_percent: Option<f64>,
    /// Thickness at end diastole (at the one gate of an ungated study) in mm.
    #[schema(required)]
    pub end_diastolic_thickness_mm: Option<f64>,
    /// Thickness at end systole in mm.
    #[schema(required)]
    pub end_systolic_thickness_mm: Option<f64>,
    /// Thickening from end diastole to end systole in percent.
    #[schema(required)]
    pub thickening_percent: Option<f64>,
    /// Inward motion of the endocardial surface from end diastole to end systole in mm.
    #[schema(required)]
    pub motion_mm: Option<f64>,
    /// Phase of the first harmonic of the counts in degrees, 0 to 360: when the wall is thickest.
    #[schema(required)]
    pub phase_degrees: Option<f64>,
}

impl Rotation {
    /// As the places were told.
    pub(super) fn of(places: &Places) -> Self {
        let [anterior, septal, _] = places.axes;
        Self { source: places.rotation, anterior: anterior.to_array(), septal: septal.to_array() }
    }
}

impl RegionalSummary {
    /// Of an analysis.
    pub(super) fn of(analysis: &Analysis) -> Self {
        let places = &analysis.places;
        let values = |wanted: &dyn Fn(&Place) -> bool| values(analysis, wanted);
        Self {
            rotation: Rotation::of(places),
            segments: segments::ALL
                .iter()
                .map(|segment| SegmentReport {
                    segment: segment.number,
                    name: segment.name.to_owned(),
                    territory: segment.territory.name().to_owned(),
                    values: values(&|place| place.segment == segment.number),
                })
                .collect(),
            territories: Territory::ALL
                .iter()
                .map(|&territory| TerritoryReport {
                    territory: territory.name().to_owned(),
                    values: values(&|place| segments::ALL[place.segment - 1].territory == territory),
                })
                .collect(),
            whole: values(&|_| true),
        }
    }
}

fn values(analysis: &Analysis, wanted: &dyn Fn(&Place) -> bool) -> RegionalValues {
    let places = &analysis.places;
    let mean = |values: &[Option<f64>]| segments::mean_where(values, places, Average::Plain, wanted);
    let gated = analysis.walls.thickness_mm.len() > 1;
    let area_mm2: f64 = places.of_vertex.iter().flatten().filter(|place| wanted(place)).map(|place| place.area_mm2).sum();
    RegionalValues {
        area_cm2: area_mm2 / 100.0,
        perfusion_percent: mean(&analysis.perfusion.percent),
        end_diastolic_thickness_mm: mean(&analysis.walls.thickness_mm[analysis.end_diastole]),
        end_systolic_thickness_mm: if gated { mean(&analysis.walls.thickness_mm[analysis.end_systole]) } else { None },
        thickening_percent: mean(&analysis.walls.thickening_percent),
        motion_mm: mean(&analysis.walls.motion_mm),
        phase_degrees: analysis.phase.as_ref().and_then(|phase| segments::mean_where(&phase.degrees, places, Average::Circular, wanted)),
    }
}
