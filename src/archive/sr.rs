//! The measurements as a Comprehensive SR by the template Measurement Report (DICOM PS3.16 TID 1500).
//!
//! One group of measurements (TID 1501) for the ventricle over the cycle, then one a gate, the gate in its time point (TID 1502). Values are
//! the report's, unrounded. An uncertainty is the standard error as a standard deviation, and the 95 % interval as upper and lower range.
//! Flags and warnings are text under the qualitative evaluations.

use super::{
    ArchiveError, Finished, Sources,
    codes::{self, Code},
    content::{Item, Relation, coded, container, image, measured, no_items, reference, root, uid, words},
    header::{self, Instance, PRODUCT},
};
use crate::{
    elements::{self, Element, sequence, text},
    pipeline::parameters::Preset,
    report::{ErrorSummary, GateReport, Report},
};
use dicom_core::VR;
use dicom_dictionary_std::{tags, uids};
use serde_json::Value;

/// Number of its series.
const SERIES_NUMBER: usize = 9901;

/// Media type of a DICOM file.
pub const MEDIA_TYPE: &str = "application/dicom";

/// The report as a DICOM file.
///
/// # Errors
/// [`ArchiveError`] where the DICOM library fails, which it has no reason to.
pub fn write(finished: &Finished) -> Result<Vec<u8>, ArchiveError> {
    let instance = Instance {
        class_uid: uids::COMPREHENSIVE_SR_STORAGE,
        uid: finished.uid("measurement report"),
        number: 1,
        series_uid: finished.uid("series of the measurement report"),
        series_number: SERIES_NUMBER,
        modality: "SR",
        series_description: "Left ventricle, measurements",
    };
    let sources = finished.sources();
    let mut all = header::elements(finished, &instance);
    all.extend([
        header::own_coding_scheme(),
        no_items(tags::REFERENCED_PERFORMED_PROCEDURE_STEP_SEQUENCE),
        no_items(tags::PERFORMED_PROCEDURE_CODE_SEQUENCE),
        text(tags::COMPLETION_FLAG, VR::CS, "COMPLETE"),
        // No person has looked at it.
        text(tags::VERIFICATION_FLAG, VR::CS, "UNVERIFIED"),
    ]);
    all.extend(sources.as_ref().map(evidence));
    all.extend(document(finished, sources.as_ref()));
    header::file(all)
}

/// The instances that the document rests on.
fn evidence(sources: &Sources<'_>) -> Element {
    let instances = sources.instances.iter().map(|source| reference(source.class_uid, source.instance_uid));
    let series = vec![
        text(tags::SERIES_INSTANCE_UID, VR::UI, sources.series_uid),
        sequence(tags::REFERENCED_SOP_SEQUENCE, instances.collect::<Vec<_>>()),
    ];
    let study = vec![text(tags::STUDY_INSTANCE_UID, VR::UI, sources.study_uid), sequence(tags::REFERENCED_SERIES_SEQUENCE, [series])];
    sequence(tags::CURRENT_REQUESTED_PROCEDURE_EVIDENCE_SEQUENCE, [study])
}

/// TID 1500.
fn document(finished: &Finished, sources: Option<&Sources<'_>>) -> Item {
    let report = &finished.report;
    let mut children = vec![coded(Relation::ConceptModifier, codes::LANGUAGE, codes::ENGLISH)];
    children.extend(observer(report));
    children.push(coded(Relation::ConceptModifier, codes::PROCEDURE_REPORTED, codes::IMAGING_PROCEDURE));
    children.extend(sources.map(|sources| image_library(report, sources)));
    let groups = std::iter::once(ventricle(finished)).chain(report.gates.iter().map(|gate| one_gate(finished, gate)));
    children.push(container(Relation::Contains, codes::IMAGING_MEASUREMENTS, None, groups.collect()));
    children.push(container(Relation::Contains, codes::QUALITATIVE_EVALUATIONS, None, evaluations(report, sources.is_some())));
    root(codes::MEASUREMENT_REPORT, "1500", children)
}

/// TID 1002 and 1004: a device observed.
fn observer(report: &Report) -> Vec<Item> {
    let software = &report.software;
    let device_uid = elements::uid("device", format!("{} {}", software.name, software.version).as_bytes());
    vec![
        coded(Relation::ObservationContext, codes::OBSERVER_TYPE, codes::DEVICE),
        uid(Relation::ObservationContext, codes::DEVICE_UID, &device_uid),
        words(Relation::ObservationContext, codes::DEVICE_NAME, &software.name),
        words(Relation::ObservationContext, codes::DEVICE_MANUFACTURER, PRODUCT),
        words(Relation::ObservationContext, codes::DEVICE_MODEL, &software.name),
    ]
}

