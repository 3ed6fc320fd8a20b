//! A report as a table for the terminal.

use std::fmt::Write as _;
use ventricle::{
    phantom::Truth,
    pipeline::clinical::PsfSource,
    report::{ErrorSummary, HALF_WIDTH_95, ModelSummary, Report},
};

/// Volumes, function and warnings (`!`: with a flag of that code); the exact values beside them in brackets when the study is simulated.
pub(crate) fn table(report: &Report, truth: Option<&Truth>) -> String {
    let mut text = String::new();
    // Writing to a String does not fail.
    let _ = write_table(&mut text, report, truth);
    text
}

fn write_table(out: &mut String, report: &Report, truth: Option<&Truth>) -> std::fmt::Result {
    write_function(out, report, truth)?;
    if let Some(model) = &report.model {
        write_psf(out, model)?;
    }
    writeln!(out)?;
    write_gates(out, report, truth)?;
    if truth.is_some() {
        writeln!(out, "\n  In brackets: the simulated ventricle's exact values.")?;
    }
    if report.uncertainty.is_some() {
        writeln!(out, "{}  ±: half of the 95 % interval.", if truth.is_some() { "" } else { "\n" })?;
    }
    if !report.warnings.is_empty() {
        writeln!(out)?;
    }
    for warning in &report.warnings {
        let mark = if report.quality.flags.contains(&warning.code) { "!" } else { "-" };
        let gate = warning.gate.map_or_else(String::new, |gate| format!("gate {gate}: "));
        writeln!(out, "  {mark} {gate}{} ({})", warning.message, warning.code)?;
    }
    Ok(())
}

/// Volumes, ejection fraction and mass, each with its uncertainty where there is one.
fn write_function(out: &mut String, report: &Report, truth: Option<&Truth>) -> std::fmt::Result {
    let errors = report.uncertainty.as_ref();
    let wide = errors.map_or(0, |_| 8);
    let mut row = |name: &str, value: f64, error: Option<ErrorSummary>, unit: &str, exact: Option<f64>, note: &str| {
        let error = error.map_or_else(String::new, |error| format!(" ± {:.1}", error.half_width_95()));
        let exact = exact.map_or_else(String::new, |exact| format!("  [{exact:6.1}]"));
        let line = format!("  {name:<5}{value:8.1}{error:<wide$} {unit:<2}{exact}{note}");
        writeln!(out, "{}", line.trim_end())
    };
    if let Some(function) = &report.function {
        let at = |gate: usize| format!("   gate {gate}");
        let (diastole, systole) = (at(function.end_diastolic_gate), at(function.end_systolic_gate));
        row("EDV", function.edv_ml, errors.map(|errors| errors.edv_ml), "ml", truth.map(|truth| truth.edv_ml), &diastole)?;
        row("ESV", function.esv_ml, errors.and_then(|errors| errors.esv_ml), "ml", truth.map(|truth| truth.esv_ml), &systole)?;
        row("SV", function.sv_ml, None, "ml", truth.map(|truth| truth.edv_ml - truth.esv_ml), "")?;
        row("EF", function.ef_percent, errors.and_then(|errors| errors.ef_percent), "%", truth.map(|truth| truth.ef_percent), "")?;
    } else if let Some(gate) = report.gates.first() {
        row("V", gate.endocardial_ml, errors.map(|errors| errors.edv_ml), "ml", None, "   one gate, so no ejection fraction")?;
    }
    row("mass", report.myocardium.mass_g, errors.map(|errors| errors.mass_g), "g", None, "")
}

/// The point-spread function that the surfaces were fitted with.
fn write_psf(out: &mut String, model: &ModelSummary) -> std::fmt::Result {
    let psf = &model.psf;
    let source = match psf.source {
        PsfSource::Given => "given".to_owned(),
        PsfSource::Estimated => format!("estimated, ± {:.1} mm", HALF_WIDTH_95 * psf.standard_error_mm),
    };
    writeln!(out, "  PSF  {:8.1} mm ({source}; 1 mm more is {:+.1} % of EDV)", psf.fwhm_mm, psf.edv_percent_per_mm)
}

/// The volumes of every gate.
fn write_gates(out: &mut String, report: &Report, truth: Option<&Truth>) -> std::fmt::Result {
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
    Ok(())
}
