//! Two reconstructions of one heart, such as stress and rest, set against each other.

use super::{
    regional::{RegionalSummary, RegionalValues},
    report::{ROTATION_UNKNOWN, Remark, Report},
    uncertainty::ErrorSummary,
};
use crate::{pipeline::parameters::Preset, study::Warning};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The value of `schema` in every comparison of this shape.
pub const COMPARISON_SCHEMA: &str = "ventricle.comparison/1";

/// What `tid_ratio` is, in the answer itself: other programs define it otherwise.
const TID_DEFINITION: &str = "Mean volume of the cavity over all gates of the first reconstruction, divided by that of the second.";

/// Two reconstructions set against each other: every difference is the first less the second. The first is the one whose comparison was asked for
/// (the stress study, where the pair is stress and rest), the second the one that was named (`with`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Comparison {
    /// Version of this shape: `ventricle.comparison/1`. Fields may be added under the same version.
    #[schema(example = "ventricle.comparison/1")]
    pub schema: String,
    /// The reconstruction whose comparison was asked for.
    pub first: ComparedStudy,
    /// The reconstruction it is compared with.
    pub second: ComparedStudy,
    /// Transient ischaemic dilation: the cavity of the first over that of the second, as `tid_definition` says; null where the second has none.
    /// What is normal depends on definition, protocol and program: limits published for others do not hold here.
    #[schema(required)]
    pub tid_ratio: Option<f64>,
    /// How `tid_ratio` is defined.
    pub tid_definition: String,
    /// Mean volume of the cavity over the gates in ml.
    pub mean_cavity_ml: Difference,
    /// End-diastolic volume in ml; null for an ungated study, as the next three are.
    pub edv_ml: UncertainDifference,
    /// End-systolic volume in ml.
    pub esv_ml: UncertainDifference,
    /// Stroke volume in ml.
    pub sv_ml: Difference,
    /// Ejection fraction in percent; the difference in points.
    pub ef_percent: UncertainDifference,
    /// Mass of the wall in g. It is one heart's: a difference tells of the measurement.
    pub mass_g: UncertainDifference,
    /// Perfusion defect in percent of the wall's area, each below its own threshold (`perfusion.threshold_percent` of its report).
    pub perfusion_extent_percent: Difference,
    /// The wall by its 17 segments.
    pub segments: Vec<SegmentDifferences>,
    /// The wall by the territories of the coronary arteries.
    pub territories: Vec<TerritoryDifferences>,
    /// All of the wall.
    pub whole: RegionalDifferences,
    /// What to beware of when the two are compared: `study_differs`, `study_unknown`, `presets_differ`, `versions_differ`, `gating_differs`,
    /// `thresholds_differ`, `rotation_unknown`, `quality_flagged`.
    pub notes: Vec<Remark>,
}

/// One of the two.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ComparedStudy {
    /// The reconstruction's id.
    pub id: String,
    /// DICOM Study Instance UID, if the input has one.
    #[schema(required)]
    pub study_instance_uid: Option<String>,
    /// DICOM Series Instance UID, if the input has one.
    #[schema(required)]
    pub series_instance_uid: Option<String>,
    /// Number of gates.
    pub gates: usize,
}

/// A value of both. What one of them does not have is null, and so is the difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Difference {
    /// Of the first.
    #[schema(required)]
    pub first: Option<f64>,
    /// Of the second.
    #[schema(required)]
    pub second: Option<f64>,
    /// The first less the second.
    #[schema(required)]
    pub difference: Option<f64>,
}

/// A value of both, with how uncertain their difference is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UncertainDifference {
    /// The value.
    #[serde(flatten)]
    pub values: Difference,
    /// Standard error of the difference, as if the errors of both were independent; null where one is not known.
    #[schema(required)]
    pub standard_error: Option<f64>,
}

