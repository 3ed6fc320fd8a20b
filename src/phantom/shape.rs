//! The ventricles that can be simulated: the paper's test object and beating truncated ellipsoids.

use super::cycle;
use super::decoy::Decoy;
use super::solid::Solid;
use serde::{Deserialize, Serialize};

/// Height in mm of the inner cylinder, without its cap, that holds the printed 89 794 mm³ at r = 20 mm (about 58.12).
const PRINTED_INNER_HEIGHT_MM: f64 = (89_794.0 - 2.0 / 3.0 * std::f64::consts::PI * 8_000.0) / (std::f64::consts::PI * 400.0);

/// What stands in the volume.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Shape {
    /// The paper's PHANTOM; it does not beat.
    Cylinder(Cylinder),
    /// A beating ventricle.
    Ventricle(Ventricle),
    /// Something bright that is no ventricle: a negative control.
    Decoy(Decoy),
    /// No ventricle at all: a negative control. Surroundings (liver, background) remain.
    Empty,
}

/// A cylinder with a hemispherical cap, open at the base, in a cylinder with a hemispherical cap.
///
/// The paper (§6) prints R1 = 20, R2 = 35, R3 = 45, H = 55 mm and volumes of 89 794 and 305 301.4 mm³. R3 and H fit neither volume. An
/// outer cylinder of height 56 with its cap gives the outer one (305 301.4 with π ≈ 3.1415, 305 310 with π); an inner cylinder of height
/// 58.12 with its cap gives the inner one. Those are the defaults; the wall at the apex is then 12.9 mm thick.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cylinder {
    /// Radius of the cavity in mm.
    pub inner_radius_mm: f64,
    /// Height of the cavity's cylinder without its cap in mm.
    pub inner_height_mm: f64,
    /// Radius of the outside in mm.
    pub outer_radius_mm: f64,
    /// Height of the outside's cylinder without its cap in mm.
    pub outer_height_mm: f64,
}

impl Default for Cylinder {
    fn default() -> Self {
        Self { inner_radius_mm: 20.0, inner_height_mm: PRINTED_INNER_HEIGHT_MM, outer_radius_mm: 35.0, outer_height_mm: 56.0 }
    }
}

/// A ventricle whose surfaces are truncated ellipsoids at every instant.
///
/// The cavity follows the time-volume curve of [`cycle`] between `edv_ml` and `esv_ml`; the wall keeps its volume; the valve
/// plane moves towards a resting apex.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Ventricle {
    /// Volume of the cavity at the R wave in ml. A gate's own volume differs: see [`super::Truth`].
    pub edv_ml: f64,
    /// Volume of the cavity at the end of ejection in ml.
    pub esv_ml: f64,
    /// Volume of the wall in ml.
    pub wall_ml: f64,
    /// Length of the cavity over its largest diameter at end diastole (the inverse of the sphericity index).
    pub elongation: f64,
    /// Shortening of the cavity from end diastole to end systole, as a fraction of its length.
    pub shortening: f64,
    /// How far the ellipsoid reaches over its widest level, as a fraction of its half length, in `[0, 1)`.
    pub truncation: f64,
    /// Thickness of the wall at the tip over its thickness at the widest level. An apex is thinner than the lateral wall.
    pub apical_thickness_ratio: f64,
}

impl Ventricle {
    /// A normal ventricle: EDV 120 ml, EF .60.
    pub const NORMAL: Self = Self {
        edv_ml: 120.0,
        esv_ml: 48.0,
        wall_ml: 120.0,
        elongation: 1.6,
        shortening: 0.15,
        truncation: 0.4,
        apical_thickness_ratio: 0.8,
    };
    /// A dilated, failing ventricle: EDV 250 ml, EF .25, rounder and hardly shortening.
    pub const DILATED: Self = Self {
        edv_ml: 250.0,
        esv_ml: 187.5,
        wall_ml: 180.0,
        elongation: 1.35,
        shortening: 0.06,
        truncation: 0.4,
        apical_thickness_ratio: 0.8,
    };
    /// A small, hyperdynamic ventricle: EDV 45 ml, EF .80; the case in which blur hides the cavity at end systole.
    pub const SMALL: Self =
        Self { edv_ml: 45.0, esv_ml: 9.0, wall_ml: 85.0, elongation: 1.65, shortening: 0.18, truncation: 0.4, apical_thickness_ratio: 0.8 };

