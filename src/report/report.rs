//! The report of one reconstruction as JSON: volumes, function, wall, how far the fit converged, and what to beware of.
//!
//! Names are part of the HTTP contract: fields are added, never renamed. Values are the full `f64`, unrounded, so that reports compare
//! byte for byte; [`TimingReport`] is the only part that differs between two runs. UIDs appear, nothing that names the patient does.

use super::{
    body::BodySummary,
    cycle::CycleSummary,
    fits::SurfaceFits,
    model::{GateModel, ModelSummary},
    pose::PoseSummary,
    quality::{Evidence, QUALITY_LIMITS, Quality, assess},
    regional::RegionalSummary,
    uncertainty::UncertaintySummary,
    wall::WallSummary,
    wall_function::{PerfusionSummary, PhaseSummary, ShapeSummary},
};
use crate::{
    analysis::{self, Analysis, RotationSource},
    pipeline::{GateReconstruction, Reconstruction, Region, Surface, clinical::GateFit, parameters::Parameters, thickness::ThicknessRange},
    study::{Affected, AffectedArc, Format, Study, Warning},
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The value of `schema` in every report of this shape.
pub const SCHEMA: &str = "ventricle.report/1";

/// Code of the warning that segments were named by an assumption.
pub(super) const ROTATION_UNKNOWN: &str = "rotation_unknown";

pub use crate::pipeline::measure::MYOCARDIAL_DENSITY_G_PER_ML;

/// What was found in a study.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Report {
    /// Version of this shape: `ventricle.report/1`. Fields may be added under the same version.
    #[schema(example = "ventricle.report/1")]
    pub schema: String,
    /// The reconstruction's id.
    pub id: String,
    /// What computed it.
    pub software: Software,
    /// What it was computed from.
    pub study: StudySummary,
    /// Ventricular function; null for a study of one gate, which has no cycle.
    #[schema(required)]
    pub function: Option<Function>,
    /// One entry a gate, in time order.
    pub gates: Vec<GateReport>,
    /// The wall between the surfaces.
    pub myocardium: Myocardium,
    /// The patient's size, and volumes and mass for each m² of body surface; null in reports of versions before 0.2.
    #[serde(default)]
    #[schema(required)]
    pub body: Option<BodySummary>,
    /// The time-volume curve; null for fewer than four gates.
    #[serde(default)]
    #[schema(required)]
    pub cycle: Option<CycleSummary>,
    /// The wall by segments; null in reports of versions before 0.2.
    #[serde(default)]
    #[schema(required)]
    pub regional: Option<RegionalSummary>,
    /// Perfusion of the wall; null likewise.
    #[serde(default)]
    #[schema(required)]
    pub perfusion: Option<PerfusionSummary>,
    /// When the wall contracts; null for fewer than four gates.
    #[serde(default)]
    #[schema(required)]
    pub phase: Option<PhaseSummary>,
    /// Length and width of the cavity.
    #[serde(default)]
    #[schema(required)]
    pub shape: Option<ShapeSummary>,
    /// Where the slices cut the ventricle; null where they do not cut it across (long-axis or transaxial slices).
    #[schema(required)]
    pub region: Option<RegionSummary>,
    /// Where the ventricle lies, however the slices lie; null with the preset `paper`.
    #[schema(required)]
    pub pose: Option<PoseSummary>,
    /// What the model of the camera says of the study; null with the preset `paper`.
    #[schema(required)]
    pub model: Option<ModelSummary>,
    /// How uncertain the values are; null with the preset `paper`, and where no model was fitted.
    #[schema(required)]
    pub uncertainty: Option<UncertaintySummary>,
    /// How far the result can be relied on, as far as the computation itself can tell.
    pub quality: Quality,
    /// The parameters used, each with its value.
    #[schema(value_type = Object)]
    pub parameters: Parameters,
    /// What the reader should know, about the input first, then about the result.
    pub warnings: Vec<Remark>,
    /// How long it took.
    pub timing_ms: TimingReport,
}

/// The program that made a report.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Software {
    /// Always `ventricle`.
    pub name: String,
    /// Semantic version.
    pub version: String,
}

