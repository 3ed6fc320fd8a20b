//! The ventricle's own coordinates: a sphere about a centre on the long axis towards the apex, a cylinder towards the base ("bullet").
//!
//! A point is `(s, φ, r)`: `r` is the distance from the centre (cap) or from the axis (cylinder); `s` is the polar angle from the apex
//! in the cap, 0 to π/2, and π/2 + height / `unit_mm` in the cylinder, so that both are about equally long a unit of `s`.

use super::basis::Angle;
use crate::pipeline::pose::Pose;
use glam::DVec3;
use std::f64::consts::FRAC_PI_2;

/// Part of the long axis that lies in the cylinder: the rest is about a radius long, so that the cap is nearly a sphere.
const CYLINDER_PART: f64 = 0.55;

/// Bullet coordinates about a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    /// The centre in grid mm.
    pub(super) centre_mm: DVec3,
    /// Unit vectors across the axis (`φ` = 0, π/2) and along it, to the base.
    pub(super) axes: [DVec3; 3],
    /// Height of the pose's valve plane over the centre.
    pub(super) base_mm: f64,
    /// From the centre to the pose's tip.
    pub(super) apex_mm: f64,
    /// Height in the cylinder a unit of `s`.
    pub(super) unit_mm: f64,
}

impl Frame {
    pub(super) fn about(pose: &Pose) -> Self {
        let w = pose.to_base();
        let length_mm = pose.length_mm();
        // The axis of the grid that is most across, so that turning a grid by its own axes turns the frame with it as little as possible.
        let across = if w.x.abs() <= w.y.abs() && w.x.abs() <= w.z.abs() {
            DVec3::X
        } else if w.y.abs() <= w.z.abs() {
            DVec3::Y
        } else {
            DVec3::Z
        };
        let u = (across - w * across.dot(w)).normalize();
        let base_mm = CYLINDER_PART * length_mm;
        Self {
            centre_mm: pose.base_mm - w * base_mm,
            axes: [u, w.cross(u), w],
            base_mm,
            apex_mm: length_mm - base_mm,
            unit_mm: pose.radius_mm,
        }
    }

    /// `[x, y, z]` across and along the axis.
    pub(super) fn local(&self, point_mm: DVec3) -> DVec3 {
        let from = point_mm - self.centre_mm;
        DVec3::from_array(self.axes.map(|axis| axis.dot(from)))
    }

    /// Grid mm of local `[x, y, z]`.
    pub(super) fn grid(&self, local: DVec3) -> DVec3 {
        self.centre_mm + self.axes[0] * local.x + self.axes[1] * local.y + self.axes[2] * local.z
    }

    /// `(s, φ, r)` of a local point.
    pub(super) fn bullet(&self, local: DVec3) -> (f64, f64, f64) {
        let across = local.x.hypot(local.y);
        let phi = local.y.atan2(local.x);
        if local.z < 0.0 { (across.atan2(-local.z), phi, across.hypot(local.z)) } else { (FRAC_PI_2 + local.z / self.unit_mm, phi, across) }
    }

    /// Grid mm of bullet coordinates.
    pub(super) fn point(&self, s: f64, angle: &Angle, r: f64) -> DVec3 {
        if s >= FRAC_PI_2 {
            return self.point_at_height((s - FRAC_PI_2) * self.unit_mm, angle, r);
        }
        let (sin, cos) = s.sin_cos();
        self.grid(DVec3::new(r * sin * angle.cos, r * sin * angle.sin, -r * cos))
    }

    /// Grid mm of a point of the cylinder.
    pub(super) fn point_at_height(&self, height_mm: f64, angle: &Angle, r: f64) -> DVec3 {
        self.grid(DVec3::new(r * angle.cos, r * angle.sin, height_mm))
    }

    /// The `s` of a height over the centre.
    pub(super) fn s_of_height(&self, height_mm: f64) -> f64 {
        FRAC_PI_2 + height_mm / self.unit_mm
    }
}
