//! Runs as tables.

use super::{
    family::{Kind, hearts},
    score::{Run, SEGMENTAL, Score},
};
use crate::{accuracy::statistics::Agreement, drawing::markdown::Table};

fn of_kind(runs: &[Run], kind: Kind) -> impl Iterator<Item = &Run> {
    runs.iter().filter(move |run| run.kind == kind)
}

/// Scores of a kind; `None` for a failure.
fn scores(runs: &[Run], kind: Kind) -> impl Iterator<Item = Option<&Score>> {
    of_kind(runs, kind).map(|run| run.outcome.as_deref().ok())
}

/// The kinds of hearts and how many of each.
pub fn definitions() -> String {
    let all = hearts();
    let mut table = Table::new(["kind", "n", "what it is about"]);
    for kind in Kind::ALL {
        let count = all.iter().filter(|heart| heart.kind == kind).count();
        table.row([kind.name().to_owned(), count.to_string(), kind.about().to_owned()]);
    }
    table.row(["**all**".to_owned(), all.len().to_string()]);
    table.to_string()
}

/// Errors of each segmental quantity, over all segments of all hearts of a kind.
pub fn segments(runs: &[Run]) -> String {
    let mut table = Table::new(["kind", "n", "failed", SEGMENTAL[0], SEGMENTAL[1], SEGMENTAL[2], SEGMENTAL[3], SEGMENTAL[4]]);
    for kind in Kind::ALL {
        let known: Vec<&Score> = scores(runs, kind).flatten().collect();
        let count = scores(runs, kind).count();
        let mut row = vec![kind.name().to_owned(), count.to_string(), (count - known.len()).to_string()];
        row.extend((0..SEGMENTAL.len()).map(|quantity| {
            Agreement::of(known.iter().flat_map(|score| score.segment_errors(quantity)).map(Some)).text(if quantity < 2 || quantity == 3 {
                2
            } else {
                1
            })
        }));
        table.row(row);
    }
    table.to_string()
}

/// Spread of the phases: mean and largest, found and true.
pub fn phases(runs: &[Run]) -> String {
    let mut table = Table::new([
        "kind",
        "SD found (°)",
        "SD true (°)",
        "bandwidth found (°)",
        "bandwidth true (°)",
        "entropy found (%)",
        "entropy true (%)",
    ]);
    for kind in Kind::ALL {
        let known: Vec<&Score> = scores(runs, kind).flatten().collect();
        let of = |values: fn(&Score) -> Option<[f64; 4]>, which: usize| {
            let all: Vec<f64> = known.iter().filter_map(|score| values(score)).map(|phase| phase[which]).collect();
            if all.is_empty() {
                return "—".to_owned();
            }
            let largest = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            format!("{:.1}, at most {largest:.1}", all.iter().sum::<f64>() / all.len() as f64)
        };
        let found: fn(&Score) -> Option<[f64; 4]> = |score| score.found.phase;
        let truth: fn(&Score) -> Option<[f64; 4]> = |score| score.truth.phase;
        table.row([kind.name().to_owned(), of(found, 1), of(truth, 1), of(found, 2), of(truth, 2), of(found, 3), of(truth, 3)]);
    }
    table.to_string()
}

/// Rates against the continuous cycle: of the exact volumes of the gates (what the gates can show at best), and of what was found.
pub fn rates(runs: &[Run]) -> String {
    type Of = fn(&Score) -> Option<[f64; 4]>;
    let mut table = Table::new(["gates and volumes", "n", "PER (%)", "PFR (%)", "MFR/3 (%)", "TTPF (% of R-R)"]);
    let kinds: [(&str, &[Kind]); 2] = [("8 gates", &[Kind::Synchronous, Kind::Pair]), ("16 gates", &[Kind::SixteenGates])];
    let which: [(&str, Of); 2] = [("exact volumes", |score| score.truth.rates), ("found", |score| score.found.rates)];
    for (gates, kinds) in kinds {
        let known: Vec<&Score> = kinds.iter().flat_map(|&kind| scores(runs, kind).flatten()).collect();
        for (name, of) in which {
            let error = |quantity: usize| {
                let each = known.iter().filter_map(|score| {
                    let (value, truth) = (of(score)?[quantity], score.continuous?[quantity]);
                    Some(Some(if quantity == 3 { value - truth } else { 100.0 * (value / truth - 1.0) }))
                });
                Agreement::of(each).text(1)
            };
            table.row([format!("{gates}, {name}"), known.len().to_string(), error(0), error(1), error(2), error(3)]);
        }
    }
    table.to_string()
}

