//! The patient's size, and what is set against it.

use super::report::{Function, Myocardium};
use crate::{pipeline::parameters::Metadata, study::Acquisition};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The patient's size, and volumes and mass for each m² of body surface. What is not known is null.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BodySummary {
    /// Height in m.
    #[schema(required)]
    pub height_m: Option<f64>,
    /// Who gave the height: the `request` (`metadata.height_m`), which wins, or the `header` of the images.
    #[schema(value_type = Option<String>, required, example = "header")]
    pub height_source: Option<BodySource>,
    /// Weight in kg.
    #[schema(required)]
    pub weight_kg: Option<f64>,
    /// Who gave the weight: the `request` (`metadata.weight_kg`), which wins, or the `header` of the images.
    #[schema(value_type = Option<String>, required, example = "request")]
    pub weight_source: Option<BodySource>,
    /// Body surface area in m² by Du Bois and Du Bois (Arch Intern Med 1916;17:863): .007184 · (weight in kg)^.425 · (height in cm)^.725.
    #[schema(required)]
    pub surface_area_m2: Option<f64>,
    /// End-diastolic volume over body surface area in ml/m².
    #[schema(required)]
    pub edv_ml_per_m2: Option<f64>,
    /// End-systolic volume over body surface area in ml/m².
    #[schema(required)]
    pub esv_ml_per_m2: Option<f64>,
    /// Stroke volume over body surface area in ml/m².
    #[schema(required)]
    pub sv_ml_per_m2: Option<f64>,
    /// Myocardial mass over body surface area in g/m².
    #[schema(required)]
    pub mass_g_per_m2: Option<f64>,
}

/// Who told the patient's size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BodySource {
    /// The client, as a parameter.
    Request,
    /// The header of the images.
    Header,
}

impl BodySummary {
    /// By what the request gives and, where it does not, by the header.
    pub(super) fn of(given: &Metadata, said: &Acquisition, function: Option<&Function>, myocardium: &Myocardium) -> Self {
        let (height_m, height_source) = first(given.height_m, said.height_m);
        let (weight_kg, weight_source) = first(given.weight_kg, said.weight_kg);
        let surface_area_m2 = height_m.zip(weight_kg).map(|(height_m, weight_kg)| surface_area_m2(height_m, weight_kg));
        let indexed = |value: Option<f64>| Some(value? / surface_area_m2?);
        Self {
            height_m,
            height_source,
            weight_kg,
            weight_source,
            surface_area_m2,
            edv_ml_per_m2: indexed(function.map(|function| function.edv_ml)),
            esv_ml_per_m2: indexed(function.map(|function| function.esv_ml)),
            sv_ml_per_m2: indexed(function.map(|function| function.sv_ml)),
            mass_g_per_m2: indexed(Some(myocardium.mass_g)),
        }
    }
}

fn first(requested: Option<f64>, header: Option<f64>) -> (Option<f64>, Option<BodySource>) {
    match (requested, header) {
        (Some(value), _) => (Some(value), Some(BodySource::Request)),
        (None, Some(value)) => (Some(value), Some(BodySource::Header)),
        (None, None) => (None, None),
    }
}

/// Body surface area in m² (Du Bois and Du Bois 1916).
fn surface_area_m2(height_m: f64, weight_kg: f64) -> f64 {
    0.007_184 * weight_kg.powf(0.425) * (100.0 * height_m).powf(0.725)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn height_goes_in_as_centimetres_and_weight_as_kilograms() {
        assert!((surface_area_m2(1.70, 70.0) - 1.8097).abs() < 1e-4);
        assert!((surface_area_m2(1.50, 40.0) - 1.3029).abs() < 1e-4);
    }
}
