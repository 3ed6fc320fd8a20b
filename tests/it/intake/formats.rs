//! NIfTI, NPY and JSON bodies written here.

use super::read_one;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::DVec3;
use std::io::Write;
use ventricle::intake::{IntakeError, Limits, Options, Part, read};
use ventricle::study::{Format, Study};

const GATES: usize = 2;
const SHAPE: [usize; 3] = [4, 16, 18];
const VOXELS: usize = GATES * 4 * 16 * 18;

/// The count at a place in memory order; fits every sample type.
fn count(index: usize) -> f64 {
    (index % 200 + 1) as f64
}

/// A sample of NIfTI's datatype code, little- or big-endian.
fn sample(value: f64, datatype: i16, big_endian: bool) -> Vec<u8> {
    let mut bytes = match datatype {
        2 => vec![value as u8],
        4 => (value as i16).to_le_bytes().to_vec(),
        8 => (value as i32).to_le_bytes().to_vec(),
        16 => (value as f32).to_le_bytes().to_vec(),
        64 => value.to_le_bytes().to_vec(),
        512 => (value as u16).to_le_bytes().to_vec(),
        other => panic!("datatype {other}"),
    };
    if big_endian {
        bytes.reverse();
    }
    bytes
}

/// Writes the fields of a NIfTI-1 header in one byte order.
struct Header {
    bytes: Vec<u8>,
    big_endian: bool,
}

impl Header {
    fn new(datatype: i16, big_endian: bool) -> Self {
        let mut header = Self { bytes: vec![0; 352], big_endian };
        header.put(0, &348_i32.to_le_bytes());
        for (index, size) in [4_i16, 18, 16, 4, 2, 1, 1, 1].into_iter().enumerate() {
            header.put(40 + 2 * index, &size.to_le_bytes());
        }
        header.put(70, &datatype.to_le_bytes());
        header.put(72, &(8 * sample(0.0, datatype, false).len() as i16).to_le_bytes());
        for (index, size) in [1.0, 2.5, 3.0, 6.5, 0.1].into_iter().enumerate() {
            header.float(76 + 4 * index, size);
        }
        header.float(108, 352.0);
        header.float(112, 1.0);
        header.bytes[123] = 2 | 8;
        header.put(254, &1_i16.to_le_bytes());
        // Columns to the right, rows to the front, slices to the head; origin (1, 2, 3).
        for (row, values) in [[2.5, 0.0, 0.0, 1.0], [0.0, 3.0, 0.0, 2.0], [0.0, 0.0, 6.5, 3.0]].into_iter().enumerate() {
            for (column, value) in values.into_iter().enumerate() {
                header.float(280 + 16 * row + 4 * column, value);
            }
        }
        header.bytes[344..348].copy_from_slice(b"n+1\0");
        header
    }

