//! A report as a table for the terminal.

use std::fmt::Write as _;
use ventricle::{phantom::Truth, report::Report};

/// Volumes, function and warnings; the exact values beside them in brackets when the study is simulated.
pub(crate) fn table(report: &Report, truth: Option<&Truth>) -> String {
    let mut text = String::new();
    // Writing to a String does not fail.
    let _ = write_table(&mut text, report, truth);
    text
}

fn write_table(out: &mut String, report: &Report, truth: Option<&Truth>) -> std::fmt::Result {
    if let Some(function) = &report.function {
        let mut row = |name: &str, value: f64, unit: &str, note: String, exact: Option<f64>| {
            let exact = exact.map_or_else(String::new, |exact| format!("  [{exact:6.1}]"));
            let line = format!("  {name:<5}{value:8.1} {unit:<2}{exact}{note}");
            writeln!(out, "{}", line.trim_end())
        };
        let at = |gate: usize| format!("   gate {gate}");
        row("EDV", function.edv_ml, "ml", at(function.end_diastolic_gate), truth.map(|truth| truth.edv_ml))?;
        row("ESV", function.esv_ml, "ml", at(function.end_systolic_gate), truth.map(|truth| truth.esv_ml))?;
        row("SV", function.sv_ml, "ml", String::new(), truth.map(|truth| truth.edv_ml - truth.esv_ml))?;
        row("EF", function.ef_percent, "%", String::new(), truth.map(|truth| truth.ef_percent))?;
    } else {
        writeln!(out, "  one gate, so no ejection fraction")?;
    }
    writeln!(out, "  mass {:8.1} g", report.myocardium.mass_g)?;
    writeln!(out)?;
    let exact_gates = truth.map(|truth| truth.gates.as_slice()).unwrap_or_default();
    let wide = if exact_gates.is_empty() { 13 } else { 22 };
    writeln!(out, "  gate{:>wide$}{:>wide$}{:>wide$}", "endocardial", "epicardial", "wall (ml)")?;
    for gate in &report.gates {
        let exact = exact_gates.get(gate.gate - 1).map(|exact| (exact.endocardial_ml, exact.epicardial_ml));
        write!(out, "  {:>4}", gate.gate)?;
        for (value, exact) in [
            (gate.endocardial_ml, exact.map(|(inner, _)| inner)),
            (gate.epicardial_ml, exact.map(|(_, outer)| outer)),
            (gate.myocardial_ml, exact.map(|(inner, outer)| outer - inner)),
        ] {
            let cell = exact.map_or_else(|| format!("{value:.1}"), |exact| format!("{value:.1}  [{exact:6.1}]"));
            write!(out, "{cell:>wide$}")?;
        }
        writeln!(out)?;
    }
    if truth.is_some() {
        writeln!(out, "\n  In brackets: the simulated ventricle's exact values.")?;
    }
    if !report.warnings.is_empty() {
        writeln!(out)?;
    }
    for warning in &report.warnings {
        let gate = warning.gate.map_or_else(String::new, |gate| format!("gate {gate}: "));
        writeln!(out, "  ! {gate}{} ({})", warning.message, warning.code)?;
    }
    Ok(())
}
