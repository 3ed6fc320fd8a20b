//! The report as one page for people: curve, bull's-eyes, numbers, surfaces, and what speaks against them. It is self-contained HTML without
//! scripts, prints on one sheet of A4 or letter, and names no patient. The same job gives the same bytes.

mod curves;
mod numbers;
mod surfaces;

use super::{ArchiveError, Finished, polar};
use crate::{
    drawing::svg::escaped,
    report::{PolarMaps, Quantity, Remark, RotationSource},
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::fmt::Write as _;

/// Media type of the page.
pub const MEDIA_TYPE: &str = "text/html; charset=utf-8";

/// Its looks.
const STYLE: &str = include_str!("style.css");

/// Remarks in full at most, and letters in all: with more the page would be two.
const REMARKS: (usize, usize) = (6, 640);

/// What the page is made of beside the report.
#[derive(Debug, Clone, Copy)]
pub struct Parts<'a> {
    /// The polar maps, where they are stored: jobs of versions before 0.2 have none.
    pub maps: Option<&'a PolarMaps>,
    /// `surfaces.glb`.
    pub surfaces: &'a [u8],
}

/// What a browser is to allow the page (`Content-Security-Policy`): its own styles, by their hash, and pictures inside of it; nothing else.
pub fn policy() -> String {
    let hash = STANDARD.encode(Sha256::digest(STYLE));
    format!(
        "default-src 'none'; style-src 'sha256-{hash}'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; sandbox \
         allow-modals"
    )
}

/// The page.
///
/// # Errors
/// [`ArchiveError`] where what is stored is not as this program stored it.
pub fn write(finished: &Finished, parts: &Parts<'_>) -> Result<String, ArchiveError> {
    let report = &finished.report;
    let mut page = String::with_capacity(1 << 19);
    // Writing to a `String` does not fail.
    let _ = write!(
        page,
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width\">\n<title>Left \
         ventricle, gated SPECT: {}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<header><h1>Left ventricle{}</h1><p class=\"unread\">Not reviewed \
         by a physician</p></header>\n",
        escaped(&finished.id.to_string()),
        if report.function.is_some() { ": gated myocardial SPECT" } else { ": myocardial SPECT" },
    );
    page.push_str(&facts(finished));
    page.push_str("<div class=\"top\">\n");
    page.push_str(&numbers::volumes(report));
    page.push_str("<section>");
    page.push_str(&report.cycle.as_ref().map_or_else(no_cycle, curves::volume));
    page.push_str("</section>\n<section>");
    page.push_str(&report.phase.as_ref().map_or_else(String::new, curves::phases));
    page.push_str(&numbers::perfusion(report));
    page.push_str("</section>\n</div>\n<div class=\"middle\">\n<section><h2>Polar maps</h2>");
    page.push_str(&bulls_eyes(parts.maps)?);
    page.push_str("</section>\n<section><h2>Surfaces</h2>");
    page.push_str(&surfaces::pictures(report, parts.surfaces)?);
    page.push_str(&numbers::territories(report));
    page.push_str("</section>\n</div>\n");
    page.push_str(&remarks(finished));
    page.push_str(&footer(finished));
    page.push_str("</body>\n</html>\n");
    Ok(page)
}

fn no_cycle() -> String {
    "<h2>Time-volume curve</h2><p class=\"aside\">Fewer than four gates: no curve, no rates, no phases.</p>".to_owned()
}

/// What the study says of itself.
fn facts(finished: &Finished) -> String {
    let study = &finished.report.study;
    // Not every report has all of these: older ones, and studies that do not tell.
    let told = serde_json::to_value(&finished.report).unwrap_or_default();
    let number = |pointer: &str| told.pointer(pointer).and_then(Value::as_f64);
    let mut facts: Vec<(&str, String)> = Vec::new();
    let mut fact = |name, value: Option<String>| facts.extend(value.map(|value| (name, value)));
    fact("Study", study.study_instance_uid.clone());
    fact("Series", study.series_instance_uid.clone());
    fact("Gates", Some(study.gates.to_string()));
    fact("Heart rate", study.heart_rate_bpm.map(|rate| format!("{rate:.0} /min")));
    fact("R-R interval", study.rr_interval_ms.map(|ms| format!("{ms:.0} ms")));
    let window = number("/study/rr_window_ms/0").zip(number("/study/rr_window_ms/1"));
    fact("R-R window", window.map(|(low, high)| format!("{low:.0} to {high:.0} ms")));
    fact("Beats accepted", number("/study/beats_accepted").map(|beats| format!("{beats:.0}")));
    fact("Beats rejected", number("/study/beats_rejected").map(|beats| format!("{beats:.0}")));
    fact("Body surface", number("/body/surface_area_m2").map(|area| format!("{area:.2} m²")));
    let [slices, rows, columns] = study.grid.shape;
    let [z, y, x] = study.grid.spacing_mm;
    fact("Voxels", Some(format!("{columns} × {rows} × {slices} of {x:.2} × {y:.2} × {z:.2} mm")));
    fact("Computed", Some(finished.finished_at.strftime("%Y-%m-%d %H:%M UTC").to_string()));
    fact("Reconstruction", Some(finished.id.to_string()));
    let items: Vec<String> = facts.iter().map(|(name, value)| format!("<div><dt>{name}</dt> <dd>{}</dd></div>", escaped(value))).collect();
    format!("<dl class=\"facts\">{}</dl>\n", items.concat())
}