/// One segment of both.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SegmentDifferences {
    /// 1 to 17.
    pub segment: usize,
    /// Its name.
    #[schema(example = "basal anterior")]
    pub name: String,
    /// The artery it is assigned to: `LAD`, `RCA` or `LCX`.
    #[schema(example = "LAD")]
    pub territory: String,
    /// What was measured.
    #[serde(flatten)]
    pub values: RegionalDifferences,
}

/// One territory of both.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TerritoryDifferences {
    /// `LAD`, `RCA` or `LCX`.
    #[schema(example = "LAD")]
    pub territory: String,
    /// What was measured.
    #[serde(flatten)]
    pub values: RegionalDifferences,
}

/// Means over a part of the wall of both.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RegionalDifferences {
    /// Counts in percent of each wall's own maximum; the difference in points.
    pub perfusion_percent: Difference,
    /// Thickening from end diastole to end systole in percent; the difference in points.
    pub thickening_percent: Difference,
    /// Inward motion of the endocardial surface in mm.
    pub motion_mm: Difference,
}

/// Why two reports cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ComparisonError {
    /// A report from before segments were derived.
    #[error(
        "the report of reconstruction {id} was made by version {version}, which did not derive segments; submit its study again and compare with the new job"
    )]
    WithoutSegments {
        /// The reconstruction.
        id: String,
        /// What made it.
        version: String,
    },
}

/// Sets two reports against each other.
///
/// # Errors
/// [`ComparisonError`] where one of them has no segments.
pub fn compare(first: &Report, second: &Report) -> Result<Comparison, ComparisonError> {
    let (here, there) = (segments_of(first)?, segments_of(second)?);
    let mean_cavity_ml = Difference::of(mean_cavity_ml(first), mean_cavity_ml(second));
    let function =
        |value: &dyn Fn(&super::Function) -> f64| Difference::of(first.function.as_ref().map(value), second.function.as_ref().map(value));
    let error = |of: &dyn Fn(&super::UncertaintySummary) -> Option<ErrorSummary>| {
        let standard = |report: &Report| report.uncertainty.as_ref().and_then(of).map(|error| error.standard_error);
        Some(standard(first)?.hypot(standard(second)?))
    };
    let uncertain = |values: Difference, standard_error: Option<f64>| UncertainDifference {
        values,
        standard_error: values.difference.and(standard_error),
    };
    let extent = |report: &Report| report.perfusion.as_ref().map(|perfusion| perfusion.extent_percent);
    Ok(Comparison {
        schema: COMPARISON_SCHEMA.to_owned(),
        first: ComparedStudy::of(first),
        second: ComparedStudy::of(second),
        tid_ratio: mean_cavity_ml
            .first
            .zip(mean_cavity_ml.second)
            .filter(|(_, second)| *second > 0.0)
            .map(|(first, second)| first / second),
        tid_definition: TID_DEFINITION.to_owned(),
        mean_cavity_ml,
        edv_ml: uncertain(function(&|function| function.edv_ml), error(&|errors| Some(errors.edv_ml))),
        esv_ml: uncertain(function(&|function| function.esv_ml), error(&|errors| errors.esv_ml)),
        sv_ml: function(&|function| function.sv_ml),
        ef_percent: uncertain(function(&|function| function.ef_percent), error(&|errors| errors.ef_percent)),
        mass_g: uncertain(
            Difference::of(Some(first.myocardium.mass_g), Some(second.myocardium.mass_g)),
            error(&|errors| Some(errors.mass_g)),
        ),
        perfusion_extent_percent: Difference::of(extent(first), extent(second)),
        segments: here
            .segments
            .iter()
            .zip(&there.segments)
            .map(|(first, second)| SegmentDifferences {
                segment: first.segment,
                name: first.name.clone(),
                territory: first.territory.clone(),
                values: RegionalDifferences::of(&first.values, &second.values),
            })
            .collect(),
        territories: here
            .territories
            .iter()
            .zip(&there.territories)
            .map(|(first, second)| TerritoryDifferences {
                territory: first.territory.clone(),
                values: RegionalDifferences::of(&first.values, &second.values),
            })
            .collect(),
        whole: RegionalDifferences::of(&here.whole, &there.whole),
        notes: notes(first, second).iter().map(Remark::from).collect(),
    })
}

