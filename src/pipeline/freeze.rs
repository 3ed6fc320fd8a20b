//! Freezing particles on the border (paper §7.1: the Canny border is what stops the oscillation).
//!
//! A particle freezes when it enters a border voxel and is then moved, along the border's normal, to the edge at sub-voxel precision:
//! freezing alone leaves every surface half a voxel too far out.

use super::{
    borders::{Border, BorderPoint},
    canny::neighbours,
    gvf::Flow,
    integrate::Particles,
    parameters::EdgeMode,
};
use crate::volume::Grid;
use glam::DVec3;
use std::collections::HashMap;

/// The particles that the border holds.
#[derive(Debug)]
pub(super) struct Ice<'a> {
    grid: &'a Grid,
    on_border: HashMap<[usize; 3], &'a BorderPoint>,
    /// Which particles are frozen.
    pub(super) frozen: Vec<bool>,
    count: usize,
}

impl<'a> Ice<'a> {
    /// No particle frozen.
    pub(super) fn new(border: &'a Border, grid: &'a Grid, particles: usize) -> Self {
        let on_border = border.points.iter().map(|point| (point.voxel, point)).collect();
        Self { grid, on_border, frozen: vec![false; particles], count: 0 }
    }

    /// Whether every particle is frozen.
    pub(super) fn holds_all(&self) -> bool {
        self.count == self.frozen.len()
    }

    /// Fraction of the particles that are frozen.
    pub(super) fn part(&self) -> f64 {
        self.count as f64 / self.frozen.len().max(1) as f64
    }

    /// Freezes the particles that have reached the border, with `subvoxel` at its edge, else where they are.
    pub(super) fn freeze(&mut self, particles: &mut Particles, flow: &Flow, subvoxel: bool) {
        for (vertex, frozen) in self.frozen.iter_mut().enumerate().filter(|(_, frozen)| !**frozen) {
            let (position, velocity) = (&mut particles.positions[vertex], &mut particles.velocities[vertex]);
            let turned = || flow.direction(*position).dot(*velocity) < 0.0;
            if let Some(point) = reached(self.grid, &self.on_border, *position, turned) {
                if subvoxel {
                    *position += point.normal * (point.position_mm - *position).dot(point.normal);
                }
                *velocity = DVec3::ZERO;
                *frozen = true;
                self.count += 1;
            }
        }
    }
}

/// The border point a particle has reached: that of its voxel, or, where the field has turned against it, the nearest one of the voxels
/// around. A border is joined over corners, and a particle may slip through between two of its voxels.
fn reached<'a>(
    grid: &Grid,
    on_border: &HashMap<[usize; 3], &'a BorderPoint>,
    position: DVec3,
    turned: impl Fn() -> bool,
) -> Option<&'a BorderPoint> {
    let voxel = grid.voxel_at(clamp_to(grid, position))?;
    if let Some(point) = on_border.get(&voxel) {
        return Some(point);
    }
    let around = || neighbours(voxel, grid.shape, EdgeMode::Volume).filter_map(|voxel| on_border.get(&voxel).copied());
    around().next()?;
    if !turned() {
        return None;
    }
    let distance = |point: &BorderPoint| point.position_mm.distance_squared(position);
    around().min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// Particles may leave the grid by its first and last slice's outer faces where a ventricle is cut off.
fn clamp_to(grid: &Grid, point_mm: DVec3) -> DVec3 {
    let dz = grid.spacing_mm[0];
    let last = (grid.shape[0] - 1) as f64 * dz;
    let nearest = point_mm.z.clamp(0.0, last);
    if (nearest - point_mm.z).abs() <= dz { point_mm.with_z(nearest) } else { point_mm }
}
