//! The wall of one gate: a mid-wall surface, a thickness about it, and a plane at the valves.

use super::{
    basis::{Angle, Basis, HARMONICS, SPLINES, Spot},
    frame::Frame,
    quadrature::gauss_legendre,
};
use crate::pipeline::{PerSurface, Surface};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Harmonics of the thickness: round and shifted.
pub(super) const THICKNESS_HARMONICS: usize = 3;
/// Coefficients a spline: mid-wall radius, then thickness.
pub(super) const STRIDE: usize = HARMONICS + THICKNESS_HARMONICS;
/// Coefficients of both surfaces.
pub(super) const SURFACES: usize = SPLINES * STRIDE;
/// Parameters of a gate: surfaces, height of the valve plane, its slope along x and y.
pub(super) const LOCAL: usize = SURFACES + 3;
/// Where the height of the valve plane stands among them; its slopes follow.
pub(super) const BASE: usize = SURFACES;
/// Slopes of the valve plane are told in mm at this distance from the axis: about the mid-wall.
pub(super) const SLOPE_AT_MM: f64 = 30.0;
/// Thinnest wall and narrowest cavity of the model in mm: below them the surfaces would cross.
const THINNEST_MM: f64 = 1.0;
const NARROWEST_MM: f64 = 0.5;

const MID: (usize, usize, usize) = (STRIDE, 0, HARMONICS);
const THICKNESS: (usize, usize, usize) = (STRIDE, HARMONICS, THICKNESS_HARMONICS);

/// The parameters of a gate's wall, `[f64; LOCAL]` in mm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shape {
    pub(super) values: Vec<f64>,
}

/// The model's coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Space {
    pub(super) frame: Frame,
    pub(super) basis: Basis,
}

/// Radii of both surfaces at a place.
pub(super) type Radii = PerSurface<f64>;

impl Shape {
    pub(super) fn mid_mm(&self, spot: &Spot) -> f64 {
        spot.value(&self.values[..SURFACES], MID)
    }

    pub(super) fn thickness_mm(&self, spot: &Spot) -> f64 {
        spot.value(&self.values[..SURFACES], THICKNESS).max(THINNEST_MM)
    }

    pub(super) fn radii(&self, spot: &Spot) -> Radii {
        let (mid, half) = (self.mid_mm(spot), self.thickness_mm(spot) / 2.0);
        let endocardial = (mid - half).max(NARROWEST_MM);
        PerSurface { endocardial, epicardial: (mid + half).max(endocardial + THINNEST_MM) }
    }

    pub(super) fn base_mm(&self) -> f64 {
        self.values[BASE]
    }

    /// Rise of the valve plane a mm away from the axis.
    pub(super) fn base_slope(&self, angle: &Angle) -> f64 {
        (self.values[BASE + 1] * angle.cos + self.values[BASE + 2] * angle.sin) / SLOPE_AT_MM
    }

    /// A surface at the part `part` of the way from the centre's height to the valve plane: its radius and height, which depend on each
    /// other where the plane is tilted, and the place.
    pub(super) fn in_cylinder(&self, space: &Space, surface: Surface, part: f64, angle: &Angle) -> (f64, f64, Spot) {
        let slope = self.base_slope(angle);
        let at = |height: f64| space.basis.at(space.frame.s_of_height(height), angle);
        let mut height = part * self.base_mm();
        let mut spot = at(height);
        let mut radius = *self.radii(&spot).get(surface);
        // The wall leans by less than the plane rises: each pass gains a digit.
        for _ in 0..2 {
            height = part * (self.base_mm() + slope * radius);
            spot = at(height);
            radius = *self.radii(&spot).get(surface);
        }
        (radius, height, spot)
    }
}

/// Volume inside both surfaces up to the valve plane in ml, and its derivative by every parameter of the gate.
pub(super) struct Volumes {
    pub(super) ml: PerSurface<f64>,
    pub(super) gradient: PerSurface<Vec<f64>>,
}

