//! Which frame is which slice of which gate.
//!
//! An NM object numbers its frames by vectors: R-R interval (0054,0060), time slot (0054,0070), slice (0054,0080), in any order. They are read
//! by what they say, not by their order: together they must name every slice of every time slot exactly once.

use super::attributes::Attributes;
use super::identity::Kind;
use super::object::Object;
use crate::intake::IntakeError;
use crate::study::Warning;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use std::collections::{BTreeMap, BTreeSet};

/// A frame of one of the objects of a study, both counted from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Source {
    pub(super) object: usize,
    pub(super) frame: usize,
}

/// The frames of a study in order.
#[derive(Debug, PartialEq)]
pub(super) struct Arrangement {
    /// Gates in time order, each with its slices in order. Neither is ever empty, and all gates have as many slices.
    pub(super) gates: Vec<Vec<Source>>,
    /// Which R-R interval was taken, counted from 0, of a file that has several.
    pub(super) rr_interval: Option<usize>,
    /// Positions of the slices along their normal in mm, if each slice came in a file of its own.
    pub(super) stack: Option<Vec<f64>>,
}

impl Arrangement {
    /// Arranges the frames of one multi-frame object.
    pub(super) fn of_object(object: &Object<'_>, warnings: &mut Vec<Warning>) -> Result<Self, IntakeError> {
        let places = Places::of(&object.attributes, object.kind, object.frames, warnings)?;
        let frames: Vec<usize> = (0..object.frames).filter(|&frame| places.rr[frame] == places.chosen_rr).collect();
        let placed = frames.iter().map(|&frame| (places.slots[frame], places.slices[frame], Source { object: 0, frame }));
        let gates = rectangle(placed)?;
        check_number(&object.attributes, tags::NUMBER_OF_TIME_SLOTS, "Number of Time Slots", gates.len(), object.kind == Kind::Gated)?;
        check_number(&object.attributes, tags::NUMBER_OF_SLICES, "Number of Slices", gates[0].len(), true)?;
        if object.kind == Kind::Gated && gates.len() == 1 {
            warnings
                .push(Warning::new("one_time_slot", "The image is called gated but holds one time slot; there is no ejection fraction."));
        }
        Ok(Self { gates, rr_interval: places.rr_interval, stack: None })
    }
}

/// Sorts `(slot, slice, source)` into gates of slices.
///
/// # Errors
/// Names what is missing or twice there.
pub(super) fn rectangle(frames: impl Iterator<Item = (i64, i64, Source)>) -> Result<Vec<Vec<Source>>, IntakeError> {
    let mut places: BTreeMap<(i64, i64), Source> = BTreeMap::new();
    for (slot, slice, source) in frames {
        if let Some(earlier) = places.insert((slot, slice), source) {
            return Err(IntakeError::InconsistentFrames {
                reason: format!("time slot {slot}, slice {slice} is there twice ({} and {})", earlier.name(), source.name()),
            });
        }
    }
    let slots: BTreeSet<i64> = places.keys().map(|(slot, _)| *slot).collect();
    let slices: BTreeSet<i64> = places.keys().map(|(_, slice)| *slice).collect();
    let missing: Vec<(i64, i64)> = slots
        .iter()
        .flat_map(|slot| slices.iter().map(|slice| (*slot, *slice)))
        .filter(|place| !places.contains_key(place))
        .take(4)
        .collect();
    if !missing.is_empty() {
        let named: Vec<String> = missing.iter().take(3).map(|(slot, slice)| format!("time slot {slot}, slice {slice}")).collect();
        let more = if missing.len() > 3 { " and more" } else { "" };
        return Err(IntakeError::InconsistentFrames { reason: format!("{}{more} missing", named.join("; ")) });
    }
    if places.is_empty() {
        return Err(IntakeError::InconsistentFrames { reason: "there are no frames".to_owned() });
    }
    Ok(slots.iter().map(|slot| places.range((*slot, i64::MIN)..=(*slot, i64::MAX)).map(|(_, source)| *source).collect()).collect())
}

impl Source {
    fn name(self) -> String {
        if self.object == 0 { format!("frame {}", self.frame + 1) } else { format!("file {}, frame {}", self.object + 1, self.frame + 1) }
    }
}

/// The place of each frame.
pub(super) struct Places {
    pub(super) rr: Vec<i64>,
    pub(super) slots: Vec<i64>,
    pub(super) slices: Vec<i64>,
    chosen_rr: i64,
    rr_interval: Option<usize>,
}

