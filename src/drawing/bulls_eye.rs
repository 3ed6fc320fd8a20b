//! The bull's-eye: a polar map in colours, the outlines of the seventeen segments over it, their means, and a colour bar.

use super::{marks::Mark, polar::PolarField, svg::Anchor};

/// Rings of segments from the middle: where each ends, where its numbers stand, and how many segments it has, the first about anterior.
const RINGS: [(f64, f64, usize, usize); 4] = [(0.25, 0.0, 17, 1), (0.5, 0.375, 13, 4), (0.75, 0.625, 7, 6), (1.0, 0.87, 1, 6)];
/// Pixels of the coloured disc a unit of its radius.
const DISC_PIXELS: f64 = 2.0;
/// Chords that a circle is drawn with.
const CHORDS: usize = 120;

const WHITE: [f32; 3] = [1.0; 3];
const BLACK: [f32; 3] = [0.0; 3];
const INK: [f32; 3] = [0.133; 3];
const FAINT: [f32; 3] = [0.35; 3];

/// A map and what is written at it.
#[derive(Debug, Clone)]
pub struct BullsEye<'a> {
    /// The values and their colours.
    pub field: PolarField<'a>,
    /// Means of the segments, the first one first.
    pub segments: &'a [Option<f64>],
    /// What is shown.
    pub title: &'a str,
    /// Its unit as it is written: `%`, `mm`, `°`.
    pub unit: &'a str,
    /// Digits after the point of the segments' means.
    pub decimals: usize,
    /// A remark below; empty for none.
    pub note: &'a str,
}

/// Size of a whole drawing by [`BullsEye::sheet`].
pub const SHEET: (f64, f64) = (450.0, 400.0);
/// Size of a small drawing by [`BullsEye::small`].
pub const SMALL: (f64, f64) = (200.0, 226.0);