/// Axes and sphericity, at both ends of the cycle.
pub fn shapes(runs: &[Run]) -> String {
    let mut table = Table::new([
        "kind",
        "long axis ED (mm)",
        "short axis ED (mm)",
        "sphericity ED",
        "long axis ES (mm)",
        "short axis ES (mm)",
        "sphericity ES",
    ]);
    for kind in Kind::ALL {
        let error = |quantity: usize| {
            let each = scores(runs, kind)
                .flatten()
                .filter_map(|score| Some(Some(score.found.shape.get(quantity)? - score.truth.shape.get(quantity)?)));
            Agreement::of(each).text(if quantity % 3 == 2 { 3 } else { 1 })
        };
        let mut row = vec![kind.name().to_owned()];
        row.extend((0..6).map(error));
        table.row(row);
    }
    table.to_string()
}

/// Each defect: its share of the wall, and the segments below the threshold, found and by the counts within the exact surfaces.
pub fn defects(runs: &[Run]) -> String {
    let mut table = Table::new(["heart", "true (% of the wall)", "found (%)", "segments within the exact surfaces", "segments found"]);
    let list = |numbers: &[usize]| numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(" ");
    for run in of_kind(runs, Kind::Defect) {
        let Ok(score) = &run.outcome else {
            table.row([run.name.clone(), String::new(), "failed".to_owned()]);
            continue;
        };
        table.row([
            run.name.clone(),
            format!("{:.0}", score.truth.defect_percent),
            format!("{:.0}", score.found.defect_percent),
            list(&score.truth.defect_segments),
            list(&score.found.defect_segments),
        ]);
    }
    for kind in [Kind::Synchronous, Kind::SixteenGates, Kind::Akinetic, Kind::Thin] {
        let found: Vec<f64> = scores(runs, kind).flatten().map(|score| score.found.defect_percent).collect();
        let largest = found.iter().copied().fold(0.0, f64::max);
        let mean = if found.is_empty() { f64::NAN } else { found.iter().sum::<f64>() / found.len() as f64 };
        table.row([format!("{} (n = {})", kind.name(), found.len()), "0".to_owned(), format!("{mean:.1}, at most {largest:.0}")]);
    }
    table.to_string()
}

/// Each late sector: how much later its segments are, and which are out of step.
pub fn late(runs: &[Run]) -> String {
    let mut table = Table::new(["heart", "segments wholly inside", "later, true (°)", "later, found (°)", "out of step by more than 45°"]);
    let list = |numbers: &[usize]| numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(" ");
    for run in of_kind(runs, Kind::Late) {
        let Ok(score) = &run.outcome else {
            table.row([run.name.clone(), "failed".to_owned()]);
            continue;
        };
        let later = |degrees: Option<f64>| degrees.map_or_else(|| "—".to_owned(), |degrees| format!("{degrees:.0}"));
        table.row([
            run.name.clone(),
            list(&score.covered),
            later(score.delay_degrees(&score.truth)),
            later(score.delay_degrees(&score.found)),
            list(&score.out_of_step(&score.found)),
        ]);
    }
    table.to_string()
}

/// Each pair: the ratio of the mean volumes of the cavity.
pub fn pairs(runs: &[Run]) -> String {
    let mut table = Table::new(["pair", "true", "found", "error (%)"]);
    for (name, truth, found) in ratios(runs) {
        let found_text = found.map_or_else(|| "failed".to_owned(), |ratio| format!("{ratio:.3}"));
        let error = found.map_or_else(String::new, |ratio| format!("{:+.1}", 100.0 * (ratio / truth - 1.0)).replace('-', "−"));
        table.row([name, format!("{truth:.3}"), found_text, error]);
    }
    table.to_string()
}

/// Of each pair its name, the true ratio of the mean volumes of the cavity and the found one.
pub fn ratios(runs: &[Run]) -> Vec<(String, f64, Option<f64>)> {
    let all: Vec<&Run> = of_kind(runs, Kind::Pair).collect();
    all.chunks_exact(2)
        .map(|pair| {
            let [rest, stress] = [0, 1].map(|index| pair[index].outcome.as_deref().ok());
            let name = format!("{} and {}", pair[0].name, pair[1].name);
            match (rest, stress) {
                (Some(rest), Some(stress)) => {
                    (name, stress.truth.cavity_ml / rest.truth.cavity_ml, Some(stress.found.cavity_ml / rest.found.cavity_ml))
                }
                _ => (name, f64::NAN, None),
            }
        })
        .collect()
}
