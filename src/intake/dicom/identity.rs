//! What a DICOM object is: only tomographic reconstructions of Nuclear Medicine Image Storage go further.

use super::attributes::{Attributes, shown_code, shown_uid};
use crate::intake::IntakeError;
use crate::intake::error::shown;
use crate::intake::prescan::Scan;
use crate::study::Warning;
use dicom_core::Tag;
use dicom_dictionary_std::tags;

pub(super) const NUCLEAR_MEDICINE: &str = "1.2.840.10008.5.1.4.1.1.20";
/// Retired, and still written by old cameras.
const NUCLEAR_MEDICINE_RETIRED: &str = "1.2.840.10008.5.1.4.1.1.5";
/// The storage classes of which objects are read.
pub const STORAGE_CLASSES: [&str; 2] = [NUCLEAR_MEDICINE, NUCLEAR_MEDICINE_RETIRED];

/// Storage classes by name (PS3.4 B.5 and retired ones), for refusals.
const CLASSES: [(&str, &str); 42] = [
    ("1.2.840.10008.1.3.10", "a DICOMDIR (an index of files, without images)"),
    ("1.2.840.10008.5.1.4.1.1.1", "Computed Radiography Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.1.1", "Digital X-Ray Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.1.2", "Digital Mammography X-Ray Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.2", "CT Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.2.1", "Enhanced CT Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.3", "Ultrasound Multi-frame Image Storage (retired)"),
    ("1.2.840.10008.5.1.4.1.1.3.1", "Ultrasound Multi-frame Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.4", "MR Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.4.1", "Enhanced MR Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.5", "Nuclear Medicine Image Storage (retired)"),
    ("1.2.840.10008.5.1.4.1.1.6", "Ultrasound Image Storage (retired)"),
    ("1.2.840.10008.5.1.4.1.1.6.1", "Ultrasound Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.7", "Secondary Capture Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.7.2", "Multi-frame Grayscale Byte Secondary Capture Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.7.3", "Multi-frame Grayscale Word Secondary Capture Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.7.4", "Multi-frame True Color Secondary Capture Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.9.1.1", "12-lead ECG Waveform Storage"),
    ("1.2.840.10008.5.1.4.1.1.11.1", "Grayscale Softcopy Presentation State Storage"),
    ("1.2.840.10008.5.1.4.1.1.12.1", "X-Ray Angiographic Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.12.2", "X-Ray Radiofluoroscopic Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.20", "Nuclear Medicine Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.30", "Parametric Map Storage"),
    ("1.2.840.10008.5.1.4.1.1.66", "Raw Data Storage"),
    ("1.2.840.10008.5.1.4.1.1.66.1", "Spatial Registration Storage"),
    ("1.2.840.10008.5.1.4.1.1.66.4", "Segmentation Storage"),
    ("1.2.840.10008.5.1.4.1.1.66.5", "Surface Segmentation Storage"),
    ("1.2.840.10008.5.1.4.1.1.77.1.6", "VL Whole Slide Microscopy Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.88.11", "Basic Text SR Storage"),
    ("1.2.840.10008.5.1.4.1.1.88.22", "Enhanced SR Storage"),
    ("1.2.840.10008.5.1.4.1.1.88.33", "Comprehensive SR Storage"),
    ("1.2.840.10008.5.1.4.1.1.88.59", "Key Object Selection Document Storage"),
    ("1.2.840.10008.5.1.4.1.1.104.1", "Encapsulated PDF Storage"),
    ("1.2.840.10008.5.1.4.1.1.104.3", "Encapsulated STL Storage"),
    ("1.2.840.10008.5.1.4.1.1.128", "Positron Emission Tomography Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.130", "Enhanced PET Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.481.1", "RT Image Storage"),
    ("1.2.840.10008.5.1.4.1.1.481.2", "RT Dose Storage"),
    ("1.2.840.10008.5.1.4.1.1.481.3", "RT Structure Set Storage"),
    ("1.2.840.10008.5.1.4.1.1.481.5", "RT Plan Storage"),
    ("1.2.840.10008.5.1.4.1.1.481.8", "RT Ion Plan Storage"),
    ("1.2.840.10008.5.1.4.1.1.481.9", "RT Ion Beams Treatment Record Storage"),
];

/// What a reconstruction holds by its image type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// RECON GATED TOMO.
    Gated,
    /// RECON TOMO.
    Ungated,
    /// The image type is missing or says projections, but the frames are slices.
    Unsaid,
}

