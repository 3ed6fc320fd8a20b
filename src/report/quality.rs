//! What the computation can tell of its own result: what it was judged by, a score, flags, and a sentence for each flag.

mod fit;
mod heart;
mod limits;

pub use limits::{QUALITY_LIMITS, QualityLimits, Range};

use super::{
    model::ModelSummary,
    pose::PoseSummary,
    report::{Function, GateReport, Myocardium},
};
use crate::{analysis::Analysis, study::Warning};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What the computation can tell of its own result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Quality {
    /// 0-1: that of the worst of `checks`. ½ and less exactly where a flag is raised. Not a probability: judge by the flags, the uncertainty and by
    /// eye.
    pub score: f64,
    /// Stable codes; each has a sentence of the same code in `warnings`. How often they are right is published (`docs/accuracy.md`).
    ///
    /// Of the study: `gating` (beats lost in a gate, end diastole far from the R wave, gates not in order), `low_counts` (noise), `truncated` (part
    /// of the wall is not in the image), `extracardiac_activity` (something bright beside the wall), `large_defect` (a third of the wall takes up
    /// little), `small_heart` (a cavity that the camera hardly resolves at end systole), `motion` (opposite sides of the wall are dim, as when the
    /// patient moved).
    ///
    /// Of the result: `shape` (a shape or size that hearts do not have), `valve_plane` (where the wall ends is not seen, or moves as no heart's),
    /// `myocardial_volume_not_conserved` (the wall's volume varies by more than 5 % over the cycle), `surfaces_cross` (a cavity is not smaller than
    /// the volume inside the outer surface).
    ///
    /// Preset `clinical`: `poor_residual` (the model leaves more than .15 of the wall's activity beyond noise), `wall_extrapolated` (more than 40 % of
    /// the wall rests on its surroundings), `pose_uncertain` (the ventricle was barely found), `psf_at_bound` (the estimated point-spread
    /// function ran into a limit), `methods_disagree` (an ejection fraction by other means is more than 10 points off), `not_converged` (the fit
    /// did not come to rest, or failed).
    ///
    /// Preset `paper`: `not_converged` (a surface has less than 95 % of its particles within one voxel of its border), `step_limit` (a mesh was still
    /// moving after `deform.max_steps`).
    pub flags: Vec<String>,
    /// What the result was judged by, each with where it begins to count and where it is a flag. Empty in reports of versions before 0.2.
    #[serde(default)]
    #[schema(required)]
    pub checks: Vec<Check>,
}

/// One measure that a result was judged by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Check {
    /// The flag that it can raise.
    #[schema(example = "truncated")]
    pub flag: String,
    /// What is measured, with its unit; null for a fact, such as a fit that did not come to rest.
    #[schema(required, example = "unseen_percent")]
    pub measure: Option<String>,
    /// Its value; null for a fact, and where it is no number.
    #[schema(required)]
    pub value: Option<f64>,
    /// Nothing is wrong up to here.
    #[schema(required)]
    pub fine: Option<f64>,
    /// The flag is raised from here on.
    #[schema(required)]
    pub limit: Option<f64>,
    /// 1 where nothing is wrong, ½ at the limit and for a fact, falling in a straight line between and beyond, to 0 at the least.
    pub score: f64,
}

/// What a result is judged by.
pub(super) struct Evidence<'a> {
    pub gates: &'a [GateReport],
    pub myocardium: &'a Myocardium,
    pub function: Option<&'a Function>,
    pub pose: Option<&'a PoseSummary>,
    pub model: Option<&'a ModelSummary>,
    pub analysis: &'a Analysis,
    /// Whether the surfaces were to be those of the fitted model.
    pub refine: bool,
}

/// What was found so far.
#[derive(Default)]
struct Findings {
    checks: Vec<Check>,
    /// The sentences of flags.
    flagged: Vec<Warning>,
}

impl Findings {
    /// A measure, and what to say from its limit on.
    fn measured(&mut self, flag: &str, measure: &str, value: f64, range: Range, sentence: impl FnOnce() -> String) {
        let warnings = if range.wrong(value) >= 1.0 { vec![Warning::new(flag, sentence())] } else { Vec::new() };
        self.told(flag, measure, value, range, warnings);
    }

