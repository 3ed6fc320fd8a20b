//! NM objects written here: every encoding and order of frames gives one study, and what is wrong is named.

use super::writer::{Element, Syntax, Value, file, items, text, words};
use super::{read_all, read_one};
use glam::DVec3;
use ventricle::intake::{IntakeError, Limits, Options, Part, Received, read};
use ventricle::study::Study;
use ventricle::subject::Attribute;

pub(super) const GATES: usize = 2;
pub(super) const SLICES: usize = 4;
pub(super) const ROWS: usize = 16;
pub(super) const COLUMNS: usize = 18;

/// The count that each voxel of the test study has: tells gate, slice, row and column apart.
fn count(gate: usize, slice: usize, row: usize, column: usize) -> u16 {
    (gate * 20_000 + slice * 4_000 + row * 100 + column + 1) as u16
}

fn pixels(order: &[(usize, usize)], big_endian: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    for &(gate, slice) in order {
        for row in 0..ROWS {
            for column in 0..COLUMNS {
                let value = count(gate, slice, row, column);
                bytes.extend(if big_endian { value.to_be_bytes() } else { value.to_le_bytes() });
            }
        }
    }
    bytes
}

/// Frames in the standard order: slices vary fastest.
pub(super) fn standard() -> Vec<(usize, usize)> {
    (0..GATES).flat_map(|gate| (0..SLICES).map(move |slice| (gate, slice))).collect()
}

/// A RECON GATED TOMO object whose frames are in this order.
pub(super) fn gated(order: &[(usize, usize)], syntax: Syntax) -> Vec<Element> {
    let data_information = vec![text((0x18, 0x1062), "IS", "900"), text((0x18, 0x1063), "DS", "450"), text((0x18, 0x1083), "IS", "500")];
    let detector = vec![text((0x20, 0x32), "DS", "10\\20\\30"), text((0x20, 0x37), "DS", "1\\0\\0\\0\\0\\-1")];
    let one_based = |value: usize| value as u16 + 1;
    vec![
        text((8, 8), "CS", "ORIGINAL\\PRIMARY\\RECON GATED TOMO\\EMISSION"),
        text((8, 0x16), "UI", "1.2.840.10008.5.1.4.1.1.20"),
        text((8, 0x18), "UI", "1.2.3.4"),
        text((8, 0x60), "CS", "NM"),
        text((0x10, 0x10), "PN", "Nobody^Nowhere"),
        text((0x18, 0x50), "DS", "7"),
        text((0x18, 0x88), "DS", "6.5"),
        text((0x18, 0x1088), "IS", "66"),
        text((0x20, 0x0D), "UI", "1.2.3"),
        text((0x20, 0x0E), "UI", "1.2.3.1"),
        words((0x28, 2), &[1]),
        text((0x28, 4), "CS", "MONOCHROME2"),
        text((0x28, 8), "IS", order.len().to_string()),
        Element { tag: (0x28, 9), vr: "AT", value: Value::Tags(vec![(0x54, 0x60), (0x54, 0x70), (0x54, 0x80)]) },
        words((0x28, 0x10), &[ROWS as u16]),
        words((0x28, 0x11), &[COLUMNS as u16]),
        text((0x28, 0x30), "DS", "3.0\\2.5"),
        words((0x28, 0x100), &[16]),
        words((0x28, 0x101), &[16]),
        words((0x28, 0x102), &[15]),
        words((0x28, 0x103), &[0]),
        items((0x54, 0x22), vec![detector]),
        words((0x54, 0x60), &vec![1; order.len()]),
        items((0x54, 0x62), vec![vec![items((0x54, 0x63), vec![data_information])]]),
        words((0x54, 0x70), &order.iter().map(|(gate, _)| one_based(*gate)).collect::<Vec<_>>()),
        words((0x54, 0x71), &[GATES as u16]),
        words((0x54, 0x80), &order.iter().map(|(_, slice)| one_based(*slice)).collect::<Vec<_>>()),
        words((0x54, 0x81), &[SLICES as u16]),
        Element { tag: (0x7FE0, 0x10), vr: "OW", value: Value::Bytes(pixels(order, syntax == Syntax::Big)) },
    ]
}

pub(super) fn standard_file() -> Vec<u8> {
    file(&gated(&standard(), Syntax::Explicit), Syntax::Explicit)
}

