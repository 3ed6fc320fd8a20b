//! Whether counts of instructions are what was committed.

use std::collections::BTreeMap;

/// What is committed.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Committed {
    /// How far a count may be from the committed one, in percent, either way.
    pub(crate) tolerance_percent: f64,
    /// Instructions of each workload.
    pub(crate) counts: BTreeMap<String, u64>,
}

/// A sentence for each workload that is not as committed; none where all are.
pub(crate) fn complaints(committed: &Committed, measured: &BTreeMap<String, u64>) -> Vec<String> {
    let mut complaints: Vec<String> = measured
        .iter()
        .filter_map(|(name, &count)| match committed.counts.get(name) {
            None => Some(format!("{name}: {count} instructions, and none are committed: run make guard-update and commit benches/instructions.json.")),
            Some(&expected) => {
                let percent = 100.0 * (count as f64 / expected as f64 - 1.0);
                let limit = committed.tolerance_percent;
                if percent > limit {
                    Some(format!(
                        "{name}: {count} instructions, {percent:.1} % more than the {expected} that are committed; {limit} % are let pass. Make it as fast \
                         as it was, or say in the commit why it must be slower, and run make guard-update."
                    ))
                } else if percent < -limit {
                    Some(format!(
                        "{name}: {count} instructions, {:.1} % fewer than the {expected} that are committed: faster. Run make guard-update and commit \
                         benches/instructions.json, so that it stays so.",
                        -percent
                    ))
                } else {
                    None
                }
            }
        })
        .collect();
    let lost = committed.counts.keys().filter(|name| !measured.contains_key(*name));
    complaints.extend(
        lost.map(|name| format!("{name} is committed and was not measured: run make guard-update and commit benches/instructions.json.")),
    );
    complaints
}
