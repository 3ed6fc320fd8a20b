//! What others published of their methods, beside ours. Their reference is magnetic resonance in patients, or simulated counts through a
//! whole camera; ours is the exact shape behind our own camera's images. The columns are no contest.

use super::{
    family::Group,
    score::{Method, Run, Score},
    statistics::Agreement,
};
use crate::drawing::markdown::Table;

/// A published row: errors against a reference, as printed.
struct Published {
    what: &'static str,
    against: &'static str,
    ef: &'static str,
    edv: &'static str,
    esv: &'static str,
    mass: &'static str,
    source: &'static str,
}

/// Soneson et al., J Nucl Cardiol 2011;18:874-885: mean bias ± SD in percent of the reference, 100 patients.
const SONESON: &str = "Soneson 2011";
/// Hedeer et al., BMC Med Imaging 2010;10:10: mean bias ± 2 SD for EF, in percent of EF; 100 patients.
const HEDEER: &str = "Hedeer 2010";
/// Nakajima et al., Eur J Nucl Med Mol Imaging 2013;40:1163-1170: ESV as percent of the truth in eight virtual patients.
const NAKAJIMA: &str = "Nakajima 2013";
/// Trägårdh et al., EJNMMI Phys 2015;2:2: means by case, three virtual patients read in seventeen departments.
const TRAGARDH: &str = "Trägårdh 2015";

const MR: &str = "MR, 100 patients";
const NONE: &str = "—";

const fn published(what: &'static str, against: &'static str, [ef, edv, esv, mass]: [&'static str; 4], source: &'static str) -> Published {
    Published { what, against, ef, edv, esv, mass, source }
}

const ROWS: [Published; 13] = [
    published("Segment", MR, ["−2 ± 13", "−5 ± 12", "0 ± 17", "+3 ± 18"], SONESON),
    published("QGS", MR, ["−1 ± 14", "−43 ± 8", "−41 ± 16", "+33 ± 25"], SONESON),
    published("MyoMetrix", MR, ["−7 ± 15", "−40 ± 8", "−34 ± 15", NONE], SONESON),
    published("ECTb", MR, ["+17 ± 16", "−42 ± 9", "−54 ± 13", "+37 ± 24"], SONESON),
    published("Exini", MR, ["+10 ± 17", "−32 ± 7", "−41 ± 10", NONE], SONESON),
    published("QGS", MR, ["−9 (2 SD 27)", "−22 to −34, all four", "−12 to −37, all four", NONE], HEDEER),
    published("ECTb", MR, ["+6 (2 SD 29)", "see QGS", "see QGS", NONE], HEDEER),
    published("MyoMetrix", MR, ["+15 (2 SD 27)", "see QGS", "see QGS", NONE], HEDEER),
    published("Exini", MR, ["0 (2 SD 28)", "see QGS", "see QGS", NONE], HEDEER),
    published("QGS, small hearts", "truth, 8 simulated patients", [NONE, NONE, "−78 ± 18", NONE], NAKAJIMA),
    published("Exini, adjusted for small hearts", "truth, 8 simulated patients", [NONE, NONE, "−13 ± 9", NONE], NAKAJIMA),
    published("17 departments' own routines", "truth, 3 simulated patients", ["−24 to +14", "−26 to −52", "−15 to −60", NONE], TRAGARDH),
    published("The paper's own cycle", "none given", [NONE, NONE, NONE, NONE], "García & Susín, Table 5: EF 58.6 %, no reference"),
];

/// Theirs, then ours with the errors in percent of the truth, as theirs are.
pub fn markdown(runs: &[Run]) -> String {
    let mut table = Table::new(["method", "against", "EF (% of EF)", "EDV (%)", "ESV (%)", "mass (%)", "source"]);
    for row in &ROWS {
        table.row([row.what, row.against, row.ef, row.edv, row.esv, row.mass, row.source].map(str::to_owned));
    }
    for method in Method::ALL {
        for group in [Group::NoDefect, Group::Defect, Group::Small] {
            let chosen: Vec<&Run> = runs.iter().filter(|run| run.method == method && run.group == group).collect();
            if chosen.is_empty() {
                continue;
            }
            let failed = chosen.iter().filter(|run| run.outcome.score().is_none()).count();
            let cell = |value: fn(&Score) -> f64| Agreement::of(chosen.iter().map(|run| run.outcome.score().map(value))).text(0);
            table.row([
                format!("**ours**: {}, {}", method.name(), group.name()),
                format!("truth, {} of our phantoms", chosen.len()),
                cell(|score| 100.0 * (score.found.ef_percent / score.truth.ef_percent - 1.0)),
                cell(Score::edv_percent),
                cell(Score::esv_percent),
                cell(Score::mass_percent),
                format!("here, {failed} failed"),
            ]);
        }
    }
    table.to_string()
}
