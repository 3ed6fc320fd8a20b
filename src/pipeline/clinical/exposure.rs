//! What a camera would count of a wall of given shape and uptake, and how that changes with every parameter.
//!
//! The image is the blurred activity `I = G ∗ [b + (A·α − b)·1_wall + (c − b)·1_cavity]` with background b, wall activity A, its map α
//! and blood c (`numerics.md`, clinical preset). Nothing is rasterised: wall, cavity, both surfaces and the valve plane are integrated by
//! Gauss-Legendre and trapezoid rules in bullet coordinates, each node a Gaussian whose variance a voxel's box is added to. Nodes closer
//! than 1.5 standard deviations integrate a blurred shape to a few parts in ten thousand, so image and derivatives are smooth functions of
//! the parameters, and derivatives by the radius of a surface are surface integrals.

use super::{
    basis::{Angle, HARMONICS, MAP_HARMONICS, MAP_WHOLE, SPLINES, Spot},
    camera::{Camera, with_box},
    film::{Derived, Film, LANES, LIT},
    quadrature::gauss_legendre,
    shape::{LOCAL, SLOPE_AT_MM, STRIDE, Shape, Space, THICKNESS_HARMONICS},
};
use crate::pipeline::Surface;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Coefficients of the uptake map.
pub(super) const UPTAKE: usize = SPLINES * MAP_HARMONICS;
/// Columns of the parameters all gates share: wall activity, blood, background, then the uptake map.
pub(super) const ACTIVITY: usize = LOCAL;
pub(super) const BLOOD: usize = LOCAL + 1;
pub(super) const BACKGROUND: usize = LOCAL + 2;
pub(super) const MAP: usize = LOCAL + 3;
/// Columns of a Jacobian with and without the map, which has [`LANES`] columns a spline: its harmonics, and one that says nothing.
pub(super) const COLUMNS: usize = MAP + SPLINES * LANES;
pub(super) const COLUMNS_WITHOUT_MAP: usize = MAP;

/// Distance of nodes in standard deviations: around the axis, where the rule is the trapezoid one, and along it.
const STEP_AROUND: f64 = 1.5;
const STEP_ALONG: f64 = 1.2;
/// Least activity of a part of the wall against the whole's: none is negative.
const LEAST_UPTAKE: f64 = 0.02;

/// What takes up how much.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Activity {
    pub(super) wall: f64,
    pub(super) blood: f64,
    pub(super) background: f64,
    /// Uptake map as coefficients of α − 1, `[UPTAKE]`.
    pub(super) map: Vec<f64>,
}

/// A box of voxels, or of bins of voxels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crop {
    /// Centre of the first along `[z, y, x]` in grid mm.
    pub(super) origin_mm: [f64; 3],
    pub(super) spacing_mm: [f64; 3],
    pub(super) shape: [usize; 3],
}

impl Crop {
    pub(super) fn voxels(&self) -> usize {
        self.shape.iter().product()
    }

    /// Centres in grid mm in memory order.
    pub(super) fn centres_mm(&self) -> impl Iterator<Item = DVec3> + '_ {
        let [nz, ny, nx] = self.shape;
        let at = |axis: usize, index: usize| self.origin_mm[axis] + self.spacing_mm[axis] * index as f64;
        (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| DVec3::new(at(2, x), at(1, y), at(0, z)))))
    }
}

/// Nodes and what they carry.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) space: &'a Space,
    pub(super) shape: &'a Shape,
    pub(super) activity: &'a Activity,
    /// Of the point-spread function.
    pub(super) sigma_mm: f64,
}

/// How finely a scene is integrated.
#[derive(Debug, Clone)]
pub(super) struct Rules {
    angles: Vec<Angle>,
    cap: Vec<(f64, f64)>,
    cylinder: Vec<(f64, f64)>,
    layers: Vec<(f64, f64)>,
    depths: Vec<(f64, f64)>,
}

