//! The exact surfaces of a gate as fine meshes, to measure distances to.
//!
//! Both are closed: the wall's side from the tip to the valve plane, and a lid in that plane. Rings are close together at the tip, where the
//! surface is most curved. The meshes lie at most 0.05 mm inside the surfaces they stand for (half a chord of 3.5 mm on a radius of
//! 35 mm), a tenth of the smallest distance that is claimed anywhere.

use super::{Phantom, anatomy, anatomy::Scene, cycle, pose::Warp, regional::Borders, shape::Surfaces, solid::Solid};
use crate::mesh::Mesh;
use glam::DVec3;
use std::f64::consts::TAU;

/// Rings from the tip to the valve plane.
const RINGS: usize = 48;
/// Points on a ring.
const AROUND: usize = 72;
/// The same where the wall's parts beat differently.
const AROUND_PARTS: usize = 120;
/// Rings of the lid, from its rim to its middle.
const LID_RINGS: usize = 8;

/// The true surfaces of one gate in grid mm.
#[derive(Debug, Clone)]
pub struct ExactSurfaces {
    /// The border of the cavity, with its lid.
    pub endocardial: Mesh,
    /// The outer border of the wall, with its lid, which covers the wall's end and the cavity's lid.
    pub epicardial: Mesh,
    /// The first vertex of either mesh that lies inside the lid; those before it are the side's, its rim with them.
    pub lid_from: usize,
    /// Uptake half way between both surfaces' vertices at the middle of the gate, as a fraction of a normal wall's. A vertex is the same piece of
    /// the wall on both surfaces and at every gate.
    pub uptake: Vec<f64>,
    /// The tip in the middle of the wall.
    pub mid_wall_tip_mm: DVec3,
    /// Where the long axis meets the valve plane.
    pub base_mm: DVec3,
}

impl Phantom {
    /// The surfaces behind a gate (counted from 0) of the simulated study: those whose cavity has the gate's own (mean) volume. `None` where
    /// there is no ventricle.
    pub fn exact_surfaces(&self, gate: usize) -> Option<ExactSurfaces> {
        let end_diastole = self.shape.surfaces(0.0)?;
        let phases: Vec<f64> = cycle::gate_phases(gate, self.imaging.gates, self.imaging.motion_samples).collect();
        let borders = Borders::mean_of(self, &phases)?;
        let Surfaces { endocardium, epicardium } = borders.surfaces;
        let warp = Warp::new(self.deformation, end_diastole.epicardium.base_w_mm());
        let (rotation, centre) = (self.pose.rotation(), anatomy::centre_mm(&self.imaging.grid, &self.pose));
        let last_slice_mm = (self.imaging.grid.shape[0] - 1) as f64 * self.imaging.grid.spacing_mm[0];
        let place = |canonical: DVec3| {
            let point = centre + rotation * warp.apply(canonical);
            if self.pose.reversed { DVec3::new(point.x, point.y, last_slice_mm - point.z) } else { point }
        };
        let on_axis = |w: f64| place(DVec3::new(0.0, 0.0, w));
        let around = if self.regional.is_empty() { AROUND } else { AROUND_PARTS };
        let inner = points(&endocardium, around, |angle, w| borders.inner_squared_mm2(|| angle, w));
        let outer = points(&epicardium, around, |angle, w| borders.outer_squared_mm2(|| angle, w));
        let scene = Scene::at_phase(self, (gate as f64 + 0.5) / self.imaging.gates as f64);
        Some(ExactSurfaces {
            uptake: inner.iter().zip(&outer).map(|(a, b)| scene.wall_uptake((*a + *b) / 2.0)).collect(),
            endocardial: closed(inner.into_iter().map(place).collect(), around, self.pose.reversed),
            epicardial: closed(outer.into_iter().map(place).collect(), around, self.pose.reversed),
            lid_from: 1 + RINGS * around,
            mid_wall_tip_mm: on_axis(f64::midpoint(endocardium.tip_w_mm(), epicardium.tip_w_mm())),
            base_mm: on_axis(epicardium.base_w_mm()),
        })
    }
}

