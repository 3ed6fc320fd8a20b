//! The cavity's shape: length, width and what is formed of them.

use super::places::Places;
use crate::pipeline::{Reconstruction, Surface};
use std::f64::consts::PI;

/// The shape of the cavity at one gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// The gate, counted from 0.
    pub gate: usize,
    /// From the tip of the cavity to the valve plane along the long axis, in mm.
    pub long_axis_mm: f64,
    /// The largest diameter across, of a circle of the same area as the cavity's cross-section there, in mm.
    pub short_axis_mm: f64,
    /// Short over long axis; 1: as wide as long.
    pub sphericity_index: f64,
    /// The cavity's volume over that of a ball whose diameter is the long axis.
    pub volume_sphericity: f64,
    /// √(1 − (short/long)²) of the ellipsoid with these axes; 0: a ball.
    pub eccentricity: f64,
}

/// Levels at which the cross-section is looked at.
const LEVELS: usize = 40;

impl Shape {
    /// Of one gate, counted from 0.
    pub(super) fn of(reconstruction: &Reconstruction, places: &Places, gate: usize) -> Self {
        let mesh = &reconstruction.gates[gate].fits.get(Surface::Endocardial).mesh;
        let [_, _, to_base] = places.axes;
        let height = |point: glam::DVec3| (point - places.centre_mm).dot(to_base);
        let heights: Vec<f64> = mesh.positions.iter().map(|&point| height(point)).collect();
        let (tip, top) = heights.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &h| (low.min(h), high.max(h)));
        // The valve plane may tilt: its middle is where the lid's is.
        let base = places.base_height_mm(mesh).unwrap_or(top);
        let long_axis_mm = base - tip;
        let widest_mm2 = (1..LEVELS)
            .map(|level| mesh.section_mm2(places.centre_mm + to_base * (tip + (top - tip) * level as f64 / LEVELS as f64), to_base))
            .fold(0.0, f64::max);
        let short_axis_mm = 2.0 * (widest_mm2 / PI).sqrt();
        let ratio = short_axis_mm / long_axis_mm;
        Self {
            gate,
            long_axis_mm,
            short_axis_mm,
            sphericity_index: ratio,
            volume_sphericity: mesh.volume_ml() * 1000.0 / (PI / 6.0 * long_axis_mm.powi(3)),
            eccentricity: (1.0 - ratio * ratio).max(0.0).sqrt(),
        }
    }
}
