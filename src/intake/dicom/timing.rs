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

/// The items of Data Information (0054,0063) by items of Gated Information (0054,0062).
pub(super) fn data_information(attributes: &Attributes) -> Vec<Vec<Attributes>> {
    attributes.items(tags::GATED_INFORMATION_SEQUENCE).iter().map(|gated| gated.items(tags::DATA_INFORMATION_SEQUENCE)).collect()
}

/// The items of Data Information that describe one R-R interval, of which the file has several (`Some`, counted from 0) or one.
///
/// An item of Gated Information is an interval (PS3.3 C.8.4.13). A file of several intervals with one such item, as older ones are, has an
/// item of Data Information for each.
pub(super) fn of_interval(attributes: &Attributes, rr_interval: Option<usize>) -> Vec<Attributes> {
    let mut gated = data_information(attributes);
    match (rr_interval, gated.len()) {
        (Some(interval), 1) => gated.remove(0).into_iter().nth(interval).into_iter().collect(),
        (interval, _) => gated.into_iter().nth(interval.unwrap_or(0)).unwrap_or_default(),
    }
}

/// Frame Time, R-R interval and heart rate: from Data Information where the standard puts them, else from the outermost data set.
pub(super) fn read(object: &Object<'_>, rr_interval: Option<usize>, gates: usize, warnings: &mut Vec<Warning>) -> Timing {
    let attributes = &object.attributes;
    let heart_rate_bpm = attributes.positive(tags::HEART_RATE).filter(|rate| (20.0..=300.0).contains(rate));
    if gates == 1 {
        return Timing { durations_ms: vec![None], rr_interval_ms: None, heart_rate_bpm };
    }
    let mut items = of_interval(attributes, rr_interval);
    if items.is_empty() {
        // Another interval's gates last about as long.
        items = of_interval(attributes, None);
    }
    let find = |tag| items.iter().find_map(|item| item.positive(tag)).or_else(|| attributes.positive(tag));
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
