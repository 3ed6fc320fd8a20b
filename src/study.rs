//! A gated study as the numerics see it: counts over the cardiac cycle on one grid, where they lie in the patient, and the few facts
//! of the acquisition that the report repeats. Nothing that names the patient is kept.

use crate::volume::{Grid, Volume};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// One or more gates on one grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// The lattice all gates share.
    pub grid: Grid,
    /// The gates in time order; one for an ungated study. Never empty.
    pub gates: Vec<Gate>,
    /// Where the grid lies in the patient, if the file says so.
    pub orientation: Option<Orientation>,
    /// What the file says of itself.
    pub acquisition: Acquisition,
    /// What was odd about the input but could be lived with.
    pub warnings: Vec<Warning>,
}

impl Study {
    /// Whether the study holds a cycle rather than one average image.
    pub fn is_gated(&self) -> bool {
        self.gates.len() > 1
    }
}

/// One time slot of the cardiac cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct Gate {
    /// Counts on the study's grid.
    pub volume: Volume,
    /// Duration of the time slot in ms, if known (DICOM Frame Time).
    pub duration_ms: Option<f64>,
}

/// The rigid map from grid mm (see [`crate::volume`]) to patient mm: DICOM LPS, `x` to the patient's left, `y` to the back, `z` to the head.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Orientation {
    /// Unit vector of increasing column index.
    pub columns: DVec3,
    /// Unit vector of increasing row index.
    pub rows: DVec3,
    /// Unit vector of increasing slice index. Either handedness occurs: real stacks run both ways.
    pub slices: DVec3,
    /// Patient position of the centre of voxel `[0, 0, 0]`, in mm.
    pub origin_mm: DVec3,
}

impl Orientation {
    /// A point in grid mm as patient mm.
    pub fn patient_mm(&self, grid_mm: DVec3) -> DVec3 {
        self.origin_mm + self.direction(grid_mm)
    }

    /// A direction in the grid frame as a direction in the patient.
    pub fn direction(&self, grid: DVec3) -> DVec3 {
        self.columns * grid.x + self.rows * grid.y + self.slices * grid.z
    }

    /// Whether the map turns right-handed frames into left-handed ones (triangles change their winding).
    pub fn mirrors(&self) -> bool {
        self.columns.cross(self.rows).dot(self.slices) < 0.0
    }
}

/// The format a study came in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// DICOM Nuclear Medicine Image Storage.
    Dicom,
    /// NIfTI-1, plain or gzipped.
    Nifti,
    /// The JSON body of the HTTP contract.
    Json,
    /// One `NumPy` array.
    Npy,
    /// Made in memory by [`crate::phantom`].
    Phantom,
}

/// What the file says of itself, as far as the report repeats it. UIDs, never names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Acquisition {
    /// The format the study came in.
    pub format: Format,
    /// DICOM Study Instance UID (0020,000D).
    pub study_instance_uid: Option<String>,
    /// DICOM Series Instance UID (0020,000E).
    pub series_instance_uid: Option<String>,
    /// DICOM SOP Instance UIDs (0008,0018) of the files, in the order received.
    pub sop_instance_uids: Vec<String>,
    /// DICOM SOP Class UIDs (0008,0016) of the files, in the same order; empty for studies stored before these were kept.
    #[serde(default)]
    pub sop_class_uids: Vec<String>,
    /// DICOM Frame of Reference UID (0020,0052).
    #[serde(default)]
    pub frame_of_reference_uid: Option<String>,
    /// Mean R-R interval in ms, from the header or the sum of the gates' durations.
    pub rr_interval_ms: Option<f64>,
    /// Heart rate in beats a minute, if the header has it.
    pub heart_rate_bpm: Option<f64>,
    /// Beats that the images are made of, if the header has it.
    #[serde(default)]
    pub beats_accepted: Option<u64>,
    /// Beats that were left out because they were too short or too long, if the header has it.
    #[serde(default)]
    pub beats_rejected: Option<u64>,
    /// Shortest and longest R-R interval of an accepted beat in ms, if the header has both.
    #[serde(default)]
    pub rr_window_ms: Option<[f64; 2]>,
    /// Whether beats were sorted by their length (DICOM Beat Rejection Flag), if the header says so.
    #[serde(default)]
    pub beat_rejection: Option<bool>,
    /// The patient's height in m, if the header has it: it names nobody.
    #[serde(default)]
    pub height_m: Option<f64>,
    /// The patient's weight in kg, if the header has it.
    #[serde(default)]
    pub weight_kg: Option<f64>,
}

impl Acquisition {
    /// A study that says nothing but its format.
    pub fn unknown(format: Format) -> Self {
        Self {
            format,
            study_instance_uid: None,
            series_instance_uid: None,
            sop_instance_uids: Vec::new(),
            sop_class_uids: Vec::new(),
            frame_of_reference_uid: None,
            rr_interval_ms: None,
            heart_rate_bpm: None,
            beats_accepted: None,
            beats_rejected: None,
            rr_window_ms: None,
            beat_rejection: None,
            height_m: None,
            weight_kg: None,
        }
    }
}

/// Code of the warning that the slices are said not to be short-axis slices, which only the preset `paper` needs.
pub const LONG_AXIS_SLICES: &str = "long_axis_slices";

/// Something the reader of a result should know: a stable code for programs, a sentence for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Stable code in `snake_case`.
    pub code: String,
    /// One sentence without anything that names the patient.
    pub message: String,
    /// The gate it concerns, counted from 1; absent for the whole study.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gate: Option<usize>,
    /// The part of a border it concerns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub affected: Option<Affected>,
}

/// The part of a border that was not seen.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Affected {
    /// `endocardial` or `epicardial`.
    pub surface: String,
    /// First slice, counted from 1.
    pub first_slice: usize,
    /// Last slice, counted from 1.
    pub last_slice: usize,
    /// The part of the circumference; absent where only the apex was not seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arc: Option<AffectedArc>,
    /// Whether no wall was seen at the apex.
    pub apex_unseen: bool,
}

/// A part of the circumferences about the ventricle's axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AffectedArc {
    /// Where it begins, in whole degrees about the ventricle's axis: 0 towards the last column, 90 towards the last row, 180 towards the
    /// first column, 270 towards the first row. In steps of 10.
    pub from_degrees: usize,
    /// Where it ends, going up from `from_degrees` (over 360, if smaller).
    pub to_degrees: usize,
    /// The edge of the image that its middle points to: `first row`, `last row`, `first column` or `last column`.
    pub towards: String,
    /// The walls it covers, the one at its middle first: `anterior`, `inferior`, `septal`, `lateral`. Empty where the study does not say how it
    /// lies in the patient.
    pub walls: Vec<String>,
}

impl Warning {
    /// A warning about the whole study.
    pub fn new(code: &str, message: impl Into<String>) -> Self {
        Self { code: code.to_owned(), message: message.into(), gate: None, affected: None }
    }

    /// A warning about one gate (counted from 1).
    pub fn at_gate(gate: usize, code: &str, message: impl Into<String>) -> Self {
        Self { gate: Some(gate), ..Self::new(code, message) }
    }
}
