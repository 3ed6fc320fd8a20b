//! The measurements as a FHIR R4 Bundle: a `DiagnosticReport`, an `Observation` a value and a gate, the `Device`.
//!
//! It names no patient: the receiver adds `subject` to the report and the observations. To the study it refers by UID. Values are the report's,
//! unrounded, in UCUM units; a standard error is the extension `iso21090-uncertainty` of the quantity. No heart rate: FHIR's profile of it
//! needs a patient and a time, which are not here.

use super::{
    ArchiveError, Finished,
    codes::{self, Code, OWN_SCHEME_UID},
    sr::method,
};
use crate::report::{ErrorSummary, GateReport};
use serde_json::{Map, Value, json};

/// The media types under which it is sent, the proper one first.
pub const MEDIA_TYPES: [&str; 2] = ["application/fhir+json", "application/json"];

const UNCERTAINTY: &str = "http://hl7.org/fhir/StructureDefinition/iso21090-uncertainty";
const UNCERTAINTY_TYPE: &str = "http://hl7.org/fhir/StructureDefinition/iso21090-uncertaintyType";

/// A resource of the bundle, by the URN under which the others refer to it.
struct Entry {
    urn: String,
    resource: Value,
}

/// The bundle as JSON.
///
/// # Errors
/// [`ArchiveError::Json`], which has no reason to be.
pub fn write(finished: &Finished) -> Result<Vec<u8>, ArchiveError> {
    let device = Entry { urn: urn(finished, "device"), resource: device(finished) };
    let observations = observations(finished, &device.urn);
    let report = Entry { urn: urn(finished, "diagnostic report"), resource: diagnostic_report(finished, &observations) };
    let entries = std::iter::once(report).chain(observations).chain([device]);
    let bundle = json!({
        "resourceType": "Bundle",
        "identifier": {"system": "urn:ietf:rfc:3986", "value": format!("urn:uuid:{}", finished.id)},
        "type": "collection",
        "timestamp": finished.finished_at.to_string(),
        "entry": entries.map(|entry| json!({"fullUrl": entry.urn, "resource": entry.resource})).collect::<Vec<_>>(),
    });
    Ok(serde_json::to_vec(&bundle)?)
}

/// A URN of this job for a purpose: the UUID that is also the number of a UID.
fn urn(finished: &Finished, purpose: &str) -> String {
    let uid = finished.uid(purpose);
    let number: u128 = uid.trim_start_matches("2.25.").parse().unwrap_or_default();
    format!("urn:uuid:{}", uuid::Uuid::from_u128(number))
}

/// A code and its system, as FHIR names it.
fn concept(code: Code) -> Value {
    let system = match code.scheme {
        "SCT" => "http://snomed.info/sct".to_owned(),
        "DCM" => "http://dicom.nema.org/resources/ontology/DCM".to_owned(),
        _ => format!("urn:oid:{OWN_SCHEME_UID}"),
    };
    json!({"coding": [{"system": system, "code": code.value, "display": code.meaning}], "text": code.meaning})
}

/// A concept for which no code is known to be right here. DICOM's are LOINC's 8821-1 and 8823-7, whose own names were not found: they may
/// mean another method.
fn in_words(text: &str) -> Value {
    json!({ "text": text })
}

fn quantity(value: f64, unit: Code, error: Option<&ErrorSummary>) -> Value {
    // UCUM's litre is l or L; FHIR's examples and most receivers write mL.
    let code = if unit.value == "ml" { "mL" } else { unit.value };
    let mut quantity = json!({"value": value, "unit": code, "system": "http://unitsofmeasure.org", "code": code});
    if let Some(error) = error {
        quantity["extension"] =
            json!([{"url": UNCERTAINTY, "valueDecimal": error.standard_error}, {"url": UNCERTAINTY_TYPE, "valueCode": "N"}]);
    }
    quantity
}

/// What all observations say.
fn observation(finished: &Finished, code: &Value, device_urn: &str) -> Map<String, Value> {
    let mut resource = Map::new();
    let mut say = |name: &str, value: Value| resource.insert(name.to_owned(), value);
    say("resourceType", json!("Observation"));
    // No person has reviewed it.
    say("status", json!("preliminary"));
    say("category", json!([{"coding": [{"system": "http://terminology.hl7.org/CodeSystem/observation-category", "code": "imaging"}]}]));
    say("code", code.clone());
    say("issued", json!(finished.finished_at.to_string()));
    say("bodySite", concept(codes::LEFT_VENTRICLE));
    say("method", concept(method(&finished.report)));
    say("device", json!({"reference": device_urn}));
    if let Some(study) = imaging_study(finished) {
        say("derivedFrom", json!([study]));
    }
    resource
}

