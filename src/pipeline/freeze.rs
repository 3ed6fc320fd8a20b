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

/// The particles that the border holds.
#[derive(Debug)]
pub(super) struct Ice<'a> {
    grid: &'a Grid,
    points: &'a [BorderPoint],
    cells: Cells,
    /// Which particles are frozen.
    pub(super) frozen: Vec<bool>,
    count: usize,
}

impl<'a> Ice<'a> {
    /// No particle frozen.
    pub(super) fn new(border: &'a Border, grid: &'a Grid, particles: usize) -> Self {
        Self { grid, points: &border.points, cells: Cells::around(&border.points), frozen: vec![false; particles], count: 0 }
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
        for vertex in 0..self.frozen.len() {
            if self.frozen[vertex] {
                continue;
            }
            let (position, velocity) = (&mut particles.positions[vertex], &mut particles.velocities[vertex]);
            let turned = || flow.direction(*position).dot(*velocity) < 0.0;
            if let Some(point) = self.reached(*position, turned) {
                if subvoxel {
                    *position += point.normal * (point.position_mm - *position).dot(point.normal);
                }
                *velocity = DVec3::ZERO;
                self.frozen[vertex] = true;
                self.count += 1;
            }
        }
    }

    /// The border point a particle has reached: that of its voxel, or, where the field has turned against it, the nearest one of the voxels
    /// around. A border is joined over corners, and a particle may slip through between two of its voxels.
    fn reached(&self, position: DVec3, turned: impl Fn() -> bool) -> Option<&'a BorderPoint> {
        let voxel = self.grid.voxel_at(clamp_to(self.grid, position))?;
        match self.cells.at(voxel)? {
            Cell::On(point) => Some(&self.points[point]),
            Cell::Beside if turned() => {
                let around = neighbours(voxel, self.grid.shape, EdgeMode::Volume).filter_map(|voxel| match self.cells.at(voxel) {
                    Some(Cell::On(point)) => Some(&self.points[point]),
                    _ => None,
                });
                let distance = |point: &BorderPoint| point.position_mm.distance_squared(position);
                around.min_by(|a, b| distance(a).total_cmp(&distance(b)))
            }
            Cell::Beside => None,
        }
    }
}

/// The voxels of a border and those beside them, looked up in an array over their box: every moving particle asks at every step.
#[derive(Debug)]
struct Cells {
    low: [usize; 3],
    shape: [usize; 3],
    kinds: Vec<Option<Cell>>,
}

/// A voxel on a border (with the place of its point in the list) or next to one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cell {
    On(usize),
    Beside,
}

impl Cells {
    fn around(points: &[BorderPoint]) -> Self {
        let extreme = |axis: usize, pick: fn(usize, usize) -> usize| points.iter().map(|point| point.voxel[axis]).reduce(pick).unwrap_or(0);
        let low: [usize; 3] = std::array::from_fn(|axis| extreme(axis, usize::min).saturating_sub(1));
        let shape = std::array::from_fn(|axis| extreme(axis, usize::max) + 2 - low[axis]);
        let mut cells = Self { low, shape, kinds: vec![None; shape.iter().product()] };
        let whole = std::array::from_fn(|axis| low[axis] + shape[axis]);
        for point in points {
            for beside in neighbours(point.voxel, whole, EdgeMode::Volume) {
                if let Some(offset) = cells.offset(beside) {
                    cells.kinds[offset] = Some(Cell::Beside);
                }
            }
        }
        for (index, point) in points.iter().enumerate() {
            if let Some(offset) = cells.offset(point.voxel) {
                cells.kinds[offset] = Some(Cell::On(index));
            }
        }
        cells
    }

    fn at(&self, voxel: [usize; 3]) -> Option<Cell> {
        self.kinds[self.offset(voxel)?]
    }

    fn offset(&self, voxel: [usize; 3]) -> Option<usize> {
        let mut offset = 0;
        for (index, (low, count)) in voxel.into_iter().zip(self.low.into_iter().zip(self.shape)) {
            let inside = index.checked_sub(low).filter(|inside| *inside < count)?;
            offset = offset * count + inside;
        }
        Some(offset)
    }
}

/// Particles may leave the grid by its first and last slice's outer faces where a ventricle is cut off.
fn clamp_to(grid: &Grid, point_mm: DVec3) -> DVec3 {
    let dz = grid.spacing_mm[0];
    let last = (grid.shape[0] - 1) as f64 * dz;
    let nearest = point_mm.z.clamp(0.0, last);
    if (nearest - point_mm.z).abs() <= dz { point_mm.with_z(nearest) } else { point_mm }
}
