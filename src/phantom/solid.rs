//! Solids of revolution about the long axis, with closed-form volumes.
//!
//! Both surfaces of a phantom are such solids in *canonical* coordinates `(x, y, w)`, in mm: `w` runs along the long axis from apex to
//! base, `x` to the lateral wall and `y` to the inferior wall. Each ends flat at the valve plane `w = base_w_mm`.

use std::f64::consts::PI;

/// A solid of revolution, cut off flat at the valve plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// A cylinder closed by a hemisphere of its own radius at the apex.
    CappedCylinder {
        /// Radius of cylinder and cap in mm.
        radius_mm: f64,
        /// Height of the cylinder without its cap in mm.
        height_mm: f64,
        /// The valve plane.
        base_w_mm: f64,
    },
    /// An ellipsoid of revolution, cut above its centre.
    TruncatedEllipsoid {
        /// Semi-axis across in mm.
        radius_mm: f64,
        /// Semi-axis along in mm.
        half_length_mm: f64,
        /// Height of the cut above the centre as a fraction of `half_length_mm`, in `[0, 1)`.
        truncation: f64,
        /// The valve plane.
        base_w_mm: f64,
    },
}

impl Solid {
    /// A truncated ellipsoid of given volume (mm³) and length from tip to valve plane (mm).
    pub fn ellipsoid_of(volume_mm3: f64, length_mm: f64, truncation: f64, base_w_mm: f64) -> Self {
        let half_length_mm = length_mm / (1.0 + truncation);
        let radius_mm = (volume_mm3 / (PI * half_length_mm * ellipsoid_section(truncation))).sqrt();
        Self::TruncatedEllipsoid { radius_mm, half_length_mm, truncation, base_w_mm }
    }

    /// The valve plane's `w`.
    pub fn base_w_mm(&self) -> f64 {
        match *self {
            Self::CappedCylinder { base_w_mm, .. } | Self::TruncatedEllipsoid { base_w_mm, .. } => base_w_mm,
        }
    }

    /// The tip's `w`.
    pub fn tip_w_mm(&self) -> f64 {
        match *self {
            Self::CappedCylinder { radius_mm, height_mm, base_w_mm } => base_w_mm - height_mm - radius_mm,
            Self::TruncatedEllipsoid { half_length_mm, truncation, base_w_mm, .. } => base_w_mm - (1.0 + truncation) * half_length_mm,
        }
    }

    /// The largest radius in mm.
    pub fn widest_radius_mm(&self) -> f64 {
        match *self {
            Self::CappedCylinder { radius_mm, .. } | Self::TruncatedEllipsoid { radius_mm, .. } => radius_mm,
        }
    }

    /// A `w` at which the solid is widest.
    pub fn widest_w_mm(&self) -> f64 {
        match *self {
            Self::CappedCylinder { height_mm, base_w_mm, .. } => base_w_mm - height_mm / 2.0,
            Self::TruncatedEllipsoid { half_length_mm, truncation, base_w_mm, .. } => base_w_mm - truncation * half_length_mm,
        }
    }

    /// Squared radius in mm² at `w`; negative beyond tip and valve plane.
    pub fn radius_squared_mm2(&self, w_mm: f64) -> f64 {
        if w_mm >= self.base_w_mm() {
            return -1.0;
        }
        match *self {
            Self::CappedCylinder { radius_mm, height_mm, base_w_mm } => {
                let below_cap_centre = (base_w_mm - height_mm - w_mm).max(0.0);
                radius_mm * radius_mm - below_cap_centre * below_cap_centre
            }
            Self::TruncatedEllipsoid { radius_mm, half_length_mm, truncation, base_w_mm } => {
                let height = (w_mm - base_w_mm) / half_length_mm + truncation;
                radius_mm * radius_mm * (1.0 - height * height)
            }
        }
    }

    /// Volume in mm³ between the tip and the height `w` (or the valve plane, if that comes first).
    pub fn volume_below_mm3(&self, w_mm: f64) -> f64 {
        match *self {
            Self::CappedCylinder { radius_mm, height_mm, .. } => {
                let depth = (w_mm - self.tip_w_mm()).clamp(0.0, radius_mm + height_mm);
                let in_cap = depth.min(radius_mm);
                PI * in_cap * in_cap * (3.0 * radius_mm - in_cap) / 3.0 + PI * radius_mm * radius_mm * (depth - in_cap)
            }
            Self::TruncatedEllipsoid { radius_mm, half_length_mm, truncation, base_w_mm } => {
                let height = ((w_mm - base_w_mm) / half_length_mm + truncation).clamp(-1.0, truncation);
                PI * radius_mm * radius_mm * half_length_mm * ellipsoid_section(height)
            }
        }
    }

    /// Volume in mm³ from the tip to the valve plane.
    pub fn volume_mm3(&self) -> f64 {
        self.volume_below_mm3(self.base_w_mm())
    }
}

/// ∫ (1 − t²) dt from −1 to `height`: the volume of a unit sphere's part below a height, over π.
fn ellipsoid_section(height: f64) -> f64 {
    height - height.powi(3) / 3.0 + 2.0 / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOLIDS: [Solid; 2] = [
        Solid::CappedCylinder { radius_mm: 20.0, height_mm: 58.0, base_w_mm: 40.0 },
        Solid::TruncatedEllipsoid { radius_mm: 24.0, half_length_mm: 55.0, truncation: 0.4, base_w_mm: 31.0 },
    ];

    #[test]
    fn closed_forms_agree_with_quadrature_of_the_profile() {
        for solid in SOLIDS {
            for share in [0.1, 0.35, 0.8, 1.0] {
                let (low, high) = (solid.tip_w_mm(), solid.tip_w_mm() + share * (solid.base_w_mm() - solid.tip_w_mm()));
                let steps = 200_000;
                let step = (high - low) / f64::from(steps);
                let sum: f64 = (0..steps).map(|i| solid.radius_squared_mm2(low + (f64::from(i) + 0.5) * step)).sum();
                let closed = solid.volume_below_mm3(high);
                assert!((PI * sum * step - closed).abs() < 1e-6 * closed, "{solid:?} at {share}: {closed}");
            }
        }
    }

    #[test]
    fn an_ellipsoid_made_for_a_volume_has_it() {
        let solid = Solid::ellipsoid_of(120_000.0, 80.0, 0.4, 40.0);
        assert!((solid.volume_mm3() - 120_000.0).abs() < 1e-6);
        assert!((solid.base_w_mm() - solid.tip_w_mm() - 80.0).abs() < 1e-12);
    }

    #[test]
    fn a_whole_sphere_is_four_thirds_pi() {
        let sphere = Solid::TruncatedEllipsoid { radius_mm: 3.0, half_length_mm: 3.0, truncation: 1.0, base_w_mm: 3.0 };
        assert!((sphere.volume_mm3() - 4.0 / 3.0 * PI * 27.0).abs() < 1e-12);
    }
}
