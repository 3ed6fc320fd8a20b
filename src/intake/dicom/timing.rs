//! How long the gates and the cardiac cycle last. Nothing here is needed for the volumes, so nothing here refuses a file.

use super::attributes::Attributes;
use super::object::Object;
use crate::study::Warning;
use dicom_dictionary_std::tags;

/// What the file says of time.
pub(super) struct Timing {
    pub(super) durations_ms: Vec<Option<f64>>,
    pub(super) rr_interval_ms: Option<f64>,
    pub(super) heart_rate_bpm: Option<f64>,
}

/// The items of Data Information (0054,0063) within Gated Information (0054,0062): one an R-R interval.
pub(super) fn data_information(attributes: &Attributes) -> Vec<Attributes> {
    attributes.items(tags::GATED_INFORMATION_SEQUENCE).first().map(|gated| gated.items(tags::DATA_INFORMATION_SEQUENCE)).unwrap_or_default()
}

/// Frame Time, R-R interval and heart rate: from Data Information where the standard puts them, else from the outermost data set.
pub(super) fn read(object: &Object<'_>, rr_interval: usize, gates: usize, warnings: &mut Vec<Warning>) -> Timing {
    let attributes = &object.attributes;
    let heart_rate_bpm = attributes.positive(tags::HEART_RATE).filter(|rate| (20.0..=300.0).contains(rate));
    if gates == 1 {
        return Timing { durations_ms: vec![None], rr_interval_ms: None, heart_rate_bpm };
    }
    let items = data_information(attributes);
    let item = items.get(rr_interval).or_else(|| items.first());
    let find = |tag| item.and_then(|item| item.positive(tag)).or_else(|| attributes.positive(tag));
    // Some cameras write seconds or microseconds here; a time slot lasts 5 ms (32 at 300 a minute) to 1 s.
    let frame_time_ms = find(tags::FRAME_TIME).filter(|time| (5.0..=1000.0).contains(time));
    if frame_time_ms.is_none() {
        warnings.push(Warning::new(
            "missing_frame_time",
            "Frame Time (0018,1063) is missing or implausible; the gates were taken as equal parts of the cycle.",
        ));
    }
    let window = find(tags::LOW_RR_VALUE).zip(find(tags::HIGH_RR_VALUE)).map(|(low, high)| f64::midpoint(low, high));
    let rr_interval_ms = find(tags::NOMINAL_INTERVAL)
        .or_else(|| frame_time_ms.map(|time| time * gates as f64))
        .or_else(|| heart_rate_bpm.map(|rate| 60_000.0 / rate))
        .or(window)
        .filter(|interval| (200.0..=3000.0).contains(interval));
    Timing { durations_ms: vec![frame_time_ms; gates], rr_interval_ms, heart_rate_bpm }
}
