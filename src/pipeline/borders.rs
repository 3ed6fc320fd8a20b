//! The borders that the surfaces are drawn to: the rings of each surface (see `rings`), their gaps bridged and their ends closed.
//!
//! The paper leaves both ends open. Its mesh then falls in at the base, and one slice more or less is 22 ml of its phantom; here a dome
//! over the apex and a disc in the valve plane end the surface at heights found between the slices.

use super::{
    PerSurface, PipelineError, Surface,
    canny::Gradient,
    gaps::{self, Unseen},
    parameters::Parameters,
    region::Extent,
    rings::{FULL_COVERAGE, Radii, Rings, SECTORS, angle_of, rings},
};
use crate::volume::{Grid, VoxelSet};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// One voxel of a border.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BorderPoint {
    /// The voxel `[z, y, x]`.
    pub voxel: [usize; 3],
    /// The border at sub-voxel precision, in grid mm.
    pub position_mm: DVec3,
    /// Unit normal of the border there, either side.
    pub normal: DVec3,
}

/// The voxels of one border, each once: first those with an edge, then bridges, valve plane and apex.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Border {
    /// The border's voxels.
    pub points: Vec<BorderPoint>,
}

impl Border {
    /// Mean of the border's places in grid mm.
    pub fn middle_mm(&self) -> DVec3 {
        self.points.iter().map(|point| point.position_mm).sum::<DVec3>() / self.points.len().max(1) as f64
    }
}

/// The borders of a gate.
#[derive(Debug, Clone)]
pub struct Borders {
    /// Both borders, their gaps bridged and, if wanted, their ends closed.
    pub found: PerSurface<Border>,
    /// Mean angular coverage over the useful slices that have a border, 0-1.
    pub coverage: PerSurface<f64>,
    /// Where nothing was seen.
    pub unseen: Unseen,
}

/// Refuses a border that cannot carry a surface: a ring of the smallest ventricle and its ends have more voxels.
pub fn check(gate: usize, surface: Surface, border: &Border) -> Result<(), PipelineError> {
    const FEWEST_VOXELS: usize = 12;
    if border.points.len() >= FEWEST_VOXELS {
        return Ok(());
    }
    let why = format!(
        "{} border voxels lie on circumferences about the axis, {FEWEST_VOXELS} are the least that enclose a surface",
        border.points.len()
    );
    Err(PipelineError::NoBorder { gate, surface, why })
}

/// Finds both borders of a gate between its apex and its valve plane.
pub fn borders(gradient: &Gradient, extent: &Extent, parameters: &Parameters) -> Borders {
    let (grid, close_ends) = (gradient.field.grid, parameters.edges.close_ends);
    let outer = rings(gradient, extent, parameters, Surface::Epicardial, &vec![None; grid.shape[0]]);
    let inner = rings(gradient, extent, parameters, Surface::Endocardial, &outer.radius_mm);
    let pixel_mm = grid.spacing_mm[1].max(grid.spacing_mm[2]);
    let of_both = PerSurface { endocardial: &inner, epicardial: &outer };
    let unseen = Unseen {
        gap: PerSurface::of(|surface| gaps::largest(of_both.get(surface), extent, pixel_mm)),
        apex: (!extent.apex_seen).then(|| PerSurface::of(|surface| of_both.get(surface).beyond_apex(grid, extent))),
    };
    Borders {
        unseen,
        coverage: PerSurface { endocardial: inner.mean_coverage(), epicardial: outer.mean_coverage() },
        found: PerSurface { endocardial: inner.border(grid, extent, close_ends), epicardial: outer.border(grid, extent, close_ends) },
    }
}

impl Rings {
    /// The rings as a border, if wanted closed by a dome over the apex and a disc in the valve plane.
    fn border(&self, grid: Grid, extent: &Extent, close_ends: bool) -> Border {
        let mut border = BorderBuilder::new(grid);
        for edge in &self.points {
            border.add(edge.voxel, edge.position_mm, edge.uphill);
        }
        for slice in 0..grid.shape[0] {
            border.bridge(extent, slice, &self.radii(extent, slice));
        }
        let (Some(apical), Some(basal)) = (self.end_ring(extent, End::Apex), self.end_ring(extent, End::Base)) else {
            return Border::default();
        };
        if !close_ends {
            return Border { points: border.points };
        }
        border.disc(extent, &basal);
        let apex_mm = if self.surface == Surface::Endocardial { extent.apex_mm.endocardial } else { extent.apex_mm.epicardial };
        border.dome(extent, &apical, apex_mm);
        Border { points: border.points }
    }

    /// The slices (from 0) from where the wall ends at the apex to the ring nearest to it.
    fn beyond_apex(&self, grid: Grid, extent: &Extent) -> [usize; 2] {
        let end = ((extent.apex_mm.epicardial / grid.spacing_mm[0]).round().max(0.0) as usize).min(grid.shape[0] - 1);
        let ring = self.end_slice(extent, End::Apex).unwrap_or(end);
        [end.min(ring), end.max(ring)]
    }

    /// The last slice with a ring towards an end.
    fn end_slice(&self, extent: &Extent, end: End) -> Option<usize> {
        let rises = (extent.towards_base() > 0.0) == (end == End::Base);
        let with_ring = self.radius_mm.iter().enumerate().filter_map(|(slice, radius)| radius.map(|_| slice));
        if rises { with_ring.max() } else { with_ring.min() }
    }

