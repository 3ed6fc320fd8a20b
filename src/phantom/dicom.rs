//! Studies as DICOM Nuclear Medicine Image Storage, as a clinic's workstation would send them.
//!
//! A gated study is a RECON GATED TOMO whose frames run over R-R interval, time slot and slice (the last fastest), an ungated one a RECON
//! TOMO. The module list is that of PS3.3 A.5 (NM Image IOD); the patient is synthetic.

use super::PhantomError;
use crate::elements::{self, Element, code, decimals, empty, number, numbers, sequence, text};
use crate::study::{Orientation, Study};
use dicom_core::{PrimitiveValue, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};

/// The patient's name in every file.
pub const PATIENT_NAME: &str = "PHANTOM^VENTRICLE";
/// The date of everything: files must not depend on the day they are written.
const DATE: &str = "20260101";
/// The time of everything.
const TIME: &str = "120000";
/// Peak of counts that had to be scaled: well inside 16 bits, fine enough that rounding is under 1 in 50 000 of the peak.
const SCALED_PEAK: f64 = 30_000.0;

/// What counts are multiplied by before they are rounded to 16 bits.
///
/// 1 for whole counts that fit (all noisy phantoms at clinical levels); otherwise the largest count of the study becomes 30 000. NM has no
/// rescale slope, so a reader cannot undo it: only ratios of counts mean anything there.
pub fn scale(study: &Study) -> f64 {
    let counts = || study.gates.iter().flat_map(|gate| gate.volume.counts.iter().copied().map(f64::from));
    let peak = counts().fold(0.0, f64::max);
    let whole = counts().all(|count| count.fract() == 0.0);
    if peak == 0.0 || (whole && peak <= f64::from(u16::MAX)) { 1.0 } else { SCALED_PEAK / peak }
}

/// A study as a DICOM file (explicit VR little endian, 16 bits unsigned), preamble and meta header included.
///
/// Counts are multiplied by [`scale`], rounded, and negative ones become 0. UIDs are the study's own, or made from its counts.
/// Errors: a gated study without gate durations, or a library failure.
pub fn write(study: &Study) -> Result<Vec<u8>, PhantomError> {
    let pixels = pixels(study);
    let mut object = InMemDicomObject::new_empty();
    for element in identity_elements(study, &pixels).into_iter().chain(image_elements(study, pixels)).chain(geometry_elements(study)) {
        object.put(element);
    }
    for element in frame_elements(study)?.into_iter().chain(source_elements()) {
        object.put(element);
    }
    let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let file = object.with_meta(meta).map_err(|error| PhantomError::Dicom(Box::new(error)))?;
    let mut bytes = Vec::new();
    file.write_all(&mut bytes).map_err(|error| PhantomError::Dicom(Box::new(error)))?;
    Ok(bytes)
}

/// Counts of all frames: gates, then slices, then rows, then columns.
fn pixels(study: &Study) -> Vec<u16> {
    let scale = scale(study);
    let counts = study.gates.iter().flat_map(|gate| gate.volume.counts.iter());
    counts.map(|&count| (f64::from(count) * scale).round().clamp(0.0, f64::from(u16::MAX)) as u16).collect()
}

/// Who, when, what: Patient, General Study, General Series, Equipment, SOP Common, Frame of Reference.
fn identity_elements(study: &Study, pixels: &[u16]) -> Vec<Element> {
    let facts = &study.acquisition;
    let described: Vec<u8> = pixels.iter().flat_map(|pixel| pixel.to_le_bytes()).collect();
    let uid = |given: Option<&String>, purpose: &str| given.cloned().unwrap_or_else(|| elements::uid(purpose, &described));
    let study_uid = uid(facts.study_instance_uid.as_ref(), "study");
    let frame_of_reference = elements::uid("frame of reference", study_uid.as_bytes());
    let description = if study.is_gated() { "Gated short axis, simulated" } else { "Short axis, simulated" };
    let mut elements = vec![
        text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192"),
        text(tags::SOP_CLASS_UID, VR::UI, uids::NUCLEAR_MEDICINE_IMAGE_STORAGE),
        text(tags::SOP_INSTANCE_UID, VR::UI, uid(facts.sop_instance_uids.first(), "instance")),
        text(tags::STUDY_INSTANCE_UID, VR::UI, study_uid),
        text(tags::SERIES_INSTANCE_UID, VR::UI, uid(facts.series_instance_uid.as_ref(), "series")),
        text(tags::FRAME_OF_REFERENCE_UID, VR::UI, frame_of_reference),
        empty(tags::POSITION_REFERENCE_INDICATOR, VR::LO),
        empty(tags::ACCESSION_NUMBER, VR::SH),
        text(tags::MODALITY, VR::CS, "NM"),
        text(tags::MANUFACTURER, VR::LO, "Ventricle"),
        text(tags::MANUFACTURER_MODEL_NAME, VR::LO, "phantom"),
        text(tags::SOFTWARE_VERSIONS, VR::LO, env!("CARGO_PKG_VERSION")),
        text(tags::DEVICE_SERIAL_NUMBER, VR::LO, "0"),
        empty(tags::REFERRING_PHYSICIAN_NAME, VR::PN),
        text(tags::STUDY_DESCRIPTION, VR::LO, "Myocardial perfusion, simulated"),
        text(tags::SERIES_DESCRIPTION, VR::LO, description),
        text(tags::PATIENT_NAME, VR::PN, PATIENT_NAME),
        text(tags::PATIENT_ID, VR::LO, "PHANTOM"),
        empty(tags::PATIENT_BIRTH_DATE, VR::DA),
        empty(tags::PATIENT_SEX, VR::CS),
        text(tags::BODY_PART_EXAMINED, VR::CS, "HEART"),
        text(tags::STUDY_ID, VR::SH, "1"),
        text(tags::SERIES_NUMBER, VR::IS, "1"),
        text(tags::INSTANCE_NUMBER, VR::IS, "1"),
    ];
    elements.extend(facts.height_m.map(|height_m| decimals(tags::PATIENT_SIZE, &[height_m])));
    elements.extend(facts.weight_kg.map(|weight_kg| decimals(tags::PATIENT_WEIGHT, &[weight_kg])));
    elements.extend([tags::STUDY_DATE, tags::SERIES_DATE, tags::ACQUISITION_DATE, tags::CONTENT_DATE].map(|tag| text(tag, VR::DA, DATE)));
    elements.extend([tags::STUDY_TIME, tags::SERIES_TIME, tags::ACQUISITION_TIME, tags::CONTENT_TIME].map(|tag| text(tag, VR::TM, TIME)));
    elements
}

