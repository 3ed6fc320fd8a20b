//! What the request says of the pose, and how a shell is made to obey it.

use super::{
    super::parameters::{PoseMarks, RegionMarks},
    shape::Shell,
};
use crate::volume::Grid;
use glam::{DVec2, DVec3};

/// An axis within this of the slices' normal is cut across by the slices: their first and last are its ends.
const ACROSS_DEGREES: f64 = 30.0;

/// The marks in grid mm.
#[expect(clippy::struct_field_names, reason = "units are in names")]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Held {
    pub apex_mm: Option<DVec3>,
    pub base_mm: Option<DVec3>,
    /// Half way between the ends.
    pub centre_mm: Option<DVec2>,
    pub radius_mm: Option<f64>,
    /// Heights between which the ventricle lies.
    pub low_mm: Option<f64>,
    pub high_mm: Option<f64>,
}

impl Held {
    pub(super) fn new(grid: &Grid, pose: &PoseMarks, region: &RegionMarks) -> Self {
        let dz = grid.spacing_mm[0];
        Self {
            apex_mm: pose.apex_mm.map(DVec3::from_array),
            base_mm: pose.base_mm.map(DVec3::from_array),
            centre_mm: region.centre_mm.map(DVec2::from_array),
            radius_mm: region.radius_mm,
            low_mm: region.first_slice.map(|slice| (slice as f64 - 1.5) * dz),
            high_mm: region.last_slice.map(|slice| (slice as f64 - 0.5) * dz),
        }
    }

    /// Whether both ends are told.
    pub(super) fn both_ends(&self) -> Option<(DVec3, DVec3)> {
        self.apex_mm.zip(self.base_mm)
    }

    /// Whether apex and base are told apart.
    pub(super) fn tells_ends(&self) -> bool {
        self.apex_mm.is_some() || self.base_mm.is_some()
    }

    /// Whether somebody has pointed at the ventricle.
    pub(super) fn points_at_it(&self) -> bool {
        self.tells_ends() || self.centre_mm.is_some()
    }

    /// Whether a point may be looked at; the circle is that about the mark or, without one, about `centre_mm`.
    pub(super) fn allows(&self, point_mm: DVec3, centre_mm: Option<DVec2>) -> bool {
        let inside = match (self.radius_mm, self.centre_mm.or(centre_mm)) {
            (Some(radius), Some(centre)) => point_mm.truncate().distance(centre) <= radius,
            _ => true,
        };
        inside && self.low_mm.is_none_or(|low| point_mm.z >= low) && self.high_mm.is_none_or(|high| point_mm.z <= high)
    }

    /// The shell moved to where the marks want it. Marks of the ends win over marks of the slices.
    pub(super) fn placed(&self, mut shell: Shell) -> Shell {
        match (self.apex_mm, self.base_mm) {
            (Some(apex), Some(base)) => {
                shell.base_mm = base;
                shell.to_apex = (apex - base).normalize_or(DVec3::Z);
                shell.length_mm = apex.distance(base);
            }
            (None, Some(base)) => {
                shell.base_mm = base;
                self.limit_apex(&mut shell);
            }
            (Some(apex), None) => {
                shell.base_mm = apex - shell.to_apex * shell.length_mm;
                self.limit_base(&mut shell, apex);
            }
            (None, None) => self.place_by_slices(&mut shell),
        }
        shell
    }

    /// The heights of apex and base that the slices tell, if the axis goes through the slices.
    fn ends_z(&self, shell: &Shell) -> (Option<f64>, Option<f64>) {
        if shell.to_apex.z.abs() < ACROSS_DEGREES.to_radians().cos() {
            (None, None)
        } else if shell.to_apex.z > 0.0 {
            (self.high_mm, self.low_mm)
        } else {
            (self.low_mm, self.high_mm)
        }
    }

    /// Given the base, the apex at its slice.
    fn limit_apex(&self, shell: &mut Shell) {
        if let (Some(apex_z), _) = self.ends_z(shell) {
            shell.length_mm = ((apex_z - shell.base_mm.z) / shell.to_apex.z).max(25.0);
        }
    }

    /// Given the apex, the base at its slice.
    fn limit_base(&self, shell: &mut Shell, apex: DVec3) {
        if let (_, Some(base_z)) = self.ends_z(shell) {
            shell.length_mm = ((apex.z - base_z) / shell.to_apex.z).max(25.0);
            shell.base_mm = apex - shell.to_apex * shell.length_mm;
        }
    }

    fn place_by_slices(&self, shell: &mut Shell) {
        let (apex_z, base_z) = self.ends_z(shell);
        match (apex_z, base_z) {
            (Some(apex_z), Some(base_z)) => {
                // Along the axis to the given heights.
                let to_base = (base_z - shell.base_mm.z) / shell.to_apex.z;
                shell.base_mm += shell.to_apex * to_base;
                shell.length_mm = (apex_z - base_z) / shell.to_apex.z;
            }
            (None, Some(base_z)) => {
                let by = (base_z - shell.base_mm.z) / shell.to_apex.z;
                shell.base_mm += shell.to_apex * by;
                shell.length_mm = (shell.length_mm - by).max(25.0);
            }
            (Some(apex_z), None) => shell.length_mm = ((apex_z - shell.base_mm.z) / shell.to_apex.z).max(25.0),
            (None, None) => {}
        }
        if let Some(centre) = self.centre_mm {
            let off = centre - shell.middle_mm().truncate();
            shell.base_mm += off.extend(0.0);
        }
    }
}