/// TID 1600.
fn image_library(report: &Report, sources: &Sources<'_>) -> Item {
    let mut group = vec![coded(Relation::AcquisitionContext, codes::MODALITY, codes::NUCLEAR_MEDICINE)];
    let frame = report.study.frame_of_reference_uid.as_deref();
    group.extend(frame.map(|frame| uid(Relation::AcquisitionContext, codes::FRAME_OF_REFERENCE, frame)));
    group.extend(sources.instances.iter().map(|source| image(Relation::Contains, source.class_uid, source.instance_uid)));
    let group = container(Relation::Contains, codes::IMAGE_LIBRARY_GROUP, None, group);
    container(Relation::Contains, codes::IMAGE_LIBRARY, Some("1600"), vec![group])
}

/// How every group of measurements begins (TID 1501, 4019).
fn group(finished: &Finished, name: &str, finding: Option<Code>) -> Vec<Item> {
    let report = &finished.report;
    let mut items = vec![
        words(Relation::ObservationContext, codes::TRACKING_IDENTIFIER, name),
        uid(Relation::ObservationContext, codes::TRACKING_UID, &finished.uid(&format!("tracking {name}"))),
    ];
    items.extend(finding.map(|finding| coded(Relation::Contains, codes::FINDING, finding)));
    items.extend([
        coded(Relation::ConceptModifier, codes::MEASUREMENT_METHOD, method(report)),
        coded(Relation::ConceptModifier, codes::FINDING_SITE, codes::LEFT_VENTRICLE),
        words(Relation::ConceptModifier, codes::ALGORITHM_NAME, &report.software.name),
        words(Relation::ConceptModifier, codes::ALGORITHM_VERSION, &report.software.version),
    ]);
    items
}

/// How the surfaces were found.
pub(super) fn method(report: &Report) -> Code {
    match (report.parameters.preset, &report.model) {
        (Preset::Paper, _) => codes::DEFORMABLE_MODEL,
        (Preset::Clinical, Some(model)) if model.refined => codes::CAMERA_MODEL,
        (Preset::Clinical, _) => codes::GRADIENT_EXTREMA,
    }
}

/// The ventricle over the cycle.
fn ventricle(finished: &Finished) -> Item {
    let report = &finished.report;
    let mut items = group(finished, "Left ventricle", None);
    let parameters = serde_json::to_value(&report.parameters).unwrap_or_default();
    items.extend(flattened("", &parameters).iter().map(|line| words(Relation::ConceptModifier, codes::ALGORITHM_PARAMETERS, line)));
    let errors = report.uncertainty.as_ref();
    if let Some(function) = &report.function {
        let volume = |name, value, error| {
            measured(Relation::Contains, name, value, codes::MILLILITRES, uncertainty(value, error, codes::MILLILITRES))
        };
        let ef = function.ef_percent;
        items.extend([
            volume(codes::ED_VOLUME, function.edv_ml, errors.map(|errors| &errors.edv_ml)),
            volume(codes::ES_VOLUME, function.esv_ml, errors.and_then(|errors| errors.esv_ml.as_ref())),
            volume(codes::STROKE_VOLUME, function.sv_ml, None),
            measured(
                Relation::Contains,
                codes::EJECTION_FRACTION,
                ef,
                codes::PERCENT,
                uncertainty(ef, errors.and_then(|errors| errors.ef_percent.as_ref()), codes::PERCENT),
            ),
        ]);
    }
    let mean = || vec![coded(Relation::ConceptModifier, codes::DERIVATION, codes::MEAN)];
    let mass = report.myocardium.mass_g;
    let mut of_mass = mean();
    of_mass.extend(uncertainty(mass, errors.map(|errors| &errors.mass_g), codes::GRAMS));
    items.extend([
        measured(Relation::Contains, codes::WALL_VOLUME, report.myocardium.mean_ml, codes::MILLILITRES, mean()),
        measured(Relation::Contains, codes::WALL_MASS, mass, codes::GRAMS, of_mass),
        measured(Relation::Contains, codes::QUALITY_SCORE, report.quality.score, codes::NO_UNIT, Vec::new()),
    ]);
    let plain = |name, value: Option<f64>, unit| value.map(|value| measured(Relation::Contains, name, value, unit, Vec::new()));
    items.extend(plain(codes::HEART_RATE, report.study.heart_rate_bpm, codes::BEATS_A_MINUTE));
    items.extend(plain(codes::R_R_INTERVAL, report.study.rr_interval_ms, codes::MILLISECONDS));
    container(Relation::Contains, codes::MEASUREMENT_GROUP, Some("1501"), items)
}

