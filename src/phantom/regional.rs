//! Parts of the wall that contract later, less, or are thinner than the rest, in closed form.
//!
//! The surfaces of a ventricle are `r² = R²(t) p(h)` with one profile *p* of the height *h*, 0 at the surface's own tip and 1 in the valve plane
//! (see [`super::solid`]). With regional function `R²` depends on the angle and the height as well: within a [`Regional`] part the cavity's `R²`
//! is the one that the ventricle would have at another volume of its cavity, and at its edge a blend. The outside follows from the wall, which
//! keeps its volume at every angle and height: `R_o² L_o = R_i² L_i + W`, with the lengths *L* of both solids and a constant *W*. Tips and
//! valve plane stay those of the ventricle without regional function, which ties the part to its neighbours.
//!
//! A piece of the wall keeps its angle and its *h*, on both surfaces. Volumes are integrals of `R²` over the angle and the height, by
//! Gauss-Legendre quadrature between the edges of the parts, where all is smooth: exact to rounding.

use super::anatomy::Site;
use super::shape::{Shape, Surfaces, Ventricle};
use super::solid::Solid;
use super::{Phantom, cycle};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// A part of the wall with a function of its own. Where parts overlap, a later one in the list takes the place of an earlier one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Regional {
    /// Its middle in degrees from the anterior (0) over the septal (90) and the inferior (180) to the lateral wall (270), as reports count.
    pub centre_degrees: f64,
    /// Its width in degrees, between the points of half strength; 360: all around.
    pub width_degrees: f64,
    /// Width in degrees of the edges, raised cosines from full strength to none; 0: sharp.
    pub edge_degrees: f64,
    /// Where it begins and ends as parts of the height from the tip (0) to the valve plane (1).
    pub heights: [f64; 2],
    /// Width of the edges between heights, in the same parts; 0: sharp. At 0 and 1 there is no edge.
    pub edge_height: f64,
    /// How much later than the rest it contracts, as a part of R-R: .25 is 90°.
    pub delay: f64,
    /// How much of the rest's contraction it has: 1 as much, 0 none (akinetic), less than 0 outwards (dyskinetic).
    pub amplitude: f64,
    /// Volume of its wall against that of the wall without regional function: 1 as much, .5 thinned by half.
    pub thickness: f64,
}

impl Regional {
    /// A sector from apex to base with edges of 20° that does as the rest: a start for one that does not.
    pub fn sector(centre_degrees: f64, width_degrees: f64) -> Self {
        Self {
            centre_degrees,
            width_degrees,
            edge_degrees: 20.0_f64.min(width_degrees),
            heights: [0.0, 1.0],
            edge_height: 0.1,
            delay: 0.0,
            amplitude: 1.0,
            thickness: 1.0,
        }
    }

    /// How much a point is part of it, 0 to 1; the angle in radians from the lateral towards the inferior wall.
    pub fn strength(&self, angle: f64, height: f64) -> f64 {
        let apart = ((self.middle() - angle + PI).rem_euclid(TAU) - PI).abs();
        let around = if self.width_degrees >= 360.0 { 1.0 } else { step(self.half_width() - apart, self.edge_degrees.to_radians()) };
        let [from, to] = self.heights;
        let above = if from <= 0.0 { 1.0 } else { step(height - from, self.edge_height) };
        let below = if to >= 1.0 { 1.0 } else { step(to - height, self.edge_height) };
        around * above * below
    }

    /// The middle in radians from the lateral towards the inferior wall.
    fn middle(&self) -> f64 {
        (270.0 - self.centre_degrees).to_radians()
    }

    fn half_width(&self) -> f64 {
        self.width_degrees.to_radians() / 2.0
    }

    /// The cavity's volume of a ventricle that would be as this part is.
    fn cavity_ml(&self, ventricle: &Ventricle, phase: f64) -> f64 {
        ventricle.edv_ml - self.amplitude * (ventricle.edv_ml - ventricle.cavity_ml(phase - self.delay))
    }
}

impl Site {
    /// The middle of this side in degrees from the anterior over the septal wall; `None` for the tip, which is on no side.
    pub fn degrees(self) -> Option<f64> {
        match self {
            Self::Apical => None,
            Self::Anterior => Some(0.0),
            Self::Septal => Some(90.0),
            Self::Inferior => Some(180.0),
            Self::Lateral => Some(270.0),
        }
    }
}

/// From 0 to 1 over an edge about 0: half a period of a cosine, or at once.
fn step(inside: f64, edge: f64) -> f64 {
    if edge <= 0.0 {
        return f64::from(u8::from(inside > 0.0));
    }
    f64::midpoint(1.0, (PI * (inside / edge).clamp(-0.5, 0.5)).sin())
}