/// The pixels and what they are: Image Pixel, Multi-frame, NM Image.
fn image_elements(study: &Study, pixels: Vec<u16>) -> Vec<Element> {
    let [slices, rows, columns] = study.grid.shape;
    let kind = if study.is_gated() { "RECON GATED TOMO" } else { "RECON TOMO" };
    let accumulated: u64 = pixels.iter().map(|&pixel| u64::from(pixel)).sum();
    let largest = pixels.iter().copied().max().unwrap_or(0);
    vec![
        text(tags::IMAGE_TYPE, VR::CS, format!("ORIGINAL\\PRIMARY\\{kind}\\EMISSION")),
        text(tags::COUNTS_ACCUMULATED, VR::IS, accumulated.min(i32::MAX as u64).to_string()),
        number(tags::SAMPLES_PER_PIXEL, 1),
        text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
        text(tags::NUMBER_OF_FRAMES, VR::IS, (study.gates.len() * slices).to_string()),
        number(tags::ROWS, rows),
        number(tags::COLUMNS, columns),
        number(tags::BITS_ALLOCATED, 16),
        number(tags::BITS_STORED, 16),
        number(tags::HIGH_BIT, 15),
        number(tags::PIXEL_REPRESENTATION, 0),
        decimals(tags::WINDOW_CENTER, &[f64::from(largest) / 2.0]),
        decimals(tags::WINDOW_WIDTH, &[f64::from(largest).max(1.0)]),
        Element::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(pixels.into())),
    ]
}

/// Where the frames lie: spacing at top level, orientation and position in the Detector Information.
fn geometry_elements(study: &Study) -> Vec<Element> {
    let [slice_mm, row_mm, column_mm] = study.grid.spacing_mm;
    // PS3.3 C.8.4.15: the sign says on which side of the image plane the next slice lies.
    let stacking = if study.orientation.is_some_and(|orientation| orientation.mirrors()) { -1.0 } else { 1.0 };
    let mut detector = vec![empty(tags::COLLIMATOR_TYPE, VR::CS)];
    match study.orientation {
        Some(Orientation { columns, rows, origin_mm, .. }) => {
            detector.push(decimals(tags::IMAGE_ORIENTATION_PATIENT, &[columns.to_array(), rows.to_array()].concat()));
            detector.push(decimals(tags::IMAGE_POSITION_PATIENT, &origin_mm.to_array()));
        }
        // Type 2: present without a value.
        None => detector.extend([tags::IMAGE_ORIENTATION_PATIENT, tags::IMAGE_POSITION_PATIENT].map(|tag| empty(tag, VR::DS))),
    }
    vec![
        decimals(tags::PIXEL_SPACING, &[row_mm, column_mm]),
        decimals(tags::SLICE_THICKNESS, &[slice_mm]),
        decimals(tags::SPACING_BETWEEN_SLICES, &[slice_mm * stacking]),
        number(tags::NUMBER_OF_DETECTORS, 1),
        sequence(tags::DETECTOR_INFORMATION_SEQUENCE, [detector]),
    ]
}

