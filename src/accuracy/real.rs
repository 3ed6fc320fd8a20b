//! Real studies with semi-automatic labels. The labels are no truth (see `docs/accuracy.md`): what is compared is agreement.

use super::{
    AccuracyError, parallel,
    score::{Method, Values},
    statistics::{Agreement, correlation, gates_apart, mean, standard_deviation},
};
use crate::{
    analysis,
    drawing::markdown::{Table, signed},
    pipeline::{self, Reconstruction, monitor::Silent},
    report::{self, Timing},
    study::Study,
};

/// A study and what its label says.
#[derive(Debug, Clone)]
pub struct Labelled {
    /// Its name; the studies of one patient differ in the last letter only.
    pub name: String,
    /// The study.
    pub study: Study,
    /// Endocardial volume of every gate in ml, as labelled.
    pub cavity_ml: Vec<f64>,
    /// Epicardial volume of every gate in ml, as labelled.
    pub whole_ml: Vec<f64>,
}

impl Labelled {
    /// What follows from the label's volumes.
    pub fn values(&self) -> Option<Values> {
        Values::of_cycle(&self.cavity_ml, &self.whole_ml)
    }
}

/// A real study by one method.
#[derive(Debug, Clone)]
pub struct RealRun {
    /// The study's name.
    pub name: String,
    /// By what it was reconstructed.
    pub method: Method,
    /// Gates of the study.
    pub gates: usize,
    /// What the label says.
    pub label: Values,
    /// What was found, or the code of the failure.
    pub found: Result<Values, &'static str>,
    /// Full width at half maximum of the estimated point-spread function in mm.
    pub psf_fwhm_mm: Option<f64>,
    /// Quality flags of its report.
    pub flags: Vec<String>,
}

impl RealRun {
    /// Found less labelled ejection fraction in points.
    pub fn ef_points(&self) -> Option<f64> {
        self.found.ok().map(|found| found.ef_percent - self.label.ef_percent)
    }

    /// Whether both gates are within one of the label's.
    pub fn gates_agree(&self) -> bool {
        self.found.is_ok_and(|found| {
            gates_apart(found.end_diastolic_gate, self.label.end_diastolic_gate, self.gates) <= 1
                && gates_apart(found.end_systolic_gate, self.label.end_systolic_gate, self.gates) <= 1
        })
    }
}

/// Every study by every method, told nothing; `each` is handed what the clinical preset found (to draw it).
///
/// Errors: no thread.
pub fn run(
    studies: &[Labelled],
    methods: &[Method],
    threads: usize,
    each: impl Fn(&Labelled, &Reconstruction) + Sync,
) -> Result<Vec<RealRun>, AccuracyError> {
    let of_study = |_: usize, labelled: &Labelled| {
        let of = |&method: &Method| {
            let found = pipeline::reconstruct(&labelled.study, &method.parameters(None), &Silent);
            if let (Method::Clinical, Ok(found)) = (method, &found) {
                each(labelled, found);
            }
            let reconstruction = found.as_ref().ok();
            let flags = reconstruction.map_or_else(Vec::new, |found| {
                let analysis = analysis::analyse(&labelled.study, found);
                report::build(&labelled.name, &labelled.study, found, &analysis, &Timing::default()).quality.flags
            });
            labelled.values().map(|label| RealRun {
                name: labelled.name.clone(),
                method,
                gates: labelled.study.gates.len(),
                label,
                psf_fwhm_mm: reconstruction.and_then(|found| found.model.as_ref()).map(|model| model.psf.fwhm_mm),
                found: found.as_ref().map_err(pipeline::PipelineError::code).and_then(|found| Values::of(found).ok_or("no_volumes")),
                flags,
            })
        };
        methods.iter().filter_map(of).collect::<Vec<_>>()
    };
    Ok(parallel::in_order(studies, threads, of_study)?.into_iter().flatten().collect())
}

/// A line a study, by one method.
pub fn studies(runs: &[RealRun], method: Method) -> String {
    let mut table = Table::new([
        "study",
        "EF (%)",
        "label",
        "difference",
        "EDV (ml)",
        "label",
        "ED / ES gate",
        "label",
        "wall spread (%)",
        "FWHM (mm)",
        "flags",
    ]);
    for run in runs.iter().filter(|run| run.method == method) {
        let label = &run.label;
        let gates = |values: &Values| format!("{} / {}", values.end_diastolic_gate, values.end_systolic_gate);
        let (ef, edv) = (format!("{:.1}", label.ef_percent), format!("{:.0}", label.edv_ml));
        match &run.found {
            Err(code) => table.row([run.name.clone(), format!("failed: {code}"), ef, String::new(), String::new(), edv]),
            Ok(found) => table.row([
                run.name.clone(),
                format!("{:.1}", found.ef_percent),
                ef,
                signed(found.ef_percent - label.ef_percent, 1),
                format!("{:.0}", found.edv_ml),
                edv,
                gates(found),
                gates(label),
                format!("{:.1}", found.wall_spread_percent),
                run.psf_fwhm_mm.map_or_else(|| "—".to_owned(), |mm| format!("{mm:.1}")),
                run.flags.join(", ").replace('_', " "),
            ]),
        }
    }
    table.to_string()
}