/// Both borders of the wall at an instant.
#[derive(Debug, Clone)]
pub(super) struct Borders {
    /// Without regional function; tips and valve plane in any case.
    pub(super) surfaces: Surfaces,
    /// Each part with its squared radius over that of the rest.
    parts: Vec<(Regional, f64)>,
    /// R² L of the cavity over that of the whole.
    inner_share: f64,
}

impl Borders {
    /// At a phase of the cycle; `None` without a ventricle.
    pub(super) fn at_phase(phantom: &Phantom, phase: f64) -> Option<Self> {
        Self::mean_of(phantom, &[phase])
    }

    /// Where the cavity (and that which stands for each part) holds its mean over several phases; `None` without a ventricle.
    pub(super) fn mean_of(phantom: &Phantom, phases: &[f64]) -> Option<Self> {
        let Shape::Ventricle(ventricle) = phantom.shape else {
            let surfaces = phantom.shape.surfaces(*phases.first()?)?;
            return Some(Self { surfaces, parts: Vec::new(), inner_share: 0.0 });
        };
        let count = phases.len() as f64;
        let mean = |of: &dyn Fn(f64) -> f64| phases.iter().copied().map(of).sum::<f64>() / count;
        let surfaces = ventricle.surfaces(mean(&|phase| ventricle.cavity_ml(phase)));
        let squared = |solid: &Solid| solid.widest_radius_mm().powi(2);
        let part = |regional: &Regional| {
            let own = ventricle.surfaces(mean(&|phase| regional.cavity_ml(&ventricle, phase)));
            (*regional, squared(&own.endocardium) / squared(&surfaces.endocardium))
        };
        let reach = |solid: &Solid| squared(solid) * (solid.base_w_mm() - solid.tip_w_mm());
        let inner_share = reach(&surfaces.endocardium) / reach(&surfaces.epicardium);
        Some(Self { surfaces, parts: phantom.regional.iter().map(part).collect(), inner_share })
    }

    /// Squared radius of the cavity in mm² at a canonical height and angle; negative beyond tip and valve plane.
    pub(super) fn inner_squared_mm2(&self, angle: impl FnOnce() -> f64, w_mm: f64) -> f64 {
        let solid = &self.surfaces.endocardium;
        solid.radius_squared_mm2(w_mm) * if self.parts.is_empty() { 1.0 } else { self.inner(angle(), height_of(solid, w_mm)) }
    }

    /// Squared radius of the outside likewise.
    pub(super) fn outer_squared_mm2(&self, angle: impl FnOnce() -> f64, w_mm: f64) -> f64 {
        let solid = &self.surfaces.epicardium;
        solid.radius_squared_mm2(w_mm) * if self.parts.is_empty() { 1.0 } else { self.outer(angle(), height_of(solid, w_mm)) }
    }

    /// A radius in mm that the outside nowhere exceeds.
    pub(super) fn reach_mm(&self) -> f64 {
        let largest = |of: fn(&(Regional, f64)) -> f64| self.parts.iter().map(of).fold(1.0, f64::max);
        let outer = self.inner_share * largest(|part| part.1) + (1.0 - self.inner_share) * largest(|part| part.0.thickness);
        self.surfaces.epicardium.widest_radius_mm() * if self.parts.is_empty() { 1.0 } else { outer.sqrt() }
    }

    /// Whether there is a wall at every angle and height that is tried.
    pub(super) fn wall_is_whole(&self) -> bool {
        let (tip, base) = (self.surfaces.endocardium.tip_w_mm(), self.surfaces.endocardium.base_w_mm());
        (0..72 * 48).all(|point| {
            let (angle, w) = (TAU * f64::from(point % 72) / 72.0, tip + (base - tip) * f64::from(point / 72) / 48.0);
            self.outer_squared_mm2(|| angle, w) > self.inner_squared_mm2(|| angle, w)
        })
    }

    /// Volumes of cavity and whole in ml.
    pub(super) fn volumes_ml(&self) -> (f64, f64) {
        let (inner, outer) = self.shares();
        (self.surfaces.endocardium.volume_mm3() / 1000.0 * inner, self.surfaces.epicardium.volume_mm3() / 1000.0 * outer)
    }

