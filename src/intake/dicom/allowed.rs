//! Which attributes of a DICOM object are read, and as what each of them leaves the intake. Everything else (names, dates, places, private
//! groups) is skipped by the scan, and never reaches a parser, the study, the disk or a result. `docs/privacy.md` has the same table.

use dicom_core::Tag;
use dicom_dictionary_std::tags;

/// An attribute that is read from the outermost data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Allowed {
    /// The attribute.
    pub tag: Tag,
    /// The part of the study that it, or what is computed from it, becomes; `None` for what only tells how the rest is to be read.
    pub leaves_as: Option<&'static str>,
}

/// A row of [`ALLOWED`].
const fn leaves(tag: Tag, as_what: &'static str) -> Allowed {
    Allowed { tag, leaves_as: Some(as_what) }
}

/// A row of [`ALLOWED`] that stays inside.
const fn stays(tag: Tag) -> Allowed {
    Allowed { tag, leaves_as: None }
}

/// All that is read, by tag. None of it names the patient: of group 0010 it is size and weight.
pub const ALLOWED: [Allowed; 51] = [
    stays(tags::IMAGE_TYPE),
    leaves(tags::SOP_CLASS_UID, "sop_class_uids"),
    leaves(tags::SOP_INSTANCE_UID, "sop_instance_uids"),
    stays(tags::MODALITY),
    leaves(tags::PATIENT_SIZE, "height_m"),
    leaves(tags::PATIENT_WEIGHT, "weight_kg"),
    leaves(tags::SLICE_THICKNESS, "grid"),
    leaves(tags::SPACING_BETWEEN_SLICES, "grid"),
    stays(tags::TRIGGER_TIME),
    leaves(tags::NOMINAL_INTERVAL, "rr_interval_ms"),
    leaves(tags::FRAME_TIME, "durations_ms"),
    leaves(tags::BEAT_REJECTION_FLAG, "beat_rejection"),
    leaves(tags::LOW_RR_VALUE, "rr_window_ms"),
    leaves(tags::HIGH_RR_VALUE, "rr_window_ms"),
    leaves(tags::INTERVALS_ACQUIRED, "beats_accepted"),
    leaves(tags::INTERVALS_REJECTED, "beats_rejected"),
    leaves(tags::HEART_RATE, "heart_rate_bpm"),
    leaves(tags::STUDY_INSTANCE_UID, "study_instance_uid"),
    leaves(tags::SERIES_INSTANCE_UID, "series_instance_uid"),
    stays(tags::INSTANCE_NUMBER),
    leaves(tags::IMAGE_POSITION_PATIENT, "orientation"),
    leaves(tags::IMAGE_ORIENTATION_PATIENT, "orientation"),
    leaves(tags::FRAME_OF_REFERENCE_UID, "frame_of_reference_uid"),
    stays(tags::TEMPORAL_POSITION_IDENTIFIER),
    leaves(tags::SLICE_LOCATION, "grid"),
    stays(tags::SAMPLES_PER_PIXEL),
    stays(tags::PHOTOMETRIC_INTERPRETATION),
    leaves(tags::NUMBER_OF_FRAMES, "grid"),
    stays(tags::FRAME_INCREMENT_POINTER),
    leaves(tags::ROWS, "grid"),
    leaves(tags::COLUMNS, "grid"),
    leaves(tags::PIXEL_SPACING, "grid"),
    stays(tags::BITS_ALLOCATED),
    stays(tags::BITS_STORED),
    stays(tags::HIGH_BIT),
    stays(tags::PIXEL_REPRESENTATION),
    leaves(tags::RESCALE_INTERCEPT, "counts"),
    leaves(tags::RESCALE_SLOPE, "counts"),
    stays(tags::ENERGY_WINDOW_VECTOR),
    stays(tags::DETECTOR_VECTOR),
    leaves(tags::DETECTOR_INFORMATION_SEQUENCE, "orientation"),
    stays(tags::PHASE_VECTOR),
    stays(tags::ROTATION_VECTOR),
    stays(tags::RR_INTERVAL_VECTOR),
    leaves(tags::GATED_INFORMATION_SEQUENCE, "durations_ms"),
    stays(tags::TIME_SLOT_VECTOR),
    stays(tags::NUMBER_OF_TIME_SLOTS),
    stays(tags::SLICE_VECTOR),
    leaves(tags::NUMBER_OF_SLICES, "grid"),
    stays(tags::ANGULAR_VIEW_VECTOR),
    stays(tags::IMAGE_ID),
];

/// Whether an attribute is among them.
pub(super) fn is_allowed(tag: Tag) -> bool {
    ALLOWED.iter().any(|allowed| allowed.tag == tag)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_listed_once_and_none_names_a_patient() {
        assert!(ALLOWED.is_sorted_by(|one, next| one.tag < next.tag), "by tag, each once");
        let of_the_patient: Vec<Tag> = ALLOWED.iter().map(|allowed| allowed.tag).filter(|tag| tag.group() == 0x0010).collect();
        assert_eq!(of_the_patient, [tags::PATIENT_SIZE, tags::PATIENT_WEIGHT]);
        assert!(ALLOWED.iter().all(|allowed| allowed.tag.group() % 2 == 0), "no private group");
    }
}