impl BullsEye<'_> {
    /// The whole drawing, of the size [`SHEET`].
    pub fn sheet(&self) -> Vec<Mark> {
        let (centre, radius) = ((192.0, 216.0), 145.0);
        let mut marks = vec![text((14.0, 20.0), 16.0, Anchor::Start, INK, self.title)];
        marks.extend(self.disc(centre, radius, 12.0));
        let far = radius + 13.0;
        for (name, (x, y), upright) in [
            ("anterior", (0.0, -far), false),
            ("septal", (-far, 0.0), true),
            ("inferior", (0.0, far), false),
            ("lateral", (far, 0.0), true),
        ] {
            let mark = text((centre.0 + x, centre.1 + y), 12.0, Anchor::Middle, FAINT, name);
            marks.push(if upright { turned(mark) } else { mark });
        }
        let (left, top, width, height) = (378.0, 92.0, 16.0, 248.0);
        for step in 0..height as usize {
            let part = 1.0 - (step as f64 + 0.5) / height;
            marks.push(Mark::Rectangle { at: (left, top + step as f64), size: (width, 1.0), colour: self.field.scale.colour(part) });
        }
        marks.push(frame((left, top), (width, height)));
        marks.push(text((left, top - 16.0), 12.0, Anchor::Start, INK, self.unit));
        for tick in self.ticks() {
            let y = top + height * (1.0 - self.part(tick));
            marks.push(line(&[(left + width, y), (left + width + 4.0, y)], INK, 1.0));
            marks.push(text((left + width + 8.0, y), 12.0, Anchor::Start, INK, &number(tick, 0)));
        }
        if !self.note.is_empty() {
            marks.push(text((14.0, 388.0), 10.0, Anchor::Start, FAINT, self.note));
        }
        marks
    }

    /// A small one for a page that says elsewhere what it is, of the size [`SMALL`].
    pub fn small(&self) -> Vec<Mark> {
        let (centre, radius) = ((100.0, 96.0), 80.0);
        let mut marks = self.disc(centre, radius, 14.0);
        let far = radius + 9.0;
        for (name, (x, y)) in [("A", (0.0, -far)), ("S", (-far, 0.0)), ("I", (0.0, far)), ("L", (far, 0.0))] {
            marks.push(text((centre.0 + x, centre.1 + y), 13.0, Anchor::Middle, FAINT, name));
        }
        let (left, top, width, height) = (28.0, 197.0, 144.0, 9.0);
        for step in 0..(width / 2.0) as usize {
            let part = (2.0 * step as f64 + 1.0) / width;
            marks.push(Mark::Rectangle { at: (left + 2.0 * step as f64, top), size: (2.2, height), colour: self.field.scale.colour(part) });
        }
        marks.push(frame((left, top), (width, height)));
        for tick in self.ticks() {
            let x = left + width * self.part(tick);
            marks.push(line(&[(x, top + height), (x, top + height + 3.0)], INK, 0.8));
            marks.push(text((x, top + height + 11.0), 13.0, Anchor::Middle, INK, &number(tick, 0)));
        }
        marks
    }

    /// The coloured disc, its outlines and the segments' means.
    fn disc(&self, centre: (f64, f64), radius: f64, size: f64) -> Vec<Mark> {
        // White around: the rim is drawn over the last pixel.
        let pixels = ((2.0 * radius + 4.0) * DISC_PIXELS) as usize;
        let side = pixels as f64 / DISC_PIXELS;
        let picture = self.field.picture(pixels, radius * DISC_PIXELS, WHITE);
        let mut marks = vec![Mark::Picture { at: (centre.0 - side / 2.0, centre.1 - side / 2.0), side, picture }];
        let place = |part: f64, degrees: f64| {
            let (sine, cosine) = degrees.to_radians().sin_cos();
            (centre.0 - part * radius * sine, centre.1 - part * radius * cosine)
        };
        let circle = |part: f64| (0..=CHORDS).map(|chord| place(part, 360.0 * chord as f64 / CHORDS as f64)).collect::<Vec<_>>();
        let mut lines: Vec<Vec<(f64, f64)>> = RINGS[..3].iter().map(|(end, ..)| circle(*end)).collect();
        for pair in RINGS.windows(2) {
            let ((from, ..), (to, _, _, count)) = (pair[0], pair[1]);
            lines.extend((0..count).map(|index| {
                let degrees = 360.0 * (index as f64 + 0.5) / count as f64;
                vec![place(from, degrees), place(to, degrees)]
            }));
        }
        // White in black: seen on every colour of a scale.
        marks.push(Mark::Lines { lines: lines.clone(), colour: BLACK, width: 2.2, opacity: 0.45 });
        marks.push(Mark::Lines { lines, colour: WHITE, width: 0.9, opacity: 0.9 });
        marks.push(Mark::Lines { lines: vec![circle(1.0)], colour: INK, width: 1.6, opacity: 1.0 });
        for (_, at, first, count) in RINGS {
            for index in 0..count {
                let Some(value) = self.segments.get(first + index - 1).copied().flatten() else { continue };
                let mark = text(place(at, 360.0 * index as f64 / count as f64), size, Anchor::Middle, WHITE, &number(value, self.decimals));
                marks.push(match mark {
                    Mark::Text { at, size, anchor, colour, upright, text, .. } => {
                        Mark::Text { at, size, anchor, colour, halo: Some(BLACK), upright, text }
                    }
                    other => other,
                });
            }
        }
        marks
    }

    /// Where a value stands on the bar, 0-1.
    fn part(&self, value: f64) -> f64 {
        let [low, high] = self.field.range;
        (value - low) / (high - low)
    }

    /// Round values of the bar: quarters of a turn, else at most six.
    fn ticks(&self) -> Vec<f64> {
        let [low, high] = self.field.range;
        let step = if self.field.cyclic {
            90.0
        } else {
            [1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 25.0, 50.0, 100.0].into_iter().find(|step| (high - low) / step <= 5.0).unwrap_or(high - low)
        };
        let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
        (first..=last).map(|tick| tick as f64 * step).collect()
    }
}

