//! What the computation can tell of its own result: a score, flags, and a sentence for each flag.

use super::{
    model::ModelSummary,
    pose::PoseSummary,
    report::{Function, GateReport, Myocardium},
};
use crate::{
    pipeline::{Surface, pose, rest::Stop},
    study::Warning,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Beyond which a result carries a flag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QualityLimits {
    /// Fraction of a surface's particles that must end within one voxel of the border, 0-1.
    pub within_one_voxel: f64,
    /// Coefficient of variation of the wall's volume over the cycle, in percent.
    pub wall_variation_percent: f64,
    /// Root mean square of what the model and noise leave of the counts, as part of the wall's activity.
    pub unexplained_residual: f64,
    /// Part of the wall that may rest on its surroundings, in percent.
    pub extrapolated_percent: f64,
    /// Part of the wall that may take up little without being told of, in percent. What is beyond is a warning, not a flag.
    pub low_uptake_percent: f64,
    /// Score that a pose must have, 0-1.
    pub pose_score: f64,
    /// How far an ejection fraction by other means may be from the reported one, in points.
    pub ef_disagreement_points: f64,
}

/// The limits in use.
///
/// - The paper's free model ends with 97 % of the particles within one voxel (its Table 1); 95 % leaves room for noise.
/// - Myocardium is nearly incompressible, so a wall whose volume varies by more than 5 % over the cycle was measured wrongly in some gate.
/// - A flat wall of 10 mm under a point-spread function of 11 mm, put 3 mm beside its place, leaves .15 of its activity within 15 mm of its
///   middle (.14 to .21 for 14 to 8 mm): further off than that, or of another shape, the model is not this wall's.
/// - Over 40 % extrapolated the shape is more the prior's than the patient's, as a defect of half the wall with its rims is.
/// - Over 6 % of low uptake is where the model's handling of defects begins to matter (`docs/numerics.md`).
/// - Poses are graded by [`crate::pipeline::pose`].
/// - Two studies of one patient differ by 6 to 7 points of ejection fraction when they are read semi-automatically (`docs/accuracy.md`); a
///   disagreement of methods beyond 10 points is more than that.
pub const QUALITY_LIMITS: QualityLimits = QualityLimits {
    within_one_voxel: 0.95,
    wall_variation_percent: 5.0,
    unexplained_residual: 0.15,
    extrapolated_percent: 40.0,
    low_uptake_percent: 6.0,
    pose_score: pose::POSE_UNCERTAIN,
    ef_disagreement_points: 10.0,
};

/// What the computation can tell of its own result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Quality {
    /// 0-1. With the preset `clinical` the product of three factors, each 1 where nothing speaks against the result, ½ at the limit of its flag and
    /// falling in a straight line between and beyond, to 0 at the least: the model's unexplained residual (0, limit .15), the extrapolated part of the
    /// wall (0, limit 40 %), the pose's score (1, limit of `pose_uncertain`). With the preset `paper` the mean, over gates and surfaces, of the
    /// fraction of particles within one voxel of the detected border: 1 says that every surface reached its border, not that the border is
    /// the heart's. Neither is a probability: judge by the flags, the uncertainty and by eye.
    pub score: f64,
    /// Stable codes; each has a sentence of the same code in `warnings`.
    ///
    /// Preset `clinical`: `poor_residual` (the model leaves more than .15 of the wall's activity beyond noise), `wall_extrapolated` (more than 40 % of
    /// the wall rests on its surroundings), `pose_uncertain` (the ventricle was barely found), `psf_at_bound` (the estimated point-spread
    /// function ran into a limit), `methods_disagree` (an ejection fraction by other means is more than 10 points off), `not_converged` (the fit
    /// did not come to rest, or failed).
    ///
    /// Preset `paper`: `not_converged` (a surface has less than 95 % of its particles within one voxel of its border), `step_limit` (a mesh was still
    /// moving after `deform.max_steps`).
    ///
    /// Both: `myocardial_volume_not_conserved` (the wall's volume varies by more than 5 % over the cycle), `surfaces_cross` (a cavity is not smaller
    /// than the volume inside the outer surface).
    pub flags: Vec<String>,
}

/// What a result is judged by.
pub(super) struct Evidence<'a> {
    pub gates: &'a [GateReport],
    pub myocardium: &'a Myocardium,
    pub function: Option<&'a Function>,
    pub pose: Option<&'a PoseSummary>,
    pub model: Option<&'a ModelSummary>,
    /// Whether the surfaces were to be those of the fitted model.
    pub refine: bool,
}