    fn put(&mut self, at: usize, little_endian: &[u8]) {
        let mut bytes = little_endian.to_vec();
        if self.big_endian {
            bytes.reverse();
        }
        self.bytes[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    fn float(&mut self, at: usize, value: f32) {
        self.put(at, &value.to_le_bytes());
    }

    /// The file: header and voxels.
    fn file(self, datatype: i16) -> Vec<u8> {
        let big_endian = self.big_endian;
        let mut bytes = self.bytes;
        bytes.extend((0..VOXELS).flat_map(|index| sample(count(index), datatype, big_endian)));
        bytes
    }
}

/// A NIfTI file of float32 (datatype 16) or another type of so many bytes.
pub(super) fn nifti_file(datatype: i16, sample_bytes: usize) -> Vec<u8> {
    let bytes = Header::new(datatype, false).file(datatype);
    assert_eq!(bytes.len(), 352 + VOXELS * sample_bytes);
    bytes
}

/// An NPY file `[2, 4, 16, 18]`.
pub(super) fn npy_file(descr: &str) -> Vec<u8> {
    let datatype = match descr {
        "|u1" => 2,
        "<u2" => 512,
        "<i2" => 4,
        "<f4" => 16,
        _ => 64,
    };
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2, 4, 16, 18), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend((0..VOXELS).flat_map(|index| sample(count(index), datatype, false)));
    bytes
}

/// The JSON body of the contract with this dtype.
pub(super) fn json_body(dtype: &str) -> String {
    let datatype = if dtype == "uint16" { 512 } else { 16 };
    let bytes: Vec<u8> = (0..VOXELS).flat_map(|index| sample(count(index), datatype, false)).collect();
    format!(
        r#"{{"grid":{{"gates":2,"shape":[4,16,18],"spacing_mm":[6.5,3.0,2.5]}},"dtype":"{dtype}","counts":"{}"}}"#,
        STANDARD.encode(bytes)
    )
}

fn study(bytes: &[u8]) -> Study {
    read_one(bytes).unwrap_or_else(|error| panic!("{error}")).study
}

fn read_npy(bytes: &[u8], spacing_mm: Option<[f64; 3]>) -> Result<Study, IntakeError> {
    let part = Part { media_type: Some("application/x-npy"), filename: None, bytes };
    read(&[part], &Options { spacing_mm, ..Options::default() }, &Limits::default()).map(|received| received.study)
}

fn assert_voxels(study: &Study) {
    assert_eq!((study.gates.len(), study.grid.shape, study.grid.spacing_mm), (GATES, SHAPE, [6.5, 3.0, 2.5]));
    let all = study.gates.iter().flat_map(|gate| gate.volume.counts.iter());
    for (index, value) in all.enumerate() {
        assert_eq!(value.to_bits(), (count(index) as f32).to_bits(), "voxel {index}");
    }
}

#[test]
fn every_nifti_type_and_byte_order_gives_the_same_study() {
    for datatype in [2, 4, 8, 16, 64, 512] {
        for big_endian in [false, true] {
            let bytes = Header::new(datatype, big_endian).file(datatype);
            let plain = study(&bytes);
            assert_voxels(&plain);
            assert_eq!(plain.acquisition.format, Format::Nifti);
            assert_eq!((plain.gates[1].duration_ms, plain.acquisition.rr_interval_ms), (Some(100.0), Some(200.0)));
            let orientation = plain.orientation.unwrap();
            assert_eq!((orientation.columns, orientation.rows, orientation.slices), (DVec3::NEG_X, DVec3::NEG_Y, DVec3::Z));
            assert_eq!(orientation.origin_mm, DVec3::new(-1.0, -2.0, 3.0));
            let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
            gzip.write_all(&bytes).unwrap();
            assert!(plain == study(&gzip.finish().unwrap()));
        }
    }
}

#[test]
fn a_quaternion_stands_in_for_the_affine() {
    let mut header = Header::new(16, false);
    header.put(254, &0_i16.to_le_bytes());
    header.put(252, &1_i16.to_le_bytes());
    // Half a turn about z, left-handed: x → −x, y → −y, z → −z.
    header.float(264, 1.0);
    header.float(276, 5.0);
    header.float(76, -1.0);
    let orientation = study(&header.file(16)).orientation.unwrap();
    assert!(orientation.columns.abs_diff_eq(DVec3::X, 1e-9) && orientation.rows.abs_diff_eq(DVec3::Y, 1e-9));
    assert!(orientation.slices.abs_diff_eq(DVec3::NEG_Z, 1e-9) && orientation.mirrors());
    assert_eq!(orientation.origin_mm.z.to_bits(), 5.0_f64.to_bits());
}

#[test]
fn nifti_units_scale_and_missing_facts_are_said() {
    let mut metres = Header::new(16, false);
    metres.bytes[123] = 1;
    for (index, size) in [0.0025, 0.003, 0.0065].into_iter().enumerate() {
        metres.float(80 + 4 * index, size);
    }
    metres.put(254, &0_i16.to_le_bytes());
    let in_metres = study(&metres.file(16));
    assert_voxels(&in_metres);
    assert_eq!(in_metres.gates[0].duration_ms, None);
    assert_eq!(in_metres.orientation, None);
    assert_eq!(in_metres.warnings.iter().map(|warning| warning.code.as_str()).collect::<Vec<_>>(), ["missing_orientation"]);

    let mut unitless = Header::new(16, false);
    unitless.bytes[123] = 0;
    assert_eq!(study(&unitless.file(16)).warnings[0].code, "unknown_unit");

    let mut scaled = Header::new(512, false);
    scaled.float(112, 0.5);
    scaled.float(116, 10.0);
    assert_eq!(study(&scaled.file(512)).gates[0].volume.counts[[0, 0, 3]].to_bits(), 12.0_f32.to_bits());
    // Slope NaN, as nibabel writes it, means no scaling.
    let mut nan = Header::new(512, false);
    nan.float(112, f32::NAN);
    assert_voxels(&study(&nan.file(512)));
}

#[test]
fn nifti_that_cannot_be_read_is_refused_by_name() {
    let refusal = |bytes: &[u8]| {
        let error = read_one(bytes).expect_err("refused");
        (error.code(), error.to_string())
    };
    let mut second = vec![0; 600];
    second[0] = 28;
    second[1] = 2;
    second[4..8].copy_from_slice(b"n+2\0");
    let (code, sentence) = refusal(&second);
    assert_eq!(code, "unsupported_nifti");
    assert!(sentence.contains("NIfTI-2"), "{sentence}");

    let mut pair = nifti_file(16, 4);
    pair[344..348].copy_from_slice(b"ni1\0");
    assert_eq!(refusal(&pair).0, "unsupported_nifti");

    let mut complex = Header::new(16, false);
    complex.put(70, &32_i16.to_le_bytes());
    let (code, sentence) = refusal(&complex.file(16));
    assert_eq!(code, "unsupported_nifti");
    assert!(sentence.contains("datatype 32"), "{sentence}");

    let mut five = Header::new(16, false);
    five.put(40, &5_i16.to_le_bytes());
    five.put(50, &3_i16.to_le_bytes());
    assert_eq!(refusal(&five.file(16)).0, "unsupported_nifti");

    let mut flat = Header::new(16, false);
    flat.float(88, 0.0);
    let (code, sentence) = refusal(&flat.file(16));
    assert_eq!(code, "malformed_nifti");
    assert!(sentence.contains("pixdim[3]"), "{sentence}");

    let mut nan = nifti_file(16, 4);
    let second_gate_second_row = 352 + 4 * (VOXELS / 2 + 18);
    nan[second_gate_second_row..second_gate_second_row + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let (code, sentence) = refusal(&nan);
    assert_eq!(code, "counts_not_finite");
    assert!(sentence.contains("gate 2 holds NaN at slice 1, row 2, column 1"), "{sentence}");

    let mut cut = nifti_file(16, 4);
    cut.pop();
    let (code, sentence) = refusal(&cut);
    assert_eq!(code, "malformed_nifti");
    assert!(sentence.contains("need 9216 bytes after byte 352, and 9215 are there"), "{sentence}");
}

#[test]
fn npy_needs_its_spacing_and_reads_every_type() {
    for descr in ["|u1", "<u2", "<i2", "<f4", "<f8"] {
        let study = read_npy(&npy_file(descr), Some([6.5, 3.0, 2.5])).unwrap();
        assert_voxels(&study);
        assert_eq!((study.acquisition.format, study.orientation), (Format::Npy, None));
    }
    assert_eq!(read_npy(&npy_file("<u2"), None).unwrap_err().code(), "missing_spacing");
    assert_eq!(read_npy(&npy_file("<u2"), Some([6.5, 3.0, -2.5])).unwrap_err().code(), "outside_limits");
    assert_eq!(read_npy(&npy_file("<u2"), Some([f64::NAN, 3.0, 2.5])).unwrap_err().code(), "outside_limits");
    let big = read_npy(&npy_file(">f8"), Some([6.5, 3.0, 2.5])).unwrap_err();
    assert!(big.to_string().contains("its type is '>f8'"), "{big}");
    let mut longer = npy_file("<u2");
    longer.push(0);
    assert!(read_npy(&longer, Some([6.5, 3.0, 2.5])).unwrap_err().to_string().contains("needs 4608 bytes of data, and 4609 are there"));
}

#[test]
fn a_json_body_gives_the_study_and_its_parameters() {
    for dtype in ["uint16", "float32"] {
        let received = read_one(json_body(dtype).as_bytes()).unwrap();
        assert_voxels(&received.study);
        assert_eq!(received.study.acquisition.format, Format::Json);
        assert_eq!(received.parameters, None);
    }
    let body = json_body("uint16").replacen('{', r#"{"parameters":{"preset":"paper"},"#, 1);
    assert_eq!(read_one(body.as_bytes()).unwrap().parameters, Some(serde_json::json!({"preset": "paper"})));
}

#[test]
fn a_wrong_json_body_is_refused_by_name() {
    let good = json_body("uint16");
    for (from, to, word) in [
        ("\"dtype\"", "\"type\"", "unknown field `type`"),
        ("\"gates\"", "\"gate\"", "unknown field `gate`"),
        ("uint16", "int8", "unknown variant `int8`"),
        ("[4,16,18]", "[4,16]", "invalid length 2"),
        ("[4,16,18]", "[4,16,19]", "counts has 6144 base64 characters where 2 gates of shape [4, 16, 19] need 6488 (4864 bytes)"),
        ("\"counts\":\"A", "\"counts\":\"*", "counts is no base64"),
    ] {
        let error = read_one(good.replace(from, to).as_bytes()).expect_err(to);
        assert_eq!(error.code(), "malformed_json", "{error}");
        assert!(error.to_string().contains(word), "{error}");
    }
    let cut = read_one(&good.as_bytes()[..good.len() - 1]).unwrap_err();
    assert!(cut.to_string().contains("EOF while parsing"), "{cut}");
    let error = read_one(good.replace("6.5", "0").as_bytes()).unwrap_err();
    assert_eq!(error.code(), "outside_limits");
    assert!(error.to_string().contains("0 mm between slices"), "{error}");
}
