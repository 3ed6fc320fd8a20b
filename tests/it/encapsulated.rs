//! DICOM files whose pixel data is replaced: by what a test makes up, or by what the programs of others write.

use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use std::{io::Cursor, path::Path, process::Command};
use ventricle::{
    codecs::Decoder,
    intake::{self, IntakeError, Limits, Options, Part},
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    study::Study,
};

/// Limits with the program of this build as decoder.
pub(crate) fn limits() -> Limits {
    Limits { decoder: Some(Decoder { program: env!("CARGO_BIN_EXE_ventricle").into() }), ..Limits::default() }
}

/// Reads a DICOM file as the service would.
pub(crate) fn read(bytes: &[u8]) -> Result<Study, IntakeError> {
    let part = Part { media_type: Some("application/dicom"), filename: None, bytes };
    intake::read(&[part], &Options::default(), &limits()).map(|received| received.study)
}

/// A noisy phantom of 24 slices of 64 × 64 a gate, explicit VR little endian, 16 bits.
pub(crate) fn phantom_file(gates: usize) -> Vec<u8> {
    let imaging = Imaging { gates, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

/// What is added to signed samples (Rescale Intercept), so that counts are positive.
const INTERCEPT: i32 = 9000;

/// The same file with other samples in so many bits. Signed ones are made positive counts by a Rescale Intercept.
pub(crate) fn with_samples(native: &[u8], bits: u16, signed: bool, sample: impl Fn(u16) -> u16) -> Vec<u8> {
    let mut object = dicom_object::from_reader(Cursor::new(native)).unwrap();
    let samples: Vec<u16> = object.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap().into_iter().map(sample).collect();
    for (tag, value) in [
        (tags::BITS_ALLOCATED, if bits > 8 { 16 } else { 8 }),
        (tags::BITS_STORED, bits),
        (tags::HIGH_BIT, bits - 1),
        (tags::PIXEL_REPRESENTATION, u16::from(signed)),
    ] {
        object.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
    }
    if signed {
        object.put(DataElement::new(tags::RESCALE_INTERCEPT, VR::DS, PrimitiveValue::from(INTERCEPT.to_string())));
        object.put(DataElement::new(tags::RESCALE_SLOPE, VR::DS, PrimitiveValue::from("1")));
    }
    let pixels = if bits > 8 {
        DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(samples.into()))
    } else {
        let bytes: Vec<u8> = samples.into_iter().map(|sample| u8::try_from(sample).unwrap()).collect();
        DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(bytes.into()))
    };
    object.put(pixels);
    let mut bytes = Vec::new();
    object.write_all(&mut bytes).unwrap();
    bytes
}

/// Where the header of the outermost Pixel Data of an explicit little-endian file begins: the last element of these files.
fn pixel_data(file: &[u8]) -> usize {
    file.windows(6).rposition(|bytes| bytes == b"\xe0\x7f\x10\0OW" || bytes == b"\xe0\x7f\x10\0OB").unwrap()
}

/// The samples of a native file.
pub(crate) fn native_samples(file: &[u8]) -> &[u8] {
    &file[pixel_data(file) + 12..]
}

/// The fragments of an encapsulated file; the first is the offset table.
pub(crate) fn fragments(file: &[u8]) -> Vec<Vec<u8>> {
    let mut rest = &file[pixel_data(file) + 12..];
    let mut found = Vec::new();
    while let Some(item) = rest.strip_prefix(b"\xfe\xff\0\xe0") {
        let (length, content) = item.split_first_chunk::<4>().unwrap();
        let (content, after) = content.split_at(u32::from_le_bytes(*length) as usize);
        found.push(content.to_vec());
        rest = after;
    }
    found
}

/// The file with other fragments, and in another transfer syntax if one is given. Odd ones are padded, as they must be.
pub(crate) fn with_fragments(file: &[u8], transfer_syntax: Option<&str>, fragments: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = match transfer_syntax {
        Some(uid) => in_syntax(&file[..pixel_data(file)], uid),
        None => file[..pixel_data(file)].to_vec(),
    };
    bytes.extend(b"\xe0\x7f\x10\0OB\0\0\xff\xff\xff\xff");
    for fragment in fragments {
        bytes.extend(b"\xfe\xff\0\xe0");
        bytes.extend(u32::try_from(fragment.len().next_multiple_of(2)).unwrap().to_le_bytes());
        bytes.extend(fragment);
        bytes.extend(std::iter::repeat_n(0, fragment.len() % 2));
    }
    bytes.extend(b"\xfe\xff\xdd\xe0\0\0\0\0");
    bytes
}

/// The file under another Transfer Syntax UID, everything else left as it is.
fn in_syntax(file: &[u8], uid: &str) -> Vec<u8> {
    let at = file.windows(6).position(|bytes| bytes == b"\x02\0\x10\0UI").unwrap();
    let old = usize::from(u16::from_le_bytes([file[at + 6], file[at + 7]]));
    let padded = format!("{uid}{}", if uid.len() % 2 == 1 { "\0" } else { "" });
    let length = u16::try_from(padded.len()).unwrap().to_le_bytes();
    [&file[..at + 6], &length, padded.as_bytes(), &file[at + 8 + old..]].concat()
}

/// Runs a program on a file and returns what it writes; `None` where the program is not installed.
pub(crate) fn converted(directory: &Path, package: &str, command: &[&str], input: &[u8]) -> Option<Vec<u8>> {
    let (from, to) = (directory.join("from.dcm"), directory.join("to.dcm"));
    std::fs::write(&from, input).unwrap();
    let _ = std::fs::remove_file(&to);
    let Ok(output) = Command::new(command[0]).args(&command[1..]).args([&from, &to]).output() else {
        crate::shared::absent(package);
        return None;
    };
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    Some(std::fs::read(&to).unwrap())
}
