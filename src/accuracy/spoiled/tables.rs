//! Runs as tables, and what was asked of them.

use super::{
    family::{Half, Kind, studies},
    score::{BAD, Judged, Run},
};
use crate::{accuracy::criteria::Criterion, drawing::markdown::Table};
use std::collections::BTreeMap;

/// Part of the bad results that a reader is to be told of, for each kind that has some: asked before anything was measured.
const SENSITIVITY: f64 = 0.80;
/// Part of the good studies that are to carry no flag.
const SPECIFICITY: f64 = 0.90;

fn of_kind(runs: &[Run], kind: Kind) -> impl Iterator<Item = &Run> {
    runs.iter().filter(move |run| run.kind == kind)
}

fn count<'a>(runs: impl Iterator<Item = &'a Run>, such: impl Fn(&Run) -> bool) -> usize {
    runs.filter(|run| such(run)).count()
}

/// `5 of 8`.
fn of(part: usize, whole: usize) -> String {
    format!("{part} of {whole}")
}

/// How often each flag is raised, most often first, by name where as often.
fn flags<'a>(runs: impl Iterator<Item = &'a Run>) -> Vec<(String, usize)> {
    let mut found: BTreeMap<&str, usize> = BTreeMap::new();
    for flag in runs.filter_map(|run| run.outcome.as_ref().ok()).flat_map(|judged| &judged.quality.flags) {
        *found.entry(flag).or_default() += 1;
    }
    let mut found: Vec<(String, usize)> = found.into_iter().map(|(flag, count)| (flag.to_owned(), count)).collect();
    found.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    found
}

/// The kinds of studies, how many of each in the published half, and the flags that are right for each.
pub fn definitions() -> String {
    let all = studies(Half::Published);
    let mut table = Table::new(["kind", "n", "what is wrong", "flags that say so"]);
    for kind in Kind::ALL {
        let count = all.iter().filter(|study| study.kind == kind).count();
        let flags: Vec<String> = kind.flags().iter().map(|flag| format!("`{flag}`")).collect();
        table.row([kind.name().to_owned(), count.to_string(), kind.about().to_owned(), flags.join(", ")]);
    }
    table.row(["**all**".to_owned(), all.len().to_string()]);
    table.to_string()
}

/// What came of each kind.
pub fn kinds(runs: &[Run]) -> String {
    let mut table = Table::new([
        "kind",
        "n",
        "refused",
        "told by flag or refusal",
        "named",
        "bad results",
        "of these flagged",
        "largest errors",
        "flags",
    ]);
    for kind in Kind::ALL {
        let all = || of_kind(runs, kind);
        let n = all().count();
        let known: Vec<&Judged> = all().filter_map(|run| run.outcome.as_ref().ok()).collect();
        let largest = |error: usize| known.iter().map(|judged| judged.errors[error].abs()).fold(0.0, f64::max);
        let bad = count(all(), Run::is_bad);
        table.row([
            kind.name().to_owned(),
            n.to_string(),
            count(all(), |run| run.outcome.is_err()).to_string(),
            of(count(all(), Run::is_told), n),
            if kind.is_good() { "—".to_owned() } else { of(count(all(), Run::is_named), n) },
            bad.to_string(),
            if bad == 0 { "—".to_owned() } else { of(count(all(), |run| run.is_bad() && run.is_told()), bad) },
            if known.is_empty() {
                "—".to_owned()
            } else {
                format!("EF {:.1}, EDV {:.0} %, {:.1} mm", largest(0), largest(1), largest(2))
            },
            flags(all()).iter().map(|(flag, count)| format!("{flag} {count}")).collect::<Vec<_>>().join(", "),
        ]);
    }
    table.to_string()
}