    /// The last ring towards an end, with its own centre.
    fn end_ring(&self, extent: &Extent, end: End) -> Option<EndRing> {
        let slice = self.end_slice(extent, end)?;
        let points: Vec<DVec3> = self.points.iter().filter(|point| point.voxel[0] == slice).map(|point| point.position_mm).collect();
        let centre = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
        let radius_mm = points.iter().map(|point| point.distance(centre)).sum::<f64>() / points.len().max(1) as f64;
        // The centre of gravity of half a ring is not its centre.
        let whole = self.coverage[slice] >= FULL_COVERAGE;
        let (off_axis_mm, radius_mm) =
            if whole { (extent.from_axis_mm(centre), radius_mm) } else { (DVec2::ZERO, self.radius_mm[slice].unwrap_or(radius_mm)) };
        Some(EndRing { slice, off_axis_mm, radius_mm })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Apex,
    Base,
}

/// The ring that a surface ends with.
struct EndRing {
    slice: usize,
    off_axis_mm: DVec2,
    radius_mm: f64,
}

/// Collects border voxels, each once.
struct BorderBuilder {
    grid: Grid,
    taken: VoxelSet,
    points: Vec<BorderPoint>,
}

impl BorderBuilder {
    fn new(grid: Grid) -> Self {
        Self { grid, taken: VoxelSet::empty(grid.shape), points: Vec::new() }
    }

    fn add(&mut self, voxel: [usize; 3], position_mm: DVec3, normal: DVec3) {
        let taken = &mut self.taken.member[voxel];
        if !*taken {
            *taken = true;
            self.points.push(BorderPoint { voxel, position_mm, normal });
        }
    }

    /// Closes the gaps of a ring: the radius changes linearly with the angle from one end of a gap to the other.
    fn bridge(&mut self, extent: &Extent, slice: usize, radii: &Radii) {
        let z_mm = slice as f64 * self.grid.spacing_mm[0];
        let pixel_mm = self.grid.spacing_mm[1].min(self.grid.spacing_mm[2]);
        let seen: Vec<(usize, f64)> =
            radii.iter().enumerate().filter_map(|(sector, radius)| radius.map(|radius| (sector, radius))).collect();
        for (i, &(from, from_mm)) in seen.iter().enumerate() {
            let (to, to_mm) = seen[(i + 1) % seen.len()];
            let gap = if to > from { to - from } else { to + SECTORS - from };
            // Neighbouring pixels of a ring lie in sectors up to this far apart.
            let hidden = (pixel_mm * 1.5 / from_mm.min(to_mm).max(pixel_mm) * SECTORS as f64 / TAU).ceil() as usize;
            if gap <= hidden {
                continue;
            }
            let steps = (gap as f64 * TAU / SECTORS as f64 * from_mm.max(to_mm) / (pixel_mm / 2.0)).ceil() as usize;
            for step in 1..steps {
                let part = step as f64 / steps as f64;
                let angle = angle_of(from as f64 + part * gap as f64);
                let out = DVec2::from_angle(angle);
                let point = extent.at_axis_mm(out * (from_mm + part * (to_mm - from_mm)), z_mm);
                if let Some(voxel) = self.grid.voxel_at(point) {
                    self.add(voxel, point, out.extend(0.0));
                }
            }
        }
    }

    /// The pixels of a slice inside an end ring moved to a height, as offsets from its centre.
    fn inside(&self, extent: &Extent, ring: &EndRing, z_mm: f64) -> Vec<DVec2> {
        let [_, rows, columns] = self.grid.shape;
        let flat = (0..rows).flat_map(|y| (0..columns).map(move |x| [0, y, x]));
        flat.map(|voxel| extent.from_axis_mm(self.grid.position_mm(voxel).with_z(z_mm)) - ring.off_axis_mm)
            .filter(|offset| offset.length() < ring.radius_mm)
            .collect()
    }

    /// The valve plane.
    fn disc(&mut self, extent: &Extent, ring: &EndRing) {
        for offset in self.inside(extent, ring, extent.base_mm) {
            let point = extent.at_axis_mm(ring.off_axis_mm + offset, extent.base_mm);
            if let Some(voxel) = nearest_slice(&self.grid, point) {
                self.add(voxel, point, DVec3::Z);
            }
        }
    }

    /// Half an ellipsoid from the ring nearest the apex to the apex.
    fn dome(&mut self, extent: &Extent, ring: &EndRing, apex_mm: f64) {
        let ring_mm = ring.slice as f64 * self.grid.spacing_mm[0];
        // At least a quarter of a slice beyond the ring: an apex found on its wrong side is the ring's own plane.
        let height = ((ring_mm - apex_mm) * extent.towards_base()).max(self.grid.spacing_mm[0] / 4.0);
        let down = -extent.towards_base();
        for offset in self.inside(extent, ring, ring_mm) {
            let rise = (1.0 - (offset.length() / ring.radius_mm).powi(2)).sqrt();
            let point = extent.at_axis_mm(ring.off_axis_mm + offset, ring_mm + down * height * rise);
            let normal = (offset / (ring.radius_mm * ring.radius_mm)).extend(down * rise / height).normalize_or(DVec3::Z);
            if let Some(voxel) = nearest_slice(&self.grid, point) {
                self.add(voxel, point, normal);
            }
        }
    }
}

/// The voxel of a point; heights beyond the grid by up to a slice belong to its first or last slice.
fn nearest_slice(grid: &Grid, point_mm: DVec3) -> Option<[usize; 3]> {
    let last = (grid.shape[0] - 1) as f64 * grid.spacing_mm[0];
    let clamped = point_mm.with_z(point_mm.z.clamp(0.0, last));
    if (clamped.z - point_mm.z).abs() > grid.spacing_mm[0] { None } else { grid.voxel_at(clamped) }
}
