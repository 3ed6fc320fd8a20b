//! Where the left ventricle lies, in whatever direction the slices cut it.

use super::{
    PipelineError,
    monitor::Monitor,
    parameters::{PoseMarks, RegionMarks},
    region,
};
use crate::{
    study::{Study, Warning},
    volume::Grid,
};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The ventricle's long axis and width, in grid mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The tip of the mid-wall surface.
    pub apex_mm: DVec3,
    /// Where the long axis meets the valve plane.
    pub base_mm: DVec3,
    /// The largest radius of the mid-wall surface in mm.
    pub radius_mm: f64,
    /// How sure it is.
    pub confidence: PoseConfidence,
}

/// How sure a pose is, and from what.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PoseConfidence {
    /// 0 (on the edge of being refused) to 1 (as clear as a phantom without noise).
    pub score: f64,
    /// Part of the perfused mid-wall points that are brighter than both sides of the wall, 0-1.
    pub ridge: f64,
    /// Part of the counts' variance around the ventricle that a half-ellipsoid's shell explains, 0-1.
    pub explained: f64,
    /// How much better the pose fits than the one with apex and base exchanged; 0: not at all.
    pub flip_margin: f64,
    /// Whether an end was told by the request or by the file rather than by the counts.
    pub ends_given: bool,
}

impl Pose {
    /// Unit vector from apex to base.
    pub fn to_base(&self) -> DVec3 {
        (self.base_mm - self.apex_mm).normalize_or(DVec3::Z)
    }

    /// From the mid-wall tip to the valve plane in mm.
    pub fn length_mm(&self) -> f64 {
        self.base_mm.distance(self.apex_mm)
    }
}

/// Least and largest distance between given ends, in mm: shorter and longer than any ventricle.
const LEAST_LENGTH_MM: f64 = 25.0;
const LARGEST_LENGTH_MM: f64 = 140.0;

/// Below this score a pose is uncertain.
pub const UNCERTAIN_BELOW: f64 = 0.3;

/// Checks that given marks are possible on a grid.
pub fn check_marks(grid: &Grid, marks: &PoseMarks) -> Result<(), PipelineError> {
    let fail = |why: String| Err(PipelineError::RegionOutside { why });
    let [slices, rows, columns] = grid.shape.map(|voxels| (voxels.max(1) - 1) as f64);
    let reach = DVec3::new(columns, rows, slices) * grid.step_mm();
    for (name, mark) in [("pose.apex_mm", marks.apex_mm), ("pose.base_mm", marks.base_mm)] {
        let Some(mark) = mark.map(DVec3::from_array) else { continue };
        let inside = mark.cmpge(DVec3::ZERO).all() && mark.cmple(reach).all();
        if !inside {
            let DVec3 { x, y, z } = mark;
            let [width, height, depth] = reach.to_array();
            return fail(format!(
                "`{name}` is [{x:?}, {y:?}, {z:?}], but the study reaches from [0, 0, 0] to [{width:.1}, {height:.1}, {depth:.1}] mm"
            ));
        }
    }
    if let (Some(apex), Some(base)) = (marks.apex_mm, marks.base_mm) {
        let length_mm = DVec3::from_array(apex).distance(DVec3::from_array(base));
        if !(LEAST_LENGTH_MM..=LARGEST_LENGTH_MM).contains(&length_mm) {
            return fail(format!(
                "`pose.apex_mm` and `pose.base_mm` are {length_mm:.1} mm apart; a left ventricle has {LEAST_LENGTH_MM} to {LARGEST_LENGTH_MM} mm"
            ));
        }
    }
    Ok(())
}

/// Finds the ventricle in the sum of a study's gates; marks that are given win.
///
/// Errors: [`PipelineError::NoLeftVentricle`] says what was looked for and not found.
pub fn find(study: &Study, marks: &PoseMarks, region: &RegionMarks, _monitor: &dyn Monitor) -> Result<(Pose, Vec<Warning>), PipelineError> {
    let location = region::locate(study, region)?;
    let found = location.region(&study.grid);
    let dz = study.grid.spacing_mm[0];
    let (first, last) = ((found.first_slice as f64 - 1.5) * dz, (found.last_slice as f64 - 0.5) * dz);
    let at = |z: f64| {
        let [x, y] = found.centre_mm;
        let [u, v] = found.axis_slope;
        let from_middle = z - f64::midpoint(first, last);
        DVec3::new(x + u * from_middle, y + v * from_middle, z)
    };
    let (apex, base) = if found.base_at_last_slice { (first, last) } else { (last, first) };
    let pose = Pose {
        apex_mm: marks.apex_mm.map_or(at(apex), DVec3::from_array),
        base_mm: marks.base_mm.map_or(at(base), DVec3::from_array),
        radius_mm: found.radius_mm - 25.0,
        confidence: PoseConfidence::default(),
    };
    Ok((pose, location.warnings()))
}
