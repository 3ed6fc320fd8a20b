//! What the study and the heart say: gates, counts, what the image does not hold, what lies beside the wall, sizes and shapes.

use super::{Findings, QualityLimits};
use crate::analysis::{Analysis, GatingSigns, Shape};

/// Of the gates and their order.
pub(super) fn gating(signs: &GatingSigns, limits: &QualityLimits, findings: &mut Findings) {
    let GatingSigns { least_gate_percent, end_diastole, systole, turns } = *signs;
    let mut of =
        |measure: &str, value: f64, range, sentence: &dyn Fn() -> String| findings.measured("gating", measure, value, range, sentence);
    of("least_gate_percent", least_gate_percent, limits.least_gate_percent, &|| {
        format!(
            "The poorest gate has {least_gate_percent:.0} % of the counts of a usual one ({:.0} % is the limit): beats were lost.",
            limits.least_gate_percent.limit
        )
    });
    of("end_diastole", end_diastole.abs(), limits.end_diastole, &|| {
        format!(
            "The cavity is largest {:.0} % of the cycle {} the R wave: the trigger is not the R wave, or the gates are not in order.",
            100.0 * end_diastole.abs(),
            if end_diastole < 0.0 { "before" } else { "after" }
        )
    });
    let order = |systole: f64| {
        format!("From the largest to the smallest cavity it takes {:.0} % of the cycle: no heart beats so.", 100.0 * systole)
    };
    of("systole", systole, limits.systole_long, &|| order(systole));
    of("systole", systole, limits.systole_short, &|| order(systole));
    of("turns", turns, limits.turns, &|| {
        format!(
            "Over the cycle the volume goes up and down by {turns:.2} times the stroke volume instead of once: gates are missing or not in order."
        )
    });
}

/// Of what the image does not hold.
pub(super) fn image(analysis: &Analysis, limits: &QualityLimits, findings: &mut Findings) {
    let signs = &analysis.signs;
    let percent = signs.unseen_percent;
    findings.measured("truncated", "unseen_percent", percent, limits.unseen_percent, || {
        format!("{percent:.0} % of the wall lies outside of the image or where it has no counts: reconstruct and reorient more of the field of view.")
    });
    let percent = signs.unseen_base_percent;
    findings.measured("valve_plane", "unseen_base_percent", percent, limits.unseen_base_percent, || {
        format!("{percent:.0} % of the wall's ring at the valve plane lies outside of the image: where the cavity ends is a guess.")
    });
}

/// Of the valve plane.
pub(super) fn valve_plane(analysis: &Analysis, tilt_degrees: Option<f64>, limits: &QualityLimits, findings: &mut Findings) {
    let signs = &analysis.signs;
    let percent = signs.base_counts_percent;
    findings.measured("valve_plane", "base_counts_percent", percent, limits.base_counts_percent, || {
        format!("The wall takes up {percent:.0} % of its maximum at the valve plane: where it ends is hardly seen.")
    });
    if let Some(degrees) = tilt_degrees {
        findings.measured("valve_plane", "base_tilt_degrees", degrees, limits.base_tilt_degrees, || {
            format!("The valve plane slopes by {degrees:.0}° against the long axis ({:.0}° is the limit).", limits.base_tilt_degrees.limit)
        });
    }
    if let Some(mm) = signs.base_motion_mm {
        for range in [limits.base_motion_far_mm, limits.base_motion_back_mm] {
            findings.measured("valve_plane", "base_motion_mm", mm, range, || {
                format!(
                    "From end diastole to end systole the valve plane moves by {mm:.0} mm towards the apex: hearts have {:.0} to {:.0} mm.",
                    limits.base_motion_back_mm.limit, limits.base_motion_far_mm.limit
                )
            });
        }
    }
}

/// Of what lies beside the wall, and of what the wall does not take up.
pub(super) fn activity(analysis: &Analysis, limits: &QualityLimits, findings: &mut Findings) {
    let percent = analysis.signs.bright_beside_percent;
    findings.measured("extracardiac_activity", "bright_beside_percent", percent, limits.bright_beside_percent, || {
        format!(
            "Beside {percent:.0} % of the wall something is nearly as bright as the wall or brighter ({:.0} % is the limit): liver or gut; mind the wall there.",
            limits.bright_beside_percent.limit
        )
    });
    let percent = analysis.signs.opposed_percent;
    findings.measured("motion", "opposed_percent", percent, limits.opposed_percent, || {
        format!(
            "Opposite sides of the wall, both, have {percent:.0} % fewer counts than what lies between them ({:.0} % is the limit), as when the patient moved: \
             look at the projections.",
            limits.opposed_percent.limit
        )
    });
    let percent = analysis.perfusion.extent_percent;
    findings.measured("large_defect", "defect_percent", percent, limits.defect_percent, || {
        format!(
            "{percent:.0} % of the wall takes up less than {:.0} % of its maximum ({:.0} % is the limit): its surfaces there lean on the wall around.",
            analysis.perfusion.threshold_percent, limits.defect_percent.limit
        )
    });
}

/// Of a ventricle that the camera hardly resolves.
pub(super) fn size(systole: &Shape, end_systolic_ml: f64, fwhm_mm: Option<f64>, limits: &QualityLimits, findings: &mut Findings) {
    findings.measured("small_heart", "end_systolic_ml", end_systolic_ml, limits.end_systolic_ml, || {
        format!(
            "The end-systolic volume is {end_systolic_ml:.0} ml (small from {:.0} ml on): every ml is some points of ejection fraction.",
            limits.end_systolic_ml.limit
        )
    });
    if let Some(widths) = fwhm_mm.filter(|&mm| mm > 0.0).map(|mm| systole.short_axis_mm / mm) {
        findings.measured("small_heart", "end_systolic_widths", widths, limits.end_systolic_widths, || {
            format!(
                "At end systole the cavity is {:.0} mm wide, {widths:.1} times what the camera resolves ({:.1} times is the limit).",
                systole.short_axis_mm, limits.end_systolic_widths.limit
            )
        });
    }
}

/// Of shapes that hearts do not have.
pub(super) fn shape(diastole: &Shape, thickness_mm: Option<f64>, limits: &QualityLimits, findings: &mut Findings) {
    let mut of =
        |measure: &str, value: f64, range, sentence: &dyn Fn() -> String| findings.measured("shape", measure, value, range, sentence);
    let (ratio, long_mm) = (diastole.sphericity_index, diastole.long_axis_mm);
    let wide =
        || format!("The cavity is {ratio:.2} times as wide as long at end diastole: check the long axis and what was taken for the wall.");
    of("sphericity_index", ratio, limits.roundness, &wide);
    of("sphericity_index", ratio, limits.slenderness, &wide);
    let long =
        || format!("The cavity is {long_mm:.0} mm long at end diastole: check the size of the voxels and what was taken for the wall.");
    of("long_axis_mm", long_mm, limits.long_axis_long_mm, &long);
    of("long_axis_mm", long_mm, limits.long_axis_short_mm, &long);
    if let Some(mm) = thickness_mm {
        let thick = || format!("The wall is {mm:.0} mm thick at end diastole, the mean of all of it: check what was taken for the wall.");
        of("mean_thickness_mm", mm, limits.thickness_thick_mm, &thick);
        of("mean_thickness_mm", mm, limits.thickness_thin_mm, &thick);
    }
}
