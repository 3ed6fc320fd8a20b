//! Bytes → study: real files, files written here, and hostile ones.

#![expect(clippy::float_cmp, reason = "spacings and counts must come through exactly")]

mod formats;
mod header;
mod hostile;
mod nuclear;
mod real;
mod writer;

use std::path::PathBuf;
use ventricle::intake::{IntakeError, Limits, Options, Part, Received, read};

/// Reads one body without a declared type.
fn read_one(bytes: &[u8]) -> Result<Received, IntakeError> {
    // Only NPY looks at the spacing.
    let options = Options { spacing_mm: Some([6.5, 3.0, 2.5]), ..Options::default() };
    read(&[Part { media_type: None, filename: None, bytes }], &options, &Limits::default())
}

/// Reads several files of one request.
fn read_all(files: &[Vec<u8>]) -> Result<Received, IntakeError> {
    let parts: Vec<Part<'_>> = files.iter().map(|bytes| Part { media_type: Some("application/dicom"), filename: None, bytes }).collect();
    read(&parts, &Options::default(), &Limits::default())
}

/// The folder of real files, if it is there; CI must have it.
fn shared_data() -> Option<PathBuf> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    if folder.is_dir() {
        return Some(folder);
    }
    // The only environment variable tests look at; the service reads none outside its configuration.
    #[expect(clippy::disallowed_methods, reason = "a test, not the service")]
    let in_ci = std::env::var_os("CI").is_some();
    assert!(!in_ci, "{} is absent", folder.display());
    eprintln!("skipped: {} is absent", folder.display());
    None
}