/// A number with a true minus, and no minus before zero.
pub fn number(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let zero = text.chars().all(|letter| matches!(letter, '0' | '.'));
    if value < 0.0 && !zero { format!("-{text}") } else { text }
}

fn text(at: (f64, f64), size: f64, anchor: Anchor, colour: [f32; 3], text: &str) -> Mark {
    Mark::Text { at, size, anchor, colour, halo: None, upright: false, text: text.to_owned() }
}

fn turned(mark: Mark) -> Mark {
    match mark {
        Mark::Text { at, size, anchor, colour, halo, text, .. } => Mark::Text { at, size, anchor, colour, halo, upright: true, text },
        other => other,
    }
}

fn line(points: &[(f64, f64)], colour: [f32; 3], width: f64) -> Mark {
    Mark::Lines { lines: vec![points.to_vec()], colour, width, opacity: 1.0 }
}

fn frame((left, top): (f64, f64), (width, height): (f64, f64)) -> Mark {
    let (right, bottom) = (left + width, top + height);
    line(&[(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], INK, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::scale::Scale;

    #[test]
    fn every_segment_has_its_number_where_the_statement_puts_it() {
        let values = vec![vec![Some(50.0); 12]; 4];
        let field = PolarField { values: &values, range: [0.0, 100.0], scale: Scale::Inferno, cyclic: false };
        let segments: Vec<Option<f64>> = (1..=17).map(|number| (number != 9).then(|| f64::from(number))).collect();
        let drawing = BullsEye { field, segments: &segments, title: "Perfusion", unit: "%", decimals: 0, note: "" };
        let marks = drawing.sheet();
        let place = |wanted: &str| {
            marks.iter().find_map(|mark| match mark {
                Mark::Text { at, halo: Some(_), text, .. } if text == wanted => Some((at.0 - 192.0, at.1 - 216.0)),
                _ => None,
            })
        };
        let (x, y) = place("17").unwrap();
        assert!(x.abs() < 1e-9 && y.abs() < 1e-9);
        // 2 basal anteroseptal: up left; 11 mid inferolateral: down right; 14 apical septal: left.
        let (x, y) = place("2").unwrap();
        assert!(x < -100.0 && y < -60.0, "{x} {y}");
        let (x, y) = place("11").unwrap();
        assert!(x > 70.0 && y > 40.0, "{x} {y}");
        let (x, y) = place("14").unwrap();
        assert!(x < -50.0 && y.abs() < 1e-9, "{x} {y}");
        assert_eq!(place("9"), None, "a segment without a value has no number");
        let numbers = |marks: &[Mark]| marks.iter().filter(|mark| matches!(mark, Mark::Text { halo: Some(_), .. })).count();
        assert_eq!((numbers(&marks), numbers(&drawing.small())), (16, 16));
    }

    #[test]
    fn bars_have_few_round_ticks() {
        let values = vec![vec![None]];
        for (range, cyclic, expected) in [
            ([0.0, 100.0], false, vec![0.0, 20.0, 40.0, 60.0, 80.0, 100.0]),
            ([-25.0, 100.0], false, vec![-25.0, 0.0, 25.0, 50.0, 75.0, 100.0]),
            ([-3.0, 12.0], false, vec![-3.0, 0.0, 3.0, 6.0, 9.0, 12.0]),
            ([0.0, 20.0], false, vec![0.0, 5.0, 10.0, 15.0, 20.0]),
            ([0.0, 360.0], true, vec![0.0, 90.0, 180.0, 270.0, 360.0]),
        ] {
            let field = PolarField { values: &values, range, scale: Scale::Viridis, cyclic };
            assert_eq!(BullsEye { field, segments: &[], title: "", unit: "", decimals: 0, note: "" }.ticks(), expected);
        }
        assert_eq!([number(-0.04, 1), number(-3.0, 0), number(9.96, 1)], ["0.0", "-3", "10.0"]);
    }
}