    /// The normal ventricle at end diastole, enlarged to the 265.501 ml of the paper's heart-like object (§7.6), and still. The paper gives no
    /// volume of its cavity: half of the whole is the normal ventricle's.
    pub const HEART_LIKE: Self =
        Self { edv_ml: 265.501 / 2.0, esv_ml: 265.501 / 2.0, wall_ml: 265.501 / 2.0, shortening: 0.0, ..Self::NORMAL };

    /// Volume of the cavity in ml at a phase of the cycle (R wave 0, next R wave 1).
    pub fn cavity_ml(&self, phase: f64) -> f64 {
        self.esv_ml + (self.edv_ml - self.esv_ml) * cycle::filling(phase)
    }

    /// Both surfaces when the cavity holds `cavity_ml`. The tip of the epicardium rests; at end diastole tip and valve plane are
    /// equally far from `w = 0`.
    pub fn surfaces(&self, cavity_ml: f64) -> Surfaces {
        let (length_ed, apex_ed) = self.lengths_mm(self.edv_ml);
        let (length, apex) = self.lengths_mm(cavity_ml);
        let base_w_mm = -(length_ed + apex_ed) / 2.0 + length + apex;
        Surfaces {
            endocardium: Solid::ellipsoid_of(cavity_ml * 1000.0, length, self.truncation, base_w_mm),
            epicardium: Solid::ellipsoid_of((cavity_ml + self.wall_ml) * 1000.0, length + apex, self.truncation, base_w_mm),
        }
    }

    /// Length of the cavity and thickness of the wall at its tip, both in mm.
    fn lengths_mm(&self, cavity_ml: f64) -> (f64, f64) {
        // With length = elongation × 2 r, the volume is proportional to the cube of the length: scale from a unit length.
        let unit = Solid::ellipsoid_of(1.0, 1.0, self.truncation, 0.0).widest_radius_mm();
        let length_ed = ((2.0 * self.elongation * unit).powi(2) * self.edv_ml * 1000.0).cbrt();
        // Length goes with a power of the volume, chosen so that the shortening is reached at end systole.
        let ejected = (self.esv_ml / self.edv_ml).ln();
        let exponent = if ejected < 0.0 { (1.0 - self.shortening).ln() / ejected } else { 0.0 };
        let length = length_ed * (cavity_ml / self.edv_ml).powf(exponent);
        let inner = Solid::ellipsoid_of(cavity_ml * 1000.0, length, self.truncation, 0.0).widest_radius_mm();
        let outer =
            |apex: f64| Solid::ellipsoid_of((cavity_ml + self.wall_ml) * 1000.0, length + apex, self.truncation, 0.0).widest_radius_mm();
        // A thicker tip leaves less for the sides: the difference is monotone, so bisection finds the one thickness that fits.
        let (mut low, mut high) = (0.0, 200.0);
        for _ in 0..100 {
            let middle = f64::midpoint(low, high);
            if middle < self.apical_thickness_ratio * (outer(middle) - inner) {
                low = middle;
            } else {
                high = middle;
            }
        }
        (length, f64::midpoint(low, high))
    }
}

/// The two surfaces at one instant, in canonical coordinates (see [`super::solid`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surfaces {
    /// The border of the cavity.
    pub endocardium: Solid,
    /// The outer border of the wall.
    pub epicardium: Solid,
}

impl Shape {
    /// The surfaces at a phase of the cycle; `None` without a ventricle.
    pub fn surfaces(&self, phase: f64) -> Option<Surfaces> {
        match self {
            Self::Cylinder(cylinder) => Some(cylinder.surfaces()),
            Self::Ventricle(ventricle) => Some(ventricle.surfaces(ventricle.cavity_ml(phase))),
            Self::Decoy(_) | Self::Empty => None,
        }
    }
}