/// The study a report is about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct StudySummary {
    /// DICOM Study Instance UID, if the input has one.
    #[schema(required)]
    pub study_instance_uid: Option<String>,
    /// DICOM Series Instance UID, if the input has one.
    #[schema(required)]
    pub series_instance_uid: Option<String>,
    /// DICOM SOP Instance UIDs of the files, in the order received.
    pub sop_instance_uids: Vec<String>,
    /// DICOM SOP Class UIDs of the files, in the same order.
    #[serde(default)]
    #[schema(required)]
    pub sop_class_uids: Vec<String>,
    /// DICOM Frame of Reference UID, if the input has one.
    #[serde(default)]
    #[schema(required)]
    pub frame_of_reference_uid: Option<String>,
    /// The format it came in: `dicom`, `nifti`, `json` or `phantom`.
    #[schema(value_type = String, example = "dicom")]
    pub format: Format,
    /// Number of gates; 1 for an ungated study.
    pub gates: usize,
    /// The lattice.
    pub grid: GridSummary,
    /// Mean R-R interval in ms, if known.
    #[schema(required)]
    pub rr_interval_ms: Option<f64>,
    /// Heart rate in beats a minute, if known.
    #[schema(required)]
    pub heart_rate_bpm: Option<f64>,
    /// Beats that the images are made of, if the header tells (DICOM Intervals Acquired).
    #[serde(default)]
    #[schema(required)]
    pub beats_accepted: Option<u64>,
    /// Beats that were left out for their length, if the header tells (DICOM Intervals Rejected).
    #[serde(default)]
    #[schema(required)]
    pub beats_rejected: Option<u64>,
    /// Shortest and longest R-R interval of an accepted beat in ms, if the header tells (DICOM Low and High R-R Value).
    #[serde(default)]
    #[schema(required, min_items = 2, max_items = 2)]
    pub rr_window_ms: Option<[f64; 2]>,
    /// Whether beats were sorted by their length, if the header tells (DICOM Beat Rejection Flag).
    #[serde(default)]
    #[schema(required)]
    pub beat_rejection: Option<bool>,
}

/// The lattice of a study.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GridSummary {
    /// Voxels along slices, rows, columns.
    pub shape: [usize; 3],
    /// Distance between voxel centres along slices, rows, columns, in mm.
    pub spacing_mm: [f64; 3],
}

/// Ventricular function over the gates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Function {
    /// End-diastolic volume: the largest endocardial volume, in ml.
    pub edv_ml: f64,
    /// End-systolic volume: the smallest endocardial volume, in ml.
    pub esv_ml: f64,
    /// Stroke volume EDV − ESV in ml.
    pub sv_ml: f64,
    /// Ejection fraction (EDV − ESV) / EDV in percent.
    pub ef_percent: f64,
    /// The gate of the EDV, counted from 1; the first of equals.
    pub end_diastolic_gate: usize,
    /// The gate of the ESV, counted from 1; the first of equals.
    pub end_systolic_gate: usize,
}

/// One gate's volumes and fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GateReport {
    /// Counted from 1.
    pub gate: usize,
    /// Volume of the cavity, up to the valve plane, in ml.
    pub endocardial_ml: f64,
    /// Volume inside the outer surface, up to the valve plane, in ml.
    pub epicardial_ml: f64,
    /// Volume of the wall, the difference, in ml.
    pub myocardial_ml: f64,
    /// The wall as tetrahedra, and its thickness.
    pub wall: WallSummary,
    /// How the surfaces were reached.
    pub fit: SurfaceFits,
    /// The model's numbers for the gate; null with the preset `paper`.
    #[schema(required)]
    pub model: Option<GateModel>,
}

/// The wall over the cycle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Myocardium {
    /// Mass in g: the mean volume times 1.05 g/ml. The mean over the cycle, not one gate's: myocardium keeps its volume, so every gate
    /// measures the same quantity and the mean has the smaller error.
    pub mass_g: f64,
    /// Mean wall volume over the gates in ml.
    pub mean_ml: f64,
    /// Standard deviation of the wall's volume over the gates, as a percentage of its mean; null for one gate.
    #[schema(required)]
    pub variation_percent: Option<f64>,
}

/// Where the ventricle was looked for: given marks, and estimates for the rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RegionSummary {
    /// Centre `[x, y]` half way between the ends, in mm from the centre of the first voxel, along columns and rows.
    pub centre_mm: [f64; 2],
    /// How far the centre moves `[x, y]` a mm of z: the tilt of the ventricle's axis against the stack.
    pub axis_slope: [f64; 2],
    /// Radius of the filtering circle in mm.
    pub radius_mm: f64,
    /// First useful slice, counted from 1.
    pub first_slice: usize,
    /// Last useful slice, counted from 1.
    pub last_slice: usize,
    /// Whether the base is at the last slice rather than at the first.
    pub base_at_last_slice: bool,
}

/// One thing the reader should know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Remark {
    /// Stable `snake_case` code.
    pub code: String,
    /// One sentence.
    pub message: String,
    /// The gate it concerns, counted from 1; absent for the whole study.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gate: Option<usize>,
    /// The part of a border it concerns; only with `partial_border`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub affected: Option<AffectedRegion>,
}

