//! The page's curves: volume over the cycle, and the phases of the wall.

use super::numbers::plain;
use crate::{
    drawing::{
        chart::Chart,
        svg::{INK, Sheet},
    },
    report::{CycleSummary, PhaseSummary},
};
use std::f64::consts::TAU;

const CURVE: &str = "#b02418";
const BARS: &str = "#3b6fa0";
/// Points that the curve is drawn through.
const POINTS: usize = 150;

/// The cavity's volume over the R-R interval: the gates, and the Fourier series through them.
pub(super) fn volume(cycle: &CycleSummary) -> String {
    let size = (300.0, 236.0);
    let largest = cycle.gates.iter().map(|gate| gate.endocardial_ml).fold(cycle.fitted_edv_ml, f64::max);
    let chart = Chart {
        corner: (56.0, 12.0),
        size: (234.0, 176.0),
        across: (0.0, 100.0),
        upwards: (0.0, (1.08 * largest / 10.0).ceil() * 10.0),
        title: String::new(),
        across_label: "% of the R-R interval",
        upwards_label: Some("ml"),
    };
    let mut sheet = Sheet::new(size.0, size.1);
    chart.axes(&mut sheet);
    let series = |part: f64| {
        let wave = |(order, harmonic): (f64, &crate::report::Harmonic)| {
            harmonic.amplitude_ml * (TAU * order * part - harmonic.phase_degrees.to_radians()).cos()
        };
        cycle.mean_ml + (1..).map(f64::from).zip(&cycle.harmonics).map(wave).sum::<f64>()
    };
    let points = (0..=POINTS).map(|point| point as f64 / POINTS as f64).map(|part| (100.0 * part, series(part)));
    chart.curve(&mut sheet, points, CURVE, 2.0);
    for gate in &cycle.gates {
        chart.disc(&mut sheet, (gate.rr_percent, gate.endocardial_ml), 3.4, INK);
    }
    let values: Vec<String> = cycle.gates.iter().map(|gate| format!("{:.0} % {:.0} ml", gate.rr_percent, gate.endocardial_ml)).collect();
    let svg = sheet.described("curve", "Volume of the cavity over the R-R interval", &format!("{}.", values.join(", ")));
    format!(
        "<h2>Time-volume curve</h2>{svg}<p class=\"aside\">Points: gates. Line: Fourier series of {} harmonic{}, {:.1} ml RMS from the gates.</p>",
        cycle.harmonics.len(),
        if cycle.harmonics.len() == 1 { "" } else { "s" },
        cycle.residual_ml
    )
}

/// The histogram of phases and its widths.
pub(super) fn phases(phase: &PhaseSummary) -> String {
    let size = (250.0, 132.0);
    let largest = phase.histogram_percent.iter().copied().fold(5.0, f64::max);
    let chart = Chart {
        corner: (34.0, 8.0),
        size: (206.0, 82.0),
        across: (0.0, 360.0),
        upwards: (0.0, (largest / 5.0).ceil() * 5.0),
        title: String::new(),
        across_label: "degrees of the R-R interval",
        upwards_label: None,
    };
    let mut sheet = Sheet::new(size.0, size.1);
    chart.axes(&mut sheet);
    let width = 360.0 / phase.histogram_percent.len().max(1) as f64;
    for (bin, &percent) in phase.histogram_percent.iter().enumerate().filter(|(_, percent)| **percent > 0.0) {
        let ((left, top), (right, bottom)) = (chart.place((width * bin as f64, percent)), chart.place((width * (bin + 1) as f64, 0.0)));
        sheet.rectangle((left, top), (right - left - 0.4, bottom - top), BARS);
    }
    let said = format!(
        "Mean {:.0} degrees, standard deviation {:.0}, 95 % of the wall within {:.0}.",
        phase.mean_degrees, phase.sd_degrees, phase.bandwidth_95_degrees
    );
    let svg = sheet.described("phases", "Histogram of the wall's phases, percent of its area", &said);
    format!(
        "<h2>Phase histogram, % of wall</h2>{svg}<table>{}{}{}{}</table>",
        plain("Mean", phase.mean_degrees, 0, "°"),
        plain("Standard deviation", phase.sd_degrees, 1, "°"),
        plain("Bandwidth 95 %", phase.bandwidth_95_degrees, 0, "°"),
        plain("Entropy", phase.entropy_percent, 0, "%"),
    )
}