    /// A measure, and what is said of it.
    fn told(&mut self, flag: &str, measure: &str, value: f64, range: Range, warnings: Vec<Warning>) {
        self.checks.push(Check {
            flag: flag.to_owned(),
            measure: Some(measure.to_owned()),
            value: value.is_finite().then_some(value),
            fine: Some(range.fine),
            limit: Some(range.limit),
            score: (1.0 - 0.5 * range.wrong(value)).max(0.0),
        });
        self.flagged.extend(warnings);
    }

    /// Something that is wrong.
    fn fact(&mut self, flag: &str, sentence: String) {
        self.facts(vec![Warning::new(flag, sentence)]);
    }

    /// Something that is wrong in one place or several; nothing is, without any.
    fn facts(&mut self, warnings: Vec<Warning>) {
        if let Some(Warning { code, .. }) = warnings.first() {
            self.checks.push(Check { flag: code.clone(), measure: None, value: None, fine: None, limit: None, score: 0.5 });
        }
        self.flagged.extend(warnings);
    }
}

/// The score and the flags, and the sentences that say what and where: one or more for each flag, and what is worth knowing besides.
pub(super) fn assess(evidence: &Evidence<'_>, limits: &QualityLimits) -> (Quality, Vec<Warning>) {
    let mut findings = Findings::default();
    fit::surfaces(evidence.gates, limits, &mut findings);
    if let Some(pose) = evidence.pose {
        fit::pose(pose, limits, &mut findings);
    }
    if let Some(model) = evidence.model {
        fit::model(model, evidence.refine, limits, &mut findings);
        if let Some(function) = evidence.function {
            fit::disagreement(model, function, limits, &mut findings);
        }
    }
    fit::wall(evidence.myocardium, limits, &mut findings);
    of_heart(evidence, limits, &mut findings);
    let Findings { checks, flagged } = findings;
    let mut flags: Vec<String> = Vec::new();
    for warning in &flagged {
        if !flags.contains(&warning.code) {
            flags.push(warning.code.clone());
        }
    }
    let score = checks.iter().map(|check| check.score).fold(1.0, f64::min);
    let mut warnings = flagged;
    warnings.extend(evidence.model.and_then(|model| fit::low_uptake(model, limits)));
    (Quality { score, flags, checks }, warnings)
}