    /// What the volumes of cavity and whole are of those without regional function.
    fn shares(&self) -> (f64, f64) {
        if self.parts.is_empty() {
            return (1.0, 1.0);
        }
        // One profile for both solids, as they have one truncation.
        let truncation = match self.surfaces.endocardium {
            Solid::TruncatedEllipsoid { truncation, .. } => truncation,
            Solid::CappedCylinder { .. } => 0.0,
        };
        let profile = |height: f64| 1.0 - ((1.0 + truncation) * height - 1.0).powi(2);
        let (angles, heights) = (self.angles(), self.heights());
        let (mut whole, mut inner, mut outer) = (0.0, 0.0, 0.0);
        for &(height, along) in &heights {
            for &(angle, around) in &angles {
                let weight = along * around * profile(height);
                whole += weight;
                inner += weight * self.inner(angle, height);
                outer += weight * self.outer(angle, height);
            }
        }
        (inner / whole, outer / whole)
    }

    fn blend(&self, angle: f64, height: f64, of: fn(&(Regional, f64)) -> f64) -> f64 {
        self.parts.iter().fold(1.0, |value, part| value + part.0.strength(angle, height) * (of(part) - value))
    }

    /// R² of the cavity over that without regional function.
    fn inner(&self, angle: f64, height: f64) -> f64 {
        self.blend(angle, height, |part| part.1)
    }

    /// R² of the outside likewise.
    fn outer(&self, angle: f64, height: f64) -> f64 {
        self.inner_share * self.inner(angle, height) + (1.0 - self.inner_share) * self.blend(angle, height, |part| part.0.thickness)
    }

    /// Angles and weights: panels between the edges of the parts.
    fn angles(&self) -> Vec<(f64, f64)> {
        let mut ends = vec![0.0, TAU];
        for (part, _) in self.parts.iter().filter(|(part, _)| part.width_degrees < 360.0) {
            let half_edge = part.edge_degrees.to_radians() / 2.0;
            for (side, edge) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
                ends.push((part.middle() + side * part.half_width() + edge * half_edge).rem_euclid(TAU));
            }
        }
        panels(ends)
    }

    /// Heights and weights likewise.
    fn heights(&self) -> Vec<(f64, f64)> {
        let mut ends = vec![0.0, 1.0];
        for (part, _) in &self.parts {
            for height in part.heights.into_iter().filter(|height| (0.0..1.0).contains(height) && *height > 0.0) {
                ends.extend([-0.5, 0.5].map(|edge| (height + edge * part.edge_height).clamp(0.0, 1.0)));
            }
        }
        panels(ends)
    }
}

impl Phantom {
    /// Volume of the cavity in ml at a phase of the continuous cycle (R wave 0, next R wave 1); `None` without a ventricle.
    pub fn cavity_ml(&self, phase: f64) -> Option<f64> {
        Borders::at_phase(self, phase).map(|borders| borders.volumes_ml().0)
    }

    /// Largest and smallest volume of the cavity over the continuous cycle in ml, of a thousand phases; `None` without a ventricle.
    pub(super) fn continuous_ends_ml(&self) -> Option<(f64, f64)> {
        if let (Shape::Ventricle(ventricle), true) = (self.shape, self.regional.is_empty()) {
            return Some((ventricle.edv_ml, ventricle.esv_ml));
        }
        let phases = cycle::gate_phases(0, 1, 1000);
        let volumes: Option<Vec<f64>> = phases.map(|phase| self.cavity_ml(phase)).collect();
        let volumes = volumes?;
        Some((volumes.iter().copied().fold(0.0, f64::max), volumes.iter().copied().fold(f64::INFINITY, f64::min)))
    }
}

/// The height above the solid's own tip as a part of its length.
fn height_of(solid: &Solid, w_mm: f64) -> f64 {
    (w_mm - solid.tip_w_mm()) / (solid.base_w_mm() - solid.tip_w_mm())
}