/// Refuses everything that is no tomographic reconstruction of nuclear medicine.
pub(super) fn check(attributes: &Attributes, scan: &Scan<'_>, frames: usize, warnings: &mut Vec<Warning>) -> Result<Kind, IntakeError> {
    let class = attributes.text(tags::SOP_CLASS_UID).or_else(|| scan.media_class.clone());
    let modality = attributes.text(tags::MODALITY);
    let nuclear = class.as_deref().is_some_and(|uid| STORAGE_CLASSES.contains(&uid));
    if !nuclear && modality.as_deref() != Some("NM") {
        let received = match (&class, &modality) {
            (None, None) => {
                return Err(IntakeError::MissingAttribute {
                    name: "Modality",
                    tag: tags::MODALITY.to_string(),
                    advice: "neither it nor SOP Class UID (0008,0016) says what the object is, and only NM images are reconstructed",
                });
            }
            (Some(uid), Some(modality)) => format!("{} (modality {})", class_name(uid), shown_code(modality)),
            (Some(uid), None) => class_name(uid),
            (None, Some(modality)) => format!("a DICOM object of modality {}", shown_code(modality)),
        };
        return Err(IntakeError::NotNuclearMedicine { received });
    }
    let kind = image_kind(attributes, frames, warnings)?;
    match class {
        Some(uid) if !nuclear => Err(IntakeError::NotNuclearMedicine { received: format!("{} (modality NM)", class_name(&uid)) }),
        None => {
            warnings.push(Warning::new(
                "missing_sop_class",
                "The object has no SOP Class UID; it was taken as an NM image because its modality is NM.",
            ));
            Ok(kind)
        }
        Some(_) => Ok(kind),
    }
}

/// The class that an object which passed [`check`] is read as: its own, or that of NM images where it says none.
pub(super) fn class_uid(attributes: &Attributes, scan: &Scan<'_>) -> String {
    let said = attributes.text(tags::SOP_CLASS_UID).or_else(|| scan.media_class.clone());
    said.filter(|uid| uid == NUCLEAR_MEDICINE_RETIRED).unwrap_or_else(|| NUCLEAR_MEDICINE.to_owned())
}

fn class_name(uid: &str) -> String {
    CLASSES
        .iter()
        .find(|(known, _)| *known == uid)
        .map_or_else(|| format!("a DICOM object of SOP class {}", shown_uid(uid)), |(_, name)| (*name).to_owned())
}

/// Judges Image Type (0008,0008), value 3, against the vectors that are there.
fn image_kind(attributes: &Attributes, frames: usize, warnings: &mut Vec<Warning>) -> Result<Kind, IntakeError> {
    let values = attributes.texts(tags::IMAGE_TYPE);
    let image_type = shown(&values.iter().map(|value| shown_code(value)).collect::<Vec<_>>().join("\\"));
    let present = |tag: Tag| attributes.has(tag) || attributes.points_at(tags::FRAME_INCREMENT_POINTER, tag);
    let slices = present(tags::SLICE_VECTOR);
    let views = present(tags::ANGULAR_VIEW_VECTOR) || present(tags::ROTATION_VECTOR);
    let projections = || IntakeError::Projections { frames, image_type: image_type.clone() };
    let kind = values.get(2).map_or("", String::as_str);
    match kind {
        "RECON GATED TOMO" | "RECON TOMO" if views && !slices => Err(projections()),
        "RECON GATED TOMO" => Ok(Kind::Gated),
        "RECON TOMO" => Ok(Kind::Ungated),
        "TOMO" | "GATED TOMO" if views || !slices => Err(projections()),
        "TOMO" | "GATED TOMO" => {
            warnings.push(Warning::new(
                "image_type_disagrees",
                format!("Image Type says {kind} (projections), but the frames are numbered as slices and were taken as such."),
            ));
            Ok(Kind::Unsaid)
        }
        "WHOLE BODY" | "STATIC" | "DYNAMIC" | "GATED" => {
            Err(IntakeError::NotTomographic { received: format!("a planar NM image (image type {image_type})") })
        }
        _ if views => Err(projections()),
        _ if slices => {
            warnings.push(Warning::new(
                "image_type_unknown",
                "Image Type (0008,0008) does not say RECON TOMO or RECON GATED TOMO; the frames are numbered as slices and were taken as such.",
            ));
            Ok(Kind::Unsaid)
        }
        _ => Err(IntakeError::NotTomographic {
            received: if image_type.is_empty() {
                "an NM image without Image Type (0008,0008)".to_owned()
            } else {
                format!("an NM image of type {image_type}")
            },
        }),
    }
}
