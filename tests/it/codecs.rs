//! Transfer syntaxes: the same volume, written by the programs of others, gives the same counts; broken ones are refused and nothing else
//! happens.

use crate::{
    encapsulated::{converted, fragments, limits, native_samples, phantom_file, read, with_fragments, with_samples},
    parted,
    served::{Directory, Served},
};
use dicom_core::VR;
use dicom_dictionary_std::tags;
use std::time::{Duration, Instant};
use ventricle::{
    analysis::analyse,
    intake::{self, IntakeError, Limits, Nature, Options, Part},
    pipeline::{self, monitor::Silent, parameters::Parameters},
    report::{self, Timing},
    study::Study,
};

const DCMTK: &str = "dcmtk";
const GDCM: &str = "libgdcm-tools";

/// What writes each lossless encoding: its UID, package and command.
const LOSSLESS: [(&str, &str, &[&str]); 13] = [
    ("1.2.840.10008.1.2", DCMTK, &["dcmconv", "+ti"]),
    ("1.2.840.10008.1.2.2", DCMTK, &["dcmconv", "+tb"]),
    ("1.2.840.10008.1.2.1.99", DCMTK, &["dcmconv", "+td"]),
    ("1.2.840.10008.1.2.5", DCMTK, &["dcmcrle"]),
    ("1.2.840.10008.1.2.5", GDCM, &["gdcmconv", "--rle"]),
    ("1.2.840.10008.1.2.4.57", DCMTK, &["dcmcjpeg", "+el", "+sv", "6"]),
    ("1.2.840.10008.1.2.4.57", DCMTK, &["dcmcjpeg", "+el", "+sv", "4"]),
    ("1.2.840.10008.1.2.4.70", DCMTK, &["dcmcjpeg", "+e1"]),
    ("1.2.840.10008.1.2.4.70", GDCM, &["gdcmconv", "--jpeg"]),
    ("1.2.840.10008.1.2.4.80", DCMTK, &["dcmcjpls", "+el"]),
    ("1.2.840.10008.1.2.4.80", GDCM, &["gdcmconv", "--jpegls"]),
    ("1.2.840.10008.1.2.4.90", GDCM, &["gdcmconv", "--j2k"]),
    ("1.2.840.10008.1.2.4.90", GDCM, &["gdcmconv", "--j2k", "-t", "32,32"]),
];

fn has_syntax(file: &[u8], uid: &str) -> bool {
    let end = file.len().min(600);
    file[..end]
        .windows(uid.len() + 1)
        .any(|bytes| bytes.starts_with(uid.as_bytes()) && !bytes[uid.len()].is_ascii_digit() && bytes[uid.len()] != b'.')
}

fn counts(study: &Study) -> Vec<f32> {
    study.gates.iter().flat_map(|gate| gate.volume.counts.iter().copied()).collect()
}

fn sum(study: &Study) -> f64 {
    counts(study).into_iter().map(f64::from).sum()
}

/// The report without what names the file: its UIDs.
fn report(study: &Study) -> serde_json::Value {
    let reconstruction = pipeline::reconstruct(study, &Parameters::clinical(), &Silent).unwrap();

    let mut report =
        serde_json::to_value(report::build("same", study, &reconstruction, &analyse(study, &reconstruction), &Timing::default())).unwrap();
    report["study"] = serde_json::Value::Null;
    report
}

#[test]
fn every_lossless_syntax_gives_the_same_counts_and_the_same_report() {
    let directory = Directory::new("syntaxes");
    let native = phantom_file(2);
    let expected = read(&native).unwrap();
    let expected_report = report(&expected);
    assert!(sum(&expected) > 1e6);
    for (uid, package, command) in LOSSLESS {
        let Some(file) = converted(&directory.0, package, command, &native) else { return };
        assert!(has_syntax(&file, uid), "{command:?} wrote another transfer syntax than {uid}");
        let study = read(&file).unwrap_or_else(|error| panic!("{command:?}: {error}"));
        assert_eq!(sum(&study).to_bits(), sum(&expected).to_bits(), "{command:?}");
        assert_eq!(study.gates, expected.gates, "{command:?}");
        assert_eq!((study.grid, study.orientation, study.warnings.len()), (expected.grid, expected.orientation, expected.warnings.len()));
        assert_eq!(report(&study), expected_report, "{command:?}");
    }
}