/// The object with elements replaced or added.
pub(super) fn with(changes: Vec<Element>) -> Vec<u8> {
    gated_with(&standard(), changes)
}

/// Frames in an order of one's choice, with elements replaced or added.
pub(super) fn gated_with(order: &[(usize, usize)], changes: Vec<Element>) -> Vec<u8> {
    let mut elements = gated(order, Syntax::Explicit);
    for change in changes {
        elements.retain(|element| element.tag != change.tag);
        elements.push(change);
    }
    file(&elements, Syntax::Explicit)
}

/// The object without these elements.
fn without(tags: &[(u16, u16)]) -> Vec<u8> {
    let mut elements = gated(&standard(), Syntax::Explicit);
    elements.retain(|element| !tags.contains(&element.tag));
    file(&elements, Syntax::Explicit)
}

fn study(bytes: &[u8]) -> Study {
    read_one(bytes).unwrap_or_else(|error| panic!("{error}")).study
}

fn codes(study: &Study) -> Vec<&str> {
    study.warnings.iter().map(|warning| warning.code.as_str()).collect()
}

/// Code and sentence of a refusal.
fn refusal(bytes: &[u8]) -> (&'static str, String) {
    let error = read_one(bytes).expect_err("refused");
    (error.code(), error.to_string())
}

fn assert_voxels(study: &Study) {
    assert_eq!((study.gates.len(), study.grid.shape), (GATES, [SLICES, ROWS, COLUMNS]));
    for (gate, volume) in study.gates.iter().map(|gate| &gate.volume).enumerate() {
        for ((slice, row, column), value) in volume.counts.indexed_iter() {
            assert_eq!(value.to_bits(), f32::from(count(gate, slice, row, column)).to_bits(), "{gate} {slice} {row} {column}");
        }
    }
}

#[test]
fn a_gated_study_is_read_whole() {
    let study = study(&standard_file());
    assert_voxels(&study);
    assert_eq!(study.grid.spacing_mm, [6.5, 3.0, 2.5]);
    assert_eq!(study.gates.iter().map(|gate| gate.duration_ms).collect::<Vec<_>>(), [Some(450.0); 2]);
    assert_eq!((study.acquisition.rr_interval_ms, study.acquisition.heart_rate_bpm), (Some(900.0), Some(66.0)));
    assert_eq!(study.acquisition.study_instance_uid.as_deref(), Some("1.2.3"));
    assert_eq!(study.acquisition.sop_instance_uids, ["1.2.3.4"]);
    let orientation = study.orientation.unwrap();
    assert_eq!((orientation.columns, orientation.rows), (DVec3::X, DVec3::NEG_Z));
    // x × −z = y: positive spacing stacks along the normal.
    assert_eq!((orientation.slices, orientation.origin_mm), (DVec3::Y, DVec3::new(10.0, 20.0, 30.0)));
    assert_eq!(codes(&study), [""; 0]);
    assert!(!format!("{study:?}").contains("Nobody"));
}

#[test]
fn every_encoding_gives_the_same_study() {
    let explicit = study(&standard_file());
    for syntax in [Syntax::Implicit, Syntax::Big, Syntax::Deflated] {
        let other = study(&file(&gated(&standard(), syntax), syntax));
        assert!(explicit == other, "{syntax:?}");
    }
    let mut elements = gated(&standard(), Syntax::Rle);
    let fragments = standard().into_iter().map(|frame| rle(&pixels(&[frame], false)));
    let value = Value::Fragments(std::iter::once(Vec::new()).chain(fragments).collect());
    elements.retain(|element| element.tag.0 != 0x7FE0);
    elements.push(Element { tag: (0x7FE0, 0x10), vr: "OB", value });
    assert!(explicit == study(&file(&elements, Syntax::Rle)), "RLE");
}

