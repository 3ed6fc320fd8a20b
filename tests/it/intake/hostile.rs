//! Files made to hurt: each gives a clean error in bounded time and memory.

use super::formats::{json_body, nifti_file, npy_file};
use super::nuclear::{gated, standard_file, with};
use super::writer::{Element, Syntax, Value, file, text, words};
use super::{read_all, read_one};
use flate2::Compression;
use flate2::write::{DeflateEncoder, GzEncoder};
use proptest::prelude::*;
use std::io::Write;
use std::process::Command;
use std::time::Instant;

/// Seconds that a file may take.
const MOST_SECONDS: f64 = 2.0;
/// Resident memory that the test process may reach over all files, in KiB: below 300 MB.
const MOST_RESIDENT_KIB: u64 = 290_000;

fn declaring(vr: &'static str, length: u32) -> Vec<u8> {
    with(vec![Element { tag: (9, 0x1010), vr, value: Value::Declared(length, vec![0; 16]) }])
}

/// A file whose data set begins with these bytes after a valid header.
fn after_meta(syntax: Syntax, data_set: &[u8]) -> Vec<u8> {
    let mut bytes = file(&[], Syntax::Explicit);
    if syntax != Syntax::Explicit {
        bytes = file(&[], syntax);
        if syntax == Syntax::Deflated {
            // The empty deflate stream is replaced.
            bytes.truncate(bytes.len() - 2);
        }
    }
    bytes.extend_from_slice(data_set);
    bytes
}

/// Sequences in each other, all lengths defined or all undefined, in explicit VR.
fn nested(levels: usize, defined: bool) -> Vec<u8> {
    let header = |out: &mut Vec<u8>, length: u32| {
        out.extend([0x08, 0, 0x40, 0x11]);
        out.extend(*b"SQ\0\0");
        out.extend(length.to_le_bytes());
    };
    let item = |out: &mut Vec<u8>, length: u32| {
        out.extend([0xFE, 0xFF, 0x00, 0xE0]);
        out.extend(length.to_le_bytes());
    };
    let mut bytes = Vec::new();
    for level in 0..levels {
        let inner = ((levels - level - 1) * 20) as u32;
        header(&mut bytes, if defined { inner + 8 } else { u32::MAX });
        item(&mut bytes, if defined { inner } else { u32::MAX });
    }
    if !defined {
        for _ in 0..levels {
            bytes.extend([0xFE, 0xFF, 0x0D, 0xE0, 0, 0, 0, 0, 0xFE, 0xFF, 0xDD, 0xE0, 0, 0, 0, 0]);
        }
    }
    bytes
}

/// UN of undefined length in each other: in explicit VR outside, in implicit VR within.
fn nested_unknown(levels: usize) -> Vec<u8> {
    let mut bytes = vec![9, 0, 0x10, 0x10, b'U', b'N', 0, 0, 0xFF, 0xFF, 0xFF, 0xFF];
    for _ in 0..levels {
        bytes.extend([0xFE, 0xFF, 0x00, 0xE0, 0xFF, 0xFF, 0xFF, 0xFF]);
        bytes.extend([9, 0, 0x10, 0x10, 0xFF, 0xFF, 0xFF, 0xFF]);
    }
    bytes
}

/// Nested sequences in implicit VR, where only the dictionary knows that they are sequences.
fn nested_implicit(levels: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for level in 0..levels {
        let inner = ((levels - level - 1) * 16) as u32;
        bytes.extend([0x54, 0, 0x22, 0]);
        bytes.extend((inner + 8).to_le_bytes());
        bytes.extend([0xFE, 0xFF, 0x00, 0xE0]);
        bytes.extend(inner.to_le_bytes());
    }
    bytes
}

fn zeros(mebibytes: usize, mut to: impl Write) {
    let block = vec![0; 1 << 20];
    (0..mebibytes).for_each(|_| to.write_all(&block).unwrap());
}

fn deflated_zeros(mebibytes: usize) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::fast());
    zeros(mebibytes, &mut encoder);
    encoder.finish().unwrap()
}

fn gzipped_zeros(mebibytes: usize) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    zeros(mebibytes, &mut encoder);
    encoder.finish().unwrap()
}

/// An RLE object of one fragment a frame, each this one.
fn rle(fragment: &[u8]) -> Vec<u8> {
    let order: Vec<(usize, usize)> = (0..8).map(|frame| (frame / 4, frame % 4)).collect();
    let mut elements = gated(&order, Syntax::Rle);
    elements.retain(|element| element.tag.0 != 0x7FE0);
    let fragments = std::iter::once(Vec::new()).chain((0..8).map(|_| fragment.to_vec())).collect();
    elements.push(Element { tag: (0x7FE0, 0x10), vr: "OB", value: Value::Fragments(fragments) });
    file(&elements, Syntax::Rle)
}

fn rle_header(segments: u32, first: u32, second: u32) -> Vec<u8> {
    let mut fragment = vec![0; 80];
    fragment[..4].copy_from_slice(&segments.to_le_bytes());
    fragment[4..8].copy_from_slice(&first.to_le_bytes());
    fragment[8..12].copy_from_slice(&second.to_le_bytes());
    fragment
}

