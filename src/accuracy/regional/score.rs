//! One heart: what was found of each part, and what is true.

use super::{
    exact::{self, Exact},
    family::{Heart, Kind},
};
use crate::{
    analysis::{
        self, Analysis, Phase,
        cycle::Rates,
        segments::{self, Average, SEGMENTS},
    },
    phantom::{self, PhantomError, Regional},
    pipeline::{self, Reconstruction, Surface, monitor::Silent, parameters::Parameters},
};

/// What a segment has a value of, in the order of [`Values::segments`].
pub const SEGMENTAL: [&str; 5] = ["thickness ED (mm)", "thickness ES (mm)", "thickening (points)", "motion (mm)", "phase (°)"];
/// Place of the phase among them.
pub const PHASE: usize = 4;

/// What is said of a heart, found or true.
#[derive(Debug, Clone, PartialEq)]
pub struct Values {
    /// `[quantity][segment]`, quantities as [`SEGMENTAL`].
    pub segments: Vec<Vec<Option<f64>>>,
    /// Counts by segment in percent of the maximum.
    pub perfusion_percent: Vec<Option<f64>>,
    /// Mean, standard deviation, bandwidth in degrees and entropy in percent of the phases.
    pub phase: Option<[f64; 4]>,
    /// Long axis, short axis in mm and sphericity index at end diastole, then at end systole.
    pub shape: Vec<f64>,
    /// PER, PFR, MFR/3 in EDV a cycle and TTPF in percent of R-R.
    pub rates: Option<[f64; 4]>,
    /// Part of the wall with a defect in percent of its area.
    pub defect_percent: f64,
    /// Segments below the threshold.
    pub defect_segments: Vec<usize>,
    /// Mean volume of the cavity over the gates in ml.
    pub cavity_ml: f64,
}

/// A heart that was reconstructed.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// What was found.
    pub found: Values,
    /// What is true; rates are those of the exact volumes of the gates.
    pub truth: Values,
    /// Rates of the continuous cycle.
    pub continuous: Option<[f64; 4]>,
    /// Segments of which a part of the regional function (or defect) covers all at half strength, and those that it touches.
    pub covered: Vec<usize>,
    /// See `covered`.
    pub touched: Vec<usize>,
}

/// A heart, and what came of it; the error's code where nothing did.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// The heart's name.
    pub name: String,
    /// Its kind.
    pub kind: Kind,
    /// The score, or why there is none.
    pub outcome: Result<Box<Score>, String>,
}

/// Simulates, reconstructs and compares.
///
/// Errors: a phantom that cannot be made.
pub fn run(heart: &Heart) -> Result<Run, PhantomError> {
    let simulation = phantom::simulate(&heart.phantom)?;
    let parameters = Parameters { analysis: heart.analysis(), ..Parameters::clinical() };
    let outcome =
        pipeline::reconstruct(&simulation.study, &parameters, &Silent).map_err(|error| error.code().to_owned()).and_then(|found| {
            let exact = exact::of(heart, &simulation).ok_or_else(|| "no_truth".to_owned())?;
            Ok(Box::new(scored(heart, &exact, &found, &analysis::analyse(&simulation.study, &found))))
        });
    Ok(Run { name: heart.name.clone(), kind: heart.kind, outcome })
}

fn scored(heart: &Heart, exact: &Exact, found: &Reconstruction, analysis: &Analysis) -> Score {
    let (covered, touched) = sectors(heart, exact);
    let cavities_ml: Vec<f64> = found.gates.iter().map(|gate| gate.volume_ml(Surface::Endocardial)).collect();
    let threshold = analysis.perfusion.threshold_percent;
    let mut found = values(analysis, &cavities_ml);
    found.defect_segments = below(&found.perfusion_percent, threshold);
    let mut truth = values(&exact.analysis, &exact.cavities_ml);
    truth.defect_percent = exact.defect_percent;
    truth.defect_segments = below(&truth.perfusion_percent, threshold);
    Score { found, truth, continuous: exact.continuous.map(|rates| four(&rates)), covered, touched }
}

fn below(percent: &[Option<f64>], threshold: f64) -> Vec<usize> {
    (1..).zip(percent).filter(|(_, percent)| percent.is_some_and(|percent| percent < threshold)).map(|(number, _)| number).collect()
}

fn values(analysis: &Analysis, cavities_ml: &[f64]) -> Values {
    let (places, walls) = (&analysis.places, &analysis.walls);
    let mean = |values: &[Option<f64>], average: Average| segments::means(values, places, average);
    let phases = analysis.phase.as_ref().map_or_else(|| vec![None; SEGMENTS], |phase| mean(&phase.degrees, Average::Circular));
    Values {
        segments: vec![
            mean(&walls.thickness_mm[analysis.end_diastole], Average::Plain),
            mean(&walls.thickness_mm[analysis.end_systole], Average::Plain),
            mean(&walls.thickening_percent, Average::Plain),
            mean(&walls.motion_mm, Average::Plain),
            phases,
        ],
        perfusion_percent: mean(&analysis.perfusion.percent, Average::Plain),
        phase: analysis
            .phase
            .as_ref()
            .map(|phase: &Phase| [phase.mean_degrees, phase.sd_degrees, phase.bandwidth_degrees, phase.entropy_percent]),
        shape: analysis.shapes.iter().flat_map(|shape| [shape.long_axis_mm, shape.short_axis_mm, shape.sphericity_index]).collect(),
        rates: analysis.cycle.as_ref().map(|cycle| four(&cycle.rates)),
        defect_percent: analysis.perfusion.extent_percent,
        defect_segments: Vec::new(),
        cavity_ml: cavities_ml.iter().sum::<f64>() / cavities_ml.len() as f64,
    }
}

