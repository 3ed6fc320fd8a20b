//! Real files: each is accepted with what it holds, or refused for what it is.

use super::{read_all, read_one, shared_data};
use std::path::Path;
use std::time::Instant;
use ventricle::study::{Format, Study};

/// Each refused file, the code of the refusal and a word of its sentence.
const REFUSED: [(&str, &str, &str); 50] = [
    ("corrupt/20-wrong-transfer-syntax.dcm", "not_nuclear_medicine", "CT Image Storage"),
    ("corrupt/3gb-bulk-data-truncated.dcm", "truncated_dicom", "(7FE0,0010) at byte 1908 declares 3221225472 bytes where 98080 remain"),
    ("corrupt/54-implicit-file-meta-info.dcm", "not_nuclear_medicine", "CT Image Storage"),
    ("corrupt/DICOMDIR", "not_nuclear_medicine", "DICOMDIR"),
    ("corrupt/ExplVR_BigEnd.dcm", "not_nuclear_medicine", "Ultrasound"),
    ("corrupt/ExplVR_BigEndNoMeta.dcm", "not_nuclear_medicine", "RT Ion Plan"),
    ("corrupt/ExplVR_LitEndNoMeta.dcm", "not_nuclear_medicine", "RT Ion Plan"),
    ("corrupt/Issue1097_FailToOpenDeflatedFileWithSQ.dcm", "not_nuclear_medicine", "2.25.152752519834663263826301420581341174218"),
    ("corrupt/MR_truncated.dcm", "truncated_dicom", "(7FE0,0010)"),
    ("corrupt/badVR.dcm", "not_nuclear_medicine", "RT Dose"),
    ("corrupt/bad_sequence.dcm", "not_nuclear_medicine", "CT Image Storage"),
    ("corrupt/empty_charset_LEI.dcm", "missing_attribute", "Modality (0008,0060)"),
    ("corrupt/emri_small_jpeg_2k_lossless_too_short.dcm", "truncated_dicom", "encapsulated Pixel Data"),
    ("corrupt/explicit_VR-UN.dcm", "not_nuclear_medicine", "CT Image Storage"),
    ("corrupt/image_dfl.dcm", "not_nuclear_medicine", "Secondary Capture"),
    ("corrupt/liver_deflate.dcm", "not_nuclear_medicine", "Segmentation"),
    ("corrupt/meta_missing_tsyntax.dcm", "no_transfer_syntax", "(0002,0010)"),
    ("corrupt/nested_priv_SQ.dcm", "missing_attribute", "Modality (0008,0060)"),
    ("corrupt/no_meta.dcm", "unknown_format", "the bytes 20 08 00 05"),
    ("corrupt/no_meta_group_length.dcm", "not_nuclear_medicine", "RT Image"),
    ("corrupt/no_preamble_dicm_in_data.dcm", "not_nuclear_medicine", "modality MG"),
    ("corrupt/rtplan_truncated.dcm", "truncated_dicom", "(300A,00B0)"),
    ("negatives/CT_small.dcm", "not_nuclear_medicine", "CT Image Storage (modality CT)"),
    ("negatives/MR_small.dcm", "not_nuclear_medicine", "MR Image Storage (modality MR)"),
    ("negatives/MR_small_RLE.dcm", "not_nuclear_medicine", "MR Image Storage"),
    ("negatives/OBXXXX1A_rle_2frame.dcm", "not_nuclear_medicine", "Ultrasound Multi-frame"),
    ("negatives/OT-PAL-8-face.dcm", "not_nuclear_medicine", "Secondary Capture"),
    ("negatives/PT_fo-dicom_GH610.dcm", "not_nuclear_medicine", "Positron Emission Tomography"),
    ("negatives/SC_rgb.dcm", "not_nuclear_medicine", "Secondary Capture"),
    ("negatives/US1_J2KR.dcm", "not_nuclear_medicine", "Ultrasound"),
    ("negatives/XA1_JPLL.dcm", "not_nuclear_medicine", "modality XA"),
    ("negatives/eCT_Supplemental.dcm", "not_nuclear_medicine", "Enhanced CT"),
    ("negatives/emri_small.dcm", "not_nuclear_medicine", "Enhanced MR"),
    ("negatives/liver.dcm", "not_nuclear_medicine", "Segmentation"),
    ("negatives/rtdose.dcm", "not_nuclear_medicine", "RT Dose"),
    ("negatives/rtplan.dcm", "not_nuclear_medicine", "RT Plan"),
    ("negatives/rtstruct.dcm", "not_nuclear_medicine", "RT Structure Set"),
    ("negatives/test-SR.dcm", "not_nuclear_medicine", "Comprehensive SR"),
    ("other-nm/NM1_J2KI.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/NM1_J2KR.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/NM1_JLSL.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/NM1_JLSN.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/NM1_JPLL.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/NM1_JPLY.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/NM1_RLE.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/NM1_UNC.dcm", "not_tomographic", "WHOLE BODY"),
    ("other-nm/poumonsReins_scrubbed.dcm", "not_tomographic", "STATIC"),
    ("projections/tomo-stress.dcm", "projections", "30 raw projections (image type ORIGINAL\\PRIMARY\\TOMO\\EMISSION)"),
    ("gated-short-axis/labels.json", "malformed_json", "unknown field `dev-01a`"),
    ("README.md", "unknown_format", "the bytes 23 20 54 65"),
];

