//! Runs as tables.

use super::{
    family::{FAMILIES, Group},
    score::{Method, Run, Score, Values},
    statistics::{Agreement, correlation, coverage_percent, known, mean},
};
use crate::{
    drawing::markdown::{Table, signed},
    pipeline::Surface,
};

/// What a row of a table is about.
fn row(name: &str, runs: &[&Run]) -> Vec<String> {
    let of = |value: fn(&Score) -> f64| Agreement::of(runs.iter().map(|run| run.outcome.score().map(value)));
    let ef = of(Score::ef_points);
    let distance = |surface| {
        let all: Vec<f64> = runs.iter().filter_map(|run| run.outcome.score()).map(|score| score.distance_mm(surface)).collect();
        average(&all, 2)
    };
    let worst = ef.worst.map_or_else(|| "—".to_owned(), |(error, place)| format!("{} ({})", signed(error, 1), runs[place].name));
    vec![
        name.to_owned(),
        ef.studies.to_string(),
        ef.failed.to_string(),
        ef.text(1),
        of(Score::edv_percent).text(1),
        of(Score::esv_percent).text(1),
        of(Score::mass_percent).text(1),
        distance(Surface::Endocardial),
        distance(Surface::Epicardial),
        worst,
    ]
}

/// One row a family and one a group, by one method; negative controls apart.
pub fn families(runs: &[Run], method: Method) -> String {
    let mut table =
        Table::new(["family", "n", "failed", "EF (points)", "EDV (%)", "ESV (%)", "mass (%)", "endo (mm)", "epi (mm)", "worst EF"]);
    let of_method: Vec<&Run> = runs.iter().filter(|run| run.method == method && run.group != Group::Negative).collect();
    let mut names: Vec<&str> = of_method.iter().map(|run| run.family).collect();
    names.dedup();
    for name in names {
        let of_family: Vec<&Run> = of_method.iter().copied().filter(|run| run.family == name).collect();
        table.row(row(name, &of_family));
    }
    for group in Group::ALL {
        let of_group: Vec<&Run> = of_method.iter().copied().filter(|run| run.group == group).collect();
        if !of_group.is_empty() {
            table.row(row(&format!("**{}**", group.name()), &of_group));
        }
    }
    table.to_string()
}

/// Bias, spread, limits of agreement, the worst study and the correlation with the truth: a row a quantity, method and group.
pub fn agreement(runs: &[Run]) -> String {
    type Of = fn(&Score) -> f64;
    /// Name and unit, error, found, true.
    const QUANTITIES: [(&str, Of, Of, Of); 4] = [
        ("EF (points)", Score::ef_points, |score| score.found.ef_percent, |score| score.truth.ef_percent),
        ("EDV (%)", Score::edv_percent, |score| score.found.edv_ml, |score| score.truth.edv_ml),
        ("ESV (%)", Score::esv_percent, |score| score.found.esv_ml, |score| score.truth.esv_ml),
        ("mass (%)", Score::mass_percent, |score| score.found.mass_g, |score| score.truth.mass_g),
    ];
    let mut table = Table::new(["group and method", "quantity", "n", "failed", "bias", "SD", "limits of agreement", "worst", "of", "r"]);
    for group in Group::ALL.into_iter().filter(|&group| group != Group::Negative) {
        for method in Method::ALL {
            let chosen: Vec<&Run> = runs.iter().filter(|run| run.method == method && run.group == group).collect();
            if chosen.is_empty() {
                continue;
            }
            for (name, error, found, truth) in QUANTITIES {
                let agreement = Agreement::of(chosen.iter().map(|run| run.outcome.score().map(error)));
                let pairs: Vec<(f64, f64)> =
                    chosen.iter().filter_map(|run| run.outcome.score()).map(|score| (found(score), truth(score))).collect();
                let (worst, of) = agreement.worst.map_or((f64::NAN, "—"), |(worst, place)| (worst, chosen[place].name.as_str()));
                table.row([
                    format!("{}, {}", group.name(), method.name()),
                    name.to_owned(),
                    agreement.studies.to_string(),
                    agreement.failed.to_string(),
                    signed(agreement.bias, 2),
                    known(agreement.sd, 2),
                    agreement.limits_text(),
                    signed(worst, 1),
                    of.to_owned(),
                    known(correlation(&pairs), 3),
                ]);
            }
        }
    }
    table.to_string()
}

