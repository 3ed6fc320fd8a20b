//! What was asked of the clinical preset before it was measured, and whether it was met.

use super::{
    family::Group,
    score::{Method, Run, Score},
    statistics::{Agreement, coverage_percent},
};
use crate::{
    drawing::markdown::{Table, signed},
    pipeline::Surface,
};

/// One demand and what was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Criterion {
    /// Whose and what.
    pub what: String,
    /// The bound.
    pub asked: String,
    /// What was found.
    pub found: String,
    /// Whether it is met.
    pub met: bool,
}

/// A demand on bias and spread: of a group by a method. A failed study is a demand that is not met.
struct Bound {
    method: Method,
    group: Group,
    what: &'static str,
    unit: &'static str,
    value: fn(&Score) -> f64,
    bias: Option<f64>,
    sd: f64,
}

const fn bound(
    (method, group): (Method, Group),
    (what, unit): (&'static str, &'static str),
    value: fn(&Score) -> f64,
    bias: Option<f64>,
    sd: f64,
) -> Bound {
    Bound { method, group, what, unit, value, bias, sd }
}

const BLIND: (Method, Group) = (Method::Clinical, Group::NoDefect);
const GIVEN: (Method, Group) = (Method::PsfGiven, Group::NoDefect);
const DEFECT: (Method, Group) = (Method::Clinical, Group::Defect);

/// Bias and standard deviation, as they were asked for.
const BOUNDS: [Bound; 8] = [
    bound(BLIND, ("EF", "points"), Score::ef_points, Some(0.5), 2.0),
    bound(BLIND, ("EDV", "%"), Score::edv_percent, Some(2.0), 4.0),
    bound(BLIND, ("ESV", "%"), Score::esv_percent, Some(3.0), 7.0),
    bound(BLIND, ("mass", "%"), Score::mass_percent, Some(3.0), 7.0),
    bound(GIVEN, ("EDV", "%"), Score::edv_percent, None, 2.0),
    bound(GIVEN, ("ESV", "%"), Score::esv_percent, None, 3.5),
    bound(DEFECT, ("EF", "points"), Score::ef_points, Some(1.5), 3.0),
    bound(DEFECT, ("EDV", "%"), Score::edv_percent, Some(3.0), 6.0),
];

/// Mean distance of the endocardial and of the epicardial surface in mm.
const DISTANCES: [((Method, Group), [f64; 2]); 2] = [(BLIND, [0.7, 0.5]), (GIVEN, [0.5, 0.4])];

/// A small heart's end-systolic volume may be off by this much in percent, in every study.
const SMALL_ESV_PERCENT: f64 = 15.0;

/// Percent of studies whose 95 % interval holds the truth.
const COVERAGE: std::ops::RangeInclusive<f64> = 90.0..=99.0;

/// Every demand that the runs speak of.
pub fn judged(runs: &[Run]) -> Vec<Criterion> {
    let of =
        |method: Method, group: Group| runs.iter().filter(move |run| run.method == method && run.group == group).collect::<Vec<&Run>>();
    let mut all = Vec::new();
    for bound in &BOUNDS {
        let chosen = of(bound.method, bound.group);
        if !chosen.is_empty() {
            all.push(spread(bound, &chosen));
        }
    }
    for ((method, group), limits) in DISTANCES {
        let chosen = of(method, group);
        if !chosen.is_empty() {
            all.push(distance(&name(method, group), &chosen, limits));
        }
    }
    let small = of(Method::Clinical, Group::Small);
    if !small.is_empty() {
        let agreement = Agreement::of(small.iter().map(|run| run.outcome.score().map(Score::esv_percent)));
        let (worst, study) = agreement.worst.map_or((f64::NAN, "none"), |(worst, place)| (worst, small[place].name.as_str()));
        all.push(Criterion {
            what: format!("{}: worst ESV", name(Method::Clinical, Group::Small)),
            asked: format!("within ± {SMALL_ESV_PERCENT:.0} %, none failed"),
            found: format!("{} % ({study}), {} failed", signed(worst, 1), agreement.failed),
            met: agreement.failed == 0 && worst.abs() <= SMALL_ESV_PERCENT,
        });
    }
    let negative = of(Method::Clinical, Group::Negative);
    if !negative.is_empty() {
        let found = negative.iter().filter(|run| run.outcome.score().is_some()).count();
        all.push(Criterion {
            what: "clinical, negative: refused".to_owned(),
            asked: "all".to_owned(),
            found: format!("{} of {}", negative.len() - found, negative.len()),
            met: found == 0,
        });
    }
    let livers: Vec<&Run> = of(Method::Clinical, Group::NoDefect).into_iter().filter(|run| run.family.starts_with("liver")).collect();
    if !livers.is_empty() {
        let lost = livers.iter().filter(|run| run.outcome.score().is_none()).count();
        all.push(Criterion {
            what: "clinical, liver 4 and 10 mm: lost".to_owned(),
            asked: "none".to_owned(),
            found: format!("{lost} of {}", livers.len()),
            met: lost == 0,
        });
    }
    all.extend(coverage(runs));
    all
}

