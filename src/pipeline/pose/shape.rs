//! The shape that is looked for: the mid-wall of a ventricle as part of an ellipsoid of revolution, cut off at the valve plane.

use glam::{DMat3, DVec3};

/// Mid-wall surface of a ventricle. With `z` from the valve plane towards the tip it is widest at `widest * length_mm` and runs from there as
/// half an ellipsoid to the tip; towards the base it follows the same ellipsoid to the valve plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shell {
    /// Where the long axis meets the valve plane, in grid mm.
    pub base_mm: DVec3,
    /// Unit vector from base to apex.
    pub to_apex: DVec3,
    /// Largest radius.
    pub radius_mm: f64,
    /// From valve plane to tip.
    pub length_mm: f64,
    /// Height of the widest section as part of the length.
    pub widest: f64,
}

/// A point as the shell sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// Distance outside the surface (to first order), negative inside, in mm.
    pub outside_mm: f64,
    /// Height over the valve plane towards the tip in mm.
    pub height_mm: f64,
    /// From the axis, in grid axes, in mm.
    pub across: DVec3,
    /// Height over the widest section, as part of the way to the tip.
    pub towards_tip: f64,
}

impl Shell {
    /// The tip.
    pub(super) fn apex_mm(&self) -> DVec3 {
        self.base_mm + self.to_apex * self.length_mm
    }

    /// The middle of the long axis.
    pub(super) fn middle_mm(&self) -> DVec3 {
        self.base_mm + self.to_apex * (self.length_mm / 2.0)
    }

    /// Length over largest radius.
    pub(super) fn elongation(&self) -> f64 {
        self.length_mm / self.radius_mm
    }

    /// A point relative to the surface.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    pub(super) fn place(&self, point_mm: DVec3) -> Place {
        let from_base = point_mm - self.base_mm;
        let height_mm = from_base.dot(self.to_apex);
        let across = from_base - self.to_apex * height_mm;
        let half_length = (1.0 - self.widest) * self.length_mm;
        let over_widest = height_mm - self.widest * self.length_mm;
        let (a2, c2) = (self.radius_mm * self.radius_mm, half_length * half_length);
        let (r2, z2) = (across.length_squared(), over_widest * over_widest);
        // Distance to the ellipsoid k = 1 to first order: (k - 1) over the gradient of k.
        let k = (r2 / a2 + z2 / c2).sqrt();
        let gradient = (r2 / (a2 * a2) + z2 / (c2 * c2)).sqrt();
        let outside_mm = (k - 1.0) * (k + 1e-9) / (gradient + 1e-9);
        Place { outside_mm, height_mm, across, towards_tip: (over_widest / half_length).clamp(-1.0, 1.0) }
    }

    /// Frame whose third axis runs from base to apex.
    pub(super) fn frame(&self) -> DMat3 {
        frame(self.to_apex)
    }
}

/// A right-handed frame with the given third axis.
pub(super) fn frame(third: DVec3) -> DMat3 {
    let (first, second) = third.any_orthonormal_pair();
    DMat3::from_cols(first, second, third)
}

/// Directions spread over the sphere: a cube's faces in `side` x `side` cells, projected. Turning the cube onto itself turns them onto
/// themselves, so that a volume with exchanged or reversed axes is searched in the same directions.
pub(super) fn cube_directions(side: usize) -> Vec<DVec3> {
    let cells = (0..side * side).map(|cell| {
        // Equal angles rather than equal lengths: the corners of the cube are no denser than its faces.
        let along = |index: usize| ((2.0 * (index as f64 + 0.5) / side as f64 - 1.0) * std::f64::consts::FRAC_PI_4).tan();
        (along(cell % side), along(cell / side))
    });
    cells
        .flat_map(|(u, v)| {
            [DVec3::new(1.0, u, v), DVec3::new(u, 1.0, v), DVec3::new(u, v, 1.0)].into_iter().flat_map(|d| [d.normalize(), -d.normalize()])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3Swizzles;

    #[test]
    fn distances_to_the_surface_are_those_of_an_ellipsoid() {
        let base_mm = DVec3::new(10.0, 20.0, 30.0);
        let to_apex = DVec3::new(1.0, -2.0, 0.5).normalize();
        let shell = Shell { base_mm, to_apex, radius_mm: 25.0, length_mm: 66.0, widest: 1.0 / 3.0 };
        let side = to_apex.any_orthonormal_vector();
        // At the tip and at the widest section, 22 mm over the valve plane, the surface is met head on.
        for outside in [-3.0, 0.0, 2.0] {
            let over_tip = shell.place(shell.apex_mm() + to_apex * outside);
            assert!((over_tip.outside_mm - outside).abs() < 1e-6 && (over_tip.height_mm - 66.0 - outside).abs() < 1e-9);
            let beside = shell.place(base_mm + to_apex * 22.0 + side * (25.0 + outside));
            assert!((beside.outside_mm - outside).abs() < 1e-6 && beside.towards_tip.abs() < 1e-9);
        }
        // Half an ellipsoid of 44 mm: at 60 degrees from its widest section.
        let (sine, cosine) = 60.0_f64.to_radians().sin_cos();
        let on = base_mm + to_apex * (22.0 + 44.0 * sine) + side * (25.0 * cosine);
        assert!(shell.place(on).outside_mm.abs() < 1e-6);
    }

    #[test]
    fn directions_go_into_each_other_when_axes_are_exchanged_or_reversed() {
        let directions = cube_directions(6);
        assert_eq!(directions.len(), 216);
        let has = |wanted: DVec3| directions.iter().any(|direction| direction.distance(wanted) < 1e-12);
        for d in &directions {
            assert!((d.length() - 1.0).abs() < 1e-12);
            assert!(has(d.yzx()) && has(d.yxz()) && has(DVec3::new(-d.x, d.y, d.z)));
        }
        let nearest = |d: &DVec3| directions.iter().filter(|other| *other != d).map(|other| other.dot(*d)).fold(-1.0, f64::max);
        assert!(directions.iter().all(|d| nearest(d).acos().to_degrees() < 20.0));
    }
}
