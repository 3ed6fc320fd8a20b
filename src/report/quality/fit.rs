//! What the computation says of itself: whether surfaces reached their borders, whether the model explains the counts, how sure values are.

use super::{Findings, QualityLimits};
use crate::{
    pipeline::{Surface, rest::Stop},
    report::{
        model::ModelSummary,
        pose::PoseSummary,
        report::{Function, GateReport, Myocardium},
    },
    study::Warning,
};

/// Of surfaces that were moved to a border (preset `paper`), and of both together.
pub(super) fn surfaces(gates: &[GateReport], limits: &QualityLimits, findings: &mut Findings) {
    let fits = || {
        gates.iter().flat_map(|gate| {
            [(Surface::Endocardial, &gate.fit.endocardial), (Surface::Epicardial, &gate.fit.epicardial)]
                .map(|(surface, fit)| (gate, surface, fit))
        })
    };
    let within = || fits().filter_map(|(gate, surface, fit)| fit.within_one_voxel_percent.map(|percent| (gate, surface, percent)));
    if let Some(worst) = within().map(|(_, _, percent)| percent).min_by(f64::total_cmp) {
        let range = limits.within_one_voxel;
        let far = within().filter(|(_, _, percent)| range.wrong(percent / 100.0) >= 1.0).map(|(gate, surface, percent)| {
            let name = surface.name();
            let text = format!("The {name} surface has {percent:.1} % of its particles within one voxel of the detected border.");
            Warning::at_gate(gate.gate, "not_converged", text)
        });
        findings.told("not_converged", "within_one_voxel", worst / 100.0, range, far.collect());
    }
    let moving = fits().filter(|(_, _, fit)| fit.stop == Some(Stop::StepLimit)).map(|(gate, surface, fit)| {
        let text = format!("The {} surface had not come to rest after {} steps, the most that were allowed.", surface.name(), fit.steps);
        Warning::at_gate(gate.gate, "step_limit", text)
    });
    findings.facts(moving.collect());
    let crossing = gates.iter().filter(|gate| gate.myocardial_ml <= 0.0).map(|gate| {
        let text = format!(
            "The cavity ({:.1} ml) is not smaller than the volume inside the outer surface ({:.1} ml).",
            gate.endocardial_ml, gate.epicardial_ml
        );
        Warning::at_gate(gate.gate, "surfaces_cross", text)
    });
    findings.facts(crossing.collect());
}

/// Of the place that was found.
pub(super) fn pose(pose: &PoseSummary, limits: &QualityLimits, findings: &mut Findings) {
    let (score, range) = (pose.confidence.score, limits.pose_score);
    findings.measured("pose_uncertain", "pose_score", score, range, || {
        format!(
            "The ventricle was found with a score of {score:.2} only (more than {} is sure enough): check the surfaces, or give `pose`.",
            range.limit
        )
    });
}

/// Of the model of the camera.
pub(super) fn model(model: &ModelSummary, refine: bool, limits: &QualityLimits, findings: &mut Findings) {
    let range = limits.unexplained_residual;
    findings.measured("poor_residual", "unexplained_residual", model.residual.unexplained, range, || {
        format!(
            "The model leaves {:.0} % of the wall's activity unexplained beyond noise ({:.0} % is the limit): something else is bright beside the \
             wall, or the wall is not where the surfaces are.",
            100.0 * model.residual.unexplained,
            100.0 * range.limit
        )
    });
    // What the residual has beside what is unexplained.
    let residual = &model.residual;
    let percent = 100.0 * (residual.relative.powi(2) - residual.unexplained.powi(2)).max(0.0).sqrt();
    findings.measured("low_counts", "noise_percent", percent, limits.noise_percent, || {
        format!(
            "Noise is {percent:.0} % of the wall's counts in the voxels that were fitted to ({:.0} % is the limit): acquire longer, or with fewer gates.",
            limits.noise_percent.limit
        )
    });
    let range = limits.extrapolated_percent;
    findings.measured("wall_extrapolated", "extrapolated_percent", model.extrapolated_percent, range, || {
        format!(
            "{:.0} % of the wall was placed by its surroundings more than by its own counts ({:.0} % is the limit).",
            model.extrapolated_percent, range.limit
        )
    });
    if model.psf.at_bound {
        let text = format!(
            "The estimate of the point-spread function ended at a limit of its search ({:.1} mm). Volumes depend on it: give `refine.psf_fwhm_mm` if \
             it is known.",
            model.psf.fwhm_mm
        );
        findings.fact("psf_at_bound", text);
    }
    if refine && !model.refined {
        findings.fact(
            "not_converged",
            "The model of the camera could not be fitted: the surfaces are those at the gradient's extrema.".to_owned(),
        );
    } else if refine && !model.converged {
        let text = format!("The fit of the model had not come to rest after {} steps, the most that were allowed.", model.steps);
        findings.fact("not_converged", text);
    }
}

/// Of ejection fractions by other means.
pub(super) fn disagreement(model: &ModelSummary, function: &Function, limits: &QualityLimits, findings: &mut Findings) {
    let range = limits.ef_disagreement_points;
    let others =
        [("the gradient's borders", model.referee.gradient_ef_percent), ("the rise of the wall's counts", model.referee.counts_ef_percent)];
    let apart = |percent: f64| (percent - function.ef_percent).abs();
    let Some(most) = others.iter().filter_map(|(_, percent)| percent.map(apart)).max_by(f64::total_cmp) else { return };
    findings.measured("methods_disagree", "ef_disagreement_points", most, range, || {
        let far: Vec<String> = others
            .iter()
            .filter_map(|(by, percent)| {
                percent.filter(|&percent| range.wrong(apart(percent)) >= 1.0).map(|percent| format!("{percent:.0} % by {by}"))
            })
            .collect();
        format!("The ejection fraction is {:.0} %, but {}: judge it by eye.", function.ef_percent, far.join(" and "))
    });
}

/// Of the wall's volume, which stays what it is.
pub(super) fn wall(myocardium: &Myocardium, limits: &QualityLimits, findings: &mut Findings) {
    let Some(percent) = myocardium.variation_percent else { return };
    findings.measured("myocardial_volume_not_conserved", "wall_variation_percent", percent, limits.wall_variation_percent, || {
        format!("The wall's volume varies by {percent:.1} % over the cycle; myocardium keeps its volume, so at least one gate is off.")
    });
}

/// Says that part of the wall takes up little: what a physician wants to know, and no doubt of the result.
pub(super) fn low_uptake(model: &ModelSummary, limits: &QualityLimits) -> Option<Warning> {
    (model.low_uptake_percent > limits.low_uptake_percent).then(|| {
        let text = format!(
            "{:.0} % of the wall takes up little: a perfusion defect, or the camera's. There the surfaces lean on the wall around.",
            model.low_uptake_percent
        );
        Warning::new("low_uptake", text)
    })
}
