//! Bright things that are no ventricle: negative controls.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A body of the uptake of a normal wall around the ventricle's place, hollow parts filled with blood. It does not beat.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "form", rename_all = "snake_case")]
pub enum Decoy {
    /// A solid ball.
    Ball {
        /// Its radius in mm.
        radius_mm: f64,
    },
    /// A hollow ball, closed on all sides.
    HollowBall {
        /// Radius of the hollow in mm.
        inner_mm: f64,
        /// Radius of the ball in mm.
        outer_mm: f64,
    },
    /// A tube along the long axis, open at both ends.
    Tube {
        /// Radius of the hollow in mm.
        inner_mm: f64,
        /// Radius of the tube in mm.
        outer_mm: f64,
        /// Its length in mm.
        length_mm: f64,
    },
    /// A ring (torus) around the long axis.
    Ring {
        /// Radius of the circle in its middle in mm.
        radius_mm: f64,
        /// Radius of its section in mm.
        thickness_mm: f64,
    },
    /// Two solid balls side by side.
    TwoBalls {
        /// Radius of each in mm.
        radius_mm: f64,
        /// Distance of their centres in mm.
        apart_mm: f64,
    },
}

/// What a point of a decoy is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    Body,
    Hollow,
}

impl Decoy {
    /// The part at a local point in mm; `None` outside.
    pub(super) fn part(&self, point: DVec3) -> Option<Part> {
        let across = point.x.hypot(point.y);
        let (body, hollow) = match *self {
            Self::Ball { radius_mm } => (point.length() < radius_mm, false),
            Self::HollowBall { inner_mm, outer_mm } => (point.length() < outer_mm, point.length() < inner_mm),
            Self::Tube { inner_mm, outer_mm, length_mm } => (across < outer_mm && point.z.abs() < length_mm / 2.0, across < inner_mm),
            Self::Ring { radius_mm, thickness_mm } => ((across - radius_mm).hypot(point.z) < thickness_mm, false),
            Self::TwoBalls { radius_mm, apart_mm } => ((point.x.abs() - apart_mm / 2.0).hypot(point.y).hypot(point.z) < radius_mm, false),
        };
        body.then_some(if hollow { Part::Hollow } else { Part::Body })
    }

    /// Half-widths of a box about the origin that holds it, in mm.
    pub(super) fn reach_mm(&self) -> DVec3 {
        match *self {
            Self::Ball { radius_mm } | Self::HollowBall { outer_mm: radius_mm, .. } => DVec3::splat(radius_mm),
            Self::Tube { outer_mm, length_mm, .. } => DVec3::new(outer_mm, outer_mm, length_mm / 2.0),
            Self::Ring { radius_mm, thickness_mm } => DVec3::new(radius_mm + thickness_mm, radius_mm + thickness_mm, thickness_mm),
            Self::TwoBalls { radius_mm, apart_mm } => DVec3::new(apart_mm / 2.0 + radius_mm, radius_mm, radius_mm),
        }
    }

    /// Its sizes in mm by name.
    pub(super) fn sizes_mm(&self) -> Vec<f64> {
        match *self {
            Self::Ball { radius_mm } => vec![radius_mm],
            Self::HollowBall { inner_mm, outer_mm } => vec![inner_mm, outer_mm],
            Self::Tube { inner_mm, outer_mm, length_mm } => vec![inner_mm, outer_mm, length_mm],
            Self::Ring { radius_mm, thickness_mm } => vec![radius_mm, thickness_mm],
            Self::TwoBalls { radius_mm, apart_mm } => vec![radius_mm, apart_mm],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::{Imaging, Phantom, Psf, Shape, Uptake, simulate};
    use std::f64::consts::PI;

    /// What is seen of each, without blur, noise and background, sums to its volume. The sampled border costs under a percent.
    #[test]
    fn every_decoy_has_its_volume_and_is_no_ventricle() {
        let ball = |radius: f64| 4.0 / 3.0 * PI * radius.powi(3);
        for (decoy, mm3) in [
            (Decoy::Ball { radius_mm: 25.0 }, ball(25.0)),
            (Decoy::HollowBall { inner_mm: 22.0, outer_mm: 34.0 }, ball(34.0) - ball(22.0)),
            (Decoy::Tube { inner_mm: 20.0, outer_mm: 31.0, length_mm: 80.0 }, PI * (31.0_f64.powi(2) - 400.0) * 80.0),
            (Decoy::Ring { radius_mm: 30.0, thickness_mm: 9.0 }, 2.0 * PI * PI * 30.0 * 81.0),
            (Decoy::TwoBalls { radius_mm: 18.0, apart_mm: 50.0 }, 2.0 * ball(18.0)),
        ] {
            let imaging = Imaging { gates: 1, noise_seed: None, counts: 1.0, psf: Psf::gaussian(0.0), ..Imaging::default() };
            let uptake = Uptake { background: 0.0, blood_pool: 0.0, ..Uptake::default() };
            let simulation = simulate(&Phantom { uptake, imaging, ..Phantom::of(Shape::Decoy(decoy)) }).unwrap();
            let volume = &simulation.study.gates[0].volume;
            let found = volume.total() * volume.grid.voxel_mm3();
            assert!((found / mm3 - 1.0).abs() < 0.01, "{decoy:?}: {found} against {mm3}");
            assert!(!simulation.truth.has_ventricle);
        }
    }
}
