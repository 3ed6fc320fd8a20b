//! The guard against slower code passes what is as committed, and nothing else.

#[path = "../../benches/instructions/judge.rs"]
mod judge;

use judge::{Committed, complaints};
use std::{collections::BTreeMap, fs, path::Path};

fn committed() -> Committed {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/instructions.json");
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// What is committed, every count times a factor.
fn times(committed: &Committed, factor: f64) -> BTreeMap<String, u64> {
    committed.counts.iter().map(|(name, &count)| (name.clone(), (count as f64 * factor) as u64)).collect()
}

#[test]
fn counts_as_committed_pass() {
    let committed = committed();
    assert!(!committed.counts.is_empty() && (1.0..=5.0).contains(&committed.tolerance_percent), "{committed:?}");
    let within = committed.tolerance_percent / 100.0 * 0.9;
    for factor in [1.0 - within, 1.0, 1.0 + within] {
        assert_eq!(complaints(&committed, &times(&committed, factor)), Vec::<String>::new());
    }
}

#[test]
fn slower_code_fails_and_faster_code_is_to_be_committed() {
    let committed = committed();
    let beyond = committed.tolerance_percent / 100.0 * 1.1;
    let slower = complaints(&committed, &times(&committed, 1.0 + beyond));
    assert_eq!(slower.len(), committed.counts.len());
    assert!(slower.iter().all(|complaint| complaint.contains("% more than the") && complaint.contains("make guard-update")), "{slower:?}");
    let faster = complaints(&committed, &times(&committed, 1.0 - beyond));
    assert_eq!(faster.len(), committed.counts.len());
    assert!(faster.iter().all(|complaint| complaint.contains("faster. Run make guard-update")), "{faster:?}");
}

#[test]
fn one_slower_workload_is_enough() {
    let committed = committed();
    for name in committed.counts.keys() {
        let mut counts = committed.counts.clone();
        *counts.get_mut(name).unwrap() *= 2;
        let found = complaints(&committed, &counts);
        assert!(found.len() == 1 && found[0].starts_with(&format!("{name}: ")) && found[0].contains("100.0 % more"), "{found:?}");
    }
}

#[test]
fn workloads_that_are_new_or_gone_are_told() {
    let committed = committed();
    let mut counts = committed.counts.clone();
    let (gone, count) = counts.pop_first().unwrap();
    counts.insert("another".into(), count);
    let found = complaints(&committed, &counts);
    assert!(found.iter().any(|complaint| complaint.starts_with("another: ") && complaint.contains("none are committed")), "{found:?}");
    assert!(found.iter().any(|complaint| complaint.starts_with(&format!("{gone} is committed and was not measured"))), "{found:?}");
}
