//! Real studies from `../shared/data`, which are not part of the project.

use std::path::PathBuf;
use ventricle::{intake, study::Study};

/// A folder of the shared data. Absent: `None` with a word on standard error, a failure where `CI` is set.
#[allow(clippy::disallowed_methods)] // tests decide by the environment whether a skip is a failure
pub(crate) fn folder(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(name);
    if path.is_dir() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is absent", path.display());
    eprintln!("skipped: ../shared/data/{name} is absent");
    None
}

/// Says that a test skips itself because a program of this Debian package is absent; a failure where `CI` is set.
#[allow(clippy::disallowed_methods)] // as above
pub(crate) fn absent(package: &str) {
    assert!(std::env::var_os("CI").is_none(), "{package} must be installed in CI");
    println!("skipped: {package} is absent (Debian package {package})");
}

/// A real gated study and what its labels say.
pub(crate) struct Labelled {
    pub(crate) name: String,
    pub(crate) study: Study,
    pub(crate) end_diastolic_gate: usize,
    pub(crate) end_systolic_gate: usize,
}

/// Reads a file as the service would.
pub(crate) fn read(path: &std::path::Path) -> Study {
    let bytes = std::fs::read(path).unwrap();
    let part = intake::Part { media_type: None, filename: None, bytes: &bytes };
    intake::read(&[part], &intake::Options::default(), &intake::Limits::default()).unwrap().study
}

/// The fourteen gated short-axis studies, by name.
pub(crate) fn gated_short_axis() -> Option<Vec<Labelled>> {
    let folder = folder("gated-short-axis")?;
    let labels: serde_json::Value = serde_json::from_slice(&std::fs::read(folder.join("labels.json")).unwrap()).unwrap();
    let studies: Vec<Labelled> = labels
        .as_object()
        .unwrap()
        .iter()
        .map(|(name, label)| Labelled {
            name: name.clone(),
            study: read(&folder.join(format!("{name}.nii.gz"))),
            end_diastolic_gate: usize::try_from(label["end_diastolic_gate"].as_u64().unwrap()).unwrap(),
            end_systolic_gate: usize::try_from(label["end_systolic_gate"].as_u64().unwrap()).unwrap(),
        })
        .collect();
    assert_eq!(studies.len(), 14);
    Some(studies)
}
