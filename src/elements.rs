//! DICOM elements as this program writes them, and the UIDs it gives.

use dicom_core::value::DataSetSequence;
use dicom_core::{DataElement, PrimitiveValue, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;
use sha2::{Digest, Sha256};

/// Names the writer of files and the speaker of associations (PS3.7 D.3.3.2).
pub(crate) const IMPLEMENTATION_UID: &str = "2.25.153879973904405785727583239291539799884";

/// An element of a data set.
pub(crate) type Element = DataElement<InMemDicomObject>;

/// Text as it is.
pub(crate) fn text(tag: Tag, vr: VR, value: impl Into<String>) -> Element {
    Element::new(tag, vr, PrimitiveValue::from(value.into()))
}

/// An attribute that is there without a value.
pub(crate) fn empty(tag: Tag, vr: VR) -> Element {
    Element::new(tag, vr, PrimitiveValue::Empty)
}

/// One 16-bit number.
pub(crate) fn number(tag: Tag, value: usize) -> Element {
    Element::new(tag, VR::US, PrimitiveValue::from(value as u16))
}

/// Several 16-bit numbers.
pub(crate) fn numbers(tag: Tag, values: impl Iterator<Item = usize>) -> Element {
    Element::new(tag, VR::US, PrimitiveValue::U16(values.map(|value| value as u16).collect()))
}

/// A sequence of items.
pub(crate) fn sequence(tag: Tag, items: impl IntoIterator<Item = Vec<Element>>) -> Element {
    let items: Vec<InMemDicomObject> = items.into_iter().map(InMemDicomObject::from_element_iter).collect();
    Element::new(tag, VR::SQ, DataSetSequence::from(items))
}

/// A coded concept: value, scheme, meaning.
pub(crate) fn code(value: &str, scheme: &str, meaning: &str) -> Vec<Element> {
    vec![
        text(tags::CODE_VALUE, VR::SH, value),
        text(tags::CODING_SCHEME_DESIGNATOR, VR::SH, scheme),
        text(tags::CODE_MEANING, VR::LO, meaning),
    ]
}

/// Decimal strings, each within DICOM's 16 characters.
pub(crate) fn decimals(tag: Tag, values: &[f64]) -> Element {
    text(tag, VR::DS, values.iter().map(|&value| decimal(value)).collect::<Vec<_>>().join("\\"))
}

/// A decimal string of at most 16 characters, which is what DICOM gives it.
pub(crate) fn decimal(value: f64) -> String {
    let plain = format!("{value}");
    if plain.len() <= 16 {
        return plain;
    }
    (0..=12).rev().map(|digits| format!("{value:.digits$}")).find(|text| text.len() <= 16).unwrap_or_else(|| format!("{value:.8e}"))
}

/// A UID under 2.25 (ISO/IEC 9834-8: a UUID as one number) from the hash of a purpose and a description.
pub(crate) fn uid(purpose: &str, described: &[u8]) -> String {
    let hash = Sha256::new().chain_update(purpose).chain_update([0]).chain_update(described).finalize();
    let mut number = [0; 16];
    number.copy_from_slice(&hash[..16]);
    // Version 8 (custom) and the RFC 9562 variant, so that the number is a valid UUID.
    number[6] = (number[6] & 0x0f) | 0x80;
    number[8] = (number[8] & 0x3f) | 0x80;
    format!("2.25.{}", u128::from_be_bytes(number))
}