/// Name, bytes and the code that refuses them.
fn files() -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let many_elements: Vec<u8> = (0..200_001).flat_map(|_| [0x09, 0, 0x10, 0x10, b'L', b'O', 0, 0]).collect();
    let npy_header = |shape: &str| {
        let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
        while (header.len() + 11) % 64 != 0 {
            header.push(' ');
        }
        header.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes
    };
    let mut nifti_dims = nifti_file(16, 4);
    nifti_dims[40..50].copy_from_slice(&[4, 0, 255, 127, 255, 127, 255, 127, 255, 127]);
    let mut nifti_negative = nifti_file(16, 4);
    nifti_negative[42..44].copy_from_slice(&(-7_i16).to_le_bytes());
    let mut nifti_offset = nifti_file(16, 4);
    nifti_offset[108..112].copy_from_slice(&1e30_f32.to_le_bytes());
    let mut nifti_short = nifti_file(16, 4);
    nifti_short.truncate(5000);
    let open_body = json_body("uint16").trim_end_matches('}').to_owned();
    let huge_parameters = format!("{open_body},\"parameters\":[{}0]}}", "0,".repeat(3_000_000));
    let deep_parameters = format!("{open_body},\"parameters\":{}", "[".repeat(1_000_000));
    let fragments = |declared: u32| {
        let mut value = vec![0xFE, 0xFF, 0x00, 0xE0];
        value.extend(declared.to_le_bytes());
        with(vec![Element { tag: (0x7FE0, 0x10), vr: "OB", value: Value::Declared(u32::MAX, value) }])
    };
    vec![
        ("UN of 4 GiB", declaring("UN", 0xFFFF_FFFE), "truncated_dicom"),
        ("OW of 4 GiB", declaring("OW", 0xFFFF_FFFE), "truncated_dicom"),
        ("UT of 2 GiB", declaring("UT", 0x7FFF_FFFE), "truncated_dicom"),
        ("fragment of 4 GiB", fragments(0xFFFF_FFFE), "truncated_dicom"),
        ("fragment of undefined length", fragments(u32::MAX), "truncated_dicom"),
        ("5 000 sequences, lengths defined", after_meta(Syntax::Explicit, &nested(5_000, true)), "dicom_too_deep"),
        ("5 000 sequences, lengths undefined", after_meta(Syntax::Explicit, &nested(5_000, false)), "dicom_too_deep"),
        ("5 000 UN of undefined length", after_meta(Syntax::Explicit, &nested_unknown(5_000)), "dicom_too_deep"),
        ("5 000 sequences, implicit", after_meta(Syntax::Implicit, &nested_implicit(5_000)), "dicom_too_deep"),
        ("unfinished sequences", after_meta(Syntax::Explicit, &nested(20, false)[..400]), "truncated_dicom"),
        ("200 001 elements", after_meta(Syntax::Explicit, &many_elements), "dicom_too_many_elements"),
        ("deflate bomb", after_meta(Syntax::Deflated, &deflated_zeros(256)), "inflates_too_large"),
        ("deflated noise", after_meta(Syntax::Deflated, &[0xFF; 1000]), "malformed_dicom"),
        ("gzip bomb", gzipped_zeros(256), "inflates_too_large"),
        ("gzip of zeros", gzipped_zeros(60), "malformed_nifti"),
        ("gzip cut", gzipped_zeros(1)[..500].to_vec(), "damaged_gzip"),
        ("RLE of 285 million segments", rle(&rle_header(0x1100_0002, 64, 70)), "damaged_pixel_data"),
        ("RLE with offsets outside", rle(&rle_header(2, 64, 0xFFFF_FFF0)), "damaged_pixel_data"),
        ("RLE with offsets backwards", rle(&rle_header(2, 76, 66)), "damaged_pixel_data"),
        ("RLE too short", rle(&rle_header(2, 64, 70)), "damaged_pixel_data"),
        ("RLE without a header", rle(&[2, 0, 0, 0]), "damaged_pixel_data"),
        ("30 000 pixel spacings", with(vec![text((0x28, 0x30), "UN", "9\\".repeat(30_000))]), "invalid_attribute"),
        ("five megabytes of detectors", with(vec![text((0x54, 0x22), "UT", "x".repeat(5 << 20))]), "malformed_dicom"),
        ("NIfTI of 10¹⁸ voxels", nifti_dims, "outside_limits"),
        ("NIfTI of −7 columns", nifti_negative, "outside_limits"),
        ("NIfTI voxels at 10³⁰", nifti_offset, "malformed_nifti"),
        ("NIfTI cut", nifti_short, "malformed_nifti"),
        ("NPY of 80 GB", npy_header("(10, 1000, 1000, 1000)"), "outside_limits"),
        ("NPY beyond 64 bits", npy_header("(4294967296, 4294967296, 4294967296)"), "outside_limits"),
        ("NPY cut", npy_file("<u2")[..1000].to_vec(), "malformed_npy"),
        ("JSON parameters of 6 MB", huge_parameters.into_bytes(), "too_large"),
        ("JSON a million deep", deep_parameters.into_bytes(), "malformed_json"),
        ("only DICM", [vec![0; 128], b"DICM".to_vec()].concat(), "malformed_dicom"),
        ("one byte", vec![8], "unknown_format"),
        ("no bytes", Vec::new(), "empty_body"),
        ("a form", b"name=value&other=thing".to_vec(), "unknown_format"),
        ("a ZIP archive", b"PK\x03\x04rest".to_vec(), "unknown_format"),
    ]
}

