//! The two commands a newcomer tries, as a newcomer runs them: `ventricle demo` and `ventricle reconstruct`.

use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use ventricle::phantom::{self, Phantom};

/// A folder of this test alone.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn ventricle(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ventricle")).args(arguments).output().unwrap()
}

/// Standard output of a command that must have succeeded.
fn said(output: &Output) -> String {
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{}\n{out}\n{err}", output.status);
    out.into_owned()
}

/// A report without what may differ between two runs of the same study.
fn comparable(path: &Path) -> Value {
    let mut report: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    report["id"].take();
    report["timing_ms"].take();
    report
}

#[test]
fn the_demo_shows_what_reconstruct_computes_without_a_service() {
    let folder = folder("demo");
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let shown = said(&ventricle(&["demo", "--once", "--listen", "127.0.0.1:0", "--data-dir", &at("data"), "--output", &at("out")]));
    for expected in ["EDV", "ESV", "EF", "mass", "±", "PSF", "endocardial", "exact values", "surfaces.glb"] {
        assert!(shown.contains(expected), "{expected} is missing in:\n{shown}");
    }
    let by_service = comparable(&folder.join("out/report.json"));
    assert_eq!(by_service["gates"].as_array().unwrap().len(), 8);

    let simulation = phantom::simulate(&Phantom::demo()).unwrap();
    fs::write(at("study.dcm"), phantom::dicom::write(&simulation.study).unwrap()).unwrap();
    let (study, report, glb) = (at("study.dcm"), at("report.json"), at("surfaces.glb"));
    let printed = said(&ventricle(&["reconstruct", &study, "-o", &report, "--glb", &glb, "--threads", "1", "--json"]));
    assert_eq!(comparable(&folder.join("report.json")), by_service);
    assert_eq!(printed, fs::read_to_string(&report).unwrap());
    assert!(fs::read(&glb).unwrap() == fs::read(folder.join("out/surfaces.glb")).unwrap(), "the surfaces differ");
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_cannot_be_read_is_told_in_one_sentence_by_both() {
    let folder = folder("unreadable");
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    fs::write(at("notes.txt"), "no study at all").unwrap();
    let (file, data, out) = (at("notes.txt"), at("data"), at("out"));
    for arguments in [
        vec!["demo", "--once", "--listen", "127.0.0.1:0", "--data-dir", &data, "--output", &out, "--file", &file],
        vec!["reconstruct", &file],
    ] {
        let output = ventricle(&arguments);
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert!(told.contains("DICOM") && told.contains("NIfTI"), "{told}");
    }
    assert!(!folder.join("out").exists());
    fs::remove_dir_all(folder).unwrap();
}
