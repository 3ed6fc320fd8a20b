//! From where on a measure speaks against a result, and from where on it is a flag.

use crate::pipeline::pose;

/// A measure's way from nothing wrong to a flag; either end may be the larger one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Nothing is wrong up to here.
    pub fine: f64,
    /// A flag from here on.
    pub limit: f64,
}

const fn range(fine: f64, limit: f64) -> Range {
    Range { fine, limit }
}

impl Range {
    /// 0 where nothing is wrong, 1 at the limit, more beyond. A value that is no number is as wrong as can be.
    pub fn wrong(&self, value: f64) -> f64 {
        let wrong = (value - self.fine) / (self.limit - self.fine);
        if wrong.is_nan() { f64::INFINITY } else { wrong.max(0.0) }
    }
}

/// Where every flag begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QualityLimits {
    /// Fraction of a surface's particles within one voxel of the border, 0-1.
    pub within_one_voxel: Range,
    /// Coefficient of variation of the wall's volume over the cycle, in percent.
    pub wall_variation_percent: Range,
    /// Root mean square of what the model and noise leave of the counts, as part of the wall's activity.
    pub unexplained_residual: Range,
    /// Part of the wall that rests on its surroundings, in percent.
    pub extrapolated_percent: Range,
    /// Part of the wall that may take up little without being told of, in percent. What is beyond is a warning, not a flag.
    pub low_uptake_percent: f64,
    /// Score of the pose, 0-1.
    pub pose_score: Range,
    /// How far an ejection fraction by other means is from the reported one, in points.
    pub ef_disagreement_points: Range,
    /// Noise in the voxels that the model is fitted to, in percent of the wall's counts.
    pub noise_percent: Range,
    /// Counts of the poorest gate in percent of the median gate's.
    pub least_gate_percent: Range,
    /// How far the largest cavity is from the R wave, as part of the cycle.
    pub end_diastole: Range,
    /// From the largest to the smallest cavity as part of the cycle: too long.
    pub systole_long: Range,
    /// The same: too short.
    pub systole_short: Range,
    /// Ways of the volume up and down over twice the stroke volume.
    pub turns: Range,
    /// Part of the wall that the image does not hold, in percent.
    pub unseen_percent: Range,
    /// The same of its ring at the valve plane.
    pub unseen_base_percent: Range,
    /// Counts of that ring in percent of the wall's brightest.
    pub base_counts_percent: Range,
    /// Slope of the valve plane in degrees.
    pub base_tilt_degrees: Range,
    /// Way of the valve plane towards the apex from end diastole to end systole in mm: too far.
    pub base_motion_far_mm: Range,
    /// The same: too little, or away from the apex.
    pub base_motion_back_mm: Range,
    /// Part of the wall beside which something else is bright, in percent.
    pub bright_beside_percent: Range,
    /// How much opposite sides of the wall have fewer counts than what lies between them, in percent.
    pub opposed_percent: Range,
    /// Part of the wall below the perfusion threshold, in percent.
    pub defect_percent: Range,
    /// End-systolic volume in ml.
    pub end_systolic_ml: Range,
    /// Width of the cavity at end systole over the full width at half maximum of the point-spread function.
    pub end_systolic_widths: Range,
    /// Short over long axis of the cavity at end diastole: too round.
    pub roundness: Range,
    /// The same: too slender.
    pub slenderness: Range,
    /// Long axis of the cavity at end diastole in mm: too long.
    pub long_axis_long_mm: Range,
    /// The same: too short.
    pub long_axis_short_mm: Range,
    /// Mean thickness of the wall at end diastole in mm: too thick.
    pub thickness_thick_mm: Range,
    /// The same: too thin.
    pub thickness_thin_mm: Range,
}

/// The limits in use.
///
/// From geometry, physiology or literature:
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
/// - Small hearts are those with an end-systolic volume of 20 ml and less (Nakajima et al., Eur J Nucl Med 2000;27:1372). The middle of a
///   cavity 1.2 widths of the point-spread function wide has .22 of the counts of flat walls of 10 mm (11 mm width), about twice that between round
///   ones: half of its contrast is gone.
/// - Cavities of 35 to 140 mm that are .40 to 1.0 times as wide as long, walls of 4 to 18 mm: beyond what hearts are at end diastole, dilated and
///   hypertrophic ones with them (Lang et al., J Am Soc Echocardiogr 2015;28:1, where severe is a wall of 17 mm and a sphericity of 1).
/// - Valve planes move by up to 15 mm towards the apex in healthy adults and by less in patients (Hu et al., Eur Heart J Cardiovasc Imaging
///   2013;14:205), and lie across the axis but for the membranous septum: the phantoms' slope by up to 16°.
/// - R-wave gating puts end diastole at the first or the last gate, systole takes 25 to 45 % of the cycle at usual heart rates, and a volume goes
///   once down and once up.
///
/// From the half of the spoiled phantoms that is not published (`accuracy::spoiled`, `docs/accuracy.md`), between what good and spoiled studies
/// have: noise, counts of the poorest gate, turns, parts unseen, counts at the base, brightness beside the wall, dim opposite sides (which motion makes:
/// Fitzgerald and Danias, J Nucl Cardiol 2001;8:701), the size of defects.
pub const QUALITY_LIMITS: QualityLimits = QualityLimits {
    within_one_voxel: range(1.0, 0.95),
    wall_variation_percent: range(2.0, 5.0),
    unexplained_residual: range(0.0, 0.15),
    extrapolated_percent: range(0.0, 40.0),
    low_uptake_percent: 6.0,
    pose_score: range(1.0, pose::POSE_UNCERTAIN),
    ef_disagreement_points: range(5.0, 10.0),
    noise_percent: range(7.0, 12.0),
    least_gate_percent: range(75.0, 50.0),
    end_diastole: range(0.13, 0.2),
    systole_long: range(0.5, 0.62),
    systole_short: range(0.25, 0.15),
    turns: range(1.05, 1.2),
    unseen_percent: range(0.0, 3.0),
    unseen_base_percent: range(3.0, 15.0),
    base_counts_percent: range(60.0, 40.0),
    base_tilt_degrees: range(15.0, 25.0),
    base_motion_far_mm: range(16.0, 20.0),
    base_motion_back_mm: range(2.0, 0.0),
    bright_beside_percent: range(3.0, 7.0),
    opposed_percent: range(4.0, 7.0),
    defect_percent: range(20.0, 35.0),
    end_systolic_ml: range(30.0, 20.0),
    end_systolic_widths: range(1.6, 1.2),
    roundness: range(0.85, 1.0),
    slenderness: range(0.5, 0.4),
    long_axis_long_mm: range(120.0, 140.0),
    long_axis_short_mm: range(45.0, 35.0),
    thickness_thick_mm: range(14.0, 18.0),
    thickness_thin_mm: range(6.0, 4.0),
};