/// Where a border was not seen and the surface was bridged: the largest contiguous gap.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct AffectedRegion {
    /// `endocardial` or `epicardial`.
    #[schema(example = "endocardial")]
    pub surface: String,
    /// First slice, counted from 1.
    pub first_slice: usize,
    /// Last slice, counted from 1.
    pub last_slice: usize,
    /// The part of the circumference; absent where only the apex was not seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arc: Option<AffectedSector>,
    /// Whether no wall was seen at the apex. The surface is then closed where the wall around ends, and what lies beyond is not in the volume.
    pub apex_unseen: bool,
}

/// A part of the circumferences about the ventricle's axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct AffectedSector {
    /// Where it begins, in degrees about the ventricle's axis in the plane of the slices: 0 towards the last column, 90 towards the last row, 180
    /// towards the first column, 270 towards the first row. A multiple of 10.
    #[schema(maximum = 359)]
    pub from_degrees: usize,
    /// Where it ends, going up from `from_degrees`; over 360 if it is the smaller one.
    #[schema(maximum = 360)]
    pub to_degrees: usize,
    /// The edge of the image that its middle points to: `first row`, `last row`, `first column` or `last column`.
    #[schema(example = "first row")]
    pub towards: String,
    /// The walls it covers, the one at its middle first: `anterior`, `inferior`, `septal`, `lateral`. Empty where the study does not say how it
    /// lies in the patient, or lies in it unusually.
    pub walls: Vec<String>,
}

/// Wall-clock times, the only part of a report that differs between two runs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TimingReport {
    /// Of the whole reconstruction, in ms.
    pub total: f64,
    /// Of each stage, summed over gates that may have run at the same time, in ms.
    pub stages: BTreeMap<String, f64>,
}

/// Wall-clock times as whoever ran the pipeline measured them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Of the whole reconstruction, in ms.
    pub total_ms: f64,
    /// By the name of the stage ([`crate::pipeline::monitor::Stage::name`]), summed over gates, in ms.
    pub stages_ms: BTreeMap<String, f64>,
}

/// The report of a reconstruction; `id` is the reconstruction's.
pub fn build(id: &str, study: &Study, reconstruction: &Reconstruction, analysis: &Analysis, timing: &Timing) -> Report {
    let model = reconstruction.model.as_ref();
    let gates: Vec<GateReport> = reconstruction
        .gates
        .iter()
        .enumerate()
        .map(|(gate, result)| {
            let range = analysis.walls.thickness_range[gate].as_ref();
            gate_report(gate + 1, result, range, model.and_then(|model| model.gates.get(gate)))
        })
        .collect();
    let myocardium = myocardium(&gates);
    let cavity_ml: Vec<f64> = gates.iter().map(|gate| gate.endocardial_ml).collect();
    let function = Function::of_cavity(&cavity_ml);
    let errors = model.and_then(|model| model.uncertainty.as_ref());
    let uncertainty =
        errors.zip(cavity_ml.first()).map(|(errors, &first_ml)| UncertaintySummary::of(errors, function.as_ref(), first_ml, &myocardium));
    let pose = reconstruction.pose.as_ref().map(|pose| PoseSummary::of(pose, study.orientation.as_ref()));
    let model = model.map(ModelSummary::from);
    let (quality, flagged) = assess(
        &Evidence {
            gates: &gates,
            myocardium: &myocardium,
            function: function.as_ref(),
            pose: pose.as_ref(),
            model: model.as_ref(),
            analysis,
            refine: reconstruction.parameters.refine.enabled,
        },
        &QUALITY_LIMITS,
    );
    let regional = RegionalSummary::of(analysis);
    let rotation = rotation_unknown(analysis);
    Report {
        schema: SCHEMA.to_owned(),
        id: id.to_owned(),
        software: Software { name: env!("CARGO_PKG_NAME").to_owned(), version: env!("CARGO_PKG_VERSION").to_owned() },
        study: study_summary(study),
        body: Some(BodySummary::of(&reconstruction.parameters.metadata, &study.acquisition, function.as_ref(), &myocardium)),
        cycle: analysis.cycle.as_ref().map(CycleSummary::from),
        perfusion: Some(PerfusionSummary::of(&analysis.perfusion, &regional)),
        phase: analysis.phase.as_ref().map(|phase| PhaseSummary::of(phase, analysis)),
        shape: ShapeSummary::of(&analysis.shapes),
        regional: Some(regional),
        function,
        myocardium,
        region: reconstruction.region.map(RegionSummary::from),
        pose,
        model,
        uncertainty,
        quality,
        parameters: reconstruction.parameters.clone(),
        warnings: study.warnings.iter().chain(&reconstruction.warnings).chain(&rotation).chain(&flagged).map(Remark::from).collect(),
        timing_ms: TimingReport { total: timing.total_ms, stages: timing.stages_ms.clone() },
        gates,
    }
}

