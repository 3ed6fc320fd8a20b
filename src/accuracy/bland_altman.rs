//! Bland-Altman plots of a method's errors. Across lies the truth, not the mean of truth and measurement: the truth is exact here, and
//! a mean with the measurement would tilt the cloud by itself (Krouwer, Stat Med 2008;27:778-780).

use super::{
    family::Group,
    score::{Method, Run, Score},
    statistics::Agreement,
};
use crate::drawing::{
    chart::Chart,
    markdown::signed,
    svg::{Anchor, FAINT, INK, Sheet},
};

/// A quantity that is plotted.
pub struct Quantity {
    /// Name of the file without its ending.
    pub file: &'static str,
    title: &'static str,
    across_label: &'static str,
    upwards_label: &'static str,
    truth: fn(&Score) -> f64,
    error: fn(&Score) -> f64,
}

/// The plots: ejection fraction, volumes and mass.
pub const QUANTITIES: [Quantity; 4] = [
    Quantity {
        file: "ef",
        title: "Ejection fraction",
        across_label: "true EF (%)",
        upwards_label: "found − true (points)",
        truth: |score| score.truth.ef_percent,
        error: Score::ef_points,
    },
    Quantity {
        file: "edv",
        title: "End-diastolic volume",
        across_label: "true EDV (ml)",
        upwards_label: "error (%)",
        truth: |score| score.truth.edv_ml,
        error: Score::edv_percent,
    },
    Quantity {
        file: "esv",
        title: "End-systolic volume",
        across_label: "true ESV (ml)",
        upwards_label: "error (%)",
        truth: |score| score.truth.esv_ml,
        error: Score::esv_percent,
    },
    Quantity {
        file: "mass",
        title: "Mass",
        across_label: "true mass (g)",
        upwards_label: "error (%)",
        truth: |score| score.truth.mass_g,
        error: Score::mass_percent,
    },
];

/// The groups and their colours, told apart by those who see red and green alike.
const GROUPS: [(Group, &str); 3] = [(Group::NoDefect, "#2a6fb0"), (Group::Defect, "#d9541e"), (Group::Small, "#7a4fa3")];
/// Colour of limits of agreement.
const LIMIT: &str = "#999";

/// One quantity by one method as an SVG sheet: a point a study, the bias and limits of agreement of all of them, and those of each group in
/// words.
pub fn draw(runs: &[Run], method: Method, quantity: &Quantity) -> String {
    let chosen: Vec<&Run> = runs.iter().filter(|run| run.method == method && run.group != Group::Negative).collect();
    let points: Vec<(Group, f64, f64)> = chosen
        .iter()
        .filter_map(|run| run.outcome.score().map(|score| (run.group, (quantity.truth)(score), (quantity.error)(score))))
        .collect();
    let all = Agreement::of(chosen.iter().map(|run| run.outcome.score().map(quantity.error)));
    let largest_truth = points.iter().map(|&(_, truth, _)| truth).fold(1.0, f64::max);
    // Four standard deviations beyond the bias, or the worst error where that is nearer; what lies outside is held at the edge and counted.
    let worst = all.worst.map_or(1.0, |(worst, _)| worst.abs());
    let reach = worst.min(all.bias.abs() + 4.0 * if all.sd.is_finite() { all.sd } else { worst }).max(0.5) * 1.08;
    let mut sheet = Sheet::new(760.0, 520.0);
    let chart = Chart {
        corner: (80.0, 50.0),
        size: (640.0, 330.0),
        across: (0.0, largest_truth * 1.05),
        upwards: (-reach, reach),
        title: format!("{}, {}: {} phantoms, {} failed", quantity.title, method.name(), all.studies, all.failed),
        across_label: quantity.across_label,
        upwards_label: Some(quantity.upwards_label),
    };
    chart.axes(&mut sheet);
    if all.sd.is_finite() {
        let (low, high) = all.limits();
        let right = chart.across.1;
        for (value, colour, name) in [(all.bias, INK, "bias"), (low, LIMIT, "−1.96 SD"), (high, LIMIT, "+1.96 SD")] {
            chart.curve(&mut sheet, [(0.0, value), (right, value)], colour, 1.3);
            let (x, y) = chart.place((right, value));
            sheet.text((x - 4.0, y - 4.0), 11.0, Anchor::End, FAINT, &format!("{name} {}", signed(value, 1)));
        }
    }
    let mut outside = 0;
    for &(group, truth, error) in &points {
        let colour = GROUPS.iter().find(|(other, _)| *other == group).map_or(INK, |(_, colour)| colour);
        if !chart.disc(&mut sheet, (truth, error), 2.8, colour) {
            outside += 1;
        }
    }
    legend(&mut sheet, &chosen, quantity);
    if outside > 0 {
        let text = format!("{outside} beyond the axis, drawn at its edge");
        sheet.text((720.0, 500.0), 11.0, Anchor::End, FAINT, &text);
    }
    sheet.finish()
}

fn legend(sheet: &mut Sheet, runs: &[&Run], quantity: &Quantity) {
    for (place, (group, colour)) in GROUPS.iter().enumerate() {
        let of_group = runs.iter().filter(|run| run.group == *group);
        let agreement = Agreement::of(of_group.map(|run| run.outcome.score().map(quantity.error)));
        let y = 450.0 + 20.0 * place as f64;
        sheet.disc((90.0, y - 4.0), 4.0, colour);
        let text = format!(
            "{}: n = {}, {} failed, bias ± SD {}, limits of agreement {}",
            group.name(),
            agreement.studies,
            agreement.failed,
            agreement.text(1),
            agreement.limits_text()
        );
        sheet.text((102.0, y), 12.0, Anchor::Start, INK, &text);
    }
}
