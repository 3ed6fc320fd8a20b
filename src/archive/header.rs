//! What every DICOM result says before its content: whom it is of, to which study it belongs, what made it.

use super::{ArchiveError, Finished, codes::OWN_SCHEME, codes::OWN_SCHEME_UID};
use crate::{
    elements::{Element, IMPLEMENTATION_UID, empty, sequence, text},
    subject::Attribute,
};
use dicom_core::{PrimitiveValue, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};

/// Name of what made the object.
pub(super) const PRODUCT: &str = "Ventricle";

/// The series and instance of an object.
pub(super) struct Instance<'a> {
    pub(super) class_uid: &'static str,
    pub(super) uid: String,
    pub(super) number: usize,
    pub(super) series_uid: String,
    /// Number of the series, which must be there; high, as the series of the study count from 1.
    pub(super) series_number: usize,
    pub(super) modality: &'static str,
    pub(super) series_description: &'a str,
}

/// Patient, General Study, Series, Enhanced General Equipment, SOP Common (PS3.3 C.7.1.1, C.7.2.1, C.7.3.1, C.7.5.2, C.12.1), and the content's
/// date and time, in UTC.
pub(super) fn elements(finished: &Finished, instance: &Instance<'_>) -> Vec<Element> {
    let mut elements = subject(finished);
    let date = finished.finished_at.strftime("%Y%m%d").to_string();
    let time = finished.finished_at.strftime("%H%M%S").to_string();
    elements.extend([
        text(tags::STUDY_INSTANCE_UID, VR::UI, finished.study_uid()),
        text(tags::MODALITY, VR::CS, instance.modality),
        text(tags::SERIES_INSTANCE_UID, VR::UI, instance.series_uid.clone()),
        text(tags::SERIES_NUMBER, VR::IS, instance.series_number.to_string()),
        text(tags::SERIES_DESCRIPTION, VR::LO, instance.series_description),
        text(tags::MANUFACTURER, VR::LO, PRODUCT),
        text(tags::MANUFACTURER_MODEL_NAME, VR::LO, finished.report.software.name.clone()),
        text(tags::DEVICE_SERIAL_NUMBER, VR::LO, "0"),
        text(tags::SOFTWARE_VERSIONS, VR::LO, finished.report.software.version.clone()),
        text(tags::SOP_CLASS_UID, VR::UI, instance.class_uid),
        text(tags::SOP_INSTANCE_UID, VR::UI, instance.uid.clone()),
        text(tags::INSTANCE_NUMBER, VR::IS, instance.number.to_string()),
        text(tags::INSTANCE_CREATION_DATE, VR::DA, date.clone()),
        text(tags::INSTANCE_CREATION_TIME, VR::TM, time.clone()),
        text(tags::CONTENT_DATE, VR::DA, date),
        text(tags::CONTENT_TIME, VR::TM, time),
    ]);
    elements
}

/// That our own coding scheme is ours.
pub(super) fn own_coding_scheme() -> Element {
    sequence(
        tags::CODING_SCHEME_IDENTIFICATION_SEQUENCE,
        [vec![
            text(tags::CODING_SCHEME_DESIGNATOR, VR::SH, OWN_SCHEME),
            text(tags::CODING_SCHEME_UID, VR::UI, OWN_SCHEME_UID),
            text(tags::CODING_SCHEME_NAME, VR::ST, "Ventricle's own codes"),
            text(tags::CODING_SCHEME_RESPONSIBLE_ORGANIZATION, VR::ST, PRODUCT),
        ]],
    )
}

/// Patient and study as they were received, if that was kept; else empty where an attribute must be there.
fn subject(finished: &Finished) -> Vec<Element> {
    let Some(subject) = &finished.subject else {
        let mut elements: Vec<Element> = Attribute::ALL.into_iter().filter(|attribute| is_required(*attribute)).map(blank).collect();
        elements.push(text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192"));
        return elements;
    };
    let received = |attribute: Attribute| match subject.get(attribute) {
        Some(value) => Some(as_received(attribute, value)),
        None => is_required(attribute).then(|| blank(attribute)),
    };
    Attribute::ALL.into_iter().filter_map(received).collect()
}

/// Whether every object must have the attribute, though it may be empty (type 2).
fn is_required(attribute: Attribute) -> bool {
    !matches!(attribute, Attribute::SpecificCharacterSet | Attribute::IssuerOfPatientId)
}

fn blank(attribute: Attribute) -> Element {
    let (group, number) = attribute.tag();
    empty(Tag(group, number), vr(attribute))
}

/// The very bytes. Their padding is ours: the writer's is a zero, which text must not have.
fn as_received(attribute: Attribute, value: &[u8]) -> Element {
    let (group, number) = attribute.tag();
    let mut bytes = value.to_vec();
    if !bytes.len().is_multiple_of(2) {
        bytes.push(b' ');
    }
    Element::new(Tag(group, number), vr(attribute), PrimitiveValue::from(bytes))
}

fn vr(attribute: Attribute) -> VR {
    match attribute {
        Attribute::SpecificCharacterSet | Attribute::PatientSex => VR::CS,
        Attribute::StudyDate | Attribute::PatientBirthDate => VR::DA,
        Attribute::StudyTime => VR::TM,
        Attribute::AccessionNumber | Attribute::StudyId => VR::SH,
        Attribute::ReferringPhysicianName | Attribute::PatientName => VR::PN,
        Attribute::PatientId | Attribute::IssuerOfPatientId => VR::LO,
    }
}

/// The elements as a DICOM file, explicit VR little endian.
pub(super) fn file(elements: impl IntoIterator<Item = Element>) -> Result<Vec<u8>, ArchiveError> {
    let meta = FileMetaTableBuilder::new()
        .transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN)
        .implementation_class_uid(IMPLEMENTATION_UID)
        .implementation_version_name("VENTRICLE");
    let object = InMemDicomObject::from_element_iter(elements);
    let file = object.with_meta(meta).map_err(|error| ArchiveError::Dicom(Box::new(error)))?;
    let mut bytes = Vec::new();
    file.write_all(&mut bytes).map_err(|error| ArchiveError::Dicom(Box::new(error)))?;
    Ok(bytes)
}
