//! Which beats the images are made of. Nothing here is needed for the volumes, so nothing here refuses a file.

use super::attributes::Attributes;
use super::timing::of_interval;
use crate::study::Warning;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use std::collections::BTreeSet;
use std::ops::RangeInclusive;

/// Most beats of an acquisition: a day at 300 a minute has half as many.
const MOST_BEATS: f64 = 1e6;
/// Longest R-R interval that a window lets in, in ms: from 200 ms, since some cameras write seconds or percent, to one that is hardly a limit.
const LONGEST_INTERVAL_MS: RangeInclusive<f64> = 200.0..=10_000.0;

/// What the file says of beats.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Gating {
    pub(super) beats_accepted: Option<u64>,
    pub(super) beats_rejected: Option<u64>,
    pub(super) rr_window_ms: Option<[f64; 2]>,
    pub(super) beat_rejection: Option<bool>,
}

/// What one item of Data Information (0054,0063) says.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Beats {
    accepted: Option<u64>,
    rejected: Option<u64>,
    window_ms: Option<[f64; 2]>,
}

/// Reads the beats of one R-R interval, of which the file has several (`Some`, counted from 0) or one; from the outermost data set where no
/// item describes it. What makes no sense is left out, with a warning.
pub(super) fn read(attributes: &Attributes, rr_interval: Option<usize>, warnings: &mut Vec<Warning>) -> Gating {
    let items = of_interval(attributes, rr_interval);
    let mut senseless = BTreeSet::new();
    let told: Vec<Beats> = if items.is_empty() && rr_interval.is_none() {
        vec![Beats::of(attributes, &mut senseless)]
    } else {
        items.iter().map(|item| Beats::of(item, &mut senseless)).collect()
    };
    for name in senseless {
        let message = format!("{name} has a value that makes no sense; the report leaves it out.");
        warnings.push(Warning::new("implausible_gating", message));
    }
    let beat_rejection = match attributes.text(tags::BEAT_REJECTION_FLAG).as_deref() {
        Some("Y") => Some(true),
        Some("N") => Some(false),
        _ => None,
    };
    Gating { beat_rejection, ..together(&told) }
}

impl Beats {
    fn of(item: &Attributes, senseless: &mut BTreeSet<&'static str>) -> Self {
        let mut number = |tag: Tag, name: &'static str, sensible: &dyn Fn(f64) -> bool| match item.number(tag, name) {
            Ok(None) => None,
            Ok(Some(number)) if sensible(number) => Some(number),
            _ => {
                senseless.insert(name);
                None
            }
        };
        let accepted = number(tags::INTERVALS_ACQUIRED, "Intervals Acquired (0018,1083)", &|beats| (1.0..=MOST_BEATS).contains(&beats));
        let rejected = number(tags::INTERVALS_REJECTED, "Intervals Rejected (0018,1084)", &|beats| (0.0..=MOST_BEATS).contains(&beats));
        let low = number(tags::LOW_RR_VALUE, "Low R-R Value (0018,1081)", &|low| low >= 0.0);
        let high = number(tags::HIGH_RR_VALUE, "High R-R Value (0018,1082)", &|high| {
            LONGEST_INTERVAL_MS.contains(&high) && low.is_none_or(|low| low < high)
        });
        Self {
            accepted: accepted.map(|beats| beats.round() as u64),
            rejected: rejected.map(|beats| beats.round() as u64),
            window_ms: low.zip(high).map(|(low, high)| [low, high]),
        }
    }
}

/// What several items say of one image. Those of one window tell of the same beats (some cameras write an item a detector or a time slot): the one
/// with most accepted ones counts. Those of different windows tell of different beats, which add up; what one window rejects another may accept.
fn together(told: &[Beats]) -> Gating {
    let mut windows: Vec<Beats> = Vec::new();
    for beats in told {
        match windows.iter_mut().find(|other| other.window_ms == beats.window_ms) {
            None => windows.push(*beats),
            Some(other) if beats.accepted > other.accepted => *other = *beats,
            Some(_) => {}
        }
    }
    let accepted: Vec<u64> = windows.iter().filter_map(|window| window.accepted).collect();
    let sum: u64 = accepted.iter().sum();
    let all = windows.iter().filter_map(|window| Some(window.accepted? + window.rejected?)).max();
    let rejected = if windows.len() > 1 { all.map(|all| all.saturating_sub(sum)) } else { windows.first().and_then(|one| one.rejected) };
    let limits: Vec<[f64; 2]> = windows.iter().filter_map(|window| window.window_ms).collect();
    let window = limits.iter().copied().reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])]);
    Gating { beats_accepted: (!accepted.is_empty()).then_some(sum), beats_rejected: rejected, rr_window_ms: window, beat_rejection: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beats(accepted: u64, rejected: u64, window_ms: [f64; 2]) -> Beats {
        Beats { accepted: Some(accepted), rejected: Some(rejected), window_ms: Some(window_ms) }
    }

    #[test]
    fn items_of_one_window_are_the_same_beats_and_those_of_others_add_up() {
        let (normal, short) = ([700.0, 1100.0], [400.0, 700.0]);
        let detectors = together(&[beats(480, 20, normal), beats(500, 21, normal)]);
        assert_eq!((detectors.beats_accepted, detectors.beats_rejected), (Some(500), Some(21)));
        // Of 560 beats 500 are normal and 40 short: 20 are neither.
        let windows = together(&[beats(500, 60, normal), beats(40, 520, short)]);
        assert_eq!((windows.beats_accepted, windows.beats_rejected), (Some(540), Some(20)));
        assert_eq!(windows.rr_window_ms, Some([400.0, 1100.0]));
        assert_eq!(together(&[]), Gating::default());
    }
}
