//! The few numbers that a list of reconstructions shows.

use super::Report;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a list tells of a result. Volumes are null for an ungated study.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Summary {
    /// End-diastolic volume in ml.
    #[schema(required)]
    pub edv_ml: Option<f64>,
    /// End-systolic volume in ml.
    #[schema(required)]
    pub esv_ml: Option<f64>,
    /// Ejection fraction in percent.
    #[schema(required)]
    pub ef_percent: Option<f64>,
    /// Mass of the left ventricle's wall in g.
    pub mass_g: f64,
    /// `quality.score` of the report, 0-1.
    pub quality_score: f64,
    /// `quality.flags` of the report: stable codes, none where nothing speaks against the result.
    pub flags: Vec<String>,
}

impl Summary {
    /// Of a report.
    pub fn of(report: &Report) -> Self {
        let function = report.function.as_ref();
        Self {
            edv_ml: function.map(|function| function.edv_ml),
            esv_ml: function.map(|function| function.esv_ml),
            ef_percent: function.map(|function| function.ef_percent),
            mass_g: report.myocardium.mass_g,
            quality_score: report.quality.score,
            flags: report.quality.flags.clone(),
        }
    }
}
