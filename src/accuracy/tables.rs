//! Runs as tables.

use super::{
    family::Group,
    score::{Method, Run, Score},
    statistics::{Agreement, coverage_percent, mean},
};
use crate::{
    drawing::markdown::{Table, signed},
    pipeline::Surface,
};

/// What a row of a table is about.
fn row(name: &str, runs: &[&Run]) -> Vec<String> {
    let of = |value: fn(&Score) -> f64| Agreement::of(runs.iter().map(|run| run.outcome.score().map(value)));
    let cell = |agreement: &Agreement| {
        let bias = signed(agreement.bias, 1);
        match (agreement.bias.is_finite(), agreement.sd.is_finite()) {
            (false, _) => "—".to_owned(),
            (true, false) => bias,
            (true, true) => format!("{bias} ± {:.1}", agreement.sd),
        }
    };
    let ef = of(Score::ef_points);
    let distance = |surface| {
        let known: Vec<f64> = runs.iter().filter_map(|run| run.outcome.score()).map(|score| score.distance_mm(surface)).collect();
        if known.is_empty() { "—".to_owned() } else { format!("{:.2}", mean(&known)) }
    };
    let worst = ef.worst.map_or_else(|| "—".to_owned(), |(error, place)| format!("{} ({})", signed(error, 1), runs[place].name));
    vec![
        name.to_owned(),
        ef.studies.to_string(),
        ef.failed.to_string(),
        cell(&ef),
        cell(&of(Score::edv_percent)),
        cell(&of(Score::esv_percent)),
        cell(&of(Score::mass_percent)),
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