/// The study by its UID; none where the input was of no study.
fn imaging_study(finished: &Finished) -> Option<Value> {
    let uid = finished.report.study.study_instance_uid.as_ref()?;
    Some(json!({"type": "ImagingStudy", "identifier": {"system": "urn:dicom:uid", "value": format!("urn:oid:{uid}")}}))
}

fn observations(finished: &Finished, device_urn: &str) -> Vec<Entry> {
    let report = &finished.report;
    let errors = report.uncertainty.as_ref();
    let mut entries = Vec::new();
    let mut add = |purpose: &str, code: Value, value: Value| {
        let mut resource = observation(finished, &code, device_urn);
        resource.insert("valueQuantity".to_owned(), value);
        entries.push(Entry { urn: urn(finished, purpose), resource: resource.into() });
    };
    if let Some(function) = &report.function {
        let edv = quantity(function.edv_ml, codes::MILLILITRES, errors.map(|errors| &errors.edv_ml));
        add("edv", in_words("Left ventricular end-diastolic volume"), edv);
        let esv = quantity(function.esv_ml, codes::MILLILITRES, errors.and_then(|errors| errors.esv_ml.as_ref()));
        add("esv", in_words("Left ventricular end-systolic volume"), esv);
        add("sv", concept(codes::STROKE_VOLUME), quantity(function.sv_ml, codes::MILLILITRES, None));
        let ef = quantity(function.ef_percent, codes::PERCENT, errors.and_then(|errors| errors.ef_percent.as_ref()));
        add("ef", concept(codes::EJECTION_FRACTION), ef);
    }
    add("wall volume", concept(codes::WALL_VOLUME), quantity(report.myocardium.mean_ml, codes::MILLILITRES, None));
    let mass = quantity(report.myocardium.mass_g, codes::GRAMS, errors.map(|errors| &errors.mass_g));
    add("wall mass", concept(codes::WALL_MASS), mass);
    if let Some(interval_ms) = report.study.rr_interval_ms {
        add("r-r interval", concept(codes::R_R_INTERVAL), quantity(interval_ms, codes::MILLISECONDS, None));
    }
    entries.extend(report.gates.iter().map(|gate| one_gate(finished, gate, device_urn)));
    entries
}

/// One gate: its volumes as components.
fn one_gate(finished: &Finished, gate: &GateReport, device_urn: &str) -> Entry {
    let report = &finished.report;
    let name = format!("Volumes of the left ventricle at gate {} of {}", gate.gate, report.gates.len());
    let mut resource = observation(finished, &in_words(&name), device_urn);
    // Without a cycle the uncertainty is this volume's.
    let error = report.uncertainty.as_ref().filter(|_| report.function.is_none()).map(|errors| &errors.edv_ml);
    let component = |code, value, error| json!({"code": concept(code), "valueQuantity": quantity(value, codes::MILLILITRES, error)});
    let components = json!([
        component(codes::ENDOCARDIAL_VOLUME, gate.endocardial_ml, error),
        component(codes::EPICARDIAL_VOLUME, gate.epicardial_ml, None),
        component(codes::WALL_VOLUME, gate.myocardial_ml, None),
    ]);
    resource.insert("component".to_owned(), components);
    Entry { urn: urn(finished, &format!("gate {}", gate.gate)), resource: resource.into() }
}

fn diagnostic_report(finished: &Finished, observations: &[Entry]) -> Value {
    let mut resource = json!({
        "resourceType": "DiagnosticReport",
        "identifier": [{"system": "urn:ietf:rfc:3986", "value": format!("urn:uuid:{}", finished.id)}],
        // Complete, but reviewed by nobody.
        "status": "partial",
        "code": concept(codes::MEASUREMENT_REPORT),
        "issued": finished.finished_at.to_string(),
        "result": observations.iter().map(|observation| json!({"reference": observation.urn})).collect::<Vec<_>>(),
        "conclusion": conclusion(finished),
    });
    if let Some(study) = imaging_study(finished) {
        resource["imagingStudy"] = json!([study]);
    }
    resource
}

/// What speaks against the result, and what it is not.
fn conclusion(finished: &Finished) -> String {
    let remarks = finished.report.warnings.iter().map(|warning| match warning.gate {
        Some(gate) => format!("Gate {gate}: {}", warning.message),
        None => warning.message.clone(),
    });
    let last = "Computed without a person's review. Research use: not a medical device.".to_owned();
    remarks.chain([last]).collect::<Vec<_>>().join("\n")
}

fn device(finished: &Finished) -> Value {
    let software = &finished.report.software;
    json!({
        "resourceType": "Device",
        "deviceName": [{"name": software.name, "type": "model-name"}],
        "version": [{"value": software.version}],
    })
}
