//! Table 6 (§7.6): what is recovered when a part of the wall is missing.

use super::{PaperError, printed};
use crate::{
    drawing::markdown::{Table, grouped, signed},
    phantom::{self, Defect, Phantom, Site},
    pipeline::{self, PipelineError, Reconstruction, Surface, monitor::Silent, parameters::Parameters},
};

/// Where the wall is emptied.
pub const SITES: [Site; 3] = [Site::Apical, Site::Anterior, Site::Inferior];

/// One reconstruction.
#[derive(Debug, Clone)]
pub struct Row {
    /// Share of the wall that was emptied, in percent.
    pub emptied_percent: f64,
    /// Where; none for the whole wall.
    pub site: Option<Site>,
    /// Volume inside the outer surface in mm³, or why there is none.
    pub outcome: Result<Recovered, PipelineError>,
}

/// What was recovered.
#[derive(Debug, Clone, PartialEq)]
pub struct Recovered {
    /// Volume inside the outer surface in mm³.
    pub volume_mm3: f64,
    /// Codes of the warnings.
    pub warnings: Vec<String>,
}

/// All of the table.
#[derive(Debug, Clone)]
pub struct Missing {
    /// The exact volume inside the outer surface in mm³, which no missing counts change.
    pub exact_mm3: f64,
    /// The whole wall first, then each site with each share.
    pub rows: Vec<Row>,
}

/// The heart-like phantom with 0, 10, 32 and 53 % of its wall without counts at each site; the region is estimated.
pub fn measure() -> Result<Missing, PaperError> {
    let mut runs = vec![(0.0, None)];
    for site in SITES {
        runs.extend(printed::MISSING[1..].iter().map(|row| (row.emptied_percent, Some(site))));
    }
    let mut rows = Vec::new();
    let mut exact_mm3 = 0.0;
    for (emptied_percent, site) in runs {
        let mut phantom = Phantom::heart_like();
        phantom.uptake.defects = site.map(|site| Defect { site, extent: emptied_percent / 100.0, severity: 1.0 }).into_iter().collect();
        let simulation = phantom::simulate(&phantom)?;
        exact_mm3 = simulation.truth.gates[0].epicardial_ml * 1000.0;
        let outcome = pipeline::reconstruct(&simulation.study, &Parameters::paper(), &Silent).map(|found| recovered(&found));
        rows.push(Row { emptied_percent, site, outcome });
    }
    Ok(Missing { exact_mm3, rows })
}

fn recovered(found: &Reconstruction) -> Recovered {
    let mut warnings: Vec<String> = found.warnings.iter().map(|warning| warning.code.clone()).collect();
    warnings.dedup();
    Recovered { volume_mm3: found.gates[0].volume_ml(Surface::Epicardial) * 1000.0, warnings }
}

/// The table, then the paper's own with its percentages and relative errors computed again.
pub fn markdown(missing: &Missing) -> String {
    let whole = missing.rows.first().and_then(|row| row.outcome.as_ref().ok()).map(|recovered| recovered.volume_mm3);
    let mut table = Table::new([
        "emptied (%)",
        "where",
        "recovered (mm³)",
        "of the whole wall's (%)",
        "off the truth (%)",
        "relative error, the paper's",
        "warnings",
    ]);
    for row in &missing.rows {
        let first = [format!("{:.0}", row.emptied_percent), row.site.map_or("—", site_name).to_owned()];
        let rest = match &row.outcome {
            Err(error) => [format!("`{}`", error.code()), "—".to_owned(), "—".to_owned(), "—".to_owned(), String::new()],
            Ok(recovered) => {
                let of_whole = whole.map(|whole| 100.0 * recovered.volume_mm3 / whole);
                let error = of_whole.filter(|_| row.site.is_some()).map(|part| printed::relative_error(row.emptied_percent, part));
                [
                    grouped(recovered.volume_mm3),
                    of_whole.map_or_else(|| "—".to_owned(), |part| format!("{part:.1}")),
                    signed(100.0 * (recovered.volume_mm3 / missing.exact_mm3 - 1.0), 1),
                    error.map_or_else(|| "—".to_owned(), |error| format!("{error:.2}")),
                    recovered.warnings.iter().map(|code| format!("`{code}`")).collect::<Vec<_>>().join(", "),
                ]
            }
        };
        table.row(first.into_iter().chain(rest));
    }
    let mut paper =
        Table::new(["**paper**: emptied (%)", "volume (mm³)", "% of total, printed", "computed", "relative error, printed", "computed"]);
    for row in &printed::MISSING {
        let percent = row.recovered_percent();
        let error = row.relative_error.map(|_| printed::relative_error(row.emptied_percent, percent));
        paper.row([
            format!("{:.0}", row.emptied_percent),
            grouped(row.volume_mm3),
            format!("{:.1}", row.of_total_percent),
            format!("{percent:.2}"),
            row.relative_error.map_or_else(|| "—".to_owned(), |error| format!("{error:.2}")),
            error.map_or_else(|| "—".to_owned(), |error| format!("{error:.3}")),
        ]);
    }
    format!("Exact volume inside the outer surface: {} mm³.\n\n{table}\n{paper}", grouped(missing.exact_mm3))
}

fn site_name(site: Site) -> &'static str {
    match site {
        Site::Apical => "apical",
        Site::Anterior => "anterior",
        Site::Inferior => "inferior",
        Site::Septal => "septal",
        Site::Lateral => "lateral",
    }
}
