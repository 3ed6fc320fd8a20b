//! What was asked of the derived quantities before they were measured, and whether it was met.

use super::{
    family::Kind,
    score::{Run, Score},
    tables,
};
use crate::{
    accuracy::{criteria::Criterion, statistics::Agreement},
    drawing::markdown::signed,
};

/// Largest bias of a segmental thickness and of the motion in mm.
const BIAS_MM: f64 = 1.0;
/// How far a late sector's delay may be off its 90°.
const DELAY_DEGREES: f64 = 20.0;
/// Largest SD and bandwidth of the phases of a heart that beats all at once.
const SYNCHRONOUS_DEGREES: [f64; 2] = [8.0, 30.0];
/// How far a TID ratio may be off, in percent.
const RATIO_PERCENT: f64 = 3.0;

/// Every demand, whether met or not.
pub fn judged(runs: &[Run]) -> Vec<Criterion> {
    let of = |kind: Kind| runs.iter().filter(move |run| run.kind == kind);
    let scores = |kind: Kind| of(kind).filter_map(|run| run.outcome.as_deref().ok()).collect::<Vec<&Score>>();
    let failed = |kind: Kind| of(kind).filter(|run| run.outcome.is_err()).count();
    let mut all = Vec::new();
    let everywhere: Vec<&Score> = runs.iter().filter_map(|run| run.outcome.as_deref().ok()).collect();
    let lost = runs.len() - everywhere.len();
    for (quantity, name) in [(0, "thickness ED"), (1, "thickness ES"), (3, "motion")] {
        let errors = Agreement::of(everywhere.iter().flat_map(|score| score.segment_errors(quantity)).map(Some));
        all.push(Criterion {
            what: format!("all hearts, segments: {name}"),
            asked: format!("bias < {BIAS_MM:.0} mm"),
            found: format!("{} mm, {lost} failed", errors.text(2)),
            met: lost == 0 && errors.bias.abs() < BIAS_MM,
        });
    }
    for (which, name) in [(1, "SD"), (2, "bandwidth")] {
        let bound = SYNCHRONOUS_DEGREES[which - 1];
        let found: Vec<f64> = scores(Kind::Synchronous).iter().filter_map(|score| score.found.phase).map(|phase| phase[which]).collect();
        let largest = found.iter().copied().fold(0.0, f64::max);
        let within = found.iter().filter(|&&degrees| degrees < bound).count();
        let count = of(Kind::Synchronous).count();
        all.push(Criterion {
            what: format!("synchronous: {name} of the phases"),
            asked: format!("< {bound:.0}° in each"),
            found: format!("{within} of {count}, at most {largest:.1}°"),
            met: within == count,
        });
    }
    let late = scores(Kind::Late);
    let delays: Vec<f64> = late.iter().filter_map(|score| score.delay_degrees(&score.found)).collect();
    let met = delays.iter().filter(|&&degrees| (degrees - 90.0).abs() <= DELAY_DEGREES).count();
    all.push(Criterion {
        what: "late sector of 60° by 90°: its segments less the rest".to_owned(),
        asked: format!("90 ± {DELAY_DEGREES:.0}° in each"),
        found: format!("{met} of {}, {}", of(Kind::Late).count(), Agreement::of(delays.into_iter().map(Some)).text(0)),
        met: met == of(Kind::Late).count(),
    });
    let outside =
        late.iter().flat_map(|score| score.out_of_step(&score.found).into_iter().filter(|number| !score.touched.contains(number))).count();
    all.push(Criterion {
        what: "late sector: segments out of step that it does not touch".to_owned(),
        asked: "none".to_owned(),
        found: format!("{outside}, {} failed", failed(Kind::Late)),
        met: outside == 0 && failed(Kind::Late) == 0,
    });
    let ratios = tables::ratios(runs);
    let errors: Vec<f64> = ratios.iter().filter_map(|(_, truth, found)| found.map(|found| 100.0 * (found / truth - 1.0))).collect();
    let worst = errors.iter().copied().fold(0.0_f64, |worst, error| if error.abs() > worst.abs() { error } else { worst });
    all.push(Criterion {
        what: "pairs: TID ratio".to_owned(),
        asked: format!("within {RATIO_PERCENT:.0} % in each"),
        found: format!("worst {} %, {} failed", signed(worst, 1), ratios.len() - errors.len()),
        met: errors.len() == ratios.len() && worst.abs() <= RATIO_PERCENT,
    });
    all
}
