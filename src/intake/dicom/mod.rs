//! DICOM Nuclear Medicine images → [`Study`].
//!
//! The checks run in the order that gives the best answer: what the object is ([`identity`]), how its pixels are encoded ([`syntaxes`], [`pixels`]),
//! which frame is which slice of which gate ([`frames`]), where they lie ([`geometry`]), and how several files make one study ([`series`]).

mod allowed;
mod attributes;
mod body;
mod encapsulated;
mod frames;
mod gating;
mod geometry;
mod identity;
mod instance;
mod object;
mod parts;
mod pixels;
mod series;
mod subject;
mod syntaxes;
mod timing;

pub use allowed::{ALLOWED, Allowed};
pub use identity::STORAGE_CLASSES;
pub use instance::{Instance, Refused, examine};
pub use parts::Holds;
pub use syntaxes::{TransferSyntax, transfer_syntaxes};

use super::{IntakeError, Limits, Part, counts};
use crate::study::{Acquisition, Format, Study, Warning};
use crate::subject::Subject;
use crate::volume::Grid;
use frames::Arrangement;
use gating::Gating;
use ndarray::{Array3, Axis};
use object::Object;

/// Reads one multi-frame object, or the files of one series, and whom they are of if that is to be kept.
pub(super) fn read(parts: &[Part<'_>], keep_subject: bool, limits: &Limits) -> Result<(Study, Option<Subject>), IntakeError> {
    let mut warnings = Vec::new();
    let mut objects: Vec<Object<'_>> = Vec::with_capacity(parts.len());
    // What all files together may take; each file leaves less for the next.
    let mut remaining = limits.clone();
    for (index, part) in parts.iter().enumerate() {
        // Of a series, the first file speaks for all.
        let mut own = Vec::new();
        let object = Object::read(part.bytes, keep_subject, &remaining, &mut own).map_err(|error| in_file(error, index, parts.len()))?;
        remaining.inflated_bytes -= object.pixels.inflated_bytes();
        remaining.described_bytes -= object.attributes.bytes;
        objects.push(object);
        if index == 0 {
            warnings = own;
        }
    }
    let arrangement = match objects.as_slice() {
        [object] => Arrangement::of_object(object, &mut warnings)?,
        objects => series::arrange(objects, &mut warnings)?,
    };
    let subject = subject::of_all(&objects)?;
    Ok((build(&objects, &arrangement, limits, warnings)?, subject))
}

/// An error of one of several files (counted from 0).
fn in_file(error: IntakeError, index: usize, files: usize) -> IntakeError {
    if files == 1 { error } else { IntakeError::InFile { file: index + 1, source: Box::new(error) } }
}

/// Decodes the frames into their places.
fn build(objects: &[Object<'_>], arrangement: &Arrangement, limits: &Limits, mut warnings: Vec<Warning>) -> Result<Study, IntakeError> {
    let first = &objects[0];
    let (gates, slices) = (arrangement.gates.len(), arrangement.gates[0].len());
    let shape = [slices, first.rows, first.columns];
    counts::check_extent(gates, shape, limits)?;
    let geometry = match &arrangement.stack {
        Some(stack) => geometry::of_positions(first, stack, &mut warnings)?,
        None => geometry::of_object(first, slices, &mut warnings)?,
    };
    counts::check_spacing(geometry.spacing_mm, limits)?;
    let grid = Grid { shape, spacing_mm: geometry.spacing_mm };

    let mut session = limits.decoder.as_ref().map(|decoder| decoder.session(gates * shape.iter().product::<usize>()));
    let mut volumes = Vec::with_capacity(gates);
    for gate in &arrangement.gates {
        let mut volume = Array3::zeros(shape);
        for (source, mut slice) in gate.iter().zip(volume.axis_iter_mut(Axis(0))) {
            if let Some(values) = slice.as_slice_mut() {
                let decoded = objects[source.object].pixels.decode(source.frame, values, session.as_mut());
                decoded.map_err(|error| in_file(error, source.object, objects.len()))?;
            }
        }
        volumes.push(volume);
    }
    let timing = timing::read(first, arrangement.rr_interval, gates, &mut warnings);
    let gating = if gates > 1 { gating::read(&first.attributes, arrangement.rr_interval, &mut warnings) } else { Gating::default() };
    let body = body::read(&first.attributes, &mut warnings);
    let gates = counts::gates(grid, volumes, &timing.durations_ms, &mut warnings)?;
    let acquisition = Acquisition {
        format: Format::Dicom,
        study_instance_uid: first.study_uid.clone(),
        series_instance_uid: first.series_uid.clone(),
        sop_instance_uids: objects.iter().filter_map(|object| object.instance_uid.clone()).collect(),
        sop_class_uids: objects.iter().filter(|object| object.instance_uid.is_some()).map(|object| object.class_uid.clone()).collect(),
        frame_of_reference_uid: first.attributes.uid(dicom_dictionary_std::tags::FRAME_OF_REFERENCE_UID),
        rr_interval_ms: timing.rr_interval_ms,
        heart_rate_bpm: timing.heart_rate_bpm,
        beats_accepted: gating.beats_accepted,
        beats_rejected: gating.beats_rejected,
        rr_window_ms: gating.rr_window_ms,
        beat_rejection: gating.beat_rejection,
        height_m: body.height_m,
        weight_kg: body.weight_kg,
    };
    Ok(Study { grid, gates, orientation: geometry.orientation, acquisition, warnings })
}