/// How well place, width of the blur and gates were found by the clinical preset: a row a family.
pub fn found_by_itself(runs: &[Run]) -> String {
    let mut table = Table::new([
        "family",
        "n",
        "FWHM − true (mm)",
        "at its bound",
        "axis (°)",
        "largest",
        "base along the axis (mm)",
        "apex (mm)",
        "ED and ES gate exact",
        "residual over noise",
    ]);
    let of_method: Vec<&Run> = runs.iter().filter(|run| run.method == Method::Clinical && run.group != Group::Negative).collect();
    let mut names: Vec<&str> = of_method.iter().map(|run| run.family).collect();
    names.dedup();
    for name in names {
        let scores: Vec<&Score> = of_method.iter().filter(|run| run.family == name).filter_map(|run| run.outcome.score()).collect();
        let spread = |values: &[f64]| Agreement::of(values.iter().copied().map(Some)).text(1);
        let poses = || scores.iter().filter_map(|score| score.pose);
        let models = || scores.iter().filter_map(|score| score.model);
        let axes: Vec<f64> = poses().map(|pose| pose.axis_degrees).collect();
        let residuals: Vec<f64> = models().map(|model| model.residual_over_noise).collect();
        let exact = scores.iter().filter(|score| {
            let gates = |values: &Values| (values.end_diastolic_gate, values.end_systolic_gate);
            gates(&score.found) == gates(&score.truth)
        });
        table.row([
            name.to_owned(),
            scores.len().to_string(),
            spread(&models().map(|model| model.psf_error_mm).collect::<Vec<_>>()),
            models().filter(|model| model.psf_at_bound).count().to_string(),
            average(&axes, 1),
            format!("{:.1}", axes.iter().copied().fold(0.0, f64::max)),
            spread(&poses().map(|pose| pose.base_mm).collect::<Vec<_>>()),
            average(&poses().map(|pose| pose.apex_mm).collect::<Vec<_>>(), 1),
            exact.count().to_string(),
            average(&residuals, 2),
        ]);
    }
    table.to_string()
}

fn average(values: &[f64], decimals: usize) -> String {
    if values.is_empty() { "—".to_owned() } else { format!("{:.decimals$}", mean(values)) }
}

/// The families and what they are about.
pub fn definitions() -> String {
    let mut table = Table::new(["family", "group", "n", "what it is about"]);
    for family in FAMILIES {
        table.row([family.name.to_owned(), family.group.name().to_owned(), family.studies.to_string(), family.about.to_owned()]);
    }
    let all: usize = FAMILIES.iter().map(|family| family.studies).sum();
    table.row(["**all**".to_owned(), String::new(), all.to_string()]);
    table.to_string()
}

/// Seconds a study on one thread, of the machine that ran it.
pub fn seconds(runs: &[Run]) -> String {
    let mut table = Table::new(["method", "mean (s)", "longest (s)", "of"]);
    for method in Method::ALL {
        let of_method = runs.iter().filter(|run| run.method == method);
        let Some(longest) = of_method.clone().max_by(|a, b| a.seconds.total_cmp(&b.seconds)) else { continue };
        let all: Vec<f64> = of_method.map(|run| run.seconds).collect();
        table.row([method.name().to_owned(), average(&all, 2), format!("{:.2}", longest.seconds), longest.name.clone()]);
    }
    table.to_string()
}

/// Share of studies whose 95 % interval holds the truth, by group: EDV, ESV, EF, mass.
pub fn coverage(runs: &[Run], method: Method) -> String {
    let mut table = Table::new(["group", "n", "EDV (%)", "ESV (%)", "EF (%)", "mass (%)"]);
    for group in Group::ALL {
        let ratios: Vec<[f64; 4]> = runs
            .iter()
            .filter(|run| run.method == method && run.group == group)
            .filter_map(|run| run.outcome.score()?.model?.over_standard_error)
            .collect();
        if ratios.is_empty() || group == Group::Negative {
            continue;
        }
        let of = |which: usize| format!("{:.0}", coverage_percent(&ratios.iter().map(|all| all[which]).collect::<Vec<_>>()));
        table.row([group.name().to_owned(), ratios.len().to_string(), of(0), of(1), of(2), of(3)]);
    }
    table.to_string()
}

/// The negative controls by method: how many were refused, and what was found in the others.
pub fn negatives(runs: &[Run]) -> String {
    let mut table = Table::new(["method", "n", "refused", "not refused"]);
    for method in Method::ALL {
        let of_method: Vec<&Run> = runs.iter().filter(|run| run.method == method && run.group == Group::Negative).collect();
        let found: Vec<&str> = of_method.iter().filter(|run| run.outcome.score().is_some()).map(|run| run.name.as_str()).collect();
        if !of_method.is_empty() {
            let refused = of_method.len() - found.len();
            table.row([method.name().to_owned(), of_method.len().to_string(), refused.to_string(), found.join(", ")]);
        }
    }
    table.to_string()
}