impl Places {
    /// Reads the vectors; what is missing is filled in from the order of the frames, with a warning.
    pub(super) fn of(attributes: &Attributes, kind: Kind, frames: usize, warnings: &mut Vec<Warning>) -> Result<Self, IntakeError> {
        for (tag, name) in [
            (tags::ENERGY_WINDOW_VECTOR, "Energy Window Vector"),
            (tags::DETECTOR_VECTOR, "Detector Vector"),
            (tags::PHASE_VECTOR, "Phase Vector"),
        ] {
            let distinct: BTreeSet<i64> = vector(attributes, tag, name, frames)?.into_iter().flatten().collect();
            if distinct.len() > 1 {
                return Err(IntakeError::InconsistentFrames {
                    reason: format!("{name} {tag} names {} of them in one object; send the slices of one", distinct.len()),
                });
            }
        }
        let rr = vector(attributes, tags::RR_INTERVAL_VECTOR, "R-R Interval Vector", frames)?;
        let slots = vector(attributes, tags::TIME_SLOT_VECTOR, "Time Slot Vector", frames)?;
        let slices = vector(attributes, tags::SLICE_VECTOR, "Slice Vector", frames)?;
        if (slots.is_some() || slices.is_some()) && !attributes.has(tags::FRAME_INCREMENT_POINTER) {
            warnings.push(Warning::new(
                "missing_frame_increment_pointer",
                "Frame Increment Pointer (0028,0009) is missing; the vectors that are there were taken as they are.",
            ));
        }
        let rr = rr.unwrap_or_else(|| vec![1; frames]);
        let (slots, slices) = match (slots, slices) {
            (Some(slots), Some(slices)) => (slots, slices),
            (Some(slots), None) => {
                warnings.push(assumed("Slice Vector (0054,0080)"));
                let slices = occurrence(rr.iter().zip(&slots));
                (slots, slices)
            }
            (None, Some(slices)) => {
                let slots = occurrence(rr.iter().zip(&slices));
                if kind == Kind::Gated || slots.iter().any(|slot| *slot > 1) {
                    warnings.push(assumed("Time Slot Vector (0054,0070)"));
                }
                (slots, slices)
            }
            (None, None) => {
                let (slots, slices) = standard_order(attributes, kind, frames)?;
                warnings.push(assumed("Slice Vector (0054,0080)"));
                (slots, slices)
            }
        };
        let (chosen_rr, rr_interval) = choose_rr(attributes, &rr, warnings);
        Ok(Self { rr, slots, slices, chosen_rr, rr_interval })
    }
}

fn assumed(name: &str) -> Warning {
    Warning::new("frame_order_assumed", format!("{name} is missing; the frames were taken in the standard order, slices varying fastest."))
}

/// A vector with a value for each frame.
fn vector(attributes: &Attributes, tag: Tag, name: &'static str, frames: usize) -> Result<Option<Vec<i64>>, IntakeError> {
    let values = attributes.integers(tag, name)?;
    if values.is_empty() {
        return Ok(None);
    }
    if values.len() != frames {
        return Err(IntakeError::InconsistentFrames {
            reason: format!("{name} {tag} has {} values for {frames} frames (Number of Frames (0028,0008))", values.len()),
        });
    }
    Ok(Some(values))
}

/// How often each key has occurred before and with a frame: 1 for the first time.
fn occurrence<K: Ord>(keys: impl Iterator<Item = K>) -> Vec<i64> {
    let mut seen = BTreeMap::new();
    keys.map(|key| {
        let times = seen.entry(key).or_insert(0);
        *times += 1;
        *times
    })
    .collect()
}

