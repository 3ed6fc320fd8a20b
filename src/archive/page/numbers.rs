//! Tables of the page.

use crate::{
    drawing::bulls_eye::number,
    report::{ErrorSummary, Report, ShapeReport},
};
use serde_json::Value;

/// Volumes, function, rates and shape.
pub(super) fn volumes(report: &Report) -> String {
    let errors = report.uncertainty.as_ref();
    let mut rows = String::new();
    if let Some(function) = &report.function {
        rows += &row("main", "EF", function.ef_percent, 0, errors.and_then(|errors| errors.ef_percent.as_ref()), "%");
        rows += &row("main", "EDV", function.edv_ml, 0, errors.map(|errors| &errors.edv_ml), "ml");
        rows += &row("main", "ESV", function.esv_ml, 0, errors.and_then(|errors| errors.esv_ml.as_ref()), "ml");
        rows += &row("", "Stroke volume", function.sv_ml, 0, None, "ml");
    } else if let Some(gate) = report.gates.first() {
        rows += &row("main", "Cavity", gate.endocardial_ml, 0, errors.map(|errors| &errors.edv_ml), "ml");
    }
    rows += &row("", "Wall mass", report.myocardium.mass_g, 0, errors.map(|errors| &errors.mass_g), "g");
    // By the body's surface, where the report has it.
    let told = serde_json::to_value(report).unwrap_or_default();
    for (name, pointer, unit) in [
        ("EDV index", "/body/edv_ml_per_m2", "ml/m²"),
        ("ESV index", "/body/esv_ml_per_m2", "ml/m²"),
        ("SV index", "/body/sv_ml_per_m2", "ml/m²"),
        ("Mass index", "/body/mass_g_per_m2", "g/m²"),
    ] {
        if let Some(value) = told.pointer(pointer).and_then(Value::as_f64) {
            rows += &row("", name, value, 0, None, unit);
        }
    }
    if let Some(cycle) = &report.cycle {
        for (name, value, decimals, unit) in [
            ("Peak emptying rate", cycle.peak_emptying_rate_edv_per_s, 2, "EDV/s"),
            ("Peak filling rate", cycle.peak_filling_rate_edv_per_s, 2, "EDV/s"),
            ("MFR/3", cycle.mean_filling_rate_first_third_edv_per_s, 2, "EDV/s"),
            ("Time to peak filling", cycle.time_to_peak_filling_ms, 0, "ms"),
        ] {
            if let Some(value) = value {
                rows += &row("", name, value, decimals, None, unit);
            }
        }
    }
    let about = if errors.is_some() { "<p class=\"aside\">± half the 95 % interval.</p>" } else { "" };
    let coarse = if report.cycle.as_ref().is_some_and(|cycle| cycle.coarse) {
        format!("<p class=\"aside\">{} gates: rates and times are coarse.</p>", report.gates.len())
    } else {
        String::new()
    };
    format!("<section><h2>Function</h2><table>{rows}</table>{about}{coarse}{}</section>\n", shape(report))
}

/// One number of a shape.
type OfShape = fn(&ShapeReport) -> f64;

/// Length and width at both ends of the cycle.
fn shape(report: &Report) -> String {
    let Some(shape) = &report.shape else { return String::new() };
    let rows: [(&str, usize, OfShape); 4] = [
        ("Long axis, mm", 0, |shape| shape.long_axis_mm),
        ("Short axis, mm", 0, |shape| shape.short_axis_mm),
        ("Sphericity index", 2, |shape| shape.sphericity_index),
        ("Eccentricity", 2, |shape| shape.eccentricity),
    ];
    let row = |(name, decimals, value): (&str, usize, OfShape)| {
        let systole = shape.end_systole.as_ref().map_or_else(String::new, |shape| number(value(shape), decimals));
        format!("<tr><td>{name}</td><td>{}</td><td>{systole}</td></tr>", number(value(&shape.end_diastole), decimals))
    };
    let (diastole, systole) = if shape.end_systole.is_some() { ("ED", "ES") } else { ("", "") };
    let rows: String = rows.into_iter().map(row).collect();
    format!("<table class=\"gap\"><thead><tr><th>Shape of the cavity</th><th>{diastole}</th><th>{systole}</th></tr></thead>{rows}</table>")
}

/// Perfusion and phase of the whole wall.
pub(super) fn perfusion(report: &Report) -> String {
    let Some(perfusion) = &report.perfusion else { return String::new() };
    let segments: Vec<String> = perfusion.defect_segments.iter().map(ToString::to_string).collect();
    let segments = if segments.is_empty() { "none".to_owned() } else { segments.join(", ") };
    format!(
        "<div class=\"gap\"></div><h2>Perfusion below {:.0} %</h2><table>{}{}{}<tr><td>Segments</td><td colspan=\"2\">{segments}</td></tr></table>",
        perfusion.threshold_percent,
        plain("Extent", perfusion.extent_percent, 0, "% of wall"),
        plain("Area", perfusion.area_cm2, 1, "cm²"),
        plain("Severity", perfusion.severity_percent, 0, "%"),
    )
}

/// Means of the coronary arteries' territories.
pub(super) fn territories(report: &Report) -> String {
    let Some(regional) = &report.regional else { return String::new() };
    let cell = |value: Option<f64>, decimals: usize| value.map_or_else(|| "–".to_owned(), |value| number(value, decimals));
    let parts = regional.territories.iter().map(|territory| (territory.territory.as_str(), &territory.values));
    let rows: Vec<String> = parts
        .chain([("Wall", &regional.whole)])
        .map(|(name, values)| {
            format!(
                "<tr><td>{name}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                cell(values.perfusion_percent, 0),
                cell(values.thickening_percent, 0),
                cell(values.motion_mm, 1),
                cell(values.phase_degrees, 0),
            )
        })
        .collect();
    format!(
        "<div class=\"gap\"></div><h2>Territories</h2><table><thead><tr><th></th><th>perf.<br>%</th><th>thick.<br>%</th><th>motion<br>mm</th><th>phase<br>°</th>\
         </tr></thead>{}</table>",
        rows.concat()
    )
}

/// Name, value, half its 95 % interval, unit.
fn row(class: &str, name: &str, value: f64, decimals: usize, error: Option<&ErrorSummary>, unit: &str) -> String {
    let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
    let error = error.map_or_else(String::new, |error| format!("± {:.decimals$}", error.half_width_95()));
    format!(
        "<tr{class}><td>{name}</td><td>{}</td><td class=\"error\">{error}</td><td class=\"unit\">{unit}</td></tr>",
        number(value, decimals)
    )
}

/// Name, value, unit.
pub(super) fn plain(name: &str, value: f64, decimals: usize, unit: &str) -> String {
    format!("<tr><td>{name}</td><td>{}</td><td class=\"unit\">{unit}</td></tr>", number(value, decimals))
}