/// One gate: the volumes at its time.
fn one_gate(finished: &Finished, gate: &GateReport) -> Item {
    let report = &finished.report;
    let phase = report.function.as_ref().and_then(|function| match gate.gate {
        number if number == function.end_diastolic_gate => Some(codes::END_DIASTOLE),
        number if number == function.end_systolic_gate => Some(codes::END_SYSTOLE),
        _ => None,
    });
    let mut items = group(finished, &format!("Gate {}", gate.gate), phase);
    let time = format!("Gate {} of {}", gate.gate, report.gates.len());
    items.push(words(Relation::ObservationContext, codes::TIME_POINT, &time));
    items.push(measured(Relation::ObservationContext, codes::TIME_POINT_ORDER, gate.gate as f64, codes::NO_UNIT, Vec::new()));
    // Without a cycle the uncertainty is this volume's.
    let error = report.uncertainty.as_ref().filter(|_| report.function.is_none()).map(|errors| &errors.edv_ml);
    let volume = |name, value, children| measured(Relation::Contains, name, value, codes::MILLILITRES, children);
    items.extend([
        volume(codes::ENDOCARDIAL_VOLUME, gate.endocardial_ml, uncertainty(gate.endocardial_ml, error, codes::MILLILITRES)),
        volume(codes::EPICARDIAL_VOLUME, gate.epicardial_ml, Vec::new()),
        volume(codes::WALL_VOLUME, gate.myocardial_ml, Vec::new()),
    ]);
    container(Relation::Contains, codes::MEASUREMENT_GROUP, Some("1501"), items)
}

/// TID 310 and 311.
fn uncertainty(value: f64, error: Option<&ErrorSummary>, unit: Code) -> Vec<Item> {
    let Some(error) = error else { return Vec::new() };
    let property = |name, value| measured(Relation::Property, name, value, unit, Vec::new());
    vec![
        property(codes::STANDARD_DEVIATION, error.standard_error),
        property(codes::UPPER_UNCERTAINTY, (error.high_95 - value).max(0.0)),
        property(codes::LOWER_UNCERTAINTY, (value - error.low_95).max(0.0)),
    ]
}

/// What speaks for or against the result, in words.
fn evaluations(report: &Report, refers: bool) -> Vec<Item> {
    let comment = |value: &str| words(Relation::Contains, codes::COMMENT, value);
    let mut items: Vec<Item> = report.quality.flags.iter().map(|flag| words(Relation::Contains, codes::QUALITY_FLAG, flag)).collect();
    items.extend(report.warnings.iter().map(|warning| match warning.gate {
        Some(gate) => comment(&format!("Gate {gate}: {} ({})", warning.message, warning.code)),
        None => comment(&format!("{} ({})", warning.message, warning.code)),
    }));
    if report.study.study_instance_uid.is_none() {
        items.push(comment("The input names no DICOM study: the Study Instance UID of this document was made for it."));
    }
    if !refers {
        items.push(comment("The input has no complete DICOM reference: this document refers to no images."));
    }
    items.push(comment("Computed without a person's review. Research use: not a medical device."));
    items
}

/// Parameters as `name = value`, one a line, by their dotted names; those without a value left out.
fn flattened(name: &str, value: &Value) -> Vec<String> {
    match value {
        Value::Object(members) => {
            let dotted = |member: &String| if name.is_empty() { member.clone() } else { format!("{name}.{member}") };
            members.iter().flat_map(|(member, value)| flattened(&dotted(member), value)).collect()
        }
        Value::Null => Vec::new(),
        Value::String(text) => vec![format!("{name} = {text}")],
        value => vec![format!("{name} = {value}")],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn parameters_are_told_by_their_dotted_names() {
        let parameters = json!({"preset": "clinical", "mesh": {"level": 3}, "pose": {"apex_mm": null, "base_mm": [1.0, 2.5, 3.0]}});
        let mut lines = flattened("", &parameters);
        lines.sort();
        assert_eq!(lines, ["mesh.level = 3", "pose.base_mm = [1.0,2.5,3.0]", "preset = clinical"]);
    }
}