/// The score and the flags, and the sentences that say what and where: one or more for each flag, and what is worth knowing besides.
pub(super) fn assess(evidence: &Evidence<'_>, limits: &QualityLimits) -> (Quality, Vec<Warning>) {
    let mut flagged = Vec::new();
    for gate in evidence.gates {
        of_gate(gate, limits, &mut flagged);
    }
    if let Some(pose) = evidence.pose.filter(|pose| pose.confidence.score < limits.pose_score) {
        let text = format!(
            "The ventricle was found with a score of {:.2} only ({} is sure enough): check the surfaces, or give `pose`.",
            pose.confidence.score, limits.pose_score
        );
        flagged.push(Warning::new("pose_uncertain", text));
    }
    if let Some(model) = evidence.model {
        of_model(model, evidence.refine, limits, &mut flagged);
        flagged.extend(evidence.function.and_then(|function| disagreement(model, function, limits)));
    }
    if let Some(percent) = evidence.myocardium.variation_percent.filter(|&percent| percent > limits.wall_variation_percent) {
        let text =
            format!("The wall's volume varies by {percent:.1} % over the cycle; myocardium keeps its volume, so at least one gate is off.");
        flagged.push(Warning::new("myocardial_volume_not_conserved", text));
    }
    let mut flags: Vec<String> = Vec::new();
    for warning in &flagged {
        if !flags.contains(&warning.code) {
            flags.push(warning.code.clone());
        }
    }
    let mut warnings = flagged;
    warnings.extend(evidence.model.and_then(|model| low_uptake(model, limits)));
    (Quality { score: score(evidence, limits), flags }, warnings)
}

fn of_gate(gate: &GateReport, limits: &QualityLimits, flagged: &mut Vec<Warning>) {
    let fits = [(Surface::Endocardial, &gate.fit.endocardial), (Surface::Epicardial, &gate.fit.epicardial)];
    for (surface, fit) in fits {
        let Some(percent) = fit.within_one_voxel_percent else { continue };
        if percent / 100.0 < limits.within_one_voxel {
            let name = surface.name();
            let text = format!("The {name} surface has {percent:.1} % of its particles within one voxel of the detected border.");
            flagged.push(Warning::at_gate(gate.gate, "not_converged", text));
        }
    }
    for (surface, fit) in fits {
        if fit.stop == Some(Stop::StepLimit) {
            let text =
                format!("The {} surface had not come to rest after {} steps, the most that were allowed.", surface.name(), fit.steps);
            flagged.push(Warning::at_gate(gate.gate, "step_limit", text));
        }
    }
    if gate.myocardial_ml <= 0.0 {
        let text = format!(
            "The cavity ({:.1} ml) is not smaller than the volume inside the outer surface ({:.1} ml).",
            gate.endocardial_ml, gate.epicardial_ml
        );
        flagged.push(Warning::at_gate(gate.gate, "surfaces_cross", text));
    }
}

fn of_model(model: &ModelSummary, refine: bool, limits: &QualityLimits, flagged: &mut Vec<Warning>) {
    let mut flag = |code: &str, text: String| flagged.push(Warning::new(code, text));
    if model.residual.unexplained > limits.unexplained_residual {
        let text = format!(
            "The model leaves {:.0} % of the wall's activity unexplained beyond noise ({:.0} % is the limit): something else is bright beside the \
             wall, or the wall is not where the surfaces are.",
            100.0 * model.residual.unexplained,
            100.0 * limits.unexplained_residual
        );
        flag("poor_residual", text);
    }
    if model.extrapolated_percent > limits.extrapolated_percent {
        let text = format!(
            "{:.0} % of the wall was placed by its surroundings more than by its own counts ({:.0} % is the limit).",
            model.extrapolated_percent, limits.extrapolated_percent
        );
        flag("wall_extrapolated", text);
    }
    if model.psf.at_bound {
        let text = format!(
            "The estimate of the point-spread function ended at a limit of its search ({:.1} mm). Volumes depend on it: give `refine.psf_fwhm_mm` if \
             it is known.",
            model.psf.fwhm_mm
        );
        flag("psf_at_bound", text);
    }
    if refine && !model.refined {
        flag("not_converged", "The model of the camera could not be fitted: the surfaces are those at the gradient's extrema.".to_owned());
    } else if refine && !model.converged {
        let text = format!("The fit of the model had not come to rest after {} steps, the most that were allowed.", model.steps);
        flag("not_converged", text);
    }
}

