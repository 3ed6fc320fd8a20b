//! Where the ventricle stands in the grid, and how it departs from a solid of revolution.
//!
//! A point goes from canonical coordinates (see [`super::solid`]) through a deformation that keeps every volume, then a
//! rotation, to grid mm. Each step of the deformation has Jacobian determinant 1, so closed-form volumes stay exact.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Rotation and displacement of the ventricle in a short-axis grid.
///
/// Untilted and centred, the long axis is parallel to the slices with the apex towards slice 0, the lateral wall towards increasing
/// columns and the inferior wall towards increasing rows.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation about the grid's x axis, then about its y axis, in degrees.
    pub tilt_degrees: [f64; 2],
    /// Displacement from the grid's centre along `[x, y, z]` in mm.
    pub offset_mm: [f64; 3],
    /// Whether slice 0 is basal instead of apical.
    pub reversed: bool,
}

impl Pose {
    /// Columns: where the canonical x, y and w directions point in a grid whose slice 0 is apical.
    pub fn rotation(&self) -> DMat3 {
        let [about_x, about_y] = self.tilt_degrees;
        DMat3::from_rotation_y(about_y.to_radians()) * DMat3::from_rotation_x(about_x.to_radians())
    }
}

/// Departures from a solid of revolution. All zero (the default): none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Deformation {
    /// How far apex and base move sideways, to the lateral side, against the middle, in mm (parabolic shear of the axis).
    pub bend_mm: f64,
    /// Turn of the cross-sections between apex and base in degrees. Visible only with `ovality` or a non-uniform wall.
    pub twist_degrees: f64,
    /// Lateral-septal over antero-inferior diameter, minus 1.
    pub ovality: f64,
    /// Slope of the valve plane in degrees: the septal wall ends nearer the apex than the lateral one (shear along the axis).
    pub base_tilt_degrees: f64,
}

/// A deformation prepared for a ventricle that reaches `± half_length_mm` along its axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Warp {
    deformation: Deformation,
    half_length_mm: f64,
    stretch: f64,
    slope: f64,
    twisted: bool,
}

impl Warp {
    pub(super) fn new(deformation: Deformation, half_length_mm: f64) -> Self {
        let slope = deformation.base_tilt_degrees.to_radians().tan();
        let twisted = deformation.twist_degrees != 0.0;
        Self { deformation, half_length_mm, stretch: (1.0 + deformation.ovality).sqrt(), slope, twisted }
    }

    /// Canonical to deformed coordinates.
    pub(super) fn apply(&self, canonical: DVec3) -> DVec3 {
        let along = canonical.z / self.half_length_mm;
        let oval = DVec3::new(canonical.x * self.stretch, canonical.y / self.stretch, canonical.z);
        let turned = self.turn(oval, along, 1.0);
        let x = turned.x + self.deformation.bend_mm * along * along;
        DVec3::new(x, turned.y, turned.z + self.slope * x)
    }

    /// Deformed to canonical coordinates.
    pub(super) fn undo(&self, deformed: DVec3) -> DVec3 {
        self.unturn(self.straighten(deformed))
    }

    /// [`Self::undo`], or `None` for most points whose canonical image is farther than `radius_mm` from the axis. Turning costs a sine and
    /// a cosine; most points around a ventricle are decided without.
    pub(super) fn undo_near(&self, deformed: DVec3, radius_mm: f64) -> Option<DVec3> {
        let straight = self.straighten(deformed);
        let reach = radius_mm * self.stretch.max(1.0 / self.stretch);
        (straight.x * straight.x + straight.y * straight.y <= reach * reach).then(|| self.unturn(straight))
    }

    fn straighten(&self, deformed: DVec3) -> DVec3 {
        let w = deformed.z - self.slope * deformed.x;
        let along = w / self.half_length_mm;
        DVec3::new(deformed.x - self.deformation.bend_mm * along * along, deformed.y, w)
    }

    fn unturn(&self, straight: DVec3) -> DVec3 {
        let oval = self.turn(straight, straight.z / self.half_length_mm, -1.0);
        DVec3::new(oval.x / self.stretch, oval.y * self.stretch, oval.z)
    }

    fn turn(&self, point: DVec3, along: f64, sense: f64) -> DVec3 {
        if !self.twisted {
            return point;
        }
        let (sine, cosine) = (sense * along * self.deformation.twist_degrees.to_radians() / 2.0).sin_cos();
        DVec3::new(cosine * point.x - sine * point.y, sine * point.x + cosine * point.y, point.z)
    }

    /// Half-widths of a box about the origin that holds the deformed image of the canonical box `± half`.
    pub(super) fn bound(&self, half: DVec3) -> DVec3 {
        let along = half.z / self.half_length_mm;
        let (wide, high) = (half.x * self.stretch, half.y / self.stretch);
        let turn = (along * self.deformation.twist_degrees.to_radians() / 2.0).abs().min(std::f64::consts::FRAC_PI_2).sin();
        let (x, y) = (wide + turn * high + self.deformation.bend_mm.abs() * along * along, high + turn * wide);
        DVec3::new(x, y, half.z + self.slope.abs() * x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Deformation = Deformation { bend_mm: 9.0, twist_degrees: 40.0, ovality: 0.25, base_tilt_degrees: 15.0 };

    #[test]
    fn undoing_a_deformation_returns_the_point() {
        let warp = Warp::new(ALL, 45.0);
        for point in [DVec3::new(30.0, -20.0, 40.0), DVec3::new(-5.0, 12.0, -44.0), DVec3::ZERO] {
            assert!((warp.undo(warp.apply(point)) - point).length() < 1e-12);
            assert_eq!(warp.undo_near(warp.apply(point), 37.0), Some(warp.undo(warp.apply(point))));
        }
        assert_eq!(warp.undo_near(warp.apply(DVec3::new(70.0, 20.0, 0.0)), 37.0), None);
    }

    #[test]
    fn every_deformation_keeps_volume() {
        let warp = Warp::new(ALL, 45.0);
        let step = 1e-4;
        for point in [DVec3::new(30.0, -20.0, 40.0), DVec3::new(-5.0, 12.0, -44.0), DVec3::new(1.0, 2.0, 3.0)] {
            let slope = |axis: DVec3| (warp.apply(point + axis * step) - warp.apply(point - axis * step)) / (2.0 * step);
            let determinant = DMat3::from_cols(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z)).determinant();
            assert!((determinant - 1.0).abs() < 1e-7, "{determinant}");
        }
    }

    #[test]
    fn the_bound_holds_the_deformed_box() {
        let warp = Warp::new(ALL, 45.0);
        let half = DVec3::new(34.0, 34.0, 45.0);
        let bound = warp.bound(half);
        for corner in 0..8 {
            let sign = |bit: i32| if corner & bit == 0 { -1.0 } else { 1.0 };
            let point = warp.apply(half * DVec3::new(sign(1), sign(2), sign(4))).abs();
            assert!(point.cmple(bound + 1e-9).all(), "{point} {bound}");
        }
    }
}
