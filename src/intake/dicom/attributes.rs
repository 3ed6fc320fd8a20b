//! The attributes that are read, through the DICOM parser; everything else (names, dates, private groups) never reaches it.

use super::allowed::is_allowed;
use crate::intake::error::shown;
use crate::intake::prescan::{Element, Scan};
use crate::intake::{IntakeError, Limits, ScanError};
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::value::Value;
use dicom_core::{Tag, VR, header::Header as _};
use dicom_dictionary_std::StandardDataDictionary;
use dicom_object::InMemDicomObject;
use dicom_transfer_syntax_registry::entries;
use sha2::{Digest as _, Sha256};

/// Stack of the thread that parses: at most 32 nested sequences of about 8 KiB a level, with a wide margin.
const STACK_BYTES: usize = 8 << 20;

/// Whether an element of the outermost data set is among those that are read.
pub(super) fn is_read(element: &Element) -> bool {
    element.unambiguous && is_allowed(element.tag)
}

/// A data set, or an item of a sequence in it.
#[derive(Debug)]
pub(super) struct Attributes {
    data_set: InMemDicomObject,
    /// Bytes it was parsed from; 0 for an item.
    pub(super) bytes: usize,
}

impl Attributes {
    /// Parses the attributes of [`ALLOWED`](super::allowed::ALLOWED).
    pub(super) fn parse(scan: &Scan<'_>, limits: &Limits) -> Result<Self, IntakeError> {
        let mut excerpt = Vec::new();
        for element in scan.elements.iter().filter(|element| is_read(element)) {
            excerpt.extend_from_slice(&scan.data[element.bytes.clone()]);
            if excerpt.len() > limits.described_bytes {
                let found = format!("the attributes that describe the images take more than {} bytes", limits.described_bytes);
                return Err(ScanError::Malformed { offset: element.bytes.start, found }.into());
            }
        }
        let syntax = match (scan.encoding.explicit, scan.encoding.big_endian) {
            (false, _) => entries::IMPLICIT_VR_LITTLE_ENDIAN.erased(),
            (true, false) => entries::EXPLICIT_VR_LITTLE_ENDIAN.erased(),
            (true, true) => entries::EXPLICIT_VR_BIG_ENDIAN.erased(),
        };
        let unreadable = |reason: String| IntakeError::UnreadableDataSet { reason };
        let parsed = std::thread::scope(|scope| {
            let parser = std::thread::Builder::new().name("dicom-parser".to_owned()).stack_size(STACK_BYTES);
            let handle = parser.spawn_scoped(scope, || InMemDicomObject::read_dataset_with_ts(excerpt.as_slice(), &syntax));
            // A panic of the parser ends its thread and arrives here as an error.
            handle.map(std::thread::ScopedJoinHandle::join)
        });
        match parsed {
            Ok(Ok(Ok(data_set))) => Ok(Self { data_set, bytes: excerpt.len() }),
            Ok(Ok(Err(error))) => Err(unreadable(one_line(&error))),
            Ok(Err(_)) => Err(unreadable("the parser gave up on it".to_owned())),
            Err(error) => Err(unreadable(error.to_string())),
        }
    }

    /// The values of an attribute as trimmed text; absent or empty: none.
    pub(super) fn texts(&self, tag: Tag) -> Vec<String> {
        let Some(element) = self.data_set.get(tag) else { return Vec::new() };
        let Value::Primitive(value) = element.value() else { return Vec::new() };
        let values: Vec<String> =
            if element.vr() == VR::UN { unknown_as_text(tag, &value.to_bytes()) } else { value.to_multi_str().into_owned() };
        let trimmed: Vec<String> = values.iter().map(|value| value.trim_matches([' ', '\0']).to_owned()).collect();
        if trimmed.iter().all(String::is_empty) { Vec::new() } else { trimmed }
    }

    /// The first value as text.
    pub(super) fn text(&self, tag: Tag) -> Option<String> {
        self.texts(tag).into_iter().next().filter(|text| !text.is_empty())
    }