/// An RLE frame of literal runs and one repeat run a plane where it can.
fn rle(frame: &[u8]) -> Vec<u8> {
    let mut segments = Vec::new();
    for plane in [1, 0] {
        let bytes: Vec<u8> = frame.iter().skip(plane).step_by(2).copied().collect();
        let mut packed = Vec::new();
        let mut rest = bytes.as_slice();
        while let Some(&first) = rest.first() {
            let run = rest.iter().take(128).take_while(|byte| **byte == first).count();
            if run > 2 {
                packed.extend([(257 - run) as u8, first]);
                rest = &rest[run..];
            } else {
                let length = rest.len().min(5);
                packed.push(length as u8 - 1);
                packed.extend_from_slice(&rest[..length]);
                rest = &rest[length..];
            }
        }
        segments.push(packed);
    }
    let mut fragment = vec![0; 64];
    fragment[0] = 2;
    fragment[4] = 64;
    fragment[8..12].copy_from_slice(&(64 + segments[0].len() as u32).to_le_bytes());
    for segment in &segments {
        fragment.extend(segment);
    }
    if fragment.len() % 2 == 1 {
        fragment.push(0x80);
    }
    fragment
}

#[test]
fn frames_may_come_in_any_order() {
    let expected = study(&standard_file());
    let slices_outside: Vec<_> = (0..SLICES).flat_map(|slice| (0..GATES).map(move |gate| (gate, slice))).collect();
    let backwards: Vec<_> = standard().into_iter().rev().collect();
    for order in [slices_outside, backwards] {
        assert!(expected == study(&file(&gated(&order, Syntax::Explicit), Syntax::Explicit)), "{order:?}");
    }
}

#[test]
fn the_sign_of_the_slice_spacing_turns_the_stack() {
    let study = study(&with(vec![text((0x18, 0x88), "DS", "-6.5")]));
    assert_voxels(&study);
    assert_eq!(study.grid.spacing_mm, [6.5, 3.0, 2.5]);
    let orientation = study.orientation.unwrap();
    assert_eq!(orientation.slices, DVec3::NEG_Y);
    assert!(orientation.mirrors());
}

#[test]
fn what_is_missing_is_lived_with_if_possible_and_said() {
    let cases: [(&[(u16, u16)], &str); 7] = [
        (&[(0x28, 9)], "missing_frame_increment_pointer"),
        (&[(0x54, 0x70), (0x54, 0x80)], "frame_order_assumed"),
        (&[(0x54, 0x70)], "frame_order_assumed"),
        (&[(0x54, 0x80)], "frame_order_assumed"),
        (&[(0x18, 0x88)], "slice_spacing_from_thickness"),
        (&[(0x54, 0x22)], "missing_orientation"),
        (&[(0x54, 0x62)], "missing_frame_time"),
    ];
    for (tags, code) in cases {
        let study = study(&without(tags));
        assert_voxels(&study);
        assert_eq!(codes(&study), [code], "{tags:?}");
    }
    let thickness = study(&without(&[(0x18, 0x88)]));
    assert_eq!(thickness.grid.spacing_mm, [7.0, 3.0, 2.5]);
    let untimed = study(&without(&[(0x54, 0x62)]));
    assert_eq!(untimed.gates[0].duration_ms, None);
    assert!((untimed.acquisition.rr_interval_ms.unwrap() - 60_000.0 / 66.0).abs() < 1e-9);
}

#[test]
fn what_cannot_be_done_without_is_named() {
    let both: &[(u16, u16)] = &[(0x18, 0x88), (0x18, 0x50)];
    for (tags, name) in [
        (both, "Spacing Between Slices (0018,0088)"),
        (&[(0x28, 0x30)], "Pixel Spacing (0028,0030)"),
        (&[(0x28, 0x10)], "Rows (0028,0010)"),
        (&[(0x28, 0x100)], "Bits Allocated (0028,0100)"),
        (&[(0x7FE0, 0x10)], "Pixel Data (7FE0,0010)"),
    ] {
        let (code, sentence) = refusal(&without(tags));
        assert_eq!(code, "missing_attribute", "{sentence}");
        assert!(sentence.contains(name), "{sentence}");
    }
}

