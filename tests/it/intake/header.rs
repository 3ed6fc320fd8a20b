//! What the header says beside the images: beats, the window they were chosen by, the patient's height and weight.

use super::nuclear::{gated, gated_with, standard, with};
use super::read_one;
use super::writer::{Element, Syntax, file, items, text, words};
use serde_json::json;
use ventricle::{
    intake::{Limits, examine},
    phantom::{self, Phantom},
    study::{Acquisition, Warning},
};

const SIZE: (u16, u16) = (0x10, 0x1020);
const WEIGHT: (u16, u16) = (0x10, 0x1030);

fn read(bytes: &[u8]) -> (Acquisition, Vec<Warning>) {
    let study = read_one(bytes).unwrap_or_else(|error| panic!("{error}")).study;
    (study.acquisition, study.warnings)
}

/// An item of Data Information: accepted, rejected, low, high.
fn data([accepted, rejected, low, high]: [&str; 4]) -> Vec<Element> {
    vec![
        text((0x18, 0x1063), "DS", "450"),
        text((0x18, 0x1081), "IS", low),
        text((0x18, 0x1082), "IS", high),
        text((0x18, 0x1083), "IS", accepted),
        text((0x18, 0x1084), "IS", rejected),
    ]
}

/// Gated Information with one item, which holds these.
fn gated_information(data_information: Vec<Vec<Element>>) -> Element {
    items((0x54, 0x62), vec![vec![items((0x54, 0x63), data_information)]])
}

fn beats(acquisition: &Acquisition) -> (Option<u64>, Option<u64>, Option<[f64; 2]>) {
    (acquisition.beats_accepted, acquisition.beats_rejected, acquisition.rr_window_ms)
}

#[test]
fn beats_and_their_window_are_read() {
    let information = gated_information(vec![data(["482", "18", "720", "1080"])]);
    let (acquisition, warnings) = read(&with(vec![information, text((0x18, 0x1080), "CS", "Y")]));
    assert_eq!(beats(&acquisition), (Some(482), Some(18), Some([720.0, 1080.0])));
    assert_eq!((acquisition.beat_rejection, warnings), (Some(true), vec![]));
    // Old files have them in the outermost data set.
    let outermost = vec![items((0x54, 0x62), vec![]), text((0x18, 0x1083), "IS", "300"), text((0x18, 0x1063), "DS", "450")];
    let (acquisition, _) = read(&with(outermost));
    assert_eq!((beats(&acquisition), acquisition.beat_rejection), ((Some(300), None, None), None));
}

#[test]
fn of_several_intervals_the_beats_are_those_of_the_images_that_were_taken() {
    let mut order = standard();
    order.extend(standard());
    let rr: Vec<u16> = (0..order.len()).map(|frame| if frame < 8 { 1 } else { 2 }).collect();
    let (ectopic, normal) = (data(["30", "470", "400", "700"]), data(["460", "40", "700", "1100"]));
    // An item of Data Information an interval, and an item of Gated Information an interval, as the standard has it now.
    let nested = gated_information(vec![ectopic.clone(), normal.clone()]);
    let apart = items((0x54, 0x62), vec![vec![items((0x54, 0x63), vec![ectopic])], vec![items((0x54, 0x63), vec![normal])]]);
    for information in [nested, apart] {
        let (acquisition, warnings) = read(&gated_with(&order, vec![words((0x54, 0x60), &rr), information]));
        assert_eq!(warnings.iter().map(|warning| warning.code.as_str()).collect::<Vec<_>>(), ["several_rr_intervals"]);
        assert!(warnings[0].message.contains("interval 2"), "{}", warnings[0].message);
        assert_eq!(beats(&acquisition), (Some(460), Some(40), Some([700.0, 1100.0])));
    }
    // The frames of the second interval alone.
    let both = items(
        (0x54, 0x62),
        vec![
            vec![items((0x54, 0x63), vec![data(["30", "470", "400", "700"])])],
            vec![items((0x54, 0x63), vec![data(["460", "40", "700", "1100"])])],
        ],
    );
    let (acquisition, warnings) = read(&with(vec![words((0x54, 0x60), &[2; 8]), both]));
    assert_eq!((beats(&acquisition), warnings), ((Some(460), Some(40), Some([700.0, 1100.0])), vec![]));
    // One interval, told once a detector.
    let detectors = gated_information(vec![data(["455", "39", "700", "1100"]), data(["460", "40", "700", "1100"])]);
    assert_eq!(beats(&read(&with(vec![detectors])).0), (Some(460), Some(40), Some([700.0, 1100.0])));
}

