//! Where the ventricle lies, however the slices lie.

use crate::{
    pipeline::pose::{Pose, PoseConfidence},
    study::Orientation,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The ventricle's long axis and width. Points are in grid mm: from the centre of the first voxel, x along a row, y down the columns, z from the first
/// slice to the last.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PoseSummary {
    /// The tip of the surface in the middle of the wall, `[x, y, z]` in grid mm.
    pub apex_mm: [f64; 3],
    /// Where the long axis meets the valve plane, `[x, y, z]` in grid mm.
    pub base_mm: [f64; 3],
    /// Unit vector from apex to base in the grid.
    pub axis: [f64; 3],
    /// From apex to base in mm.
    pub length_mm: f64,
    /// Largest radius of the surface in the middle of the wall, in mm.
    pub radius_mm: f64,
    /// The same in the patient; null where the study does not say how it lies in the patient.
    #[schema(required)]
    pub patient: Option<PatientPose>,
    /// How sure it is.
    pub confidence: PoseConfidenceSummary,
}

/// A pose along the patient's axes: `[left, posterior, superior]` growing (LPS), from the origin of the study's DICOM frame of reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PatientPose {
    /// The tip, in mm.
    pub apex_mm: [f64; 3],
    /// Where the long axis meets the valve plane, in mm.
    pub base_mm: [f64; 3],
    /// Unit vector from apex to base.
    pub axis: [f64; 3],
}

/// How sure a pose is, and from what.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PoseConfidenceSummary {
    /// 0 (on the edge of being refused) to 1 (as clear as a simulated ventricle without noise).
    pub score: f64,
    /// Perfused points in the middle of the wall that are brighter than both of its sides, in percent.
    pub ridge_percent: f64,
    /// Variance of the counts around the ventricle that the shell of a half ellipsoid explains, in percent.
    pub explained_percent: f64,
    /// How much better the pose fits than the one with apex and base exchanged; 0: not at all.
    pub flip_margin: f64,
    /// Whether an end was told by the request or the file rather than by the counts.
    pub ends_given: bool,
}

impl PoseSummary {
    /// Of a pose, in a study that lies so in the patient.
    pub(super) fn of(pose: &Pose, orientation: Option<&Orientation>) -> Self {
        let axis = pose.to_base();
        Self {
            apex_mm: pose.apex_mm.to_array(),
            base_mm: pose.base_mm.to_array(),
            axis: axis.to_array(),
            length_mm: pose.length_mm(),
            radius_mm: pose.radius_mm,
            patient: orientation.map(|orientation| PatientPose {
                apex_mm: orientation.patient_mm(pose.apex_mm).to_array(),
                base_mm: orientation.patient_mm(pose.base_mm).to_array(),
                axis: orientation.direction(axis).to_array(),
            }),
            confidence: (&pose.confidence).into(),
        }
    }
}

impl From<&PoseConfidence> for PoseConfidenceSummary {
    fn from(confidence: &PoseConfidence) -> Self {
        let PoseConfidence { score, ridge, explained, flip_margin, ends_given } = *confidence;
        Self { score, ridge_percent: 100.0 * ridge, explained_percent: 100.0 * explained, flip_margin, ends_given }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_pose_is_told_in_the_grid_and_in_the_patient() {
        let pose = Pose {
            apex_mm: DVec3::new(10.0, 20.0, 5.0),
            base_mm: DVec3::new(10.0, 20.0, 85.0),
            radius_mm: 30.0,
            confidence: PoseConfidence { score: 0.8, ridge: 0.9, explained: 0.85, flip_margin: 0.1, ends_given: false },
        };
        let turned = Orientation { columns: DVec3::Y, rows: DVec3::NEG_Z, slices: DVec3::X, origin_mm: DVec3::new(1.0, 2.0, 3.0) };
        assert_eq!(PoseSummary::of(&pose, None).patient, None);
        let told = PoseSummary::of(&pose, Some(&turned));
        assert_eq!((told.axis, told.length_mm, told.confidence.ridge_percent), ([0.0, 0.0, 1.0], 80.0, 90.0));
        let patient = told.patient.unwrap();
        assert_eq!((patient.apex_mm, patient.axis), ([6.0, 12.0, -17.0], [1.0, 0.0, 0.0]));
    }
}