fn name(method: Method, group: Group) -> String {
    format!("{}, {}", method.name(), group.name())
}

fn spread(bound: &Bound, runs: &[&Run]) -> Criterion {
    let agreement = Agreement::of(runs.iter().map(|run| run.outcome.score().map(bound.value)));
    let unit = bound.unit;
    let asked = match bound.bias {
        Some(bias) => format!("bias ≤ {bias}, SD ≤ {} {unit}", bound.sd),
        None => format!("SD ≤ {} {unit}", bound.sd),
    };
    Criterion {
        what: format!("{}: {}", name(bound.method, bound.group), bound.what),
        asked,
        found: format!("{} {unit}, {} failed", agreement.text(1), agreement.failed),
        met: agreement.failed == 0 && agreement.sd <= bound.sd && bound.bias.is_none_or(|bias| agreement.bias.abs() <= bias),
    }
}

fn distance(what: &str, runs: &[&Run], limits: [f64; 2]) -> Criterion {
    let of = |surface| Agreement::of(runs.iter().map(|run| run.outcome.score().map(|score| score.distance_mm(surface))));
    let (endocardial, epicardial) = (of(Surface::Endocardial), of(Surface::Epicardial));
    Criterion {
        what: format!("{what}: mean distance endo / epi"),
        asked: format!("≤ {} / {} mm", limits[0], limits[1]),
        found: format!("{:.2} / {:.2} mm", endocardial.bias, epicardial.bias),
        met: endocardial.failed == 0 && endocardial.bias <= limits[0] && epicardial.bias <= limits[1],
    }
}

/// The intervals of all ventricles by the clinical preset together.
fn coverage(runs: &[Run]) -> Vec<Criterion> {
    let chosen = runs.iter().filter(|run| run.method == Method::Clinical && run.group != Group::Negative);
    let ratios: Vec<[f64; 4]> = chosen.filter_map(|run| run.outcome.score()?.model?.over_standard_error).collect();
    if ratios.is_empty() {
        return Vec::new();
    }
    let one = |(which, what): (usize, &str)| {
        let percent = coverage_percent(&ratios.iter().map(|all| all[which]).collect::<Vec<_>>());
        Criterion {
            what: format!("clinical, all ventricles: 95 % interval of {what} holds the truth"),
            asked: format!("{:.0}-{:.0} % of studies", COVERAGE.start(), COVERAGE.end()),
            found: format!("{percent:.0} % of {}", ratios.len()),
            met: COVERAGE.contains(&percent),
        }
    };
    [(0, "EDV"), (1, "ESV"), (2, "EF"), (3, "mass")].map(one).to_vec()
}

/// The demands as a table.
pub fn markdown(criteria: &[Criterion]) -> String {
    let mut table = Table::new(["what", "asked", "found", "met"]);
    for one in criteria {
        table.row([one.what.clone(), one.asked.clone(), one.found.clone(), if one.met { "yes" } else { "**no**" }.to_owned()]);
    }
    table.to_string()
}
