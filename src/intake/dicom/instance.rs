//! One DICOM object as it comes from a PACS, on its own: what it is, which part of a study it holds, and the excerpt of it that is kept
//! until the study is whole.

use super::attributes::{Attributes, is_read};
use super::identity::NUCLEAR_MEDICINE;
use super::object::Object;
use super::parts::{self, Holds};
use super::subject;
use crate::intake::prescan::{self, Element, Pixels, Scan};
use crate::intake::{IntakeError, Limits, Part, sniff};
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::meta::FileMetaTableBuilder;
use sha2::{Digest as _, Sha256};

/// A DICOM object that is, or is part of, a study that can be reconstructed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Instance {
    /// SOP Class UID (0008,0016).
    pub class_uid: String,
    /// SOP Instance UID (0008,0018).
    pub instance_uid: String,
    /// Study Instance UID (0020,000D).
    pub study_uid: String,
    /// Series Instance UID (0020,000E).
    pub series_uid: String,
    /// What part of a study it is.
    pub holds: Holds,
    /// SHA-256 of the attributes that are read, of whom it is of where that is to be kept and, of a part of a study, of its counts: the same for the same object in every lossless transfer
    /// syntax. The counts of a whole study are not in it, as they are not decoded here.
    pub identity: [u8; 32],
    /// A DICOM file with its pixel data and the attributes that are read, of which none names the patient unless that is to be kept.
    pub excerpt: Vec<u8>,
}

/// Why an object is not taken, and what it is called, as far as that could be read.
#[derive(Debug, thiserror::Error)]
#[error("{error}")]
pub struct Refused {
    /// SOP Class UID.
    pub class_uid: Option<String>,
    /// SOP Instance UID.
    pub instance_uid: Option<String>,
    /// What is wrong with it.
    pub error: Box<IntakeError>,
}

/// Looks at one DICOM object: it must be, or be part of, a study that can be reconstructed, and its pixel data must be whole.
///
/// The excerpt holds whom it is of if that is to be kept.
///
/// # Errors
/// [`Refused`] for everything else; the UIDs are there if the object could be parsed.
pub fn examine(bytes: &[u8], keep_subject: bool, limits: &Limits) -> Result<Instance, Refused> {
    let unnamed = |error: IntakeError| Refused { class_uid: None, instance_uid: None, error: Box::new(error) };
    let part = Part { media_type: Some("application/dicom"), filename: None, bytes };
    match sniff::format(&part).map_err(unnamed)? {
        sniff::Format::Dicom => {}
        other => return Err(unnamed(IntakeError::NotDicom { received: other.name() })),
    }
    let scan = prescan::scan(bytes, limits).map_err(|error| unnamed(error.into()))?;
    let attributes = Attributes::parse(&scan, limits).map_err(unnamed)?;
    let (class_uid, instance_uid) = (attributes.uid(tags::SOP_CLASS_UID), attributes.uid(tags::SOP_INSTANCE_UID));
    let named = |error| Refused { class_uid: class_uid.clone(), instance_uid: instance_uid.clone(), error: Box::new(error) };
    let object = Object::of(scan.clone(), attributes, keep_subject, limits, &mut Vec::new()).map_err(named)?;
    let mut digest = Sha256::new();
    object.attributes.digest(&mut digest);
    if let Some(subject) = &object.subject {
        digest.update(subject.encode());
    }
    let holds = parts::holds(&object, &mut digest, limits).map_err(named)?;
    let needed = |uid: &Option<String>, name, tag: Tag| {
        let advice = "instances are told apart and put together by it";
        uid.clone().ok_or_else(|| named(IntakeError::MissingAttribute { name, tag: tag.to_string(), advice }))
    };
    Ok(Instance {
        class_uid: class_uid.clone().unwrap_or_else(|| NUCLEAR_MEDICINE.to_owned()),
        instance_uid: needed(&object.instance_uid, "SOP Instance UID", tags::SOP_INSTANCE_UID)?,
        study_uid: needed(&object.study_uid, "Study Instance UID", tags::STUDY_INSTANCE_UID)?,
        series_uid: needed(&object.series_uid, "Series Instance UID", tags::SERIES_INSTANCE_UID)?,
        holds,
        identity: digest.finalize().into(),
        excerpt: excerpt(&scan, keep_subject, &object).map_err(named)?,
    })
}

/// A Part-10 file of the elements that are read and the pixel data, each as it is in the file; what was deflated is not any more.
fn excerpt(scan: &Scan<'_>, keep_subject: bool, object: &Object<'_>) -> Result<Vec<u8>, IntakeError> {
    let failed =
        |error: &dyn std::fmt::Display| IntakeError::UnreadableDataSet { reason: format!("it could not be written again: {error}") };
    let inflated = matches!(scan.data, std::borrow::Cow::Owned(_));
    let meta = FileMetaTableBuilder::new()
        .media_storage_sop_class_uid(scan.media_class.as_deref().unwrap_or(NUCLEAR_MEDICINE))
        .media_storage_sop_instance_uid(object.instance_uid.as_deref().unwrap_or_default())
        .transfer_syntax(if inflated { "1.2.840.10008.1.2.1" } else { &scan.encoding.uid })
        .build()
        .map_err(|error| failed(&error))?;
    let mut file = vec![0; 128];
    file.extend_from_slice(b"DICM");
    meta.write(&mut file).map_err(|error| failed(&error))?;
    let kept = |element: &&Element| is_read(element) || (keep_subject && subject::names(element.tag));
    for element in scan.elements.iter().filter(kept) {
        file.extend_from_slice(&scan.data[element.bytes.clone()]);
    }
    write_pixels(scan, &mut file);
    Ok(file)
}

fn write_pixels(scan: &Scan<'_>, file: &mut Vec<u8>) {
    let number = |value: u32| if scan.encoding.big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
    let word = |value: u16| if scan.encoding.big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
    let header = |file: &mut Vec<u8>, vr: &[u8; 2], length: u32| {
        file.extend_from_slice(&word(0x7FE0));
        file.extend_from_slice(&word(0x0010));
        if scan.encoding.explicit {
            file.extend_from_slice(vr);
            file.extend_from_slice(&[0, 0]);
        }
        file.extend_from_slice(&number(length));
    };
    let item = |file: &mut Vec<u8>, element: u16, length: u32| {
        file.extend_from_slice(&word(0xFFFE));
        file.extend_from_slice(&word(element));
        file.extend_from_slice(&number(length));
    };
    match &scan.pixels {
        Pixels::Absent => {}
        Pixels::Native { value, vr } => {
            header(file, if *vr == dicom_core::VR::OB { b"OB" } else { b"OW" }, value.len() as u32);
            file.extend_from_slice(&scan.data[value.clone()]);
        }
        Pixels::Encapsulated { fragments } => {
            header(file, b"OB", u32::MAX);
            for fragment in fragments {
                item(file, 0xE000, fragment.len() as u32);
                file.extend_from_slice(&scan.data[fragment.clone()]);
            }
            item(file, 0xE0DD, 0);
        }
    }
}
