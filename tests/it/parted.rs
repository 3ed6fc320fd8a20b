//! A phantom's study as cameras and PACS cut it: a file for all gates, a file a gate, a file a slice.

use dicom_core::{DataElement, PrimitiveValue, Tag, VR, value::DataSetSequence};
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, from_reader};
use glam::DVec3;
use ventricle::{
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    volume::Grid,
};

pub(crate) const GATES: usize = 4;
pub(crate) const SLICES: usize = 24;
const SHAPE: [usize; 3] = [SLICES, 32, 32];

/// A gated study in one file, small enough to be reconstructed in a second; another seed is another study.
pub(crate) fn whole(seed: u64) -> Vec<u8> {
    simulated(seed, GATES)
}

/// An ungated study.
pub(crate) fn ungated(seed: u64) -> Vec<u8> {
    simulated(seed, 1)
}

fn simulated(seed: u64, gates: usize) -> Vec<u8> {
    let imaging = Imaging { gates, noise_seed: Some(seed), grid: Grid { shape: SHAPE, spacing_mm: [6.4; 3] }, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

/// A file of the study with some of its elements replaced.
pub(crate) fn with(bytes: &[u8], changes: &[(Tag, VR, &str)]) -> Vec<u8> {
    let mut object = from_reader(bytes).unwrap();
    for (tag, vr, value) in changes {
        object.put(DataElement::new(*tag, *vr, PrimitiveValue::from(*value)));
    }
    written(&object)
}

/// A file without some of its elements.
pub(crate) fn without(bytes: &[u8], tags: &[Tag]) -> Vec<u8> {
    let mut object = from_reader(bytes).unwrap();
    for tag in tags {
        object.remove_element(*tag);
    }
    written(&object)
}

pub(crate) fn text_of(bytes: &[u8], tag: Tag) -> String {
    from_reader(bytes).unwrap().element(tag).unwrap().to_str().unwrap().trim_end_matches('\0').to_owned()
}

/// The study with a file a gate.
pub(crate) fn gates(whole: &[u8]) -> Vec<Vec<u8>> {
    (0..GATES).map(|gate| cut(whole, gate * SLICES..(gate + 1) * SLICES)).collect()
}

/// The study with a file a slice, each with its own position.
pub(crate) fn slices(whole: &[u8]) -> Vec<Vec<u8>> {
    (0..GATES * SLICES)
        .map(|frame| {
            let mut object = from_reader(cut(whole, frame..frame + 1).as_slice()).unwrap();
            let spacing: f64 = object.element(tags::SPACING_BETWEEN_SLICES).unwrap().to_float64().unwrap();
            let mut detector = object.element(tags::DETECTOR_INFORMATION_SEQUENCE).unwrap().items().unwrap()[0].clone();
            let numbers = |tag| -> Vec<f64> { detector.element(tag).unwrap().to_multi_float64().unwrap() };
            let (plane, origin) = (numbers(tags::IMAGE_ORIENTATION_PATIENT), numbers(tags::IMAGE_POSITION_PATIENT));
            let (row, column) = (DVec3::from_slice(&plane[..3]), DVec3::from_slice(&plane[3..]));
            let position = DVec3::from_slice(&origin) + row.cross(column) * spacing * (frame % SLICES) as f64;
            let text = position.to_array().map(|value| format!("{value:.9}")).join("\\");
            detector.put(DataElement::new(tags::IMAGE_POSITION_PATIENT, VR::DS, PrimitiveValue::from(text.as_str())));
            object.put(DataElement::new(tags::DETECTOR_INFORMATION_SEQUENCE, VR::SQ, DataSetSequence::from(vec![detector])));
            written(&object)
        })
        .collect()
}

/// Some frames of the study as an instance of their own.
fn cut(whole: &[u8], frames: std::ops::Range<usize>) -> Vec<u8> {
    let mut object = from_reader(whole).unwrap();
    let uid = object.element(tags::SOP_INSTANCE_UID).unwrap().to_str().unwrap().trim_end_matches('\0').to_owned();
    let uid = format!("{uid}.{}.{}", frames.start + 1, frames.len());
    let pixels: Vec<u16> = object.element(tags::PIXEL_DATA).unwrap().to_multi_int().unwrap();
    let size = SHAPE[1] * SHAPE[2];
    let numbers = |number: &dyn Fn(usize) -> usize| PrimitiveValue::U16(frames.clone().map(|frame| number(frame) as u16).collect());
    let elements = [
        DataElement::new(tags::SOP_INSTANCE_UID, VR::UI, PrimitiveValue::from(uid.as_str())),
        DataElement::new(tags::NUMBER_OF_FRAMES, VR::IS, PrimitiveValue::from(frames.len().to_string())),
        DataElement::new(tags::TIME_SLOT_VECTOR, VR::US, numbers(&|frame| frame / SLICES + 1)),
        DataElement::new(tags::SLICE_VECTOR, VR::US, numbers(&|frame| frame % SLICES + 1)),
        DataElement::new(tags::RR_INTERVAL_VECTOR, VR::US, numbers(&|_| 1)),
        DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(pixels[frames.start * size..frames.end * size].into())),
    ];
    for element in elements {
        object.put(element);
    }
    object.meta_mut().media_storage_sop_instance_uid = uid;
    written(&object)
}

fn written(object: &DefaultDicomObject) -> Vec<u8> {
    let mut bytes = Vec::new();
    object.write_all(&mut bytes).unwrap();
    bytes
}
