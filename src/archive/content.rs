//! Content items of a structured report (PS3.3 C.17.3).

use super::codes::Code;
use crate::elements::{Element, code, decimal, sequence, text};
use dicom_core::{PrimitiveValue, VR};
use dicom_dictionary_std::tags;

/// An item of the content tree.
pub(super) type Item = Vec<Element>;

/// What an item is to the one above it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Relation {
    Contains,
    ObservationContext,
    AcquisitionContext,
    ConceptModifier,
    Property,
}

impl Relation {
    fn name(self) -> &'static str {
        match self {
            Self::Contains => "CONTAINS",
            Self::ObservationContext => "HAS OBS CONTEXT",
            Self::AcquisitionContext => "HAS ACQ CONTEXT",
            Self::ConceptModifier => "HAS CONCEPT MOD",
            Self::Property => "HAS PROPERTIES",
        }
    }
}

fn item(relation: Relation, kind: &str, name: Option<Code>) -> Item {
    let mut item = vec![text(tags::RELATIONSHIP_TYPE, VR::CS, relation.name()), text(tags::VALUE_TYPE, VR::CS, kind)];
    item.extend(name.map(|name| sequence(tags::CONCEPT_NAME_CODE_SEQUENCE, [concept(name)])));
    item
}

/// A coded concept as an item of a code sequence.
pub(super) fn concept(concept: Code) -> Vec<Element> {
    code(concept.value, concept.scheme, concept.meaning)
}

/// Text. What is not ASCII is replaced: names keep the file's character set, in which it may have no letter.
pub(super) fn words(relation: Relation, name: Code, value: &str) -> Item {
    let mut item = item(relation, "TEXT", Some(name));
    item.push(text(tags::TEXT_VALUE, VR::UT, ascii(value)));
    item
}

pub(super) fn coded(relation: Relation, name: Code, value: Code) -> Item {
    let mut item = item(relation, "CODE", Some(name));
    item.push(sequence(tags::CONCEPT_CODE_SEQUENCE, [concept(value)]));
    item
}

pub(super) fn uid(relation: Relation, name: Code, value: &str) -> Item {
    let mut item = item(relation, "UIDREF", Some(name));
    item.push(text(tags::UID, VR::UI, value));
    item
}

/// A number, rounded to the 16 characters of a decimal string and beside it to the last bit, and what is said of it.
pub(super) fn measured(relation: Relation, name: Code, value: f64, unit: Code, children: Vec<Item>) -> Item {
    let mut item = item(relation, "NUM", Some(name));
    item.push(sequence(
        tags::MEASURED_VALUE_SEQUENCE,
        [vec![
            text(tags::NUMERIC_VALUE, VR::DS, decimal(value)),
            Element::new(tags::FLOATING_POINT_VALUE, VR::FD, PrimitiveValue::from(value)),
            sequence(tags::MEASUREMENT_UNITS_CODE_SEQUENCE, [concept(unit)]),
        ]],
    ));
    nest(item, children)
}

pub(super) fn image(relation: Relation, class_uid: &str, instance_uid: &str) -> Item {
    let mut item = item(relation, "IMAGE", None);
    item.push(sequence(tags::REFERENCED_SOP_SEQUENCE, [reference(class_uid, instance_uid)]));
    item
}

/// A reference to an instance.
pub(super) fn reference(class_uid: &str, instance_uid: &str) -> Vec<Element> {
    vec![text(tags::REFERENCED_SOP_CLASS_UID, VR::UI, class_uid), text(tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, instance_uid)]
}

/// A container, by a template of PS3.16 if it follows one.
pub(super) fn container(relation: Relation, name: Code, template: Option<&str>, children: Vec<Item>) -> Item {
    let mut container = item(relation, "CONTAINER", Some(name));
    container.extend(contained(template));
    nest(container, children)
}

/// The document's root.
pub(super) fn root(name: Code, template: &str, children: Vec<Item>) -> Item {
    let mut root = vec![text(tags::VALUE_TYPE, VR::CS, "CONTAINER"), sequence(tags::CONCEPT_NAME_CODE_SEQUENCE, [concept(name)])];
    root.extend(contained(Some(template)));
    nest(root, children)
}

fn contained(template: Option<&str>) -> Vec<Element> {
    let template = template.map(|number| {
        let identification = vec![text(tags::MAPPING_RESOURCE, VR::CS, "DCMR"), text(tags::TEMPLATE_IDENTIFIER, VR::CS, number)];
        sequence(tags::CONTENT_TEMPLATE_SEQUENCE, [identification])
    });
    std::iter::once(text(tags::CONTINUITY_OF_CONTENT, VR::CS, "SEPARATE")).chain(template).collect()
}

fn nest(mut parent: Item, children: Vec<Item>) -> Item {
    if !children.is_empty() {
        parent.push(sequence(tags::CONTENT_SEQUENCE, children));
    }
    parent
}

/// A type 2 sequence without items.
pub(super) fn no_items(tag: dicom_core::Tag) -> Element {
    sequence(tag, [])
}

/// ASCII for a text that may hold the signs of our own sentences.
pub(super) fn ascii(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '\n' | ' '..='~' => plain.push(letter),
            '×' => plain.push('x'),
            '±' => plain.push_str("+/-"),
            '–' | '—' | '−' => plain.push('-'),
            '’' | '‘' => plain.push('\''),
            '…' => plain.push_str("..."),
            _ => plain.push('?'),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_become_ascii() {
        assert_eq!(ascii("5 ± 2 % – the wall’s…\u{1b}é"), "5 +/- 2 % - the wall's...??");
    }
}