impl Cylinder {
    /// Both surfaces; tip and valve plane are equally far from `w = 0`.
    pub fn surfaces(&self) -> Surfaces {
        let base_w_mm = f64::midpoint(self.outer_height_mm, self.outer_radius_mm);
        Surfaces {
            endocardium: Solid::CappedCylinder { radius_mm: self.inner_radius_mm, height_mm: self.inner_height_mm, base_w_mm },
            epicardium: Solid::CappedCylinder { radius_mm: self.outer_radius_mm, height_mm: self.outer_height_mm, base_w_mm },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_s_printed_volumes() {
        let surfaces = Cylinder::default().surfaces();
        assert!((surfaces.endocardium.volume_mm3() - 89_794.0).abs() < 1e-6);
        let printed_with_its_pi = 305_301.4 * std::f64::consts::PI / (31_415.0 / 10_000.0);
        assert!((surfaces.epicardium.volume_mm3() - printed_with_its_pi).abs() < 0.5);
    }

    #[test]
    fn the_heart_like_ventricle_has_the_papers_volume_and_stands_still() {
        for phase in [0.0, 0.35, 0.6] {
            let surfaces = Ventricle::HEART_LIKE.surfaces(Ventricle::HEART_LIKE.cavity_ml(phase));
            assert!((surfaces.epicardium.volume_mm3() - 265_501.0).abs() < 1e-6, "{}", surfaces.epicardium.volume_mm3());
        }
    }

    #[test]
    fn volumes_follow_the_curve_and_the_wall_is_conserved() {
        for ventricle in [Ventricle::NORMAL, Ventricle::DILATED, Ventricle::SMALL] {
            for step in 0..=20 {
                let phase = f64::from(step) / 20.0;
                let surfaces = ventricle.surfaces(ventricle.cavity_ml(phase));
                let cavity = surfaces.endocardium.volume_mm3() / 1000.0;
                let wall = surfaces.epicardium.volume_mm3() / 1000.0 - cavity;
                assert!((cavity - ventricle.cavity_ml(phase)).abs() < 1e-9);
                assert!((wall - ventricle.wall_ml).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn the_cavity_lies_inside_the_epicardium_with_a_plausible_wall() {
        for ventricle in [Ventricle::NORMAL, Ventricle::DILATED, Ventricle::SMALL] {
            for cavity_ml in [ventricle.edv_ml, ventricle.esv_ml] {
                let Surfaces { endocardium, epicardium } = ventricle.surfaces(cavity_ml);
                for step in 0..100 {
                    let w = endocardium.tip_w_mm() + (endocardium.base_w_mm() - endocardium.tip_w_mm()) * f64::from(step) / 100.0;
                    let thickness = epicardium.radius_squared_mm2(w).sqrt() - endocardium.radius_squared_mm2(w).max(0.0).sqrt();
                    assert!(thickness > 4.0, "{ventricle:?} {cavity_ml} ml: {thickness} mm at {w}");
                }
                let lateral = epicardium.widest_radius_mm() - endocardium.widest_radius_mm();
                let apical = endocardium.tip_w_mm() - epicardium.tip_w_mm();
                assert!((apical / lateral - ventricle.apical_thickness_ratio).abs() < 1e-9);
                assert!((6.0..20.0).contains(&lateral), "{lateral}");
            }
        }
    }

    #[test]
    fn the_base_descends_by_the_shortening_while_the_tip_rests() {
        let ventricle = Ventricle::NORMAL;
        let (ed, es) = (ventricle.surfaces(ventricle.edv_ml), ventricle.surfaces(ventricle.esv_ml));
        assert!((ed.epicardium.tip_w_mm() - es.epicardium.tip_w_mm()).abs() < 1e-9);
        assert!((ed.epicardium.tip_w_mm() + ed.epicardium.base_w_mm()).abs() < 1e-9);
        let length = |surfaces: &Surfaces| surfaces.endocardium.base_w_mm() - surfaces.endocardium.tip_w_mm();
        assert!((length(&es) / length(&ed) - 0.85).abs() < 1e-9);
        let elongation = length(&ed) / (2.0 * ed.endocardium.widest_radius_mm());
        assert!((elongation - 1.6).abs() < 1e-9);
    }
}