#[test]
fn beats_that_make_no_sense_are_left_out_and_said() {
    let cases = [
        (["0", "5", "700", "1100"], (None, Some(5), Some([700.0, 1100.0])), "Intervals Acquired"),
        (["-3", "5", "700", "1100"], (None, Some(5), Some([700.0, 1100.0])), "Intervals Acquired"),
        (["500", "-1", "700", "1100"], (Some(500), None, Some([700.0, 1100.0])), "Intervals Rejected"),
        (["many", "5", "700", "1100"], (None, Some(5), Some([700.0, 1100.0])), "Intervals Acquired"),
        // Percent, seconds, the wrong way round.
        (["500", "5", "80", "120"], (Some(500), Some(5), None), "High R-R Value"),
        (["500", "5", "0", "1"], (Some(500), Some(5), None), "High R-R Value"),
        (["500", "5", "1100", "700"], (Some(500), Some(5), None), "High R-R Value"),
        (["500", "5", "-1", "1100"], (Some(500), Some(5), None), "Low R-R Value"),
    ];
    for (written, expected, named) in cases {
        let (acquisition, warnings) = read(&with(vec![gated_information(vec![data(written)])]));
        assert_eq!(beats(&acquisition), expected, "{written:?}");
        assert_eq!(warnings.len(), 1, "{written:?}: {warnings:?}");
        assert_eq!(warnings[0].code, "implausible_gating");
        assert!(warnings[0].message.starts_with(named), "{}", warnings[0].message);
    }
    // Absent and empty are no fault.
    let empty = gated_information(vec![data(["", "", "", ""])]);
    assert_eq!(read(&with(vec![empty])), read(&with(vec![gated_information(vec![vec![text((0x18, 0x1063), "DS", "450")]])])));
}

#[test]
fn height_and_weight_are_read_in_their_units_or_left_out_with_a_word() {
    let body = |size: &str, weight: &str| read(&with(vec![text(SIZE, "DS", size), text(WEIGHT, "DS", weight)]));
    let (acquisition, warnings) = body("1.72", "81.5");
    assert_eq!((acquisition.height_m, acquisition.weight_kg, warnings), (Some(1.72), Some(81.5), vec![]));
    let (acquisition, warnings) = body("", "");
    assert_eq!((acquisition.height_m, acquisition.weight_kg, warnings), (None, None, vec![]));
    for (size, told) in [("172", "172 m"), ("0", "0 m"), ("-1.7", "-1.7 m"), ("0.29", "0.29 m"), ("2.51", "2.51 m"), ("1E300", " m")] {
        let (acquisition, warnings) = body(size, "81.5");
        assert_eq!((acquisition.height_m, acquisition.weight_kg), (None, Some(81.5)), "{size}");
        assert_eq!((warnings.len(), warnings[0].code.as_str()), (1, "implausible_body_size"));
        let message = &warnings[0].message;
        assert!(message.contains(told) && message.contains("metadata.height_m") && message.len() < 400, "{message}");
    }
    for weight in ["0", "-80", "1.9", "401", "81500"] {
        let (acquisition, warnings) = body("1.72", weight);
        assert_eq!((acquisition.height_m, acquisition.weight_kg), (Some(1.72), None), "{weight}");
        assert!(warnings[0].message.contains("metadata.weight_kg"), "{}", warnings[0].message);
    }
    // A field that was misused is not repeated, and refuses nothing.
    let (acquisition, warnings) = body("Nobody^Nowhere", "1.5\u{e9}");
    assert_eq!((acquisition.height_m, acquisition.weight_kg, warnings.len()), (None, None, 2));
    assert!(warnings.iter().all(|warning| warning.message.contains("no number") && !warning.message.contains("Nobody")), "{warnings:?}");
}

/// What waits for the rest of its study keeps them, and no name.
#[test]
fn the_excerpt_of_a_part_keeps_beats_and_body() {
    let information = gated_information(vec![data(["482", "18", "720", "1080"])]);
    let body = [text(SIZE, "DS", "1.72"), text(WEIGHT, "DS", "81.5")];
    let whole = with([information].into_iter().chain(body).collect());
    let excerpt = examine(&whole, false, &Limits::default()).unwrap().excerpt;
    assert_eq!(read(&excerpt), read(&whole));
    assert_eq!(read(&excerpt).0.height_m, Some(1.72));
    assert!(!excerpt.windows(6).any(|bytes| bytes == b"Nobody") && whole.windows(6).any(|bytes| bytes == b"Nobody"));
    assert_eq!(read(&file(&gated(&standard(), Syntax::Explicit), Syntax::Explicit)).0.height_m, None);
}

#[test]
fn the_phantom_s_file_says_what_the_phantom_does() {
    let mut study = phantom::simulate(&Phantom::small()).unwrap().study;
    study.acquisition.height_m = Some(1.6);
    study.acquisition.weight_kg = Some(54.5);
    study.acquisition.beats_rejected = Some(12);
    let (acquisition, warnings) = read(&phantom::dicom::write(&study).unwrap());
    assert_eq!((beats(&acquisition), warnings), ((Some(1000), Some(12), Some([666.0, 1000.0])), vec![]));
    assert_eq!((acquisition.beat_rejection, acquisition.height_m, acquisition.weight_kg), (Some(true), Some(1.6), Some(54.5)));
}

/// What was stored before these were kept is still read.
#[test]
fn a_stored_acquisition_of_before_is_read() {
    let (acquisition, _) = read(&with(vec![]));
    let mut before = json!(acquisition);
    for later in ["beats_accepted", "beats_rejected", "rr_window_ms", "beat_rejection", "height_m", "weight_kg"] {
        assert!(before.as_object_mut().unwrap().remove(later).is_some(), "{later}");
    }
    let read: Acquisition = serde_json::from_value(before).unwrap();
    assert_eq!(read, Acquisition { beats_accepted: None, ..acquisition });
}