/// The ejection fractions by other means that are too far from the reported one.
fn disagreement(model: &ModelSummary, function: &Function, limits: &QualityLimits) -> Option<Warning> {
    let others =
        [("the gradient's borders", model.referee.gradient_ef_percent), ("the rise of the wall's counts", model.referee.counts_ef_percent)];
    let far: Vec<String> = others
        .into_iter()
        .filter_map(|(by, percent)| percent.map(|percent| (by, percent)))
        .filter(|(_, percent)| (percent - function.ef_percent).abs() > limits.ef_disagreement_points)
        .map(|(by, percent)| format!("{percent:.0} % by {by}"))
        .collect();
    if far.is_empty() {
        return None;
    }
    let text = format!("The ejection fraction is {:.0} %, but {}: judge it by eye.", function.ef_percent, far.join(" and "));
    Some(Warning::new("methods_disagree", text))
}

/// Says that part of the wall takes up little: what a physician wants to know, and no doubt of the result.
fn low_uptake(model: &ModelSummary, limits: &QualityLimits) -> Option<Warning> {
    (model.low_uptake_percent > limits.low_uptake_percent).then(|| {
        let text = format!(
            "{:.0} % of the wall takes up little: a perfusion defect, or the camera's. There the surfaces lean on the wall around.",
            model.low_uptake_percent
        );
        Warning::new("low_uptake", text)
    })
}

/// 1 where nothing is wrong, ½ at the limit, 0 at twice of it and beyond.
fn factor(wrong: f64, limit: f64) -> f64 {
    (1.0 - 0.5 * wrong / limit).clamp(0.0, 1.0)
}

fn score(evidence: &Evidence<'_>, limits: &QualityLimits) -> f64 {
    if evidence.model.is_none() && evidence.pose.is_none() {
        let fits = evidence.gates.iter().flat_map(|gate| [&gate.fit.endocardial, &gate.fit.epicardial]);
        let within: Vec<f64> = fits.filter_map(|fit| fit.within_one_voxel_percent).map(|percent| percent / 100.0).collect();
        return within.iter().sum::<f64>() / within.len().max(1) as f64;
    }
    let found = evidence.pose.map_or(1.0, |pose| factor(1.0 - pose.confidence.score, 1.0 - limits.pose_score));
    let explained = evidence.model.map_or(1.0, |model| factor(model.residual.unexplained, limits.unexplained_residual));
    let seen = evidence.model.map_or(1.0, |model| factor(model.extrapolated_percent, limits.extrapolated_percent));
    found * explained * seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{
        clinical::{ModelFit, PsfEstimate, PsfSource, Referee, Residual},
        pose::{Pose, PoseConfidence},
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

    fn judged_with(fit: &ModelFit, pose: &PoseSummary, myocardium: &Myocardium, refine: bool) -> (Quality, Vec<Warning>) {
        let model = ModelSummary::from(fit);
        let evidence = Evidence { gates: &[], myocardium, function: Some(&FUNCTION), pose: Some(pose), model: Some(&model), refine };
        assess(&evidence, &QUALITY_LIMITS)
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
        assert!(of(0.2, 1.1).0.flags.is_empty(), "noise explains it");
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
        assert_eq!(flag(of(QUALITY_LIMITS.pose_score - 0.01)), "pose_uncertain");
        assert!(of(QUALITY_LIMITS.pose_score).0.flags.is_empty());
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
    fn the_score_falls_with_everything_that_is_wrong_and_is_half_at_a_limit() {
        let clear = ModelFit { residual: Residual { relative: 0.0, over_noise: 0.0 }, extrapolated_fraction: 0.0, ..good() };
        let score = |fit: &ModelFit, of_pose: f64| judged_with(fit, &pose(of_pose), &MYOCARDIUM, true).0.score;
        assert!((score(&clear, 1.0) - 1.0).abs() < 1e-12);
        let halves = [
            score(&ModelFit { extrapolated_fraction: 0.4, ..clear.clone() }, 1.0),
            score(&ModelFit { residual: Residual { relative: 0.15, over_noise: 1e9 }, ..clear.clone() }, 1.0),
            score(&clear, QUALITY_LIMITS.pose_score),
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