fn study_summary(study: &Study) -> StudySummary {
    let said = &study.acquisition;
    StudySummary {
        study_instance_uid: said.study_instance_uid.clone(),
        series_instance_uid: said.series_instance_uid.clone(),
        sop_instance_uids: said.sop_instance_uids.clone(),
        sop_class_uids: said.sop_class_uids.clone(),
        frame_of_reference_uid: said.frame_of_reference_uid.clone(),
        format: said.format,
        gates: study.gates.len(),
        grid: GridSummary { shape: study.grid.shape, spacing_mm: study.grid.spacing_mm },
        rr_interval_ms: said.rr_interval_ms,
        heart_rate_bpm: said.heart_rate_bpm,
        beats_accepted: said.beats_accepted,
        beats_rejected: said.beats_rejected,
        rr_window_ms: said.rr_window_ms,
        beat_rejection: said.beat_rejection,
    }
}

/// That nothing told the wall's sides apart.
fn rotation_unknown(analysis: &Analysis) -> Option<Warning> {
    let sentence = "The study does not say how it lies in the patient: the first row was taken for anterior and the first column for septal, \
                    and segments and territories may be others. Give the direction of the anterior wall as `analysis.anterior`.";
    (analysis.places.rotation == RotationSource::Assumed).then(|| Warning::new(ROTATION_UNKNOWN, sentence))
}

fn gate_report(number: usize, gate: &GateReconstruction, thickness: Option<&ThicknessRange>, model: Option<&GateFit>) -> GateReport {
    GateReport {
        gate: number,
        endocardial_ml: gate.volume_ml(Surface::Endocardial),
        epicardial_ml: gate.volume_ml(Surface::Epicardial),
        myocardial_ml: gate.myocardial_ml(),
        wall: WallSummary::of(gate, thickness),
        fit: SurfaceFits { endocardial: (&gate.fits.endocardial).into(), epicardial: (&gate.fits.epicardial).into() },
        model: model.map(GateModel::from),
    }
}

impl Function {
    /// EDV, ESV and what follows from them, from the cavity's volume in ml at every gate; `None` for fewer than two gates, or when no cavity
    /// has a volume.
    pub fn of_cavity(cavity_ml: &[f64]) -> Option<Self> {
        if cavity_ml.len() < 2 {
            return None;
        }
        let (diastole, systole) = analysis::ends(cavity_ml);
        let (edv_ml, esv_ml) = (cavity_ml[diastole], cavity_ml[systole]);
        (edv_ml > 0.0).then(|| Self {
            edv_ml,
            esv_ml,
            sv_ml: edv_ml - esv_ml,
            ef_percent: 100.0 * (edv_ml - esv_ml) / edv_ml,
            end_diastolic_gate: diastole + 1,
            end_systolic_gate: systole + 1,
        })
    }
}

fn myocardium(gates: &[GateReport]) -> Myocardium {
    let count = gates.len().max(1) as f64;
    let mean_ml = gates.iter().map(|gate| gate.myocardial_ml).sum::<f64>() / count;
    let variance = gates.iter().map(|gate| (gate.myocardial_ml - mean_ml).powi(2)).sum::<f64>() / count;
    let variation_percent = (gates.len() > 1 && mean_ml > 0.0).then(|| 100.0 * variance.sqrt() / mean_ml);
    Myocardium { mass_g: MYOCARDIAL_DENSITY_G_PER_ML * mean_ml, mean_ml, variation_percent }
}

impl From<Region> for RegionSummary {
    fn from(region: Region) -> Self {
        let Region { centre_mm, axis_slope, radius_mm, first_slice, last_slice, base_at_last_slice } = region;
        Self { centre_mm, axis_slope, radius_mm, first_slice, last_slice, base_at_last_slice }
    }
}

impl From<&Warning> for Remark {
    fn from(warning: &Warning) -> Self {
        Self {
            code: warning.code.clone(),
            message: warning.message.clone(),
            gate: warning.gate,
            affected: warning.affected.as_ref().map(AffectedRegion::from),
        }
    }
}

impl From<&Affected> for AffectedRegion {
    fn from(affected: &Affected) -> Self {
        let Affected { surface, first_slice, last_slice, arc, apex_unseen } = affected.clone();
        let sector = |AffectedArc { from_degrees, to_degrees, towards, walls }| AffectedSector { from_degrees, to_degrees, towards, walls };
        Self { surface, first_slice, last_slice, arc: arc.map(sector), apex_unseen }
    }
}