/// Slots and slices of frames without vectors: time slots outside, slices inside.
fn standard_order(attributes: &Attributes, kind: Kind, frames: usize) -> Result<(Vec<i64>, Vec<i64>), IntakeError> {
    let declared_slots = attributes.integer(tags::NUMBER_OF_TIME_SLOTS, "Number of Time Slots")?;
    let declared_slices = attributes.integer(tags::NUMBER_OF_SLICES, "Number of Slices")?;
    let all = frames as i64;
    let (slots, slices) = match (declared_slots, declared_slices) {
        (Some(slots), Some(slices)) => (slots, slices),
        (None, Some(slices)) if slices > 0 => (all / slices, slices),
        (Some(slots), None) if slots > 0 => (slots, all / slots),
        _ if kind == Kind::Gated => {
            return Err(IntakeError::MissingAttribute {
                name: "Slice Vector",
                tag: tags::SLICE_VECTOR.to_string(),
                advice: "and neither Time Slot Vector (0054,0070) nor the numbers of time slots and slices say which frame is which slice of which gate",
            });
        }
        _ => (1, all),
    };
    if slots < 1 || slices < 1 || slots.checked_mul(slices) != Some(all) {
        return Err(IntakeError::InconsistentFrames {
            reason: format!("{slots} time slots of {slices} slices are declared, but there are {frames} frames and no vectors"),
        });
    }
    Ok((0..all).map(|frame| (frame / slices + 1, frame % slices + 1)).unzip())
}

/// Of several R-R intervals (arrhythmia windows), the one that accumulated most beats; the first if the file does not say. With its index,
/// counted from 0, if there are several.
fn choose_rr(attributes: &Attributes, rr: &[i64], warnings: &mut Vec<Warning>) -> (i64, Option<usize>) {
    let distinct: Vec<i64> = rr.iter().copied().collect::<BTreeSet<i64>>().into_iter().collect();
    // Counted from 1 (PS3.3 C.8.4.13); some count from 0. Frames may be left of the second of two intervals alone.
    let lowest = distinct.first().copied().unwrap_or(1).min(1);
    let index = |interval: i64| usize::try_from(interval.saturating_sub(lowest)).unwrap_or(usize::MAX);
    if distinct.len() <= 1 {
        let interval = distinct.first().copied().unwrap_or(1);
        return (interval, Some(index(interval)).filter(|&index| index > 0));
    }
    let beats = |interval: i64| {
        let items = super::timing::of_interval(attributes, Some(index(interval)));
        items.iter().filter_map(|item| item.positive(tags::INTERVALS_ACQUIRED)).sum::<f64>()
    };
    let mut chosen = (distinct[0], beats(distinct[0]));
    for &candidate in &distinct[1..] {
        let accepted = beats(candidate);
        if accepted > chosen.1 {
            chosen = (candidate, accepted);
        }
    }
    warnings.push(Warning::new(
        "several_rr_intervals",
        format!("The file holds {} R-R intervals; interval {}, the one with most accepted beats, was taken.", distinct.len(), chosen.0),
    ));
    (chosen.0, Some(index(chosen.0)))
}

/// Compares a declared number with what the vectors hold: fewer would be a silently incomplete heart.
fn check_number(attributes: &Attributes, tag: Tag, name: &'static str, actual: usize, strict: bool) -> Result<(), IntakeError> {
    match attributes.integer(tag, name)? {
        Some(declared) if strict && declared != actual as i64 => {
            Err(IntakeError::InconsistentFrames { reason: format!("{name} {tag} says {declared}, but the frames hold {actual}") })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(frame: usize) -> Source {
        Source { object: 0, frame }
    }

    #[test]
    fn frames_in_any_order_make_the_same_rectangle() {
        let mut frames: Vec<(i64, i64, Source)> =
            (0..6).map(|frame| ((frame / 3) as i64 + 1, (frame % 3) as i64 + 1, source(frame))).collect();
        let expected = vec![vec![source(0), source(1), source(2)], vec![source(3), source(4), source(5)]];
        assert_eq!(rectangle(frames.clone().into_iter()).unwrap(), expected);
        frames.reverse();
        assert_eq!(rectangle(frames.clone().into_iter()).unwrap(), expected);
        frames.swap(1, 4);
        assert_eq!(rectangle(frames.into_iter()).unwrap(), expected);
    }

    #[test]
    fn holes_and_duplicates_are_named() {
        let hole = rectangle([(1, 1, source(0)), (1, 2, source(1)), (2, 1, source(2))].into_iter()).unwrap_err();
        assert!(hole.to_string().contains("time slot 2, slice 2 missing"), "{hole}");
        let twice = rectangle([(1, 1, source(0)), (1, 1, source(5))].into_iter()).unwrap_err();
        assert!(twice.to_string().contains("time slot 1, slice 1 is there twice (frame 1 and frame 6)"), "{twice}");
    }

    #[test]
    fn occurrences_count_from_one() {
        assert_eq!(occurrence([7, 7, 3, 7, 3].into_iter()), [1, 2, 1, 3, 2]);
    }
}