#[test]
fn every_hostile_file_is_refused_quickly() {
    for (name, bytes, code) in files() {
        let begun = Instant::now();
        let error = read_one(&bytes).expect_err(name);
        assert_eq!(error.code(), code, "{name}: {error}");
        assert!(error.to_string().len() < 600, "{name}: {error}");
        assert!(begun.elapsed().as_secs_f64() < MOST_SECONDS, "{name} took {:?}", begun.elapsed());
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("VmHWM: unknown");
    println!("{peak}");
}

/// Runs the test above in a process of its own, where nothing else takes memory, and reads its peak.
#[test]
#[cfg(target_os = "linux")]
fn all_hostile_files_together_take_little_memory() {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "intake::hostile::every_hostile_file_is_refused_quickly", "--nocapture", "--test-threads=1"])
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{printed}");
    let peak = printed.lines().find_map(|line| line.split_once("VmHWM:")).map(|(_, rest)| rest.trim().trim_end_matches(" kB").to_owned());
    let peak: u64 = peak.unwrap_or_else(|| panic!("no peak in {printed}")).parse().unwrap();
    assert!(peak < MOST_RESIDENT_KIB, "{peak} KiB resident");
}

#[test]
fn many_deflate_bombs_in_one_request_share_one_limit() {
    let mut elements = gated(&[(0, 0)], Syntax::Deflated);
    elements.push(Element { tag: (9, 0x1010), vr: "OB", value: Value::Bytes(vec![0; 40 << 20]) });
    let bomb = file(&elements, Syntax::Deflated);
    assert!(bomb.len() < 100_000);
    let error = read_all(&vec![bomb; 8]).unwrap_err();
    assert_eq!(error.code(), "inflates_too_large", "{error}");
    assert!(error.to_string().starts_with("file 2 of the request: "), "{error}");
}

#[test]
fn every_cut_of_a_valid_file_is_refused() {
    let whole = standard_file();
    assert!(read_one(&whole).is_ok());
    for length in (0..whole.len()).step_by(if whole.len() > 2000 { 3 } else { 1 }) {
        let error = read_one(&whole[..length]).expect_err("cut");
        assert_ne!(error.code(), "unreadable_data_set", "{length}: {error}");
    }
}

/// The largest study that the limits allow costs seconds too, and is not refused.
#[test]
fn the_largest_study_is_read_quickly() {
    let (gates, slices, rows, columns) = (16_usize, 64_usize, 128_usize, 128_usize);
    let frames = gates * slices;
    let one_based = |values: &mut dyn Iterator<Item = usize>| values.map(|value| value as u16 + 1).collect::<Vec<u16>>();
    let bytes = with(vec![
        text((0x28, 8), "IS", frames.to_string()),
        words((0x28, 0x10), &[rows as u16]),
        words((0x28, 0x11), &[columns as u16]),
        words((0x54, 0x60), &vec![1; frames]),
        words((0x54, 0x70), &one_based(&mut (0..frames).map(|frame| frame / slices))),
        words((0x54, 0x71), &[gates as u16]),
        words((0x54, 0x80), &one_based(&mut (0..frames).map(|frame| frame % slices))),
        words((0x54, 0x81), &[slices as u16]),
        Element { tag: (0x7FE0, 0x10), vr: "OW", value: Value::Bytes(vec![1; frames * rows * columns * 2]) },
    ]);
    let begun = Instant::now();
    let study = read_one(&bytes).unwrap().study;
    assert!(begun.elapsed().as_secs_f64() < MOST_SECONDS, "{:?}", begun.elapsed());
    assert_eq!((study.gates.len(), study.grid.shape), (gates, [slices, rows, columns]));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever byte is changed, the answer is a study or an error, never a panic.
    #[test]
    fn changed_bytes_never_panic(which in 0_usize..6, changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12)) {
        let order: Vec<(usize, usize)> = (0..8).map(|frame| (frame / 4, frame % 4)).collect();
        let mut bytes = match which {
            0 => standard_file(),
            1 => file(&gated(&order, Syntax::Implicit), Syntax::Implicit),
            2 => file(&gated(&order, Syntax::Big), Syntax::Big),
            3 => nifti_file(16, 4),
            4 => npy_file("<f4"),
            _ => json_body("float32").into_bytes(),
        };
        // The header is where changes matter.
        let header = bytes.len().min(1400);
        for (index, value) in changes {
            let at = index.index(header);
            bytes[at] = value;
        }
        let _ = read_one(&bytes).map_err(|error| error.to_string());
    }
}