/// Nodes and weights of Gauss-Legendre quadrature, eight a panel, between ends in any order; long panels are cut in four.
fn panels(mut ends: Vec<f64>) -> Vec<(f64, f64)> {
    /// Positive nodes and their weights.
    const GAUSS: [(f64, f64); 4] = [
        (0.183_434_642_495_649_8, 0.362_683_783_378_362),
        (0.525_532_409_916_329, 0.313_706_645_877_887_3),
        (0.796_666_477_413_626_7, 0.222_381_034_453_374_47),
        (0.960_289_856_497_536_2, 0.101_228_536_290_376_26),
    ];
    ends.sort_by(f64::total_cmp);
    let mut nodes = Vec::new();
    for pair in ends.windows(2).filter(|pair| pair[1] - pair[0] > 1e-12) {
        let quarter = (pair[1] - pair[0]) / 4.0;
        for piece in 0..4 {
            let (middle, half) = (pair[0] + quarter * (f64::from(piece) + 0.5), quarter / 2.0);
            nodes.extend(GAUSS.iter().flat_map(|&(node, weight)| [-1.0, 1.0].map(|side| (middle + side * half * node, half * weight))));
        }
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(regional: &[Regional]) -> Phantom {
        Phantom { regional: regional.to_vec(), ..Phantom::normal() }
    }

    #[test]
    fn a_sector_that_does_as_the_rest_changes_nothing() {
        let plain = Phantom::normal();
        let same = with(&[Regional::sector(40.0, 90.0)]);
        for phase in [0.0, 0.2, 0.7] {
            let (a, b) = (Borders::at_phase(&plain, phase).unwrap(), Borders::at_phase(&same, phase).unwrap());
            assert!((a.volumes_ml().0 - b.volumes_ml().0).abs() < 1e-9 && (a.volumes_ml().1 - b.volumes_ml().1).abs() < 1e-9);
            assert!((a.reach_mm() - b.reach_mm()).abs() < 1e-9);
        }
    }

    /// A sharp sector of 90° is a quarter of the circle; an edge is half in, half out.
    #[test]
    fn volumes_are_those_of_the_sectors() {
        for edge_degrees in [0.0, 30.0] {
            let akinetic = Regional { edge_degrees, amplitude: 0.0, ..Regional::sector(350.0, 90.0) };
            let borders = Borders::at_phase(&with(&[akinetic]), 0.35).unwrap();
            let (plain, still) = (Ventricle::NORMAL.surfaces(48.0), Ventricle::NORMAL.surfaces(120.0));
            let ratio = (still.endocardium.widest_radius_mm() / plain.endocardium.widest_radius_mm()).powi(2);
            let (cavity, whole) = borders.volumes_ml();
            assert!((cavity - 48.0 * (0.75 + 0.25 * ratio)).abs() < 1e-9, "{cavity}");
            assert!((whole - cavity - 120.0).abs() < 1e-9, "the wall is conserved: {}", whole - cavity);
        }
    }

    #[test]
    fn a_thinned_sector_has_less_wall_and_the_same_cavity() {
        let thin = Regional { thickness: 0.5, edge_degrees: 0.0, ..Regional::sector(90.0, 120.0) };
        let (cavity, whole) = Borders::at_phase(&with(&[thin]), 0.1).unwrap().volumes_ml();
        assert!((cavity - Ventricle::NORMAL.cavity_ml(0.1)).abs() < 1e-9);
        assert!((whole - cavity - 120.0 * (1.0 - 0.5 / 3.0)).abs() < 1e-9, "{}", whole - cavity);
    }

    /// The quadrature against a fine sum over angle and height.
    #[test]
    fn parts_of_the_height_are_integrated_too() {
        let apical = Regional { heights: [0.0, 0.4], amplitude: 0.0, ..Regional::sector(0.0, 360.0) };
        let late = Regional { heights: [0.3, 0.8], edge_height: 0.2, delay: 0.25, ..Regional::sector(200.0, 70.0) };
        let borders = Borders::at_phase(&with(&[apical, late]), 0.3).unwrap();
        let solid = &borders.surfaces.endocardium;
        let (tip, base) = (solid.tip_w_mm(), solid.base_w_mm());
        let (rows, around) = (4000, 720);
        let mut sum = 0.0;
        for row in 0..rows {
            let w = tip + (base - tip) * (f64::from(row) + 0.5) / f64::from(rows);
            for step in 0..around {
                sum += borders.inner_squared_mm2(|| TAU * (f64::from(step) + 0.5) / f64::from(around), w) / 2.0;
            }
        }
        let ml = sum * TAU / f64::from(around) * (base - tip) / f64::from(rows) / 1000.0;
        assert!((borders.volumes_ml().0 / ml - 1.0).abs() < 1e-6, "{} {ml}", borders.volumes_ml().0);
    }

    #[test]
    fn a_part_is_where_it_is_said_to_be() {
        let inferior = Regional { edge_degrees: 10.0, heights: [0.2, 0.9], ..Regional::sector(180.0, 60.0) };
        let at = |degrees: f64, height: f64| inferior.strength((270.0 - degrees).to_radians(), height);
        assert!((at(180.0, 0.5) - 1.0).abs() < 1e-12 && (at(156.0, 0.5) - 1.0).abs() < 1e-12 && at(144.0, 0.5).abs() < 1e-12);
        assert!((at(210.0, 0.5) - 0.5).abs() < 1e-9 && (at(180.0, 0.2) - 0.5).abs() < 1e-9 && at(180.0, 0.1).abs() < 1e-12);
        // The inferior wall is towards y, the lateral towards x.
        assert!((inferior.strength(PI / 2.0, 0.5) - 1.0).abs() < 1e-12);
        assert_eq!(Site::Lateral.degrees().map(|degrees| (270.0 - degrees).to_radians()), Some(0.0));
    }
}