    /// A UID; what is no UID (digits and dots, at most 64) is not repeated anywhere and counts as absent.
    pub(super) fn uid(&self, tag: Tag) -> Option<String> {
        self.text(tag).filter(|uid| uid.len() <= 64 && uid.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.'))
    }

    /// The values as finite numbers; absent or empty: none.
    pub(super) fn numbers(&self, tag: Tag, name: &'static str) -> Result<Vec<f64>, IntakeError> {
        self.texts(tag)
            .iter()
            .map(|text| {
                text.parse::<f64>().ok().filter(|number| number.is_finite()).ok_or_else(|| invalid(tag, name, text, "it must be a number"))
            })
            .collect()
    }

    /// The first value as a finite number.
    pub(super) fn number(&self, tag: Tag, name: &'static str) -> Result<Option<f64>, IntakeError> {
        Ok(self.numbers(tag, name)?.first().copied())
    }

    /// A number that is only repeated, never computed with: one that makes no sense counts as absent.
    pub(super) fn positive(&self, tag: Tag) -> Option<f64> {
        self.number(tag, "").ok().flatten().filter(|number| *number > 0.0)
    }

    /// The values as integers; absent or empty: none.
    pub(super) fn integers(&self, tag: Tag, name: &'static str) -> Result<Vec<i64>, IntakeError> {
        self.texts(tag).iter().map(|text| text.parse::<i64>().map_err(|_| invalid(tag, name, text, "it must be a whole number"))).collect()
    }

    /// The first value as an integer.
    pub(super) fn integer(&self, tag: Tag, name: &'static str) -> Result<Option<i64>, IntakeError> {
        Ok(self.integers(tag, name)?.first().copied())
    }

    /// Whether the attribute is there with a value.
    pub(super) fn has(&self, tag: Tag) -> bool {
        !self.texts(tag).is_empty()
    }

    /// Whether the attribute points at another: Frame Increment Pointer.
    pub(super) fn points_at(&self, tag: Tag, target: Tag) -> bool {
        let Some(element) = self.data_set.get(tag) else { return false };
        match element.value() {
            Value::Primitive(dicom_core::PrimitiveValue::Tags(targets)) => targets.contains(&target),
            _ => false,
        }
    }

    /// Feeds a digest with everything that was parsed, in the order of tags: the same for the same values in any transfer syntax.
    pub(super) fn digest(&self, digest: &mut Sha256) {
        for element in &self.data_set {
            let tag = element.tag();
            digest.update([tag.group().to_le_bytes(), tag.element().to_le_bytes()].concat());
            let items = element.items().unwrap_or_default();
            digest.update((items.len() as u64).to_le_bytes());
            for item in items {
                Self { data_set: item.clone(), bytes: 0 }.digest(digest);
            }
            for text in self.texts(tag) {
                digest.update((text.len() as u64).to_le_bytes());
                digest.update(text);
            }
        }
        // The end of an item: what follows is not its own.
        digest.update([0xFF; 4]);
    }

    /// The items of a sequence.
    pub(super) fn items(&self, tag: Tag) -> Vec<Self> {
        let items = self.data_set.get(tag).and_then(|element| element.items()).unwrap_or_default();
        items.iter().map(|item| Self { data_set: item.clone(), bytes: 0 }).collect()
    }
}

/// An attribute error with its value shortened. A text where a number or a code string belongs may be anything, a name among them: it is not
/// repeated.
pub(super) fn invalid(tag: Tag, name: &'static str, value: &str, expected: &str) -> IntakeError {
    let value = if is_number_like(value) || is_code(value) { format!("\"{}\"", shown(value)) } else { unrepeated(value) };
    IntakeError::InvalidAttribute { name, tag: tag.to_string(), value, expected: expected.to_owned() }
}

/// Whether a text consists of what numbers are written with: it names nobody.
fn is_number_like(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_digit() || b"+-.,eE[] ".contains(&byte)) || ["inf", "-inf", "NaN", "nan"].contains(&text)
}

/// Whether a text is a code string as DICOM has them (PS3.5 6.2): at most 16 capital letters, digits, spaces and underscores.
fn is_code(text: &str) -> bool {
    text.len() <= 16 && text.bytes().all(|byte| byte.is_ascii_uppercase() || byte.is_ascii_digit() || b" _".contains(&byte))
}

/// A code string for a sentence, or what is said instead of a text that is none.
pub(super) fn shown_code(text: &str) -> String {
    if is_code(text) { text.to_owned() } else { unrepeated(text) }
}

/// A UID for a sentence, likewise.
pub(super) fn shown_uid(text: &str) -> String {
    if text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.') { shown(text) } else { unrepeated(text) }
}

fn unrepeated(text: &str) -> String {
    format!("a text of {} characters that is not repeated here", text.chars().count())
}

/// A value of unknown VR as text, by the VR that the dictionary gives its attribute. UN is little-endian.
fn unknown_as_text(tag: Tag, bytes: &[u8]) -> Vec<String> {
    let vr = StandardDataDictionary.by_tag(tag).map(|entry| entry.vr().relaxed());
    if vr == Some(VR::US) {
        return bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]).to_string()).collect();
    }
    String::from_utf8_lossy(bytes).split('\\').map(str::to_owned).collect()
}

fn one_line(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        line.push_str(": ");
        line.push_str(&cause.to_string());
        source = cause.source();
    }
    line.chars().take(300).collect()
}