/// Rings of the volume's quadrature in the cap and in the cylinder, and points a ring: 24 × 16 integrate an ellipsoid to 1e-5. A radius has
/// harmonics up to the second, so what is integrated about the axis has them up to the seventh: 16 points are exact.
const RINGS: usize = 24;
const POINTS: usize = 16;

impl Volumes {
    pub(super) fn of(shape: &Shape, space: &Space) -> Self {
        let mut gradient = PerSurface::of(|_| vec![0.0; LOCAL]);
        let endocardial = inside(shape, space, Surface::Endocardial, Some(&mut gradient.endocardial));
        let epicardial = inside(shape, space, Surface::Epicardial, Some(&mut gradient.epicardial));
        Self { ml: PerSurface { endocardial, epicardial }, gradient }
    }

    /// The cavity alone in ml.
    pub(super) fn cavity_ml(shape: &Shape, space: &Space) -> f64 {
        inside(shape, space, Surface::Endocardial, None)
    }

    pub(super) fn wall_ml(&self) -> f64 {
        self.ml.epicardial - self.ml.endocardial
    }

    pub(super) fn wall_gradient(&self) -> Vec<f64> {
        self.gradient.epicardial.iter().zip(&self.gradient.endocardial).map(|(outer, inner)| outer - inner).collect()
    }
}

/// Volume inside a surface in ml; adds what a mm of every parameter changes to a gradient if there is one.
fn inside(shape: &Shape, space: &Space, surface: Surface, mut gradient: Option<&mut Vec<f64>>) -> f64 {
    let nodes = gauss_legendre(RINGS);
    let around = TAU / POINTS as f64;
    let mut ml = 0.0;
    for angle in Angle::around(POINTS) {
        let mut add = |volume: f64, a_mm: f64, spot: &Spot| {
            ml += volume;
            if let Some(gradient) = &mut gradient {
                for (index, weight) in radius_derivative(surface, spot) {
                    gradient[index] += a_mm * weight;
                }
            }
        };
        for &(at, weight) in &nodes {
            let s = at * FRAC_PI_2;
            let spot = space.basis.at(s, &angle);
            let r = *shape.radii(&spot).get(surface);
            let area = weight * FRAC_PI_2 * around * s.sin() * r * r / 1000.0;
            add(area * r / 3.0, area, &spot);
        }
        let slope = shape.base_slope(&angle);
        for &(at, weight) in &nodes {
            let (r, _, spot) = shape.in_cylinder(space, surface, at, &angle);
            let scale = weight * around / 1000.0;
            let volume = scale * (shape.base_mm() * r * r / 2.0 + slope * r * r * r / 3.0);
            add(volume, scale * r * (shape.base_mm() + slope * r), &spot);
        }
        if let Some(gradient) = &mut gradient {
            // What a mm of the valve plane adds, and a mm of radius times its slope.
            let (r, _, _) = shape.in_cylinder(space, surface, 1.0, &angle);
            let tilted = around * r * r * r / 3000.0 / SLOPE_AT_MM;
            gradient[BASE] += around * r * r / 2000.0;
            gradient[BASE + 1] += tilted * angle.cos;
            gradient[BASE + 2] += tilted * angle.sin;
        }
    }
    ml
}

/// How the radius of a surface depends on the coefficients that matter at a place.
fn radius_derivative(surface: Surface, spot: &Spot) -> impl Iterator<Item = (usize, f64)> {
    let Spot { first, splines, harmonics } = *spot;
    let side = match surface {
        Surface::Endocardial => -0.5,
        Surface::Epicardial => 0.5,
    };
    splines.into_iter().enumerate().flat_map(move |(k, spline)| {
        let start = (first + k) * STRIDE;
        let mid = harmonics.into_iter().take(HARMONICS).enumerate().map(move |(h, value)| (start + h, spline * value));
        let thickness = harmonics
            .into_iter()
            .take(THICKNESS_HARMONICS)
            .enumerate()
            .map(move |(h, value)| (start + HARMONICS + h, side * spline * value));
        mid.chain(thickness)
    })
}