/// Each flag: where it is right, and where nothing is wrong.
pub fn by_flag(runs: &[Run]) -> String {
    let raised = |run: &Run, flag: &str| run.outcome.as_ref().is_ok_and(|judged| judged.quality.flags.iter().any(|one| one == flag));
    let mut names: Vec<String> = flags(runs.iter()).into_iter().map(|(flag, _)| flag).collect();
    let expected = Kind::ALL.iter().flat_map(|kind| kind.flags()).map(|&flag| flag.to_owned());
    names.extend(expected);
    names.sort_unstable();
    names.dedup();
    let mut table =
        Table::new(["flag", "raised where it is right", "raised on good studies", "raised elsewhere", "of results with it, bad"]);
    for flag in names {
        let right = |run: &&Run| run.outcome.is_ok() && run.kind.flags().contains(&flag.as_str());
        let good = |run: &&Run| run.outcome.is_ok() && run.kind.is_good();
        let elsewhere = |run: &&Run| run.outcome.is_ok() && !right(run) && !good(run);
        let part = |chosen: &dyn Fn(&&Run) -> bool| {
            let all: Vec<&Run> = runs.iter().filter(|run| chosen(run)).collect();
            if all.is_empty() { "—".to_owned() } else { of(all.iter().filter(|run| raised(run, &flag)).count(), all.len()) }
        };
        let with = runs.iter().filter(|run| raised(run, &flag)).count();
        let bad = runs.iter().filter(|run| raised(run, &flag) && run.is_bad()).count();
        table.row([format!("`{flag}`"), part(&right), part(&good), part(&elsewhere), of(bad, with)]);
    }
    table.to_string()
}

/// Every demand, whether met or not.
pub fn judged(runs: &[Run]) -> Vec<Criterion> {
    let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
    let mut all = Vec::new();
    let bad = count(runs.iter(), Run::is_bad);
    let told = count(runs.iter(), |run| run.is_bad() && run.is_told());
    all.push(Criterion {
        what: format!(
            "bad results (EF off by > {:.0} points, EDV by > {:.0} % or a surface by > {:.0} mm): flagged",
            BAD[0], BAD[1], BAD[2]
        ),
        asked: format!("≥ {:.0} %", 100.0 * SENSITIVITY),
        found: format!("{}: {:.0} %", of(told, bad), percent(told, bad)),
        met: told as f64 >= SENSITIVITY * bad as f64,
    });
    for kind in Kind::ALL.into_iter().filter(|kind| !kind.is_good()) {
        let bad = count(of_kind(runs, kind), Run::is_bad);
        if bad > 0 {
            let told = count(of_kind(runs, kind), |run| run.is_bad() && run.is_told());
            all.push(Criterion {
                what: format!("{}: bad results flagged", kind.name()),
                asked: format!("≥ {:.0} %", 100.0 * SENSITIVITY),
                found: format!("{}: {:.0} %", of(told, bad), percent(told, bad)),
                met: told as f64 >= SENSITIVITY * bad as f64,
            });
        }
    }
    let spoiled = || runs.iter().filter(|run| !run.kind.is_good());
    let (n, told) = (spoiled().count(), count(spoiled(), Run::is_told));
    all.push(Criterion {
        what: "spoiled studies, whatever came of them: flagged or refused".to_owned(),
        asked: format!("≥ {:.0} %", 100.0 * SENSITIVITY),
        found: format!("{}: {:.0} %", of(told, n), percent(told, n)),
        met: told as f64 >= SENSITIVITY * n as f64,
    });
    let good = || runs.iter().filter(|run| run.kind.is_good());
    let (n, silent) = (good().count(), count(good(), |run| !run.is_told()));
    all.push(Criterion {
        what: "good studies: no flag".to_owned(),
        asked: format!("≥ {:.0} %", 100.0 * SPECIFICITY),
        found: format!("{}: {:.0} %", of(silent, n), percent(silent, n)),
        met: silent as f64 >= SPECIFICITY * n as f64,
    });
    all
}

/// A run as a line of text, for those who look for what went wrong: the checks that speak against it, the worst first.
pub fn line(run: &Run) -> String {
    let judged = match &run.outcome {
        Err(code) => return format!("{:<20} {code}", run.name),
        Ok(judged) => judged,
    };
    let [ef, edv, mm] = judged.errors;
    let mut checks: Vec<_> = judged.quality.checks.iter().filter(|check| check.score < 0.9).collect();
    checks.sort_by(|one, other| one.score.total_cmp(&other.score));
    let checks: Vec<String> = checks
        .iter()
        .take(6)
        .map(|check| format!("{}={:.2}", check.measure.as_deref().unwrap_or(&check.flag), check.value.unwrap_or(f64::NAN)))
        .collect();
    format!(
        "{:<20} EF {ef:+.1} EDV {edv:+.1} % {mm:.1} mm, score {:.2}, {} | {}",
        run.name,
        judged.quality.score,
        judged.quality.flags.join(" "),
        checks.join(" ")
    )
}