/// All maps, or why there are none.
fn bulls_eyes(maps: Option<&PolarMaps>) -> Result<String, ArchiveError> {
    let Some(maps) = maps else {
        return Ok(
            "<p class=\"aside\">This reconstruction was made before polar maps were kept: reconstruct the study again.</p>".to_owned()
        );
    };
    let mut html = String::from("<div class=\"maps\">");
    for map in &maps.maps {
        let unit = polar::shown_unit(map.quantity);
        let unit = if map.quantity == Quantity::Phase { "° of R-R" } else { unit };
        let _ =
            write!(html, "<figure><figcaption><b>{}</b>, {unit}</figcaption>{}</figure>", map.quantity.title(), polar::small(maps, map)?);
    }
    html.push_str("</div>");
    if maps.rotation.source == RotationSource::Assumed {
        html.push_str(
            "<p class=\"aside\"><b>The rotation is not known</b>: the first row was taken for anterior, the first column for septal.</p>",
        );
    }
    html.push_str(
        "<p class=\"aside\">Apex in the middle; A anterior, S septal, I inferior, L lateral. Numbers: means of the 17 AHA segments.</p>",
    );
    Ok(html)
}

/// The score, the flags and the warnings in words.
fn remarks(finished: &Finished) -> String {
    let report = &finished.report;
    let quality = &report.quality;
    let flags = if quality.flags.is_empty() {
        "no flag".to_owned()
    } else {
        format!("<b>{}</b>", escaped(&quality.flags.join(", ").replace('_', " ")))
    };
    let mut letters = 0;
    let fits = |remark: &&Remark| {
        letters += remark.message.len();
        letters <= REMARKS.1
    };
    let shown: Vec<&Remark> = report.warnings.iter().take(REMARKS.0).take_while(fits).collect();
    let items: Vec<String> = shown
        .iter()
        .map(|remark| {
            let gate = remark.gate.map_or_else(String::new, |gate| format!("Gate {gate}: "));
            format!("<li>{gate}{}</li>", escaped(&remark.message))
        })
        .collect();
    let more = report.warnings.len() - shown.len();
    let more = if more == 0 { String::new() } else { format!("<li>And {more} more in the report as JSON.</li>") };
    let many = if shown.len() > 4 { " many" } else { "" };
    let list = if report.warnings.is_empty() { "<p>No warnings.</p>".to_owned() } else { format!("<ul>{}{more}</ul>", items.concat()) };
    format!(
        "<section class=\"remarks{many}\"><h2>Quality and warnings</h2><p>Score {:.2} of 1, {flags}.</p>{list}</section>\n",
        quality.score
    )
}

/// Software, parameters, and what this is not.
fn footer(finished: &Finished) -> String {
    let report = &finished.report;
    let parameters = &report.parameters;
    let preset = serde_json::to_value(parameters.preset).ok().and_then(|preset| preset.as_str().map(str::to_owned)).unwrap_or_default();
    let psf = report.model.as_ref().map_or_else(String::new, |model| {
        let source = serde_json::to_value(model.psf.source).ok().and_then(|source| source.as_str().map(str::to_owned)).unwrap_or_default();
        format!(", point-spread function {:.1} mm ({source})", model.psf.fwhm_mm)
    });
    format!(
        "<footer>{} {}, preset {preset}, mesh level {}{psf}, perfusion threshold {:.0} % of the maximum; all parameters are in the report as JSON. No normal \
         database was used. Computed without a person's review. Research use: not a medical device.</footer>\n",
        escaped(&report.software.name),
        escaped(&report.software.version),
        parameters.mesh.level,
        parameters.analysis.perfusion_threshold_percent,
    )
}
