//! Phantoms by name.

use super::{Cylinder, Deformation, Imaging, Phantom, Pose, Psf, Shape, Uptake, Ventricle};

impl Phantom {
    /// A shape with the default uptake and imaging, upright in the middle of the grid.
    pub fn of(shape: Shape) -> Self {
        Self {
            shape,
            pose: Pose::default(),
            deformation: Deformation::default(),
            uptake: Uptake::default(),
            imaging: Imaging::default(),
            regional: Vec::new(),
        }
    }

    /// The paper's PHANTOM: cylinders with caps, static, one gate, an 8 mm PSF, without noise, background or blood.
    pub fn paper() -> Self {
        let uptake = Uptake { background: 0.0, blood_pool: 0.0, ..Uptake::default() };
        let imaging = Imaging { gates: 1, psf: Psf::gaussian(8.0), noise_seed: None, ..Imaging::default() };
        Self { uptake, imaging, ..Self::of(Shape::Cylinder(Cylinder::default())) }
    }

    /// A stand-in for the paper's "more geometric heart-like" object of 265 501 mm³ (§7.6), which it does not draw: the normal ventricle
    /// enlarged to that volume inside its outer surface, standing still and seen as [`Phantom::paper`] is.
    pub fn heart_like() -> Self {
        let Self { uptake, imaging, .. } = Self::paper();
        Self { uptake, imaging, ..Self::of(Shape::Ventricle(Ventricle::HEART_LIKE)) }
    }

    /// A normal ventricle, EF .60.
    pub fn normal() -> Self {
        Self::of(Shape::Ventricle(Ventricle::NORMAL))
    }

    /// A dilated ventricle, EF .25.
    pub fn dilated() -> Self {
        Self::of(Shape::Ventricle(Ventricle::DILATED))
    }

    /// A small ventricle, EF .80.
    pub fn small() -> Self {
        Self::of(Shape::Ventricle(Ventricle::SMALL))
    }

    /// A normal ventricle with a bent axis.
    pub fn bent() -> Self {
        Self { deformation: Deformation { bend_mm: 9.0, ..Deformation::default() }, ..Self::normal() }
    }

    /// A normal ventricle of oval section that turns from apex to base.
    pub fn twisted() -> Self {
        Self { deformation: Deformation { twist_degrees: 60.0, ovality: 0.25, ..Deformation::default() }, ..Self::normal() }
    }

    /// No ventricle: background and noise.
    pub fn empty() -> Self {
        Self::of(Shape::Empty)
    }

    /// What `ventricle demo` posts: a normal ventricle as a clinic might see it, slightly tilted and oval, its septal wall ending before the
    /// lateral one, with uneven uptake, a right ventricle and noise.
    pub fn demo() -> Self {
        Self {
            pose: Pose { tilt_degrees: [6.0, -4.0], offset_mm: [3.0, -2.0, 0.0], reversed: false },
            deformation: Deformation { bend_mm: 3.0, twist_degrees: 15.0, ovality: 0.06, base_tilt_degrees: 6.0 },
            uptake: Uptake { nonuniformity: 0.15, right_ventricle: 0.25, ..Uptake::default() },
            ..Self::normal()
        }
    }
}
