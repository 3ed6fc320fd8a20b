//! A small DICOM writer for tests: writes what it is told, right or wrong, in four encodings.

use flate2::Compression;
use flate2::write::DeflateEncoder;
use std::io::Write;

/// The encodings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Syntax {
    Implicit,
    Explicit,
    Big,
    Deflated,
    Rle,
}

impl Syntax {
    pub(super) fn uid(self) -> &'static str {
        match self {
            Self::Implicit => "1.2.840.10008.1.2",
            Self::Explicit => "1.2.840.10008.1.2.1",
            Self::Big => "1.2.840.10008.1.2.2",
            Self::Deflated => "1.2.840.10008.1.2.1.99",
            Self::Rle => "1.2.840.10008.1.2.5",
        }
    }
}

/// A value as the test thinks of it.
#[derive(Debug, Clone)]
pub(super) enum Value {
    Text(String),
    Words(Vec<u16>),
    Tags(Vec<(u16, u16)>),
    Bytes(Vec<u8>),
    Items(Vec<Vec<Element>>),
    /// Fragments of undefined length; the first is the offset table.
    Fragments(Vec<Vec<u8>>),
    /// Bytes under a declared length of one's choice.
    Declared(u32, Vec<u8>),
}

#[derive(Debug, Clone)]
pub(super) struct Element {
    pub(super) tag: (u16, u16),
    pub(super) vr: &'static str,
    pub(super) value: Value,
}

pub(super) fn text(tag: (u16, u16), vr: &'static str, value: impl Into<String>) -> Element {
    Element { tag, vr, value: Value::Text(value.into()) }
}

pub(super) fn words(tag: (u16, u16), values: &[u16]) -> Element {
    Element { tag, vr: "US", value: Value::Words(values.to_vec()) }
}

pub(super) fn items(tag: (u16, u16), items: Vec<Vec<Element>>) -> Element {
    Element { tag, vr: "SQ", value: Value::Items(items) }
}

/// A Part-10 file.
pub(super) fn file(elements: &[Element], syntax: Syntax) -> Vec<u8> {
    let mut bytes = vec![0; 128];
    bytes.extend_from_slice(b"DICM");
    let meta = [
        Element { tag: (2, 1), vr: "OB", value: Value::Bytes(vec![0, 1]) },
        text((2, 2), "UI", "1.2.840.10008.5.1.4.1.1.20"),
        text((2, 0x10), "UI", syntax.uid()),
    ];
    for element in &meta {
        encode(element, Syntax::Explicit, &mut bytes);
    }
    let data_set = data_set(elements, syntax);
    if syntax == Syntax::Deflated {
        let mut deflate = DeflateEncoder::new(Vec::new(), Compression::best());
        deflate.write_all(&data_set).unwrap();
        bytes.extend(deflate.finish().unwrap());
    } else {
        bytes.extend(data_set);
    }
    bytes
}

/// The data set alone.
pub(super) fn data_set(elements: &[Element], syntax: Syntax) -> Vec<u8> {
    let mut sorted = elements.to_vec();
    sorted.sort_by_key(|element| element.tag);
    let mut bytes = Vec::new();
    for element in &sorted {
        encode(element, syntax, &mut bytes);
    }
    bytes
}

fn encode(element: &Element, syntax: Syntax, out: &mut Vec<u8>) {
    let put16 = |out: &mut Vec<u8>, value: u16| out.extend(if syntax == Syntax::Big { value.to_be_bytes() } else { value.to_le_bytes() });
    let put32 = |out: &mut Vec<u8>, value: u32| out.extend(if syntax == Syntax::Big { value.to_be_bytes() } else { value.to_le_bytes() });
    let mut value = Vec::new();
    let mut declared = None;
    match &element.value {
        Value::Text(text) => value.extend_from_slice(text.as_bytes()),
        Value::Words(words) => words.iter().for_each(|word| put16(&mut value, *word)),
        Value::Tags(tags) => tags.iter().for_each(|(group, number)| {
            put16(&mut value, *group);
            put16(&mut value, *number);
        }),
        Value::Bytes(bytes) => value.extend_from_slice(bytes),
        Value::Items(items) => {
            for item in items {
                let mut content = Vec::new();
                for element in item {
                    encode(element, syntax, &mut content);
                }
                put16(&mut value, 0xFFFE);
                put16(&mut value, 0xE000);
                put32(&mut value, content.len() as u32);
                value.extend(content);
            }
        }
        Value::Fragments(fragments) => {
            declared = Some(u32::MAX);
            for fragment in fragments {
                value.extend([0xFE, 0xFF, 0x00, 0xE0]);
                value.extend((fragment.len() as u32).to_le_bytes());
                value.extend_from_slice(fragment);
            }
            value.extend([0xFE, 0xFF, 0xDD, 0xE0, 0, 0, 0, 0]);
        }
        Value::Declared(length, bytes) => {
            declared = Some(*length);
            value.extend_from_slice(bytes);
        }
    }
    if value.len() % 2 == 1 && declared.is_none() {
        value.push(if matches!(element.value, Value::Text(_)) && element.vr != "UI" { b' ' } else { 0 });
    }
    let length = declared.unwrap_or(value.len() as u32);
    put16(out, element.tag.0);
    put16(out, element.tag.1);
    if syntax == Syntax::Implicit {
        put32(out, length);
    } else {
        out.extend_from_slice(element.vr.as_bytes());
        if matches!(element.vr, "OB" | "OW" | "SQ" | "UN" | "UT") {
            put16(out, 0);
            put32(out, length);
        } else {
            put16(out, length as u16);
        }
    }
    out.extend(value);
}