/// A surface's points in canonical coordinates: the tip, rings to the valve plane, rings of the lid, its middle.
fn points(solid: &Solid, around: usize, radius_squared_mm2: impl Fn(f64, f64) -> f64) -> Vec<DVec3> {
    let (tip, base) = (solid.tip_w_mm(), solid.base_w_mm());
    let mut positions = vec![DVec3::new(0.0, 0.0, tip)];
    let mut ring = |part: f64, w: f64| {
        for step in 0..around {
            let angle = TAU * step as f64 / around as f64;
            // Just below the valve plane, where the profile still has its radius.
            let radius = part * radius_squared_mm2(angle, w.min(base - 1e-9)).max(0.0).sqrt();
            let (sine, cosine) = angle.sin_cos();
            positions.push(DVec3::new(radius * cosine, radius * sine, w));
        }
    };
    for step in 1..=RINGS {
        // Squares: the profile is a parabola at the tip, so that radii grow evenly there.
        ring(1.0, tip + (base - tip) * (step as f64 / RINGS as f64).powi(2));
    }
    for step in (1..LID_RINGS).rev() {
        ring(step as f64 / LID_RINGS as f64, base);
    }
    positions.push(DVec3::new(0.0, 0.0, base));
    positions
}

/// The closed mesh through these points.
fn closed(positions: Vec<DVec3>, around: usize, mirrored: bool) -> Mesh {
    let rings = RINGS + LID_RINGS - 1;
    let at = |ring: usize, step: usize| (1 + ring * around + step % around) as u32;
    let middle = positions.len() as u32 - 1;
    let mut triangles: Vec<[u32; 3]> = (0..around).map(|step| [0, at(0, step + 1), at(0, step)]).collect();
    for low in 0..rings - 1 {
        for step in 0..around {
            let (a, b, c, d) = (at(low, step), at(low, step + 1), at(low + 1, step), at(low + 1, step + 1));
            triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    triangles.extend((0..around).map(|step| [middle, at(rings - 1, step), at(rings - 1, step + 1)]));
    if mirrored {
        for triangle in &mut triangles {
            triangle.swap(1, 2);
        }
    }
    Mesh { positions, triangles: triangles.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::{Imaging, simulate};

    #[test]
    fn the_meshes_are_closed_and_have_the_exact_volumes() {
        let mut reversed = Phantom::demo();
        reversed.pose.reversed = true;
        let moving = Phantom { imaging: Imaging { motion_samples: 4, ..Imaging::default() }, ..Phantom::small() };
        for phantom in [Phantom::paper(), Phantom::twisted(), Phantom::dilated(), Phantom::demo(), reversed, moving] {
            let truth = simulate(&phantom).unwrap().truth;
            for (gate, exact) in truth.gates.iter().enumerate() {
                let surfaces = phantom.exact_surfaces(gate).unwrap();
                for (mesh, ml) in [(&surfaces.endocardial, exact.endocardial_ml), (&surfaces.epicardial, exact.epicardial_ml)] {
                    assert!(mesh.is_closed());
                    // Inscribed polygons of 72 sides hold 0.13 % less than their circles.
                    let off = mesh.volume_ml() / ml - 1.0;
                    assert!((-0.004..0.0).contains(&off), "{off}");
                }
                let base = exact.base_mm.unwrap();
                if phantom.imaging.motion_samples == 1 {
                    assert!(surfaces.base_mm.distance(DVec3::from_array(base)) < 1e-9);
                }
            }
        }
        assert!(Phantom::empty().exact_surfaces(0).is_none());
    }

    #[test]
    fn the_lid_lies_in_the_valve_plane() {
        let surfaces = Phantom::normal().exact_surfaces(0).unwrap();
        for mesh in [&surfaces.endocardial, &surfaces.epicardial] {
            assert!(mesh.positions[surfaces.lid_from..].iter().all(|point| (point.z - surfaces.base_mm.z).abs() < 1e-9));
            assert!(mesh.positions[surfaces.lid_from - AROUND - 1].z < surfaces.base_mm.z - 1.0);
        }
    }
}