impl Rules {
    /// For shapes like this one, blurred this much.
    pub(super) fn of(shape: &Shape, space: &Space, crop: &Crop, sigma_mm: f64) -> Self {
        let sigma = crop.spacing_mm.iter().map(|spacing| with_box(sigma_mm, *spacing)).fold(f64::INFINITY, f64::min);
        let frame = &space.frame;
        let spots: Vec<Spot> = (0..8).map(|k| space.basis.at(0.3 * f64::from(k), &Angle::new(0.0))).collect();
        let widest = spots.iter().map(|spot| shape.radii(spot).epicardial).fold(20.0, f64::max);
        let thickest = spots.iter().map(|spot| shape.thickness_mm(spot)).fold(8.0, f64::max);
        let points = (2.0 * (0.5 * TAU * widest / (STEP_AROUND * sigma)).ceil()).max(12.0) as usize;
        let cap_mm = FRAC_PI_2 * f64::midpoint(frame.apex_mm, frame.unit_mm) + 8.0;
        let count = |length_mm: f64, step: f64, most: usize| ((length_mm / (step * sigma)).ceil() as usize + 1).clamp(3, most);
        Self {
            angles: Angle::around(points).collect(),
            cap: gauss_legendre(count(cap_mm, STEP_ALONG, 40)),
            cylinder: gauss_legendre(count(shape.base_mm(), STEP_ALONG, 40)),
            layers: gauss_legendre(count(thickest, 1.4, 8)),
            depths: gauss_legendre(count(widest, 1.6, 12)),
        }
    }
}