/// The segments, which reports of all versions since list in the same order.
fn segments_of(report: &Report) -> Result<&RegionalSummary, ComparisonError> {
    report
        .regional
        .as_ref()
        .ok_or_else(|| ComparisonError::WithoutSegments { id: report.id.clone(), version: report.software.version.clone() })
}

/// Mean volume of the cavity over the gates, which last equally long, in ml.
fn mean_cavity_ml(report: &Report) -> Option<f64> {
    let gates = report.gates.len();
    (gates > 0).then(|| report.gates.iter().map(|gate| gate.endocardial_ml).sum::<f64>() / gates as f64)
}

/// What to beware of.
fn notes(first: &Report, second: &Report) -> Vec<Warning> {
    let both = [first, second];
    let mut notes = Vec::new();
    let mut note = |code: &str, message: String| notes.push(Warning::new(code, message));
    match (&first.study.study_instance_uid, &second.study.study_instance_uid) {
        (Some(one), Some(other)) if one == other => {}
        (Some(_), Some(_)) => note(
            "study_differs",
            "The two are of different studies (Study Instance UID): whether they are of one patient cannot be seen here.".to_owned(),
        ),
        _ => note("study_unknown", "Not both say which study they are of: whether they are of one patient cannot be seen here.".to_owned()),
    }
    let presets = both.map(|report| report.parameters.preset);
    if presets[0] != presets[1] {
        let [one, other] = presets.map(Preset::name);
        note(
            "presets_differ",
            format!("The first was measured by the preset `{one}`, the second by `{other}`: methods differ by more than hearts do."),
        );
    }
    let [one, other] = both.map(|report| &report.software.version);
    if one != other {
        note("versions_differ", format!("The first was measured by version {one}, the second by version {other}."));
    }
    let [one, other] = both.map(|report| report.study.gates);
    if (one > 1) != (other > 1) {
        note(
            "gating_differs",
            "One of the two is not gated: its cavity is that of an image blurred by the heart's motion, and not the mean over the cycle."
                .to_owned(),
        );
    } else if one != other {
        note(
            "gating_differs",
            format!("The first has {one} gates, the second {other}: fewer gates blur end diastole and end systole more."),
        );
    }
    let [one, other] = both.map(|report| report.parameters.analysis.perfusion_threshold_percent);
    if (one - other).abs() > 0.0 {
        note(
            "thresholds_differ",
            format!("Perfusion defects are below {one} % of the maximum in the first and below {other} % in the second."),
        );
    }
    for (report, which) in both.into_iter().zip(["first", "second"]) {
        if report.warnings.iter().any(|warning| warning.code == ROTATION_UNKNOWN) {
            note(ROTATION_UNKNOWN, format!("Which side is anterior is assumed in the {which}: segments may be others, territories too."));
        }
        if !report.quality.flags.is_empty() {
            note("quality_flagged", format!("The {which} carries quality flags: {}.", report.quality.flags.join(", ")));
        }
    }
    notes
}

impl ComparedStudy {
    fn of(report: &Report) -> Self {
        Self {
            id: report.id.clone(),
            study_instance_uid: report.study.study_instance_uid.clone(),
            series_instance_uid: report.study.series_instance_uid.clone(),
            gates: report.study.gates,
        }
    }
}

impl Difference {
    fn of(first: Option<f64>, second: Option<f64>) -> Self {
        Self { first, second, difference: first.zip(second).map(|(first, second)| first - second) }
    }
}

impl RegionalDifferences {
    fn of(first: &RegionalValues, second: &RegionalValues) -> Self {
        Self {
            perfusion_percent: Difference::of(first.perfusion_percent, second.perfusion_percent),
            thickening_percent: Difference::of(first.thickening_percent, second.thickening_percent),
            motion_mm: Difference::of(first.motion_mm, second.motion_mm),
        }
    }
}
