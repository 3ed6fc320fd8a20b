//! Bytes → [`Study`]: what a client sent is recognised, checked and read, or refused with a sentence that says what it is and what to send.
//!
//! Every byte here is hostile until shown otherwise. Three rules keep time and memory bounded whatever a file declares:
//! lengths are compared with what is there before anything is allocated (`prescan.rs` for DICOM, the header first for the others),
//! compressed input is inflated against a cap, and every count of rows, columns, slices, gates and voxels has a limit ([`Limits`]).

mod counts;
mod dicom;
mod error;
mod inflate;
mod json;
mod nifti;
mod npy;
mod prescan;
mod sniff;

pub use dicom::{ALLOWED, Allowed, Holds, Instance, Refused, STORAGE_CLASSES, TransferSyntax, examine, transfer_syntaxes};
pub(crate) use error::sentence;
pub use error::{IntakeError, Nature};
pub use prescan::ScanError;

use crate::{codecs, study::Study, subject::Subject};
use std::ops::RangeInclusive;

/// One body, or one part of a multipart body.
#[derive(Debug, Clone, Copy)]
pub struct Part<'a> {
    /// The declared media type; the content's own signature outranks it.
    pub media_type: Option<&'a str>,
    /// The declared file name.
    pub filename: Option<&'a str>,
    /// The content.
    pub bytes: &'a [u8],
}

/// What the request says beside the body.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Distance between voxel centres along `[z, y, x]` in mm: needed for NPY, which cannot say it, and ignored by the other formats.
    pub spacing_mm: Option<[f64; 3]>,
    /// Whether the patient and study attributes of DICOM files are kept ([`Received::subject`]).
    pub keep_subject: bool,
}

/// What is accepted at most. The defaults hold every clinical gated SPECT study (64 or 128 rows, up to 64 slices, 8 to 32 gates) with room,
/// and keep one request under 300 MB of memory.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Rows and columns of a slice. Below 16 no ventricle is resolved; SPECT matrices end at 256.
    pub rows_and_columns: RangeInclusive<usize>,
    /// Slices of the stack. A ventricle needs at least 4.
    pub slices: RangeInclusive<usize>,
    /// Gates (time slots). Clinical gating uses 8, 16, at most 32.
    pub gates: RangeInclusive<usize>,
    /// Frames of one DICOM object (slices × time slots × R-R intervals).
    pub frames: usize,
    /// Voxels of all gates together: 128 × 128 × 64 × 16.
    pub voxels: usize,
    /// Distance between voxel centres in mm. SPECT lies between 2 and 10.
    pub spacing_mm: RangeInclusive<f64>,
    /// Bytes of all parts together.
    pub body_bytes: usize,
    /// Bytes after inflating (deflated DICOM, gzipped NIfTI).
    pub inflated_bytes: usize,
    /// Bytes of a JSON body beside its counts.
    pub json_overhead_bytes: usize,
    /// Parts of one request: one slice a file of the largest stack.
    pub parts: usize,
    /// Bytes of the DICOM attributes that describe the images, all files together: 4 096 single slices take about 1 KiB each.
    pub described_bytes: usize,
    /// Data elements of one DICOM object, at all depths.
    pub elements: usize,
    /// Depth of nested DICOM sequences. Structured reports, the deepest valid files, reach 10.
    pub depth: usize,
    /// Where compressed DICOM frames are decoded: a program of its own, since some of what can be wrong with them cannot be survived. Without
    /// one they are refused by name.
    pub decoder: Option<codecs::Decoder>,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            rows_and_columns: 16..=512,
            slices: 4..=512,
            gates: 1..=64,
            frames: 4096,
            voxels: 16 << 20,
            spacing_mm: 0.1..=50.0,
            body_bytes: 64 << 20,
            inflated_bytes: 64 << 20,
            json_overhead_bytes: 256 << 10,
            parts: 4096,
            described_bytes: 4 << 20,
            elements: 200_000,
            depth: 32,
            decoder: None,
        }
    }
}

/// What was in the request.
#[derive(Debug, Clone, PartialEq)]
pub struct Received {
    /// The study.
    pub study: Study,
    /// The `parameters` member of a JSON body, not yet judged.
    pub parameters: Option<serde_json::Value>,
    /// Whom it is of; only if that was to be kept, and only of DICOM.
    pub subject: Option<Subject>,
}

/// Reads one study from the parts of a request.
///
/// # Errors
/// [`IntakeError`] with a stable [`code`](IntakeError::code) for everything that is not a reconstructed tomographic study within the limits.
pub fn read(parts: &[Part<'_>], options: &Options, limits: &Limits) -> Result<Received, IntakeError> {
    let bytes = parts.iter().fold(0_usize, |sum, part| sum.saturating_add(part.bytes.len()));
    if bytes == 0 {
        return Err(IntakeError::Empty);
    }
    if bytes > limits.body_bytes {
        return Err(IntakeError::TooLarge { what: "the request", bytes: Some(bytes), limit: limits.body_bytes });
    }
    if parts.len() > limits.parts {
        return Err(IntakeError::MixedParts {
            reason: format!("it holds {} parts, more than the {} that one study may have", parts.len(), limits.parts),
        });
    }
    let formats = parts
        .iter()
        .enumerate()
        .map(|(index, part)| match sniff::format(part) {
            Err(error) if parts.len() > 1 => Err(IntakeError::InFile { file: index + 1, source: Box::new(error) }),
            format => format,
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut subject = None;
    let study = match (parts, formats.as_slice()) {
        ([part], [sniff::Format::Json]) => return json::read(part.bytes, limits),
        ([part], [sniff::Format::Npy]) => npy::read(part.bytes, options, limits)?,
        ([part], [sniff::Format::Nifti]) => nifti::read(part.bytes, limits)?,
        ([part], [sniff::Format::Gzip]) => nifti::read_gzipped(part.bytes, limits)?,
        (_, formats) if formats.iter().all(|format| *format == sniff::Format::Dicom) => {
            let (study, whose) = dicom::read(parts, options.keep_subject, limits)?;
            subject = whose;
            study
        }
        (_, formats) => {
            let mut names: Vec<&str> = formats.iter().map(|format| format.name()).collect();
            names.dedup();
            return Err(IntakeError::MixedParts {
                reason: format!("only DICOM may come in several files, and it holds {} files: {}", parts.len(), names.join(", ")),
            });
        }
    };
    Ok(Received { study, parameters: None, subject })
}

/// Walks a DICOM file as [`read`] does first; the number of its outermost elements. For the fuzz target of the walk.
#[doc(hidden)]
pub fn scan_only(bytes: &[u8], limits: &Limits) -> Result<usize, ScanError> {
    prescan::scan(bytes, limits).map(|scan| scan.elements.len())
}
