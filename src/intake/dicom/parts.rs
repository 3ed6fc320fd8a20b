//! Which part of a study one object holds.

use super::frames::{Arrangement, Places};
use super::identity::Kind;
use super::object::Object;
use super::timing::data_information;
use crate::intake::{IntakeError, Limits};
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeSet;

/// What part of a study an object holds, and of how many such parts the study consists, if the object says so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holds {
    /// All of it.
    Study,
    /// All slices of one gate.
    Gate {
        /// Number of Time Slots (0054,0071), if more than one.
        of: Option<usize>,
    },
    /// One slice of one gate.
    Slice {
        /// Number of Time Slots times Number of Slices (0054,0081), if the file has both.
        of: Option<usize>,
    },
}

impl Holds {
    /// Whether parts such as these are all that their study has: each names the same number, and that many are there.
    pub fn complete(parts: &[Self]) -> bool {
        let number = |part: &Self| match part {
            Self::Study => Some(1),
            Self::Gate { of } | Self::Slice { of } => *of,
        };
        let Some((first, rest)) = parts.split_first() else { return false };
        rest.iter().all(|part| part == first) && number(first) == Some(parts.len())
    }
}

/// What this object holds. Its frames must be consistent in themselves, and those of a part that has to wait for others must decode: their
/// counts go into the digest.
pub(super) fn holds(object: &Object<'_>, digest: &mut Sha256, limits: &Limits) -> Result<Holds, IntakeError> {
    let time_slots = number(object, tags::NUMBER_OF_TIME_SLOTS, "Number of Time Slots")?;
    let holds = if object.frames == 1 {
        let slices = number(object, tags::NUMBER_OF_SLICES, "Number of Slices")?;
        // A file of one slice may count its own: then nothing is said of the others.
        Holds::Slice { of: slices.filter(|&slices| slices > 1).map(|slices| slices.saturating_mul(time_slots.unwrap_or(1))) }
    } else {
        let places = Places::of(&object.attributes, object.kind, object.frames, &mut Vec::new())?;
        let gates = places.slots.iter().collect::<BTreeSet<_>>().len();
        if gates > 1 || (object.kind == Kind::Ungated && !is_one_of_several(object)) {
            Arrangement::of_object(object, &mut Vec::new())?;
            return Ok(Holds::Study);
        }
        Holds::Gate { of: time_slots.filter(|&slots| slots > 1) }
    };
    let mut counts = vec![0.0; object.rows * object.columns];
    let mut session = limits.decoder.as_ref().map(|decoder| decoder.session(object.frames * counts.len()));
    for frame in 0..object.frames {
        object.pixels.decode(frame, &mut counts, session.as_mut())?;
        for count in &counts {
            digest.update(count.to_le_bytes());
        }
    }
    Ok(holds)
}

/// Whether an object called ungated is numbered as one gate of several.
fn is_one_of_several(object: &Object<'_>) -> bool {
    let attributes = &object.attributes;
    [tags::TRIGGER_TIME, tags::TEMPORAL_POSITION_IDENTIFIER, tags::TIME_SLOT_VECTOR].into_iter().any(|tag| attributes.has(tag))
        || data_information(attributes).iter().any(|items| !items.is_empty())
}

/// A number of parts that makes sense.
fn number(object: &Object<'_>, tag: Tag, name: &'static str) -> Result<Option<usize>, IntakeError> {
    let number = object.attributes.integer(tag, name)?;
    Ok(number.and_then(|number| usize::try_from(number).ok()).filter(|&number| number > 0))
}