#[test]
fn incomplete_rectangles_and_wrong_lengths_are_refused() {
    let mut hole = standard();
    hole[5] = (1, 0);
    let (code, sentence) = refusal(&file(&gated(&hole, Syntax::Explicit), Syntax::Explicit));
    assert_eq!(code, "inconsistent_frames");
    assert!(sentence.contains("time slot 2, slice 1 is there twice (frame 5 and frame 6)"), "{sentence}");

    let (code, sentence) = refusal(&file(&gated(&standard()[..7], Syntax::Explicit), Syntax::Explicit));
    assert_eq!(code, "inconsistent_frames");
    assert!(sentence.contains("time slot 2, slice 4 missing"), "{sentence}");

    let (code, sentence) = refusal(&with(vec![words((0x54, 0x71), &[8])]));
    assert_eq!(code, "inconsistent_frames");
    assert!(sentence.contains("Number of Time Slots (0054,0071) says 8, but the frames hold 2"), "{sentence}");

    let (code, sentence) = refusal(&with(vec![words((0x54, 0x80), &[1, 2, 3])]));
    assert_eq!(code, "inconsistent_frames");
    assert!(sentence.contains("Slice Vector (0054,0080) has 3 values for 8 frames"), "{sentence}");

    let short = pixels(&standard()[..7], false);
    let (code, sentence) = refusal(&with(vec![Element { tag: (0x7FE0, 0x10), vr: "OW", value: Value::Bytes(short) }]));
    assert_eq!(code, "pixel_data_length");
    assert!(sentence.contains("has 4032 bytes where 8 frames of 16 rows and 18 columns need 4608"), "{sentence}");
}

#[test]
fn numbers_that_make_no_sense_are_refused() {
    let is = |value: &str| text((0x28, 8), "IS", value);
    let cases = [
        (is("2147483647"), "outside_limits", "2147483647 frames"),
        (is("0"), "invalid_attribute", "Number of Frames (0028,0008)"),
        (is("-5"), "invalid_attribute", "Number of Frames (0028,0008)"),
        (is("abcd"), "invalid_attribute", "a text of 4 characters that is not repeated here"),
        (words((0x28, 0x101), &[0]), "invalid_attribute", "Bits Stored (0028,0101)"),
        (words((0x28, 0x101), &[99]), "invalid_attribute", "Bits Stored (0028,0101)"),
        (words((0x28, 0x102), &[7]), "invalid_attribute", "High Bit (0028,0102)"),
        (words((0x28, 0x100), &[32]), "invalid_attribute", "Bits Allocated (0028,0100)"),
        (words((0x28, 2), &[3]), "invalid_attribute", "Samples per Pixel (0028,0002)"),
        (text((0x28, 4), "CS", "RGB"), "invalid_attribute", "Photometric Interpretation (0028,0004)"),
        (words((0x28, 0x10), &[65_535]), "outside_limits", "65535 rows"),
        (words((0x28, 0x11), &[8]), "outside_limits", "8 columns"),
        (text((0x28, 0x30), "DS", "0\\3"), "invalid_attribute", "Pixel Spacing (0028,0030)"),
        (text((0x28, 0x30), "DS", "nan\\3"), "invalid_attribute", "Pixel Spacing (0028,0030)"),
        (text((0x28, 0x30), "DS", "1e300\\3"), "outside_limits", "mm between rows"),
        (text((0x28, 0x1053), "DS", "0"), "invalid_attribute", "Rescale Slope (0028,1053)"),
    ];
    for (change, code, word) in cases {
        let (found, sentence) = refusal(&with(vec![change]));
        assert_eq!(found, code, "{sentence}");
        assert!(sentence.contains(word), "{sentence}");
    }
}

#[test]
fn rescaled_signed_counts_are_clamped_and_said() {
    // As int16, counts over 32 767 are negative: those of gate 2 with slice 4 (20 000 + 12 000 + …).
    let signed = study(&with(vec![words((0x28, 0x103), &[1]), text((0x28, 0x1053), "DS", "0.5"), text((0x28, 0x1052), "DS", "-1000")]));
    let first = signed.gates[0].volume.counts[[0, 0, 0]];
    assert_eq!(first.to_bits(), 0.0_f32.to_bits());
    assert_eq!(signed.gates[1].volume.counts[[0, 0, 0]].to_bits(), (20_001.0_f32 * 0.5 - 1000.0).to_bits());
    assert_eq!(signed.gates[1].volume.counts[[3, 15, 17]].to_bits(), 0.0_f32.to_bits());
    assert_eq!(codes(&signed), ["negative_counts"]);
    let (code, _) = refusal(&with(vec![text((0x28, 0x1052), "DS", "-100000")]));
    assert_eq!(code, "no_counts");
}