/// What the studies say together, a row a method.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// By what they were reconstructed.
    pub method: Method,
    /// Found less labelled ejection fraction in points, with the failures.
    pub ef: Agreement,
    /// Correlation of the ejection fractions.
    pub ef_r: f64,
    /// Correlation of the end-diastolic volumes.
    pub edv_r: f64,
    /// Mean ratio of the end-diastolic volumes, found over labelled.
    pub edv_ratio: f64,
    /// Studies whose two gates are both within one of the label's.
    pub gates_agree: usize,
    /// Standard deviation of the differences between a patient's two ejection fractions, found and labelled, in points, over the patients whose
    /// two studies did not fail.
    pub pair_sd: [f64; 2],
    /// Mean and largest spread of the wall's volume over the cycle in percent.
    pub wall_spread_percent: [f64; 2],
}

impl Summary {
    /// Of the runs by one method.
    pub fn of(runs: &[RealRun], method: Method) -> Self {
        let chosen: Vec<&RealRun> = runs.iter().filter(|run| run.method == method).collect();
        let known: Vec<(Values, Values)> = chosen.iter().filter_map(|run| run.found.ok().map(|found| (found, run.label))).collect();
        let pairs = |value: fn(&Values) -> f64| known.iter().map(|(found, label)| (value(found), value(label))).collect::<Vec<_>>();
        let ratios: Vec<f64> = known.iter().map(|(found, label)| found.edv_ml / label.edv_ml).collect();
        let spreads: Vec<f64> = known.iter().map(|(found, _)| found.wall_spread_percent).collect();
        let both: Vec<(f64, f64)> = patients(&chosen)
            .filter_map(|(one, other)| {
                let (first, second) = (one.found.ok()?, other.found.ok()?);
                Some((first.ef_percent - second.ef_percent, one.label.ef_percent - other.label.ef_percent))
            })
            .collect();
        let (ours, labels): (Vec<f64>, Vec<f64>) = both.into_iter().unzip();
        Self {
            method,
            ef: Agreement::of(chosen.iter().map(|run| run.ef_points())),
            ef_r: correlation(&pairs(|values| values.ef_percent)),
            edv_r: correlation(&pairs(|values| values.edv_ml)),
            edv_ratio: mean(&ratios),
            gates_agree: chosen.iter().filter(|run| run.gates_agree()).count(),
            pair_sd: [standard_deviation(&ours), standard_deviation(&labels)],
            wall_spread_percent: [mean(&spreads), spreads.iter().copied().fold(f64::NAN, f64::max)],
        }
    }
}

/// Pairs of studies whose names differ in the last letter only.
fn patients<'a>(runs: &'a [&'a RealRun]) -> impl Iterator<Item = (&'a RealRun, &'a RealRun)> {
    let patient = |run: &RealRun| run.name.char_indices().last().map_or(String::new(), |(last, _)| run.name[..last].to_owned());
    runs.iter().enumerate().filter_map(move |(place, &one)| {
        let other = runs[place + 1..].iter().find(|other| patient(other) == patient(one))?;
        Some((one, *other))
    })
}

/// The summaries as a table.
pub fn summaries(runs: &[RealRun], methods: &[Method]) -> String {
    let mut table = Table::new([
        "method",
        "n",
        "failed",
        "EF − label (points)",
        "EF r",
        "EDV r",
        "EDV / label",
        "ED and ES gate within one",
        "SD of pair differences (points)",
        "labels'",
        "wall spread, mean (%)",
        "largest (%)",
    ]);
    for &method in methods {
        let of = Summary::of(runs, method);
        if of.ef.studies == 0 {
            continue;
        }
        table.row([
            method.name().to_owned(),
            of.ef.studies.to_string(),
            of.ef.failed.to_string(),
            of.ef.text(1),
            format!("{:.2}", of.ef_r),
            format!("{:.2}", of.edv_r),
            format!("{:.2}", of.edv_ratio),
            format!("{} of {}", of.gates_agree, of.ef.studies),
            format!("{:.1}", of.pair_sd[0]),
            format!("{:.1}", of.pair_sd[1]),
            format!("{:.1}", of.wall_spread_percent[0]),
            format!("{:.1}", of.wall_spread_percent[1]),
        ]);
    }
    table.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(name: &str, ef: Option<f64>, label: f64) -> RealRun {
        let values = |ef: f64| Values::of_cycle(&[100.0, 100.0 - ef], &[200.0, 200.0 - ef]).unwrap();
        RealRun {
            name: name.to_owned(),
            method: Method::Clinical,
            gates: 2,
            label: values(label),
            found: ef.map(values).ok_or("no_border"),
            psf_fwhm_mm: None,
            flags: Vec::new(),
        }
    }

    /// Differences of pairs: found 60 − 50 = 10 and 40 − 42 = −2, mean 4, SD √72; labels 8 and 0: SD √32. The third patient's second study failed.
    #[test]
    fn pairs_are_patients_and_failures_are_counted() {
        let runs = [
            run("x-1a", Some(60.0), 58.0),
            run("x-1b", Some(50.0), 50.0),
            run("x-2a", Some(40.0), 41.0),
            run("x-2b", Some(42.0), 41.0),
            run("x-3a", Some(42.0), 41.0),
            run("x-3b", None, 90.0),
        ];
        let found = Summary::of(&runs, Method::Clinical);
        assert!((found.pair_sd[0] - 72.0_f64.sqrt()).abs() < 1e-9 && (found.pair_sd[1] - 32.0_f64.sqrt()).abs() < 1e-9, "{found:?}");
        assert_eq!((found.ef.studies, found.ef.failed, found.gates_agree), (6, 1, 5));
        assert!((found.ef.bias - 0.6).abs() < 1e-9);
        assert!(summaries(&runs, &[Method::Clinical]).contains("| clinical | 6 | 1 | +0.6 ± 1.1 |"));
        assert!(studies(&runs, Method::Clinical).contains("failed: no_border"));
    }
}