/// Which frame is which: NM Multi-frame and NM Multi-gated Acquisition.
fn frame_elements(study: &Study) -> Result<Vec<Element>, PhantomError> {
    let (gates, slices) = (study.gates.len(), study.grid.shape[0]);
    let mut elements = vec![
        numbers(tags::SLICE_VECTOR, (0..gates * slices).map(|frame| frame % slices + 1)),
        number(tags::NUMBER_OF_SLICES, slices),
        number(tags::NUMBER_OF_ENERGY_WINDOWS, 1),
        number(tags::NUMBER_OF_ROTATIONS, 1),
    ];
    let pointer = |pointed: &[Tag]| Element::new(tags::FRAME_INCREMENT_POINTER, VR::AT, PrimitiveValue::Tags(pointed.into()));
    if !study.is_gated() {
        elements.push(pointer(&[tags::SLICE_VECTOR]));
        return Ok(elements);
    }
    let frame_time_ms = study.gates[0].duration_ms.ok_or(PhantomError::NoGateDuration)?;
    let rr_ms = study.acquisition.rr_interval_ms.unwrap_or(frame_time_ms * gates as f64);
    let whole = |tag: Tag, value: f64| text(tag, VR::IS, format!("{value:.0}"));
    let facts = &study.acquisition;
    let mut data = vec![decimals(tags::FRAME_TIME, &[frame_time_ms]), whole(tags::NOMINAL_INTERVAL, rr_ms)];
    let [low_ms, high_ms] = facts.rr_window_ms.map_or([None, None], |window| window.map(Some));
    let (accepted, rejected) = (facts.beats_accepted.map(|beats| beats as f64), facts.beats_rejected.map(|beats| beats as f64));
    let told = [
        (tags::LOW_RR_VALUE, low_ms),
        (tags::HIGH_RR_VALUE, high_ms),
        (tags::INTERVALS_ACQUIRED, accepted),
        (tags::INTERVALS_REJECTED, rejected),
    ];
    data.extend(told.into_iter().filter_map(|(tag, value)| Some(whole(tag, value?))));
    let gated = vec![
        decimals(tags::TRIGGER_TIME, &[0.0]),
        text(tags::CARDIAC_FRAMING_TYPE, VR::LO, "FORW"),
        sequence(tags::DATA_INFORMATION_SEQUENCE, [data]),
    ];
    elements.extend([
        pointer(&[tags::RR_INTERVAL_VECTOR, tags::TIME_SLOT_VECTOR, tags::SLICE_VECTOR]),
        numbers(tags::RR_INTERVAL_VECTOR, (0..gates * slices).map(|_| 1)),
        number(tags::NUMBER_OF_RR_INTERVALS, 1),
        numbers(tags::TIME_SLOT_VECTOR, (0..gates * slices).map(|frame| frame / slices + 1)),
        number(tags::NUMBER_OF_TIME_SLOTS, gates),
        whole(tags::HEART_RATE, 60_000.0 / rr_ms),
        sequence(tags::GATED_INFORMATION_SEQUENCE, [gated]),
    ]);
    elements.extend(facts.beat_rejection.map(|sorted| text(tags::BEAT_REJECTION_FLAG, VR::CS, if sorted { "Y" } else { "N" })));
    Ok(elements)
}

/// What a camera would say of tracer and patient: NM/PET Patient Orientation, NM Isotope, NM TOMO Acquisition, NM Reconstruction.
fn source_elements() -> Vec<Element> {
    let mut recumbent = code("102538003", "SCT", "recumbent");
    recumbent.push(sequence(tags::PATIENT_ORIENTATION_MODIFIER_CODE_SEQUENCE, [code("40199007", "SCT", "supine")]));
    let range = vec![decimals(tags::ENERGY_WINDOW_LOWER_LIMIT, &[126.0]), decimals(tags::ENERGY_WINDOW_UPPER_LIMIT, &[154.0])];
    let window = vec![text(tags::ENERGY_WINDOW_NAME, VR::SH, "Tc99m"), sequence(tags::ENERGY_WINDOW_RANGE_SEQUENCE, [range])];
    let tracer = vec![
        text(tags::RADIOPHARMACEUTICAL, VR::LO, "Tc99m sestamibi, simulated"),
        // Type 2: present without an item; the text above names the tracer.
        sequence(tags::RADIONUCLIDE_CODE_SEQUENCE, []),
    ];
    let rotation = vec![
        decimals(tags::START_ANGLE, &[45.0]),
        decimals(tags::ANGULAR_STEP, &[3.0]),
        text(tags::ROTATION_DIRECTION, VR::CS, "CW"),
        decimals(tags::SCAN_ARC, &[180.0]),
        text(tags::ACTUAL_FRAME_DURATION, VR::IS, "25000"),
        decimals(tags::RADIAL_POSITION, &[250.0]),
        number(tags::NUMBER_OF_FRAMES_IN_ROTATION, 60),
    ];
    vec![
        sequence(tags::PATIENT_ORIENTATION_CODE_SEQUENCE, [recumbent]),
        sequence(tags::PATIENT_GANTRY_RELATIONSHIP_CODE_SEQUENCE, [code("102540008", "SCT", "headfirst")]),
        sequence(tags::ENERGY_WINDOW_INFORMATION_SEQUENCE, [window]),
        sequence(tags::RADIOPHARMACEUTICAL_INFORMATION_SEQUENCE, [tracer]),
        text(tags::TYPE_OF_DETECTOR_MOTION, VR::CS, "STEP AND SHOOT"),
        sequence(tags::ROTATION_INFORMATION_SEQUENCE, [rotation]),
    ]
}