fn study(folder: &Path, name: &str) -> Study {
    read_one(&std::fs::read(folder.join(name)).unwrap()).unwrap_or_else(|error| panic!("{name}: {error}")).study
}

fn codes(study: &Study) -> Vec<&str> {
    study.warnings.iter().map(|warning| warning.code.as_str()).collect()
}

#[test]
fn every_file_that_is_no_study_is_refused_for_what_it_is() {
    let Some(data) = shared_data() else { return };
    for (name, code, word) in REFUSED {
        let bytes = std::fs::read(data.join(name)).unwrap();
        let begun = Instant::now();
        let error = read_one(&bytes).expect_err(name);
        assert_eq!(error.code(), code, "{name}: {error}");
        assert!(error.to_string().contains(word), "{name}: {error}");
        assert!(begun.elapsed().as_secs_f64() < 2.0, "{name} took {:?}", begun.elapsed());
    }
    for folder in ["corrupt", "negatives", "other-nm", "projections"] {
        for entry in std::fs::read_dir(data.join(folder)).unwrap() {
            let name = format!("{folder}/{}", entry.unwrap().file_name().display());
            assert!(REFUSED.iter().any(|(known, ..)| *known == name), "{name} has no line in the table");
        }
    }
}

#[test]
fn every_gated_study_is_accepted() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("gated-short-axis");
    for patient in 1..=7 {
        for visit in ["a", "b"] {
            let study = study(&folder, &format!("dev-0{patient}{visit}.nii.gz"));
            assert_eq!((study.gates.len(), study.grid.shape, study.grid.spacing_mm), (8, [32, 64, 64], [3.2; 3]));
            assert_eq!(study.acquisition.format, Format::Nifti);
            assert!(study.gates.iter().all(|gate| gate.volume.total() > 0.0 && gate.duration_ms == Some(100.0)));
            assert!(study.orientation.is_some() && study.warnings.is_empty(), "{:?}", study.warnings);
        }
    }
    let study = study(&folder, "dev-01a.dcm");
    assert_eq!((study.gates.len(), study.grid.shape, study.grid.spacing_mm), (8, [32, 64, 64], [3.2; 3]));
    let acquisition = &study.acquisition;
    assert_eq!((acquisition.format, acquisition.rr_interval_ms, acquisition.heart_rate_bpm), (Format::Dicom, Some(900.0), Some(66.0)));
    assert_eq!(acquisition.study_instance_uid.as_deref(), Some("1.2.826.0.1.3680043.8.498.25718497321564519257217873532072178635"));
    assert_eq!(study.gates[7].duration_ms, Some(112.5));
    let orientation = study.orientation.unwrap();
    assert!(!orientation.mirrors(), "positive Spacing Between Slices stacks along the normal");
    assert_eq!(codes(&study), [""; 0]);
}

/// Both formats were written from one array without a flip, so they must come back as one.
#[test]
fn dicom_and_nifti_of_one_study_have_the_same_voxels() {
    let Some(data) = shared_data() else { return };
    let folder = data.join("gated-short-axis");
    for name in ["dev-01a", "dev-01b"] {
        let (dicom, nifti) = (study(&folder, &format!("{name}.dcm")), study(&folder, &format!("{name}.nii.gz")));
        for (gate, (a, b)) in dicom.gates.iter().zip(&nifti.gates).enumerate() {
            assert!(a.volume.counts == b.volume.counts, "{name}, gate {}", gate + 1);
        }
    }
}

#[test]
fn the_long_axis_study_is_one_gate_with_a_warning() {
    let Some(data) = shared_data() else { return };
    let study = study(&data, "long-axis/NM-MONO2-16-13x-heart.dcm");
    assert_eq!((study.gates.len(), study.grid.shape), (1, [13, 64, 64]));
    assert_eq!(study.grid.spacing_mm, [6.231_669, 3.115_83, 3.115_83]);
    assert_eq!(study.orientation, None);
    assert_eq!(codes(&study), ["long_axis_slices"]);
    assert!(study.warnings[0].message.contains("horizontal long-axis"));
    // Largest Image Pixel Value (0028,0107) of the file.
    assert_eq!(study.gates[0].volume.maximum().to_bits(), 141.0_f32.to_bits());
}

#[test]
fn files_of_two_studies_are_not_one() {
    let Some(data) = shared_data() else { return };
    let file = |name: &str| std::fs::read(data.join("gated-short-axis").join(name)).unwrap();
    let two = read_all(&[file("dev-01a.dcm"), file("dev-01b.dcm")]).unwrap_err();
    assert_eq!(two.code(), "mixed_parts");
    assert!(two.to_string().contains("another study"), "{two}");
    let mixed = read_all(&[file("dev-01a.dcm"), file("dev-01a.nii.gz")]).unwrap_err();
    assert!(mixed.to_string().contains("2 files: DICOM, gzip"), "{mixed}");
    let twice = read_all(&[file("dev-01a.dcm"), file("dev-01a.dcm")]).unwrap_err();
    assert!(twice.to_string().contains("files 1 and 2 are the same object"), "{twice}");
}