#[test]
fn eight_twelve_and_signed_bits_come_through_every_codec() {
    let directory = Directory::new("bits");
    let native = phantom_file(1);
    for (what, bits, signed) in [("8 bits", 8, false), ("12 bits", 12, false), ("16 bits signed", 16, true)] {
        let changed = |sample: u16| if signed { sample.wrapping_mul(150).wrapping_sub(9000) } else { sample.min(255) };
        let file = with_samples(&native, bits, signed, changed);
        let expected = counts(&read(&file).unwrap());
        // Below 9000, the Rescale Intercept, samples are negative.
        assert!(!signed || (expected.iter().any(|count| *count < 9000.0) && expected.iter().any(|count| *count > 9000.0)));
        for (uid, package, command) in LOSSLESS {
            let Some(file) = converted(&directory.0, package, command, &file) else { return };
            assert!(has_syntax(&file, uid), "{what}: {command:?}");
            let study = read(&file).unwrap_or_else(|error| panic!("{what}: {command:?}: {error}"));
            assert!(counts(&study) == expected, "{what}: {command:?}");
        }
    }
}

/// Lossy encodings: bits, UID, package, command that writes, package and command that decodes for comparison, how far counts may be from
/// those of the other decoder, and from those that were compressed.
type Lossy = (u16, &'static str, (&'static str, &'static [&'static str]), (&'static str, &'static [&'static str]), f32, f32);

const LOSSY: [Lossy; 7] = [
    (16, "1.2.840.10008.1.2.4.81", (DCMTK, &["dcmcjpls", "+en", "+md", "3"]), (DCMTK, &["dcmdjpls"]), 0.0, 3.0),
    (16, "1.2.840.10008.1.2.4.81", (GDCM, &["gdcmconv", "--jpegls", "--lossy", "-e", "2"]), (GDCM, &["gdcmconv", "--raw"]), 0.0, 2.0),
    (8, "1.2.840.10008.1.2.4.81", (DCMTK, &["dcmcjpls", "+en", "+md", "3"]), (DCMTK, &["dcmdjpls"]), 0.0, 3.0),
    (16, "1.2.840.10008.1.2.4.91", (GDCM, &["gdcmconv", "--j2k", "--lossy", "-r", "6"]), (GDCM, &["gdcmconv", "--raw"]), 1.0, 20.0),
    (16, "1.2.840.10008.1.2.4.91", (GDCM, &["gdcmconv", "--j2k", "--lossy", "--irreversible"]), (GDCM, &["gdcmconv", "--raw"]), 1.0, 3.0),
    (8, "1.2.840.10008.1.2.4.50", (DCMTK, &["dcmcjpeg", "+eb", "+q", "95"]), (DCMTK, &["dcmdjpeg"]), 1.0, 20.0),
    (8, "1.2.840.10008.1.2.4.51", (DCMTK, &["dcmcjpeg", "+ee", "+be", "+q", "95"]), (DCMTK, &["dcmdjpeg"]), 1.0, 20.0),
];

#[test]
fn lossy_syntaxes_come_as_close_as_other_decoders_and_warn() {
    let directory = Directory::new("lossy");
    let sixteen = phantom_file(1);
    let largest = native_samples(&sixteen).chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).max().unwrap();
    // The writer stretches values to the range of 8 bits, so they fill it beforehand.
    let eight = with_samples(&sixteen, 8, false, |sample| (f64::from(sample) * 255.0 / f64::from(largest)).round() as u16);
    let furthest = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    for (bits, uid, (writer, write), (reader, decode), of_decoder, of_original) in LOSSY {
        let native = if bits == 8 { &eight } else { &sixteen };
        let Some(file) = converted(&directory.0, writer, write, native) else { return };
        assert!(has_syntax(&file, uid), "{write:?}");
        let Some(decoded) = converted(&directory.0, reader, decode, &file) else { return };
        let study = read(&file).unwrap_or_else(|error| panic!("{write:?}: {error}"));
        let (ours, theirs, original) = (counts(&study), counts(&read(&decoded).unwrap()), counts(&read(native).unwrap()));
        assert!(furthest(&ours, &theirs) <= of_decoder, "{write:?}: {} from {decode:?}", furthest(&ours, &theirs));
        assert!(furthest(&ours, &original) <= of_original, "{write:?}: {} from the original", furthest(&ours, &original));
        assert!(study.warnings.iter().any(|warning| warning.code == "lossy_compression"), "{write:?}");
    }
}

#[test]
fn frames_of_several_fragments_are_joined() {
    let directory = Directory::new("fragments");
    let native = phantom_file(1);
    let expected = counts(&read(&native).unwrap());
    for table in ["+ot", "-ot"] {
        let command = ["dcmcjpls", "+el", "+fs", "1", table];
        let Some(file) = converted(&directory.0, DCMTK, &command, &native) else { return };
        let found = fragments(&file);
        assert!(found.len() > 25 && found[0].is_empty() == (table == "-ot"), "{} fragments, {table}", found.len());
        assert!(counts(&read(&file).unwrap()) == expected, "{table}");
    }
}

#[test]
fn encapsulated_uncompressed_is_read_here() {
    let native = phantom_file(1);
    let frames: Vec<Vec<u8>> = native_samples(&native).chunks_exact(64 * 64 * 2).map(<[u8]>::to_vec).collect();
    let pieces = [vec![Vec::new()], frames].concat();
    let uid = Some("1.2.840.10008.1.2.1.98");
    // It needs no decoder.
    let part = |bytes| [Part { media_type: None, filename: None, bytes }];
    let file = with_fragments(&native, uid, &pieces);
    let study = intake::read(&part(&file), &Options::default(), &Limits::default()).unwrap().study;
    assert!(counts(&study) == counts(&read(&native).unwrap()));
    let short = with_fragments(&native, uid, &pieces[..24]);
    assert!(matches!(read(&short), Err(IntakeError::InconsistentFrames { .. })));
    let mut cut = pieces;
    cut[3].truncate(100);
    assert!(matches!(read(&with_fragments(&native, uid, &cut)), Err(IntakeError::PixelDataLength { .. })));
}

#[test]
fn what_is_not_decoded_is_refused_by_name() {
    let directory = Directory::new("refused");
    let native = phantom_file(1);
    let Some(twelve) = converted(&directory.0, DCMTK, &["dcmcjpeg", "+ee"], &native) else { return };
    let error = read(&twelve).unwrap_err();
    assert_eq!((error.code(), error.nature()), ("unsupported_transfer_syntax", Nature::Unsupported));
    assert!(error.to_string().contains("JPEG Extended with 12 bits (1.2.840.10008.1.2.4.51)"), "{error}");

    let Some(file) = converted(&directory.0, GDCM, &["gdcmconv", "--j2k"], &native) else { return };
    let part = Part { media_type: None, filename: None, bytes: &file };
    let error = intake::read(&[part], &Options::default(), &Limits::default()).unwrap_err();
    assert!(error.to_string().contains("JPEG 2000 Lossless (1.2.840.10008.1.2.4.90); send it uncompressed"), "{error}");

    let missing = Limits { decoder: Some(ventricle::codecs::Decoder { program: "/nowhere/ventricle".into() }), ..limits() };
    let error = intake::read(&[part], &Options::default(), &missing).unwrap_err();
    assert_eq!((error.code(), error.nature()), ("decoder_unavailable", Nature::Unavailable));

    for uid in ["1.2.840.10008.1.2.4.201", "1.2.840.10008.1.2.4.110", "1.2.840.10008.1.2.4.100", "1.2.3.4"] {
        let error = read(&with_fragments(&native, Some(uid), &fragments(&file))).unwrap_err();
        assert_eq!(error.code(), "unsupported_transfer_syntax", "{error}");
        assert!(error.to_string().contains(uid), "{error}");
    }
}

#[test]
fn an_instance_is_the_same_in_every_lossless_syntax() {
    let directory = Directory::new("same-instance");
    let service = Served::start(&directory.0.join("data"), &["--quiet-seconds", "3600"]);
    let whole = parted::whole(60);
    let study = parted::text_of(&whole, tags::STUDY_INSTANCE_UID);
    let gate = parted::with(&parted::gates(&whole)[2], &[(tags::STUDY_INSTANCE_UID, VR::UI, "1.2.3")]);
    for native in [&whole, &gate] {
        assert_eq!(service.post_to("/dicom-web/studies", "application/dicom", native).status, 200);
        for (uid, package, command) in LOSSLESS {
            let Some(file) = converted(&directory.0, package, command, native) else { return };
            let answer = service.post_to("/dicom-web/studies", "application/dicom", &file);
            assert_eq!(answer.status, 200, "{uid}: {}", answer.json());
        }
        // One count changed is another image.
        let mut other = native.clone();
        let last = other.len() - 2;
        other[last] ^= 1;
        assert_eq!(service.post_to("/dicom-web/studies", "application/dicom", &other).status, 409);
    }
    let jobs = service.get("/v1/reconstructions").json()["reconstructions"].as_array().unwrap().clone();
    assert_eq!(jobs.len(), 1, "the gate waits for the others: {jobs:?}");
    assert_eq!(jobs[0]["study_instance_uid"], study);
}

#[test]
fn the_service_decodes_what_is_posted_to_it() {
    let directory = Directory::new("posted");
    let native = phantom_file(1);
    let Some(file) = converted(&directory.0, DCMTK, &["dcmcjpls", "+el"], &native) else { return };
    let service = Served::start(&directory.0.join("data"), &[]);
    let accepted = service.post("application/dicom", &file);
    assert_eq!(accepted.status, 202, "{}", String::from_utf8_lossy(&accepted.body));
    let job = service.finished(accepted.json()["id"].as_str().unwrap(), Duration::from_mins(2));
    assert_eq!(job["state"], "succeeded", "{job}");
    let mut broken = fragments(&file);
    broken[7].truncate(400);
    broken[7].extend([0xFF, 0xD9]);
    let refused = service.post("application/dicom", &with_fragments(&file, None, &broken));
    assert_eq!((refused.status, refused.json()["code"].as_str()), (400, Some("damaged_pixel_data")));
    assert!(refused.json()["detail"].as_str().unwrap().contains("Frame 7 of the compressed pixel data"), "{}", refused.json());
}

/// Places a broken file is broken at, spread over all bytes from the compressed data's beginning, the same in every run.
fn places(from: usize, to: usize, number: usize) -> impl Iterator<Item = usize> {
    (0..number).map(move |index| from + (to - from) * index / number + index % 7)
}

#[test]
fn compressed_files_broken_anywhere_are_refused_or_read_as_a_study_of_the_same_shape() {
    let directory = Directory::new("corruptions");
    let native = phantom_file(1);
    let eight = with_samples(&native, 8, false, |sample| sample.min(255));
    let expected = read(&native).unwrap();
    let commands = LOSSLESS[3..].iter().map(|(_, package, command)| (&native, *package, *command));
    let commands = commands.chain(LOSSY.iter().map(|lossy| (if lossy.0 == 8 { &eight } else { &native }, lossy.2.0, lossy.2.1)));
    for (native, package, command) in commands {
        let Some(file) = converted(&directory.0, package, command, native) else { return };
        let whole = fragments(&file);
        let pixels: usize = file.len() - whole.iter().map(|fragment| fragment.len() + 8).sum::<usize>() - 8;
        let flipped = places(pixels, file.len(), 60).filter(|place| *place < file.len()).enumerate().map(|(index, place)| {
            let mut broken = file.clone();
            broken[place] ^= [0x01, 0x80, 0xFF, 0x10][index % 4];
            (format!("byte {place} changed"), broken)
        });
        let cut = places(0, whole[5].len(), 40).map(|length| {
            let mut pieces = whole.clone();
            pieces[5].truncate(length);
            (format!("frame 5 cut to {length} bytes"), with_fragments(&file, None, &pieces))
        });
        let (mut refused, mut read_all_the_same) = (0, 0);
        for (what, broken) in flipped.chain(cut) {
            let start = Instant::now();
            match read(&broken) {
                Ok(study) => {
                    assert_eq!((study.grid, study.gates.len()), (expected.grid, 1), "{command:?}: {what}");
                    read_all_the_same += 1;
                }
                Err(error) => {
                    assert!(error.nature() != Nature::Unavailable, "{command:?}: {what}: {error}");
                    refused += 1;
                }
            }
            assert!(start.elapsed() < Duration::from_secs(5), "{command:?}: {what}: {:?}", start.elapsed());
        }
        assert!(refused >= 35, "{command:?}: {refused} refused, {read_all_the_same} read");
        println!("{command:?}: {refused} refused, {read_all_the_same} read");
    }
}
