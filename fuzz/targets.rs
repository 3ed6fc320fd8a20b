//! What is fuzzed: plain functions over bytes, run by libFuzzer (`make fuzz`) and over the corpus by the tests. None may panic, whatever
//! the bytes are; what they return does not matter.

#![allow(dead_code)] // each fuzz target uses one

use ventricle::{
    codecs::{self, Codec, Layout},
    http,
    intake::{self, Limits, Options, Part},
};

/// Small enough that the fuzzer's memory limit finds what grows beyond its input.
fn limits() -> Limits {
    Limits { voxels: 1 << 20, body_bytes: 1 << 20, inflated_bytes: 4 << 20, ..Limits::default() }
}

fn read(media_type: &str, bytes: &[u8]) {
    let part = Part { media_type: Some(media_type), filename: None, bytes };
    let _ = intake::read(&[part], &Options { spacing_mm: Some([5.0, 3.0, 3.0]), ..Options::default() }, &limits());
}

/// The walk over a DICOM file's structure.
pub(super) fn prescan(bytes: &[u8]) {
    let _ = intake::scan_only(bytes, &limits());
}

/// A DICOM file from its first byte to its counts. Compressed frames are checked and end there: no program to decode them with.
pub(super) fn dicom(bytes: &[u8]) {
    let decoder = Some(codecs::Decoder { program: "/dev/null".into() });
    let part = Part { media_type: Some("application/dicom"), filename: None, bytes };
    let _ = intake::read(&[part], &Options::default(), &Limits { decoder, ..limits() });
}

/// NIfTI, plain and gzipped.
pub(super) fn nifti(bytes: &[u8]) {
    read("application/x-nifti", bytes);
}

/// NPY.
pub(super) fn npy(bytes: &[u8]) {
    read("application/x-npy", bytes);
}

/// The JSON body with counts in base64.
pub(super) fn json(bytes: &[u8]) {
    read("application/json", bytes);
}

/// A multipart body: a line with the boundary, then the body.
pub(super) fn multipart(bytes: &[u8]) {
    let end = bytes.iter().position(|byte| *byte == b'\n').unwrap_or(bytes.len());
    let (boundary, body) = (String::from_utf8_lossy(&bytes[..end]), bytes.get(end + 1..).unwrap_or_default());
    let _ = http::take_apart(&format!("multipart/form-data; boundary={boundary}"), body.to_vec());
}

/// The header of a compressed frame. The first byte chooses codec and bits.
pub(super) fn frame_header(bytes: &[u8]) {
    let Some((choice, frame)) = bytes.split_first() else { return };
    let codec = [Codec::Jpeg, Codec::JpegLossless, Codec::JpegLs, Codec::Jpeg2000][usize::from(choice & 3)];
    let bits_allocated = if choice & 4 == 0 { 8 } else { 16 };
    let layout = Layout { rows: 64, columns: 64, bits_allocated, bits_stored: bits_allocated - (choice >> 5) };
    let _ = codecs::check(codec, layout, frame);
}