fn four(rates: &Rates) -> [f64; 4] {
    [rates.peak_emptying, rates.peak_filling, rates.mean_filling_first_third, 100.0 * rates.time_to_peak_filling]
}

/// Segments with at least 98 % of their area within a sector, and those with more than 2 %.
fn sectors(heart: &Heart, exact: &Exact) -> (Vec<usize>, Vec<usize>) {
    let within = |part: &Regional, degrees: f64| part.strength((270.0 - degrees).to_radians(), 0.5) >= 0.5;
    let places = &exact.analysis.places;
    let inside: Vec<Option<f64>> = places
        .of_vertex
        .iter()
        .map(|place| place.as_ref().map(|place| f64::from(u8::from(heart.phantom.regional.iter().any(|part| within(part, place.degrees))))))
        .collect();
    let shares = segments::means(&inside, places, Average::Plain);
    let over = |least: f64| -> Vec<usize> {
        (1..).zip(&shares).filter(|(_, share)| share.is_some_and(|share| share > least)).map(|(number, _)| number).collect()
    };
    (over(0.98), over(0.02))
}

/// The difference of two angles in degrees, −180 to 180.
pub fn apart(one: f64, other: f64) -> f64 {
    (one - other + 180.0).rem_euclid(360.0) - 180.0
}

impl Score {
    /// Errors of a quantity of [`SEGMENTAL`] in the segments that have it, found and in truth.
    pub fn segment_errors(&self, quantity: usize) -> Vec<f64> {
        let pairs = self.found.segments[quantity].iter().zip(&self.truth.segments[quantity]);
        let difference = |(found, truth): (f64, f64)| if quantity == PHASE { apart(found, truth) } else { found - truth };
        pairs.filter_map(|(found, truth)| found.zip(*truth)).map(difference).collect()
    }

    /// The mean phase of some segments less that of others, in degrees; `None` where either has none.
    pub fn delay_degrees(&self, values: &Values) -> Option<f64> {
        let mean = |wanted: &dyn Fn(usize) -> bool| {
            let phases = (1..).zip(&values.segments[PHASE]).filter(|(number, _)| wanted(*number));
            analysis::phase::circular_mean(phases.filter_map(|(_, phase)| phase.map(|degrees| (degrees, 1.0))))
        };
        let inside = mean(&|number| self.covered.contains(&number))?;
        let outside = mean(&|number| !self.touched.contains(&number))?;
        Some(apart(inside, outside))
    }

    /// Segments whose phase is more than 45° off that of the segments that no sector touches.
    pub fn out_of_step(&self, values: &Values) -> Vec<usize> {
        let phases = || (1..).zip(&values.segments[PHASE]).filter_map(|(number, phase)| Some((number, (*phase)?)));
        let usual = phases().filter(|(number, _)| !self.touched.contains(number)).map(|(_, degrees)| (degrees, 1.0));
        let Some(usual) = analysis::phase::circular_mean(usual) else { return Vec::new() };
        phases().filter(|&(_, degrees)| apart(degrees, usual).abs() > 45.0).map(|(number, _)| number).collect()
    }
}

/// A run as a line of text, for those who look for what went wrong.
pub fn line(run: &Run) -> String {
    let score = match &run.outcome {
        Err(code) => return format!("{:<20} {code}", run.name),
        Ok(score) => score,
    };
    let mut parts = vec![format!("{:<20}", run.name)];
    for (quantity, name) in SEGMENTAL.iter().enumerate() {
        let errors = super::super::statistics::Agreement::of(score.segment_errors(quantity).into_iter().map(Some));
        parts.push(format!("{name} {}", errors.text(1)));
    }
    let phase =
        |values: &Values| values.phase.map_or_else(String::new, |[mean, sd, width, _]| format!("{mean:.0} sd {sd:.1} bw {width:.0}"));
    parts.push(format!("phase {} (true {})", phase(&score.found), phase(&score.truth)));
    if !score.touched.is_empty() {
        parts.push(format!(
            "delay {:.0} (true {:.0}) out of step {:?} (true {:?}), covered {:?}",
            score.delay_degrees(&score.found).unwrap_or(f64::NAN),
            score.delay_degrees(&score.truth).unwrap_or(f64::NAN),
            score.out_of_step(&score.found),
            score.out_of_step(&score.truth),
            score.covered
        ));
    }
    parts.push(format!(
        "defect {:.0} (true {:.0}) {:?}",
        score.found.defect_percent, score.truth.defect_percent, score.found.defect_segments
    ));
    parts.join("  ")
}
