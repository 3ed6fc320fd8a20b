//! A surface as DICOM Encapsulated STL (SOP Class 1.2.840.10008.5.1.4.1.1.104.3): the file that [`crate::export::stl`] makes, filed with the study.

use super::{
    ArchiveError, Finished, Sources,
    codes::MILLIMETRES,
    content::{concept, no_items, reference},
    header::{self, Instance},
};
use crate::{
    elements::{self, Element, empty, sequence, text},
    export::stl::Stl,
    pipeline::Surface,
};
use dicom_core::{PrimitiveValue, VR};
use dicom_dictionary_std::{tags, uids};

/// Number of the series that all surfaces share.
const SERIES_NUMBER: usize = 9902;

/// Media type of an STL file, which DICOM has registered.
pub const MEDIA_TYPE: &str = "model/stl";

/// The surface of a gate (counted from 1) as a DICOM file.
///
/// # Errors
/// [`ArchiveError`] where the DICOM library fails, which it has no reason to.
pub fn write(finished: &Finished, surface: Surface, gate: usize, stl: &Stl) -> Result<Vec<u8>, ArchiveError> {
    let instance = Instance {
        class_uid: uids::ENCAPSULATED_STL_STORAGE,
        uid: finished.uid(&format!("{} surface of gate {gate}", surface.name())),
        number: 2 * gate - usize::from(surface == Surface::Endocardial),
        series_uid: finished.uid("series of the surfaces"),
        series_number: SERIES_NUMBER,
        modality: "M3D",
        series_description: "Left ventricle, surfaces",
    };
    let title = format!("{} surface, gate {gate} of {}", capitalised(surface.name()), finished.report.gates.len());
    let mut all = header::elements(finished, &instance);
    all.extend([
        text(tags::FRAME_OF_REFERENCE_UID, VR::UI, frame_of_reference(finished, stl.in_patient_frame)),
        empty(tags::POSITION_REFERENCE_INDICATOR, VR::LO),
        empty(tags::ACQUISITION_DATE_TIME, VR::DT),
        text(tags::BURNED_IN_ANNOTATION, VR::CS, "NO"),
        text(tags::DOCUMENT_TITLE, VR::ST, title),
        // CID 7061 names no model made from nuclear medicine.
        no_items(tags::CONCEPT_NAME_CODE_SEQUENCE),
        text(tags::MIME_TYPE_OF_ENCAPSULATED_DOCUMENT, VR::LO, MEDIA_TYPE),
        Element::new(tags::ENCAPSULATED_DOCUMENT_LENGTH, VR::UL, PrimitiveValue::from(stl.bytes.len() as u32)),
        Element::new(tags::ENCAPSULATED_DOCUMENT, VR::OB, PrimitiveValue::from(stl.bytes.clone())),
        sequence(tags::MEASUREMENT_UNITS_CODE_SEQUENCE, [concept(MILLIMETRES)]),
        text(tags::MODEL_MODIFICATION, VR::CS, "NO"),
        text(tags::MODEL_MIRRORING, VR::CS, "NO"),
    ]);
    all.extend(finished.sources().as_ref().map(references).into_iter().flatten());
    header::file(all)
}

/// What the surface was made from.
fn references(sources: &Sources<'_>) -> Vec<Element> {
    let instances = || sources.instances.iter().map(|source| reference(source.class_uid, source.instance_uid)).collect::<Vec<_>>();
    let series =
        vec![text(tags::SERIES_INSTANCE_UID, VR::UI, sources.series_uid), sequence(tags::REFERENCED_INSTANCE_SEQUENCE, instances())];
    vec![sequence(tags::SOURCE_INSTANCE_SEQUENCE, instances()), sequence(tags::REFERENCED_SERIES_SEQUENCE, [series])]
}

/// That of the images where coordinates are the patient's. Else one of its own: nothing else can lie in it.
fn frame_of_reference(finished: &Finished, in_patient_frame: bool) -> String {
    let received = finished.report.study.frame_of_reference_uid.clone().filter(|_| in_patient_frame);
    received.unwrap_or_else(|| elements::uid("frame of reference", finished.id.as_bytes()))
}

fn capitalised(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().map(|first| first.to_ascii_uppercase().to_string() + letters.as_str()).unwrap_or_default()
}
