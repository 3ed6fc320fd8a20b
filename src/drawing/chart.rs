//! Line charts with axes.

use super::svg::{Anchor, FAINT, INK, Sheet};

/// Where a chart stands on a sheet and what its axes say.
#[derive(Debug, Clone)]
pub struct Chart {
    /// Upper left corner of the plotted area.
    pub corner: (f64, f64),
    /// Its size.
    pub size: (f64, f64),
    /// Values at the left and the right end.
    pub across: (f64, f64),
    /// Values at the lower and the upper end.
    pub upwards: (f64, f64),
    /// What is said above.
    pub title: String,
    /// Name and unit of the horizontal axis.
    pub across_label: &'static str,
    /// Name and unit of the vertical axis; none for a chart beside another with the same one.
    pub upwards_label: Option<&'static str>,
}

impl Chart {
    /// Where a value lies on the sheet.
    pub fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let part = |value: f64, (from, to): (f64, f64)| (value - from) / (to - from);
        (self.corner.0 + part(x, self.across) * self.size.0, self.corner.1 + (1.0 - part(y, self.upwards)) * self.size.1)
    }

    /// Axes, their ticks and the title.
    pub fn axes(&self, sheet: &mut Sheet) {
        let ((left, top), (width, height)) = (self.corner, self.size);
        sheet.text((left + width / 2.0, top - 12.0), 14.0, Anchor::Middle, INK, &self.title);
        for tick in ticks(self.across) {
            let (x, _) = self.place((tick, self.upwards.0));
            sheet.line(&[(x, top), (x, top + height)], "#e4e4e4", 1.0);
            sheet.text((x, top + height + 17.0), 12.0, Anchor::Middle, INK, &label(tick));
        }
        for tick in ticks(self.upwards) {
            let (_, y) = self.place((self.across.0, tick));
            sheet.line(&[(left, y), (left + width, y)], "#e4e4e4", 1.0);
            sheet.text((left - 7.0, y + 4.0), 12.0, Anchor::End, INK, &label(tick));
        }
        sheet.line(&[(left, top), (left, top + height), (left + width, top + height)], INK, 1.2);
        sheet.text((left + width / 2.0, top + height + 38.0), 13.0, Anchor::Middle, INK, self.across_label);
        if let Some(label) = self.upwards_label {
            sheet.upright_text((left - 42.0, top + height / 2.0), 13.0, label);
        }
    }

    /// A level across the chart, with its name at the left end.
    pub fn level(&self, sheet: &mut Sheet, value: f64, name: &str) {
        let (from, to) = (self.place((self.across.0, value)), self.place((self.across.1, value)));
        sheet.line(&[from, to], INK, 1.4);
        sheet.text((from.0 + 4.0, from.1 + 14.0), 11.0, Anchor::Start, FAINT, name);
    }

    /// A disc at a value, held to the plotted area; whether it lies within.
    pub fn disc(&self, sheet: &mut Sheet, (x, y): (f64, f64), radius: f64, colour: &str) -> bool {
        let within = |value: f64, (from, to): (f64, f64)| value.clamp(from, to);
        let held = (within(x, self.across), within(y, self.upwards));
        sheet.disc(self.place(held), radius, colour);
        (held.0 - x).abs() + (held.1 - y).abs() < 1e-9
    }

    /// A line; what lies outside the axes is left out.
    pub fn curve(&self, sheet: &mut Sheet, points: impl IntoIterator<Item = (f64, f64)>, colour: &str, width: f64) {
        let inside = |(x, y): (f64, f64)| {
            let within = |value: f64, (from, to): (f64, f64)| value >= from - 1e-9 && value <= to + 1e-9;
            if within(x, self.across) && within(y, self.upwards) { self.place((x, y)) } else { (f64::NAN, f64::NAN) }
        };
        let points: Vec<(f64, f64)> = points.into_iter().map(inside).collect();
        sheet.line(&points, colour, width);
    }
}

/// Round values between two ends, at most six of them.
fn ticks((from, to): (f64, f64)) -> Vec<f64> {
    let rough = (to - from) / 5.0;
    let power = 10.0_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|factor| factor * power).find(|&step| step >= rough).unwrap_or(rough);
    let (first, last) = ((from / step - 1e-9).ceil() as i64, (to / step + 1e-9).floor() as i64);
    (first..=last).map(|tick| tick as f64 * step).collect()
}

fn label(value: f64) -> String {
    let text = format!("{:.6}", value.abs());
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if value < 0.0 && text != "0" { format!("−{text}") } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks((0.0, 10.0)), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(ticks((-4.0, 12.0)), [0.0, 5.0, 10.0]);
        assert_eq!([0.5, -2.0, 0.0].map(label), ["0.5", "−2", "0"]);
    }
}