#[test]
fn of_several_rr_intervals_the_one_with_most_beats_is_taken() {
    let beats = |count: &str| vec![text((0x18, 0x1063), "DS", "400"), text((0x18, 0x1083), "IS", count)];
    let mut order = standard();
    order.extend(standard());
    let rr: Vec<u16> = (0..order.len()).map(|frame| if frame < 8 { 1 } else { 2 }).collect();
    let mut elements = gated(&order, Syntax::Explicit);
    elements.retain(|element| element.tag != (0x54, 0x60) && element.tag != (0x54, 0x62));
    elements.push(words((0x54, 0x60), &rr));
    elements.push(items((0x54, 0x62), vec![vec![items((0x54, 0x63), vec![beats("30"), beats("470")])]]));
    let study = study(&file(&elements, Syntax::Explicit));
    assert_voxels(&study);
    assert_eq!(codes(&study), ["several_rr_intervals"]);
    assert!(study.warnings[0].message.contains("interval 2"), "{}", study.warnings[0].message);
}

#[test]
fn image_types_decide() {
    let kind = |value: &str| text((8, 8), "CS", format!("ORIGINAL\\PRIMARY\\{value}\\EMISSION"));
    for (value, code) in
        [("STATIC", "not_tomographic"), ("WHOLE BODY", "not_tomographic"), ("DYNAMIC", "not_tomographic"), ("GATED", "not_tomographic")]
    {
        let (found, sentence) = refusal(&with(vec![kind(value)]));
        assert_eq!(found, code);
        assert!(sentence.contains(value), "{sentence}");
    }
    let views = words((0x54, 0x90), &[1, 2, 3, 4, 5, 6, 7, 8]);
    let (code, sentence) = refusal(&with(vec![kind("GATED TOMO"), views]));
    assert_eq!(code, "projections");
    assert!(sentence.contains("8 raw projections"), "{sentence}");
    // Mislabelled, but numbered as slices.
    let mislabelled = study(&with(vec![kind("GATED TOMO")]));
    assert_voxels(&mislabelled);
    assert_eq!(codes(&mislabelled), ["image_type_disagrees"]);
}

/// A file of some frames of the study.
fn some_frames(order: &[(usize, usize)], instance: usize, extra: Vec<Element>) -> Vec<u8> {
    let mut elements = gated(order, Syntax::Explicit);
    elements
        .retain(|element| !matches!(element.tag, (8, 0x18) | (0x54, 0x71 | 0x81)) && !extra.iter().any(|change| change.tag == element.tag));
    elements.push(text((8, 0x18), "UI", format!("1.2.3.4.{instance}")));
    if !extra.iter().any(|change| change.tag == (0x20, 0x13)) {
        elements.push(text((0x20, 0x13), "IS", instance.to_string()));
    }
    elements.extend(extra);
    file(&elements, Syntax::Explicit)
}

#[test]
fn a_file_a_gate_makes_the_study() {
    let gate = |gate: usize| -> Vec<u8> {
        let order: Vec<_> = (0..SLICES).map(|slice| (gate, slice)).collect();
        some_frames(&order, gate + 1, Vec::new())
    };
    let mut study = read_all(&[gate(1), gate(0)]).unwrap().study;
    assert_voxels(&study);
    assert_eq!(study.acquisition.sop_instance_uids, ["1.2.3.4.2", "1.2.3.4.1"]);
    study.acquisition.sop_instance_uids = vec!["1.2.3.4".to_owned()];
    assert_eq!(study.acquisition.sop_class_uids, ["1.2.840.10008.5.1.4.1.1.20"; 2]);
    study.acquisition.sop_class_uids.truncate(1);
    assert!(study == self::study(&standard_file()));
}

#[test]
fn a_file_a_slice_makes_the_study() {
    let slice = |gate: usize, slice: usize| -> Vec<u8> {
        let position = format!("10\\{}\\30", 20.0 + 6.5 * slice as f64);
        let detector = vec![text((0x20, 0x32), "DS", position), text((0x20, 0x37), "DS", "1\\0\\0\\0\\0\\-1")];
        some_frames(&[(gate, slice)], gate * SLICES + slice + 1, vec![items((0x54, 0x22), vec![detector])])
    };
    let files: Vec<Vec<u8>> = standard().into_iter().rev().map(|(g, s)| slice(g, s)).collect();
    let mut study = read_all(&files).unwrap().study;
    assert_voxels(&study);
    study.acquisition.sop_instance_uids = vec!["1.2.3.4".to_owned()];
    study.acquisition.sop_class_uids.truncate(1);
    assert!(study == self::study(&standard_file()), "{study:?}");

    let missing = read_all(&files[1..]).unwrap_err();
    assert_eq!(missing.code(), "inconsistent_frames");
    assert!(missing.to_string().contains("missing"), "{missing}");
}

