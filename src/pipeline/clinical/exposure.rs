//! What a camera would count of a wall of given shape and uptake, and how that changes with every parameter.
//!
//! The image is the blurred activity `I = G ∗ [b + (A·α − b)·1_wall + (c − b)·1_cavity]` with background b, wall activity A, its map α
//! and blood c (`numerics.md`, clinical preset). Nothing is rasterised: wall, cavity, both surfaces and the valve plane are integrated by
//! Gauss-Legendre and trapezoid rules in bullet coordinates, each node a Gaussian whose variance a voxel's box is added to. Nodes closer
//! than 1.5 standard deviations integrate a blurred shape to a few parts in ten thousand, so image and derivatives are smooth functions of
//! the parameters, and derivatives by the radius of a surface are surface integrals.

use super::{
    basis::{Angle, HARMONICS, MAP_HARMONICS, MAP_WHOLE, SPLINES, Spot},
    quadrature::gauss_legendre,
    shape::{BASE, LOCAL, SLOPE_AT_MM, STRIDE, SURFACES, Shape, Space, THICKNESS_HARMONICS},
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
/// Columns of a Jacobian with and without the map, filled up to whole groups of eight.
pub(super) const COLUMNS: usize = MAP + UPTAKE;
pub(super) const COLUMNS_WITHOUT_MAP: usize = MAP;

/// A Gaussian is cut off at this many standard deviations: 4 ‰ of it lie beyond on each side of an axis, where the wall is thin.
const REACH: f64 = 3.2;
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

/// An image and, if asked for, its derivatives.
pub(super) struct Exposure {
    /// `[voxels]`.
    pub(super) image: Vec<f32>,
    /// `[voxels × columns]`, empty if not asked for.
    pub(super) jacobian: Vec<f32>,
}

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Want {
    Image,
    /// Derivatives by the first so many columns.
    Derivatives(usize),
}

/// The image of a gate for a point-spread function of `sigma_mm`, integrated by rules that were made for about this shape and width: the same
/// rules make it a smooth function of both.
pub(super) fn expose(crop: &Crop, space: &Space, shape: &Shape, activity: &Activity, sigma_mm: f64, rules: &Rules, want: Want) -> Exposure {
    let columns = match want {
        Want::Image => 0,
        Want::Derivatives(columns) => columns,
    };
    let mut camera = Camera::new(crop, sigma_mm, columns);
    let scene = Scene { space, shape, activity };
    scene.show(&mut camera, rules);
    camera.finish(activity)
}

/// Nodes and what they carry.
struct Scene<'a> {
    space: &'a Space,
    shape: &'a Shape,
    activity: &'a Activity,
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
    fn show(&self, camera: &mut Camera<'_>, rules: &Rules) {
        let frame = &self.space.frame;
        let around = TAU / rules.angles.len() as f64;
        for &(at, weight) in &rules.cap {
            let s = at * FRAC_PI_2;
            for angle in &rules.angles {
                self.cap_node(camera, rules, s, angle, weight * FRAC_PI_2 * around);
            }
            camera.end_ring(&self.space.basis.splines(s), self.activity.wall);
        }
        for &(at, weight) in &rules.cylinder {
            for angle in &rules.angles {
                self.cylinder_node(camera, rules, at, angle, weight * around);
            }
            camera.end_ring(&self.space.basis.splines(frame.s_of_height(at * self.shape.base_mm())), self.activity.wall);
        }
        if camera.columns > 0 {
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
            camera.plane(point_mm, rise);
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
        if camera.columns == 0 {
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
        camera.volume(point_mm, carried);
    }

    fn cavity(&self, camera: &mut Camera<'_>, point_mm: DVec3, volume: f64) {
        camera.cavity(point_mm, [volume as f32, ((self.activity.blood - self.activity.background) * volume) as f32]);
    }

    /// A piece of a surface: what a mm of its radius adds, by the harmonics of mid-wall radius and thickness.
    fn border(&self, camera: &mut Camera<'_>, surface: Surface, point_mm: DVec3, spot: &Spot, uptake: f64, area: f64) {
        if camera.columns == 0 {
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
        camera.surface(point_mm, carried);
    }
}

/// One axis of a Gaussian on the crop's voxels.
#[derive(Clone, Copy)]
struct AxisBlur {
    spacing_mm: f64,
    origin_mm: f64,
    voxels: usize,
    /// Of point-spread function and voxel box together.
    sigma_mm: f64,
}

/// Standard deviation of point-spread function and voxel box together. The box has variance h²/12; its shape beyond that is lost in the blur
/// (kurtosis 1.03 of 3 at the paper's grid).
fn with_box(sigma_mm: f64, spacing_mm: f64) -> f64 {
    (sigma_mm * sigma_mm + spacing_mm * spacing_mm / 12.0).sqrt()
}

/// Most voxels a cut-off Gaussian reaches along an axis; grids finer than that are cut shorter.
const WIDEST: usize = 64;

impl AxisBlur {
    /// Fills the values of a unit Gaussian at the voxels it reaches; returns the first and how many.
    fn fill(&self, at_mm: f64, values: &mut [f32; WIDEST]) -> (usize, usize) {
        let at = (at_mm - self.origin_mm) / self.spacing_mm;
        let reach = (REACH * self.sigma_mm / self.spacing_mm).min((WIDEST / 2 - 1) as f64);
        let last = (self.voxels - 1) as f64;
        let (low, high) = ((at - reach).ceil().max(0.0), (at + reach).floor().min(last));
        if low > high {
            return (0, 0);
        }
        let count = (high - low) as usize + 1;
        let step = self.spacing_mm / self.sigma_mm;
        let start = (low - at) * step;
        let scale = 1.0 / (self.sigma_mm * TAU.sqrt());
        // exp(−(x + k·h)²/2) by two multiplications a voxel.
        let mut value = scale * (-0.5 * start * start).exp();
        let mut ratio = (-start * step - 0.5 * step * step).exp();
        let fall = (-step * step).exp();
        for slot in &mut values[..count] {
            *slot = value as f32;
            value *= ratio;
            ratio *= fall;
        }
        (low as usize, count)
    }
}

/// Collects nodes into voxels.
struct Camera<'a> {
    crop: &'a Crop,
    axes: [AxisBlur; 3],
    columns: usize,
    image: Vec<f32>,
    jacobian: Vec<f32>,
    /// Of the ring at hand, `[voxels]`: surface harmonics; wall harmonics and uptake.
    of_surface: Vec<[f32; STRIDE]>,
    of_wall: Vec<[f32; LANES]>,
    /// Of all rings, `[voxels]`: wall with uptake, wall, cavity.
    lit: Vec<f32>,
    wall: Vec<f32>,
    cavity: Vec<f32>,
    /// Voxels the ring at hand has reached, `[low, end]` along `[z, y, x]`.
    touched: [[usize; 2]; 3],
}

impl<'a> Camera<'a> {
    fn new(crop: &'a Crop, sigma_mm: f64, columns: usize) -> Self {
        let axes: [AxisBlur; 3] = std::array::from_fn(|axis| {
            let spacing_mm = crop.spacing_mm[axis];
            AxisBlur { spacing_mm, origin_mm: crop.origin_mm[axis], voxels: crop.shape[axis], sigma_mm: with_box(sigma_mm, spacing_mm) }
        });
        let voxels = crop.voxels();
        let derived = if columns > 0 { voxels } else { 0 };
        Self {
            crop,
            axes,
            columns,
            image: vec![0.0; voxels],
            jacobian: vec![0.0; derived * columns],
            of_surface: vec![[0.0; STRIDE]; derived],
            of_wall: vec![[0.0; LANES]; derived],
            lit: vec![0.0; derived],
            wall: vec![0.0; derived],
            cavity: vec![0.0; derived],
            touched: [[usize::MAX, 0]; 3],
        }
    }

    /// Calls `each(first voxel of a row, weight of the row, values along x)` for the rows a Gaussian at a point reaches.
    fn rows(&mut self, point_mm: DVec3, mut each: impl FnMut(&mut Self, usize, f32, &[f32])) {
        let mut values = [[0.0_f32; WIDEST]; 3];
        let mut spans = [(0, 0); 3];
        for (axis, at_mm) in [point_mm.z, point_mm.y, point_mm.x].into_iter().enumerate() {
            spans[axis] = self.axes[axis].fill(at_mm, &mut values[axis]);
            if spans[axis].1 == 0 {
                return;
            }
        }
        for (touched, (first, count)) in self.touched.iter_mut().zip(spans) {
            *touched = [touched[0].min(first), touched[1].max(first + count)];
        }
        let [_, ny, nx] = self.crop.shape;
        let [(z0, nz_), (y0, ny_), (x0, nx_)] = spans;
        for z in 0..nz_ {
            for y in 0..ny_ {
                let weight = values[0][z] * values[1][y];
                let start = ((z0 + z) * ny + y0 + y) * nx + x0;
                each(self, start, weight, &values[2][..nx_]);
            }
        }
    }

    fn excess(&mut self, point_mm: DVec3, excess: f32) {
        self.rows(point_mm, |camera, start, weight, along| {
            for (voxel, value) in camera.image[start..].iter_mut().zip(along) {
                *voxel += weight * excess * value;
            }
        });
    }

    fn volume(&mut self, point_mm: DVec3, carried: [f32; LANES]) {
        self.rows(point_mm, |camera, start, weight, along| {
            for (lanes, value) in camera.of_wall[start..].iter_mut().zip(along) {
                let weight = weight * value;
                for (to, what) in lanes.iter_mut().zip(carried) {
                    *to += weight * what;
                }
            }
        });
    }

    fn cavity(&mut self, point_mm: DVec3, [volume, excess]: [f32; 2]) {
        let derived = self.columns > 0;
        self.rows(point_mm, |camera, start, weight, along| {
            for (voxel, value) in camera.image[start..].iter_mut().zip(along) {
                *voxel += weight * excess * value;
            }
            if derived {
                for (voxel, value) in camera.cavity[start..].iter_mut().zip(along) {
                    *voxel += weight * volume * value;
                }
            }
        });
    }

    fn surface(&mut self, point_mm: DVec3, carried: [f32; STRIDE]) {
        self.rows(point_mm, |camera, start, weight, along| {
            for (eight, value) in camera.of_surface[start..].iter_mut().zip(along) {
                let weight = weight * value;
                for (to, what) in eight.iter_mut().zip(carried) {
                    *to += weight * what;
                }
            }
        });
    }

    fn plane(&mut self, point_mm: DVec3, carried: [f32; 3]) {
        let columns = self.columns;
        self.rows(point_mm, |camera, start, weight, along| {
            for (voxel, value) in along.iter().enumerate() {
                let row = &mut camera.jacobian[(start + voxel) * columns + BASE..][..3];
                for (to, what) in row.iter_mut().zip(carried) {
                    *to += weight * value * what;
                }
            }
        });
    }

    /// Hands what a ring collected to the columns of its splines.
    fn end_ring(&mut self, (first, splines): &(usize, [f64; 4]), activity: f64) {
        if self.columns == 0 {
            return;
        }
        let [_, ny, nx] = self.crop.shape;
        let [[z0, z1], [y0, y1], [x0, x1]] = self.touched;
        self.touched = [[usize::MAX, 0]; 3];
        let (splines, activity) = (splines.map(|value| value as f32), activity as f32);
        let mapped = self.columns > MAP;
        for z in z0..z1 {
            for y in y0..y1 {
                let start = (z * ny + y) * nx;
                for voxel in start + x0..start + x1 {
                    let row = &mut self.jacobian[voxel * self.columns..][..self.columns];
                    let surface = std::mem::replace(&mut self.of_surface[voxel], [0.0; STRIDE]);
                    let wall = std::mem::replace(&mut self.of_wall[voxel], [0.0; LANES]);
                    let (strides, _) = row[first * STRIDE..].as_chunks_mut::<STRIDE>();
                    for (to, spline) in strides.iter_mut().zip(splines) {
                        add_scaled(to, &surface, spline);
                    }
                    if mapped {
                        let (strides, _) = row[MAP + first * MAP_HARMONICS..].as_chunks_mut::<MAP_HARMONICS>();
                        for (to, spline) in strides.iter_mut().zip(splines) {
                            add_scaled(to, &harmonics_of(&wall), spline * activity);
                        }
                    }
                    self.lit[voxel] += wall[LIT];
                    self.wall[voxel] += wall[0];
                }
            }
        }
    }

    fn finish(mut self, activity: &Activity) -> Exposure {
        let (bright, background) = (activity.wall as f32, activity.background as f32);
        for voxel in &mut self.image {
            *voxel += background;
        }
        if self.columns > 0 {
            let occupied = self.lit.iter().zip(&self.wall).zip(&self.cavity);
            let rows = self.jacobian.chunks_exact_mut(self.columns).zip(&mut self.image);
            for ((row, voxel), ((lit, wall), cavity)) in rows.zip(occupied) {
                *voxel += bright * lit - background * wall;
                row[ACTIVITY] = *lit;
                row[BLOOD] = *cavity;
                row[BACKGROUND] = 1.0 - wall - cavity;
            }
        }
        Exposure { image: self.image, jacobian: self.jacobian }
    }
}

fn add_scaled<const N: usize>(to: &mut [f32; N], what: &[f32; N], by: f32) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += by * what;
    }
}

/// What a node of the wall carries but for its uptake.
fn harmonics_of(wall: &[f32; LANES]) -> [f32; MAP_HARMONICS] {
    std::array::from_fn(|h| wall[h])
}

/// Of the values a node of the wall carries, the one that its uptake is in; the harmonics of the map come before.
const LIT: usize = MAP_HARMONICS;
const LANES: usize = MAP_HARMONICS + 1;

const _: () = assert!(STRIDE == 8 && LANES == 12 && SURFACES == SPLINES * STRIDE);
