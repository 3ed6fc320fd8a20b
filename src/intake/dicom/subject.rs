//! Whom DICOM files are of, where the operator wants that kept. Values are taken from the scanned bytes as they stand: nothing of group 0010
//! reaches a parser but size and weight.

use super::object::Object;
use crate::intake::IntakeError;
use crate::intake::prescan::Scan;
use crate::study::Warning;
use crate::subject::{Attribute, Subject};
use dicom_core::Tag;

/// Takes the attributes out of a scanned file. One that cannot be kept is told of without its value.
pub(super) fn of_scan(scan: &Scan<'_>, warnings: &mut Vec<Warning>) -> Subject {
    let mut subject = Subject::default();
    for attribute in Attribute::ALL {
        let (group, number) = attribute.tag();
        let tag = Tag(group, number);
        let Some(element) = scan.elements.iter().find(|element| element.tag == tag) else { continue };
        if !subject.put(attribute, &scan.data[element.value_start..element.bytes.end]) {
            let text = format!(
                "The attribute {tag} of the file has a value that DICOM does not allow there; DICOM results of this reconstruction leave it empty."
            );
            warnings.push(Warning::new("subject_attribute_left_out", text));
        }
    }
    subject
}

/// Whether this is an attribute that may be kept.
pub(super) fn names(tag: Tag) -> bool {
    Attribute::ALL.into_iter().any(|attribute| attribute.tag() == (tag.group(), tag.element()))
}

/// Whom several files are of: what the first one says. None may name another patient, for a result would then be filed with the wrong one.
pub(super) fn of_all(objects: &[Object<'_>]) -> Result<Option<Subject>, IntakeError> {
    let Some(first) = objects.first().and_then(|object| object.subject.as_ref()) else { return Ok(None) };
    let who = |subject: &Subject| {
        [Attribute::PatientId, Attribute::IssuerOfPatientId].map(|attribute| subject.get(attribute).map(<[u8]>::to_vec))
    };
    let other = objects.iter().position(|object| object.subject.as_ref().is_some_and(|subject| who(subject) != who(first)));
    if let Some(index) = other {
        return Err(IntakeError::MixedParts {
            reason: format!("file {} names another patient (Patient ID (0010,0020) and its issuer (0010,0021)) than file 1", index + 1),
        });
    }
    Ok(Some(first.clone()))
}
