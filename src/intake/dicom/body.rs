//! How tall and heavy the patient is: volumes are set against it. It names nobody and is all that is read of the patient.

use super::attributes::Attributes;
use crate::intake::error::shown;
use crate::study::Warning;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use std::ops::RangeInclusive;

/// Heights that people have, in m; those that a request may give.
const HEIGHT_M: RangeInclusive<f64> = 0.3..=2.5;
/// Weights that people have, in kg; likewise.
const WEIGHT_KG: RangeInclusive<f64> = 2.0..=400.0;

/// Height in m and weight in kg.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Body {
    pub(super) height_m: Option<f64>,
    pub(super) weight_kg: Option<f64>,
}

/// Reads Patient's Size (0010,1020) and Patient's Weight (0010,1030) (PS3.3 C.7.2.2), in m and kg. Other units and empty fields that were
/// filled with 0 are left out, with a warning.
pub(super) fn read(attributes: &Attributes, warnings: &mut Vec<Warning>) -> Body {
    let mut value = |tag: Tag, name: &'static str, sensible: &RangeInclusive<f64>, unit: &str, parameter: &str| {
        let told = match attributes.number(tag, name) {
            Ok(None) => return None,
            Ok(Some(number)) if sensible.contains(&number) => return Some(number),
            Ok(Some(number)) => {
                format!("{} {unit}, where {} to {} is expected", shown(&number.to_string()), sensible.start(), sensible.end())
            }
            // What is no number may be anything, and is not repeated.
            Err(_) => "no number".to_owned(),
        };
        let message = format!("{name} {tag} is {told}; it was left out. Give the parameter `{parameter}` to have volumes indexed.");
        warnings.push(Warning::new("implausible_body_size", message));
        None
    };
    Body {
        height_m: value(tags::PATIENT_SIZE, "Patient's Size", &HEIGHT_M, "m", "metadata.height_m"),
        weight_kg: value(tags::PATIENT_WEIGHT, "Patient's Weight", &WEIGHT_KG, "kg", "metadata.weight_kg"),
    }
}
