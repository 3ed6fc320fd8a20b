//! Figure 5 (§7.1): the distance of particles to the border over time, without and with freezing.

use super::super::{
    PaperError,
    oscillation::{FOLLOWED_S, PARTICLES, measure},
};
use crate::{
    drawing::chart::Chart,
    drawing::svg::{Anchor, FAINT, INK, Sheet},
};

/// Distances that are drawn, in mm.
const SHOWN_MM: (f64, f64) = (-30.0, 30.0);
/// The colours of single particles (Okabe and Ito's, which the colour-blind tell apart).
const COLOURS: [&str; PARTICLES.len()] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00"];

/// Both courses beside each other.
pub(super) fn draw() -> Result<String, PaperError> {
    let mut sheet = Sheet::new(900.0, 440.0);
    sheet.text((450.0, 26.0), 16.0, Anchor::Middle, INK, "Distance of particles to the border of the outer surface");
    for (panel, course) in measure()?.iter().enumerate() {
        let chart = Chart {
            corner: (75.0 + 415.0 * panel as f64, 70.0),
            size: (385.0, 280.0),
            across: (0.0, FOLLOWED_S),
            upwards: SHOWN_MM,
            title: ["without freezing", "frozen on the first border voxel"][panel].to_owned(),
            across_label: "simulated time (s)",
            upwards_label: (panel == 0).then_some("distance to the border (mm), positive outside"),
        };
        chart.axes(&mut sheet);
        chart.level(&mut sheet, 0.0, "border");
        let curve = |values: &[f64]| course.time_s.iter().copied().zip(values.iter().copied()).collect::<Vec<_>>();
        for (colour, values) in COLOURS.iter().zip(&course.particles_mm) {
            chart.curve(&mut sheet, curve(values), colour, 1.5);
        }
        chart.curve(&mut sheet, curve(&course.mean_mm), INK, 2.6);
    }
    legend(&mut sheet);
    Ok(sheet.finish())
}

fn legend(sheet: &mut Sheet) {
    let y = 416.0;
    for (index, colour) in COLOURS.iter().enumerate() {
        let x = 150.0 + 22.0 * index as f64;
        sheet.line(&[(x, y - 4.0), (x + 18.0, y - 4.0)], colour, 2.0);
    }
    sheet.text((268.0, y), 13.0, Anchor::Start, INK, "single particles");
    sheet.line(&[(400.0, y - 4.0), (430.0, y - 4.0)], INK, 2.6);
    sheet.text((438.0, y), 13.0, Anchor::Start, INK, "mean of all 642, without sign");
    sheet.text((890.0, 434.0), 10.0, Anchor::End, FAINT, "free model, RK4, Δt 0.05 s, damping 1 %, not smoothed");
}
