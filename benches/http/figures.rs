//! What was measured: tables for people, JSON for programs.

use serde_json::{Value, json};
use std::{fs, path::PathBuf};

/// A table: each row was measured once a round.
pub(crate) struct Table {
    id: &'static str,
    title: &'static str,
    rows: Vec<Row>,
}

struct Row {
    id: String,
    name: String,
    unit: &'static str,
    values: Vec<f64>,
}

impl Row {
    fn sorted(&self) -> Vec<f64> {
        let mut sorted = self.values.clone();
        sorted.sort_by(f64::total_cmp);
        sorted
    }

    /// Median, least, most.
    fn summary(&self) -> (f64, f64, f64) {
        let sorted = self.sorted();
        (sorted[sorted.len() / 2], sorted[0], sorted[sorted.len() - 1])
    }
}

impl Table {
    pub(crate) fn new(id: &'static str, title: &'static str) -> Self {
        Self { id, title, rows: Vec::new() }
    }

    /// Adds what one round measured of the row of this id.
    pub(crate) fn add(&mut self, id: &str, name: &str, unit: &'static str, value: f64) {
        match self.rows.iter_mut().find(|row| row.id == id) {
            Some(row) => row.values.push(value),
            None => self.rows.push(Row { id: id.to_owned(), name: name.to_owned(), unit, values: vec![value] }),
        }
    }

    pub(crate) fn print(&self) {
        println!("\n| {} | median | least to most |\n|---|---|---|", self.title);
        for row in &self.rows {
            let (median, least, most) = row.summary();
            println!("| {} | {} {} | {} to {} |", row.name, digits(median), row.unit, digits(least), digits(most));
        }
    }

    fn json(&self) -> Vec<Value> {
        let figure = |row: &Row| {
            let (median, least, most) = row.summary();
            let id = format!("{}.{}", self.id, row.id);
            json!({"id": id, "name": row.name, "unit": row.unit, "median": median, "least": least, "most": most, "rounds": row.values})
        };
        self.rows.iter().map(figure).collect()
    }
}

/// Three digits that mean something.
fn digits(value: f64) -> String {
    let decimals = if value.abs() >= 100.0 { 0 } else { usize::from(value.abs() < 10.0) + 1 };
    format!("{value:.decimals$}")
}

/// The value below which this share of them lies.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() as f64 * share) as usize).min(values.len() - 1)]
}

/// Writes all figures to `bench/http.json` in cargo's target directory; returns the path.
pub(crate) fn write(tables: &[Table]) -> PathBuf {
    let processor = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let processor = processor.lines().find_map(|line| line.strip_prefix("model name")).map(|name| name.trim_matches([':', ' ', '\t']));
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let figures: Vec<Value> = tables.iter().flat_map(Table::json).collect();
    let all = json!({
        "schema": "ventricle.bench/1", "bench": "http", "version": env!("CARGO_PKG_VERSION"),
        "machine": {"processor": processor, "processors": processors}, "figures": figures,
    });
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).with_file_name("bench");
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join("http.json");
    fs::write(&path, serde_json::to_vec_pretty(&all).unwrap()).unwrap();
    path
}