fn of_heart(evidence: &Evidence<'_>, limits: &QualityLimits, findings: &mut Findings) {
    let analysis = evidence.analysis;
    if let Some(gating) = &analysis.signs.gating {
        heart::gating(gating, limits, findings);
    }
    heart::image(analysis, limits, findings);
    let tilts = evidence.gates.iter().filter_map(|gate| gate.model.as_ref()).map(|model| model.base_tilt_degrees.abs());
    heart::valve_plane(analysis, tilts.max_by(f64::total_cmp), limits, findings);
    heart::activity(analysis, limits, findings);
    if let (Some(function), [_, systole]) = (evidence.function, analysis.shapes.as_slice()) {
        heart::size(systole, function.esv_ml, evidence.model.map(|model| model.psf.fwhm_mm), limits, findings);
    }
    if let Some(diastole) = analysis.shapes.first() {
        let thickness_mm = analysis.walls.thickness_range[analysis.end_diastole].as_ref().map(|range| range.mean_mm);
        heart::shape(diastole, thickness_mm, limits, findings);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        analysis::{GatingSigns, Perfusion, Places, RotationSource, Shape, Signs, Walls},
        pipeline::{
            clinical::{ModelFit, PsfEstimate, PsfSource, Referee, Residual},
            pose::{Pose, PoseConfidence},
            thickness::ThicknessRange,
        },
    };
    use glam::DVec3;

    const FUNCTION: Function =
        Function { edv_ml: 100.0, esv_ml: 40.0, sv_ml: 60.0, ef_percent: 60.0, end_diastolic_gate: 1, end_systolic_gate: 4 };
    const MYOCARDIUM: Myocardium = Myocardium { mass_g: 126.0, mean_ml: 120.0, variation_percent: Some(2.0) };

    /// A fit that nothing speaks against.
    fn good() -> ModelFit {
        ModelFit {
            refined: true,
            psf: PsfEstimate {
                fwhm_mm: 11.0,
                source: PsfSource::Estimated,
                standard_error_mm: 0.4,
                at_bound: false,
                edv_percent_per_mm: 9.0,
            },
            residual: Residual { relative: 0.06, over_noise: 1.2 },
            uncertainty: None,
            low_uptake_fraction: 0.0,
            extrapolated_fraction: 0.02,
            referee: Referee { gradient_ef_percent: Some(58.0), counts_ef_percent: Some(66.0) },
            steps: 9,
            converged: true,
            gates: Vec::new(),
        }
    }

    fn pose(score: f64) -> PoseSummary {
        let confidence = PoseConfidence { score, ..PoseConfidence::default() };
        PoseSummary::of(&Pose { apex_mm: DVec3::ZERO, base_mm: DVec3::Z * 80.0, radius_mm: 30.0, confidence }, None)
    }

    /// A heart that nothing speaks against.
    fn heart() -> Analysis {
        let shape = |gate, long_axis_mm: f64, short_axis_mm: f64| Shape {
            gate,
            long_axis_mm,
            short_axis_mm,
            sphericity_index: short_axis_mm / long_axis_mm,
            volume_sphericity: 0.5,
            eccentricity: 0.7,
        };
        let gating = GatingSigns { least_gate_percent: 90.0, end_diastole: -0.125, systole: 0.375, turns: 1.0 };
        Analysis {
            places: Places {
                of_vertex: Vec::new(),
                axes: [DVec3::X, DVec3::Y, DVec3::Z],
                centre_mm: DVec3::ZERO,
                rotation: RotationSource::Given,
            },
            end_diastole: 0,
            end_systole: 3,
            walls: Walls {
                thickness_mm: Vec::new(),
                thickness_range: vec![Some(ThicknessRange { mean_mm: 10.0, max_mm: 12.0, min_mm: 8.0 })],
                thickening_percent: Vec::new(),
                motion_mm: Vec::new(),
            },
            perfusion: Perfusion {
                percent: Vec::new(),
                maximum_counts: 100.0,
                threshold_percent: 50.0,
                extent_percent: 4.0,
                severity_percent: 10.0,
                area_cm2: 5.0,
                without_border_cm2: None,
            },
            phase: None,
            cycle: None,
            shapes: vec![shape(0, 80.0, 50.0), shape(3, 70.0, 35.0)],
            signs: Signs {
                gating: Some(gating),
                unseen_percent: 0.0,
                unseen_base_percent: 0.0,
                base_counts_percent: 85.0,
                bright_beside_percent: 1.0,
                base_motion_mm: Some(9.0),
                opposed_percent: 1.0,
            },
        }
    }

    fn judged_with(fit: &ModelFit, pose: &PoseSummary, myocardium: &Myocardium, refine: bool) -> (Quality, Vec<Warning>) {
        let (model, analysis) = (ModelSummary::from(fit), heart());
        let evidence = Evidence {
            gates: &[],
            myocardium,
            function: Some(&FUNCTION),
            pose: Some(pose),
            model: Some(&model),
            analysis: &analysis,
            refine,
        };
        assess(&evidence, &QUALITY_LIMITS)
    }

    /// The one flag of a heart that is changed.
    fn flag_of_heart(esv_ml: f64, change: impl FnOnce(&mut Analysis)) -> String {
        let mut analysis = heart();
        change(&mut analysis);
        let (model, pose, function) = (ModelSummary::from(&good()), pose(0.9), Function { esv_ml, ..FUNCTION });
        let (function, pose, model) = (Some(&function), Some(&pose), Some(&model));
        let evidence = Evidence { gates: &[], myocardium: &MYOCARDIUM, function, pose, model, analysis: &analysis, refine: true };
        flag(assess(&evidence, &QUALITY_LIMITS))
    }

    fn judged(fit: &ModelFit) -> (Quality, Vec<Warning>) {
        judged_with(fit, &pose(0.9), &MYOCARDIUM, true)
    }

    /// The one flag of a result, its sentence checked.
    fn flag(judged: (Quality, Vec<Warning>)) -> String {
        let (quality, warnings) = judged;
        assert_eq!((quality.flags.len(), warnings.len()), (1, 1), "{quality:?} {warnings:?}");
        assert_eq!(quality.flags[0], warnings[0].code);
        assert!(warnings[0].message.ends_with('.') && warnings[0].message.len() > 40, "{warnings:?}");
        quality.flags[0].clone()
    }

    #[test]
    fn a_good_result_has_no_flag() {
        let (quality, warnings) = judged(&good());
        assert!(quality.flags.is_empty() && warnings.is_empty(), "{quality:?} {warnings:?}");
        assert!(quality.score > 0.75 && quality.score < 1.0, "{quality:?}");
    }

    #[test]
    fn a_residual_that_noise_does_not_explain_is_flagged() {
        let of = |relative, over_noise| judged(&ModelFit { residual: Residual { relative, over_noise }, ..good() });
        assert_eq!(flag(of(0.2, 4.0)), "poor_residual");
        assert_eq!(flag(of(0.2, 1.1)), "low_counts", "noise explains it");
        assert!(of(0.14, 9.0).0.flags.is_empty(), "below the limit");
    }

    #[test]
    fn a_wall_that_is_mostly_extrapolated_is_flagged() {
        let of = |fraction| judged(&ModelFit { extrapolated_fraction: fraction, ..good() });
        assert_eq!(flag(of(0.41)), "wall_extrapolated");
        assert!(of(0.39).0.flags.is_empty());
    }

    #[test]
    fn an_uncertain_pose_is_flagged() {
        let of = |score| judged_with(&good(), &pose(score), &MYOCARDIUM, true);
        assert_eq!(flag(of(QUALITY_LIMITS.pose_score.limit - 0.01)), "pose_uncertain");
        assert!(of(QUALITY_LIMITS.pose_score.limit + 0.01).0.flags.is_empty());
    }

    #[test]
    fn a_point_spread_function_at_its_limit_is_flagged() {
        let of = |at_bound| judged(&ModelFit { psf: PsfEstimate { at_bound, ..good().psf }, ..good() });
        assert_eq!(flag(of(true)), "psf_at_bound");
        assert!(of(false).0.flags.is_empty());
    }

    #[test]
    fn methods_that_disagree_are_flagged_with_what_they_say() {
        let of = |gradient_ef_percent, counts_ef_percent| {
            judged(&ModelFit { referee: Referee { gradient_ef_percent, counts_ef_percent }, ..good() })
        };
        assert_eq!(flag(of(Some(49.0), Some(60.0))), "methods_disagree");
        let (_, warnings) = of(Some(49.0), Some(71.0));
        assert!(warnings[0].message.contains("49 %") && warnings[0].message.contains("71 %"), "{warnings:?}");
        for (gradient, counts) in [(Some(51.0), Some(69.0)), (None, None), (None, Some(55.0))] {
            assert!(of(gradient, counts).0.flags.is_empty());
        }
    }

    #[test]
    fn a_fit_that_did_not_come_to_rest_is_flagged_where_there_was_to_be_one() {
        assert_eq!(flag(judged(&ModelFit { converged: false, ..good() })), "not_converged");
        let fallen_back = ModelFit { refined: false, converged: false, ..good() };
        let judgement = judged(&fallen_back);
        assert!(judgement.1[0].message.contains("gradient"), "{judgement:?}");
        assert_eq!(flag(judgement), "not_converged");
        assert!(judged_with(&fallen_back, &pose(0.9), &MYOCARDIUM, false).0.flags.is_empty(), "switched off");
    }

    #[test]
    fn a_wall_whose_volume_varies_is_flagged() {
        let of = |percent| judged_with(&good(), &pose(0.9), &Myocardium { variation_percent: percent, ..MYOCARDIUM }, true);
        assert_eq!(flag(of(Some(5.1))), "myocardial_volume_not_conserved");
        assert!(of(Some(4.9)).0.flags.is_empty() && of(None).0.flags.is_empty());
    }

    #[test]
    fn low_uptake_is_told_and_no_flag() {
        let (quality, warnings) = judged(&ModelFit { low_uptake_fraction: 0.1, ..good() });
        assert!(quality.flags.is_empty());
        assert_eq!(warnings[0].code, "low_uptake");
        assert!(judged(&ModelFit { low_uptake_fraction: 0.05, ..good() }).1.is_empty());
    }

    #[test]
    fn noise_is_flagged_only_where_the_model_explains_the_rest() {
        let of = |relative, over_noise| judged(&ModelFit { residual: Residual { relative, over_noise }, ..good() });
        assert_eq!(flag(of(0.14, 1.05)), "low_counts");
        assert!(of(0.1, 1.05).0.flags.is_empty(), "below the limit");
    }

    #[test]
    fn gates_that_no_heart_makes_are_flagged() {
        let of = |change: fn(&mut GatingSigns)| flag_of_heart(40.0, |heart| heart.signs.gating.as_mut().into_iter().for_each(change));
        let changes: [fn(&mut GatingSigns); 6] = [
            |gates| gates.least_gate_percent = 49.0,
            |gates| gates.end_diastole = -0.25,
            |gates| gates.end_diastole = 0.25,
            |gates| gates.systole = 0.625,
            |gates| gates.systole = 0.125,
            |gates| gates.turns = 1.3,
        ];
        for change in changes {
            assert_eq!(of(change), "gating");
        }
    }

    #[test]
    fn what_the_image_does_not_hold_or_holds_besides_is_flagged() {
        let of = |change: fn(&mut Analysis)| flag_of_heart(40.0, change);
        assert_eq!(of(|heart| heart.signs.unseen_percent = 5.1), "truncated");
        assert_eq!(of(|heart| heart.signs.bright_beside_percent = 30.0), "extracardiac_activity");
        assert_eq!(of(|heart| heart.perfusion.extent_percent = 40.0), "large_defect");
        assert_eq!(of(|heart| heart.signs.opposed_percent = 10.0), "motion");
        let of_plane: [fn(&mut Analysis); 4] = [
            |heart| heart.signs.unseen_base_percent = 60.0,
            |heart| heart.signs.base_counts_percent = 30.0,
            |heart| heart.signs.base_motion_mm = Some(-2.0),
            |heart| heart.signs.base_motion_mm = Some(25.0),
        ];
        for change in of_plane {
            assert_eq!(of(change), "valve_plane");
        }
    }

    #[test]
    fn sizes_and_shapes_that_hearts_do_not_have_are_flagged() {
        assert_eq!(flag_of_heart(15.0, |_| ()), "small_heart");
        assert_eq!(flag_of_heart(40.0, |heart| heart.shapes[1].short_axis_mm = 12.0), "small_heart");
        let of_shape: [fn(&mut Analysis); 4] = [
            |heart| heart.shapes[0].sphericity_index = 1.1,
            |heart| heart.shapes[0].sphericity_index = 0.3,
            |heart| heart.shapes[0].long_axis_mm = 150.0,
            |heart| heart.walls.thickness_range[0].as_mut().into_iter().for_each(|range| range.mean_mm = 3.0),
        ];
        for change in of_shape {
            assert_eq!(flag_of_heart(40.0, change), "shape");
        }
    }

    #[test]
    fn every_check_says_what_it_measured_and_a_flag_is_half_a_score() {
        let (quality, _) = judged(&good());
        assert!(quality.checks.len() > 20, "{quality:?}");
        assert!(quality.checks.iter().all(|check| check.measure.is_some() && check.value.is_some() && check.score > 0.5), "{quality:?}");
        for judged in [judged(&ModelFit { converged: false, ..good() }), judged(&ModelFit { extrapolated_fraction: 0.4, ..good() })] {
            let (quality, _) = judged;
            let raised: Vec<&str> = quality.checks.iter().filter(|check| check.score <= 0.5).map(|check| check.flag.as_str()).collect();
            assert_eq!(raised, quality.flags, "{quality:?}");
            assert!((quality.score - 0.5).abs() < 1e-9, "{quality:?}");
        }
    }

    #[test]
    fn the_score_falls_with_everything_that_is_wrong_and_is_half_at_a_limit() {
        let clear = ModelFit {
            residual: Residual { relative: 0.0, over_noise: 0.0 },
            extrapolated_fraction: 0.0,
            referee: Referee { gradient_ef_percent: Some(58.0), counts_ef_percent: Some(62.0) },
            ..good()
        };
        let score = |fit: &ModelFit, of_pose: f64| judged_with(fit, &pose(of_pose), &MYOCARDIUM, true).0.score;
        assert!((score(&clear, 1.0) - 1.0).abs() < 1e-12);
        let halves = [
            score(&ModelFit { extrapolated_fraction: 0.4, ..clear.clone() }, 1.0),
            score(&ModelFit { residual: Residual { relative: 0.15, over_noise: 1e9 }, ..clear.clone() }, 1.0),
            score(&clear, QUALITY_LIMITS.pose_score.limit),
        ];
        assert!(halves.iter().all(|half| (half - 0.5).abs() < 1e-9), "{halves:?}");
        let falling: Vec<f64> = (0..10)
            .map(|step| {
                let wrong = f64::from(step) / 10.0;
                let residual = Residual { relative: 0.4 * wrong, over_noise: 1e9 };
                score(&ModelFit { residual, extrapolated_fraction: wrong, ..good() }, 1.0 - wrong)
            })
            .collect();
        assert!(falling.windows(2).all(|pair| pair[1] <= pair[0]) && falling[9].abs() < 1e-12, "{falling:?}");
    }
}