#[test]
fn files_that_nothing_tells_apart_are_refused() {
    let order: Vec<_> = (0..SLICES).map(|slice| (0, slice)).collect();
    let anonymous = |instance: usize| some_frames(&order, instance, vec![text((0x20, 0x13), "IS", "1")]);
    let error = read_all(&[anonymous(1), anonymous(2)]).unwrap_err();
    assert_eq!(error.code(), "mixed_parts");
    assert!(error.to_string().contains("nothing tells the gates"), "{error}");
    let other = read_all(&[anonymous(1), some_frames(&order, 2, vec![text((0x28, 0x30), "DS", "4\\4")])]).unwrap_err();
    assert!(other.to_string().contains("file 2 has another Pixel Spacing (0028,0030)"), "{other}");
}

/// Reads files of one request, keeping whom they are of.
fn read_with_subject(files: &[Vec<u8>]) -> Result<Received, IntakeError> {
    let parts: Vec<Part<'_>> = files.iter().map(|bytes| Part { media_type: None, filename: None, bytes }).collect();
    read(&parts, &Options { keep_subject: true, ..Options::default() }, &Limits::default())
}

fn bytes(attribute: Attribute, vr: &'static str, value: &[u8]) -> Element {
    Element { tag: attribute.tag(), vr, value: Value::Bytes(value.to_vec()) }
}

#[test]
fn whom_it_is_of_is_read_byte_for_byte_where_that_is_kept() {
    // Latin-1, which is no UTF-8.
    let (name, id) = (b"M\xfcller^J\xf6rg ".as_slice(), b"0815");
    for syntax in [Syntax::Implicit, Syntax::Explicit, Syntax::Big, Syntax::Deflated] {
        let mut elements = gated(&standard(), syntax);
        elements.retain(|element| Attribute::ALL.iter().all(|attribute| attribute.tag() != element.tag));
        elements.extend([
            bytes(Attribute::SpecificCharacterSet, "CS", b"ISO_IR 100"),
            bytes(Attribute::PatientName, "PN", name),
            bytes(Attribute::PatientId, "LO", id),
            bytes(Attribute::PatientBirthDate, "DA", b"tomorrow"),
            // In a sequence: of somebody else.
            items((0x10, 0x1002), vec![vec![bytes(Attribute::StudyId, "SH", b"other")]]),
        ]);
        let file = file(&elements, syntax);
        assert_eq!(read_one(&file).unwrap().subject, None, "nothing is kept unless it is asked for");
        let received = read_with_subject(&[file]).unwrap();
        let subject = received.subject.unwrap();
        assert_eq!(subject.get(Attribute::PatientName), Some(b"M\xfcller^J\xf6rg".as_slice()), "{syntax:?}");
        assert_eq!(subject.get(Attribute::PatientId), Some(id.as_slice()));
        assert_eq!((subject.get(Attribute::PatientBirthDate), subject.get(Attribute::StudyId)), (None, None));
        assert_eq!(codes(&received.study), ["subject_attribute_left_out"]);
        let message = &received.study.warnings[0].message;
        assert!(message.contains("(0010,0030)") && !message.contains("tomorrow"), "{message}");
    }
}

#[test]
fn files_of_two_patients_make_no_study_that_could_be_filed() {
    let gate = |gate: usize, id: &[u8]| -> Vec<u8> {
        let order: Vec<_> = (0..SLICES).map(|slice| (gate, slice)).collect();
        some_frames(&order, gate + 1, vec![bytes(Attribute::PatientId, "LO", id)])
    };
    let (same, other) = ([gate(0, b"A1"), gate(1, b"A1 ")], [gate(0, b"A1"), gate(1, b"B2")]);
    assert!(read_with_subject(&same).is_ok());
    let error = read_with_subject(&other).unwrap_err();
    assert_eq!(error.code(), "mixed_parts");
    assert!(error.to_string().contains("file 2 names another patient (Patient ID (0010,0020)"), "{error}");
    assert!(!error.to_string().contains("B2"), "{error}");
    // Where nobody is kept nobody is looked at.
    assert!(read_all(&other).is_ok());
}
