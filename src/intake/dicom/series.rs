//! Several files that make one study: a file a gate, or a file a slice.

use super::frames::{Arrangement, Places, Source, rectangle};
use super::geometry::Plane;
use super::object::Object;
use crate::intake::IntakeError;
use crate::study::Warning;
use dicom_dictionary_std::tags;
use std::collections::BTreeMap;

/// Arranges the files of one series.
pub(super) fn arrange(objects: &[Object<'_>], warnings: &mut Vec<Warning>) -> Result<Arrangement, IntakeError> {
    check_same_series(objects)?;
    if objects.iter().all(|object| object.frames == 1) {
        return slice_a_file(objects);
    }
    if let Some(index) = objects.iter().position(|object| object.frames == 1) {
        return Err(mixed(format!("file {} is a single slice and another holds several", index + 1)));
    }
    gate_a_file(objects, warnings)
}

fn mixed(reason: String) -> IntakeError {
    IntakeError::MixedParts { reason }
}

/// All files must be different objects of one series with one matrix, one pixel size and one orientation.
fn check_same_series(objects: &[Object<'_>]) -> Result<(), IntakeError> {
    let first = &objects[0];
    let plane_of = |object: &Object<'_>| Plane::of(&object.attributes);
    let first_plane = plane_of(first)?;
    for (index, object) in objects.iter().enumerate().skip(1) {
        let file = index + 1;
        if object.study_uid != first.study_uid {
            return Err(mixed(format!("file {file} belongs to another study (Study Instance UID (0020,000D)) than file 1")));
        }
        if object.series_uid != first.series_uid {
            return Err(mixed(format!("file {file} belongs to another series (Series Instance UID (0020,000E)) than file 1")));
        }
        if (object.rows, object.columns) != (first.rows, first.columns) {
            return Err(mixed(format!(
                "file {file} has {} rows and {} columns, file 1 has {} and {}",
                object.rows, object.columns, first.rows, first.columns
            )));
        }
        for (tag, name) in [(tags::PIXEL_SPACING, "Pixel Spacing"), (tags::SPACING_BETWEEN_SLICES, "Spacing Between Slices")] {
            if object.attributes.numbers(tag, name)? != first.attributes.numbers(tag, name)? {
                return Err(mixed(format!("file {file} has another {name} {tag} than file 1")));
            }
        }
        let same_plane = match (first_plane, plane_of(object)?) {
            (Some(a), Some(b)) => a.columns.abs_diff_eq(b.columns, 1e-3) && a.rows.abs_diff_eq(b.rows, 1e-3),
            (None, None) => true,
            _ => false,
        };
        if !same_plane {
            return Err(mixed(format!("file {file} has another Image Orientation (Patient) (0020,0037) than file 1")));
        }
    }
    let mut seen = BTreeMap::new();
    for (index, object) in objects.iter().enumerate() {
        if let Some(uid) = &object.instance_uid
            && let Some(earlier) = seen.insert(uid, index)
        {
            return Err(mixed(format!("files {} and {} are the same object (SOP Instance UID (0008,0018))", earlier + 1, index + 1)));
        }
    }
    Ok(())
}

/// Each file is the stack of one gate.
fn gate_a_file(objects: &[Object<'_>], warnings: &mut Vec<Warning>) -> Result<Arrangement, IntakeError> {
    let order = gate_numbers(objects)?;
    let mut placed = Vec::new();
    for (index, object) in objects.iter().enumerate() {
        let mut own = Vec::new();
        let places = Places::of(&object.attributes, object.kind, object.frames, &mut own)?;
        if index == 0 {
            warnings.append(&mut own);
        }
        if let Some(frame) = (1..object.frames).find(|&frame| places.slots[frame] != places.slots[0] || places.rr[frame] != places.rr[0]) {
            return Err(mixed(format!(
                "file {} holds several gates (frame {} is of time slot {}); of several files each must be the slices of one gate",
                index + 1,
                frame + 1,
                places.slots[frame]
            )));
        }
        placed.extend(places.slices.iter().enumerate().map(|(frame, slice)| (order[index], *slice, Source { object: index, frame })));
    }
    Ok(Arrangement { gates: rectangle(placed.into_iter())?, rr_interval: None, stack: None })
}

/// Each file is one slice of one gate; slices are ordered by their position.
fn slice_a_file(objects: &[Object<'_>]) -> Result<Arrangement, IntakeError> {
    let positions_mm = positions(objects)?;
    // Positions are compared as whole micrometres: files round them differently.
    let keys: Vec<i64> = positions_mm.iter().map(|position| (position * 1000.0).round() as i64).collect();
    let mut slices: Vec<i64> = keys.clone();
    slices.sort_unstable();
    slices.dedup();
    let gates: Vec<i64> = if slices.len() == objects.len() { vec![1; objects.len()] } else { gate_numbers(objects)? };
    let placed = keys.iter().zip(&gates).enumerate().map(|(object, (slice, gate))| (*gate, *slice, Source { object, frame: 0 }));
    let gates = rectangle(placed).map_err(|error| match error {
        IntakeError::InconsistentFrames { reason } => {
            IntakeError::InconsistentFrames { reason: format!("{reason} (slices are named by their position in micrometres)") }
        }
        other => other,
    })?;
    Ok(Arrangement { gates, rr_interval: None, stack: Some(slices.iter().map(|micrometres| *micrometres as f64 / 1000.0).collect()) })
}

/// Positions of single slices along their normal: Image Position, else Slice Location.
fn positions(objects: &[Object<'_>]) -> Result<Vec<f64>, IntakeError> {
    let mut positions = Vec::with_capacity(objects.len());
    for (index, object) in objects.iter().enumerate() {
        let plane = Plane::of(&object.attributes)?.filter(Plane::is_orthonormal);
        let along = plane.and_then(|plane| plane.position_mm.map(|position| position.dot(plane.normal())));
        let position = match along {
            Some(position) => Some(position),
            None => object.attributes.number(tags::SLICE_LOCATION, "Slice Location")?,
        };
        positions.push(position.ok_or_else(|| {
            mixed(format!(
                "file {} is a single slice without Image Position (Patient) (0020,0032) or Slice Location (0020,1041), so its place in the stack is not known",
                index + 1
            ))
        })?);
    }
    if positions.iter().any(|position| position.abs() > 1e6) {
        return Err(mixed("a slice lies more than a kilometre away".to_owned()));
    }
    Ok(positions)
}

/// The gate of each file, by the first attribute that all files have and that tells at least two of them apart: time slot, trigger time,
/// temporal position, and for whole stacks the instance number.
fn gate_numbers(objects: &[Object<'_>]) -> Result<Vec<i64>, IntakeError> {
    type Key = fn(&Object<'_>) -> Option<f64>;
    let keys: [Key; 5] = [
        |object| object.attributes.number(tags::TIME_SLOT_VECTOR, "Time Slot Vector").ok().flatten(),
        |object| object.attributes.number(tags::TRIGGER_TIME, "Trigger Time").ok().flatten(),
        |object| {
            let gated = object.attributes.items(tags::GATED_INFORMATION_SEQUENCE);
            gated.first().and_then(|item| item.number(tags::TRIGGER_TIME, "Trigger Time").ok().flatten())
        },
        |object| object.attributes.number(tags::TEMPORAL_POSITION_IDENTIFIER, "Temporal Position Identifier").ok().flatten(),
        |object| if object.frames > 1 { object.attributes.number(tags::INSTANCE_NUMBER, "Instance Number").ok().flatten() } else { None },
    ];
    for key in keys {
        let Some(values) = objects.iter().map(key).collect::<Option<Vec<f64>>>() else { continue };
        let mut distinct = values.clone();
        distinct.sort_by(f64::total_cmp);
        distinct.dedup();
        if distinct.len() > 1 {
            return Ok(values.iter().map(|value| distinct.partition_point(|other| other < value) as i64 + 1).collect());
        }
    }
    Err(mixed(format!(
        "nothing tells the gates of the {} files apart: Time Slot Vector (0054,0070), Trigger Time (0018,1060) and Temporal Position Identifier (0020,0100) are missing or all the same",
        objects.len()
    )))
}