impl Scene<'_> {
    /// The image, and its derivatives where voxels are given for them, by rules that were made for about this shape and width: the same rules
    /// make it a smooth function of both.
    pub(super) fn expose(&self, crop: &Crop, rules: &Rules, derived: Option<Derived<'_>>, film: &mut Film) {
        let mut camera = Camera::load(crop, self.sigma_mm, derived, film);
        self.show(&mut camera, rules);
        camera.finish(self.activity);
    }

    fn show(&self, camera: &mut Camera<'_>, rules: &Rules) {
        let frame = &self.space.frame;
        let around = TAU / rules.angles.len() as f64;
        for &(at, weight) in &rules.cap {
            let s = at * FRAC_PI_2;
            for angle in &rules.angles {
                self.cap_node(camera, rules, s, angle, weight * FRAC_PI_2 * around);
            }
            camera.end_ring(&self.space.basis.splines(s));
        }
        for &(at, weight) in &rules.cylinder {
            for angle in &rules.angles {
                self.cylinder_node(camera, rules, at, angle, weight * around);
            }
            camera.end_ring(&self.space.basis.splines(frame.s_of_height(at * self.shape.base_mm())));
        }
        if camera.derives() {
            for angle in &rules.angles {
                self.base_node(camera, rules, angle, around);
            }
        }
    }

    /// Relative uptake.
    fn uptake(&self, spot: &Spot) -> f64 {
        (1.0 + spot.value(&self.activity.map, MAP_WHOLE)).max(LEAST_UPTAKE)
    }

    fn cap_node(&self, camera: &mut Camera<'_>, rules: &Rules, s: f64, angle: &Angle, ring: f64) {
        let spot = self.space.basis.at(s, angle);
        let radii = self.shape.radii(&spot);
        let area = ring * s.sin();
        let uptake = self.uptake(&spot);
        let (inner, outer) = (radii.endocardial, radii.epicardial);
        let unit = self.space.frame.point(s, angle, 1.0) - self.space.frame.centre_mm;
        let at = |r: f64| self.space.frame.centre_mm + unit * r;
        for &(part, weight) in &rules.layers {
            let r = inner + (outer - inner) * part;
            self.wall(camera, at(r), &spot, uptake, area * weight * (outer - inner) * r * r);
        }
        for &(part, weight) in &rules.depths {
            let r = inner * part;
            self.cavity(camera, at(r), area * weight * inner * r * r);
        }
        self.border(camera, Surface::Endocardial, at(inner), &spot, uptake, area * inner * inner);
        self.border(camera, Surface::Epicardial, at(outer), &spot, uptake, area * outer * outer);
    }

    fn cylinder_node(&self, camera: &mut Camera<'_>, rules: &Rules, part_up: f64, angle: &Angle, ring: f64) {
        let (base_mm, slope) = (self.shape.base_mm(), self.shape.base_slope(angle));
        let (inner, low, spot_inner) = self.shape.in_cylinder(self.space, Surface::Endocardial, part_up, angle);
        let (outer, high, spot_outer) = self.shape.in_cylinder(self.space, Surface::Epicardial, part_up, angle);
        let height = |r: f64| part_up * (base_mm + slope * r);
        let middle = self.space.basis.at(self.space.frame.s_of_height(height(f64::midpoint(inner, outer))), angle);
        let uptake = self.uptake(&middle);
        let column = |r: f64| ring * r * (base_mm + slope * r);
        let at = |height: f64, r: f64| self.space.frame.point_at_height(height, angle, r);
        for &(part, weight) in &rules.layers {
            let r = inner + (outer - inner) * part;
            self.wall(camera, at(height(r), r), &middle, uptake, column(r) * weight * (outer - inner));
        }
        for &(part, weight) in &rules.depths {
            let r = inner * part;
            self.cavity(camera, at(height(r), r), column(r) * weight * inner);
        }
        self.border(camera, Surface::Endocardial, at(low, inner), &spot_inner, uptake, column(inner));
        self.border(camera, Surface::Epicardial, at(high, outer), &spot_outer, uptake, column(outer));
    }

    /// The valve plane at an angle: what a mm more of ventricle adds.
    fn base_node(&self, camera: &mut Camera<'_>, rules: &Rules, angle: &Angle, ring: f64) {
        let (base_mm, slope) = (self.shape.base_mm(), self.shape.base_slope(angle));
        let (inner, _, _) = self.shape.in_cylinder(self.space, Surface::Endocardial, 1.0, angle);
        let (outer, _, spot) = self.shape.in_cylinder(self.space, Surface::Epicardial, 1.0, angle);
        let uptake = self.uptake(&spot);
        let mut disc = |r: f64, area: f64, excess: f64| {
            let point_mm = self.space.frame.point_at_height(base_mm + slope * r, angle, r);
            let rise = [1.0, r * angle.cos / SLOPE_AT_MM, r * angle.sin / SLOPE_AT_MM].map(|by| (by * excess * area) as f32);
            camera.plane(point_mm, &rise);
        };
        for &(part, weight) in &rules.layers {
            let r = inner + (outer - inner) * part;
            disc(r, ring * r * weight * (outer - inner), self.activity.wall * uptake - self.activity.background);
        }
        for &(part, weight) in &rules.depths {
            let r = inner * part;
            disc(r, ring * r * weight * inner, self.activity.blood - self.activity.background);
        }
    }

    fn wall(&self, camera: &mut Camera<'_>, point_mm: DVec3, spot: &Spot, uptake: f64, volume: f64) {
        if !camera.derives() {
            return camera.excess(point_mm, ((self.activity.wall * uptake - self.activity.background) * volume) as f32);
        }
        let mut carried = [0.0_f32; LANES];
        carried[0] = volume as f32;
        // At its lower limit the map changes nothing.
        if uptake > LEAST_UPTAKE {
            for (to, h) in carried[1..].iter_mut().zip(&spot.harmonics[1..]) {
                *to = (h * volume) as f32;
            }
        }
        carried[LIT] = (uptake * volume) as f32;
        camera.wall(point_mm, &carried);
    }

    fn cavity(&self, camera: &mut Camera<'_>, point_mm: DVec3, volume: f64) {
        camera.cavity(point_mm, volume as f32, ((self.activity.blood - self.activity.background) * volume) as f32);
    }

    /// A piece of a surface: what a mm of its radius adds, by the harmonics of mid-wall radius and thickness.
    fn border(&self, camera: &mut Camera<'_>, surface: Surface, point_mm: DVec3, spot: &Spot, uptake: f64, area: f64) {
        if !camera.derives() {
            return;
        }
        let (excess, side) = match surface {
            Surface::Endocardial => (self.activity.blood - self.activity.wall * uptake, -0.5),
            Surface::Epicardial => (self.activity.wall * uptake - self.activity.background, 0.5),
        };
        let mut carried = [0.0_f32; STRIDE];
        for (h, value) in spot.harmonics.iter().take(HARMONICS).enumerate() {
            let by = value * excess * area;
            carried[h] = by as f32;
            if h < THICKNESS_HARMONICS {
                carried[HARMONICS + h] = (side * by) as f32;
            }
        }
        camera.surface(point_mm, &carried);
    }
}
