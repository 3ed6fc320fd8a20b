//! Gradient vector flow (paper §5, figure 2; Xu & Prince 1997): the field V that minimises
//! ∫ μ|∇V|² + |∇f|²|V − ∇f|², where f is the map of one border, 1 on it and 0 elsewhere.
//!
//! Its Euler equation is linear: (b − μ∇·∇) V = b ∇f with b = |∇f|², all lengths in mm, and no flow through the faces (Neumann).
//! The matrix is symmetric and positive definite, so the steady state is solved for, by conjugate gradients (`system`) that a multigrid
//! cycle (`multigrid`) preconditions, to a stated residual; the paper stepped towards it ([`explicit`]). 5.74 mm between slices against
//! 2.87 mm between pixels is a factor of four in the diffusion that unit spacing would lose.

pub mod explicit;
mod lattice;
mod multigrid;
mod system;
#[cfg(test)]
pub(super) mod tests;
mod transfer;

use super::{PipelineError, borders::Border, canny::central_difference, monitor, monitor::Monitor, parameters::GvfParameters};
use crate::volume::{Grid, VectorField};
use glam::DVec3;
use ndarray::Array3;
use std::cell::Cell;
use system::System;

/// The solved field and how well it was solved.
#[derive(Debug, Clone)]
pub struct Flow {
    /// Where the field is.
    pub window: Window,
    /// The field V, a mm, on the window; only its direction is used.
    pub field: VectorField,
    /// Relative residual ‖b∇f − (b − μΔ)V‖ / ‖b∇f‖ reached, per component x, y, z; both norms weighted by the inverse diagonal.
    pub residual: [f64; 3],
    /// Iterations, per component.
    pub iterations: [usize; 3],
}

/// The part of a grid around a border. It may reach beyond the grid: ventricles are cut by the field of view, their fields are not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// The window's lattice.
    pub grid: Grid,
    /// Its first voxel `[z, y, x]` in the study's grid.
    low: [i64; 3],
}

/// Room around a border for the initial ellipsoid and for the field to turn in.
const MARGIN_MM: f64 = 12.0;

impl Window {
    /// The voxels of a border and a margin.
    pub fn around(border: &Border, grid: &Grid) -> Self {
        let mut window = Self { grid: *grid, low: [0; 3] };
        for axis in 0..3 {
            let indices = border.points.iter().map(|point| point.voxel[axis] as i64);
            let margin = (MARGIN_MM / grid.spacing_mm[axis]).ceil() as i64;
            let (low, high) = (indices.clone().min().unwrap_or(0) - margin, indices.max().unwrap_or(0) + margin);
            window.low[axis] = low;
            window.grid.shape[axis] = (high - low + 1) as usize;
        }
        window
    }

    fn local(&self, voxel: [usize; 3]) -> [usize; 3] {
        std::array::from_fn(|axis| (voxel[axis] as i64 - self.low[axis]) as usize)
    }

    /// The study's grid mm of the window's first voxel.
    fn origin_mm(&self) -> DVec3 {
        let [z, y, x] = self.low;
        DVec3::new(x as f64, y as f64, z as f64) * self.grid.step_mm()
    }
}

impl Flow {
    /// The direction of the field at a point in grid mm: a unit vector, zero where the field vanishes.
    pub fn direction(&self, point_mm: DVec3) -> DVec3 {
        self.field.sample(point_mm - self.window.origin_mm()).normalize_or_zero()
    }
}

/// A field that minimises the functional for an edge map, and how well it was found.
#[derive(Debug, Clone)]
pub struct Solution {
    /// V, a mm, on the map's grid.
    pub field: VectorField,
    /// Relative residual reached, per component x, y, z: ‖b∇f − (b − μΔ)V‖ / ‖b∇f‖ of the field that is returned, both norms weighted by
    /// the inverse diagonal. Rounding to f32 leaves about 3·10⁻⁸.
    pub residual: [f64; 3],
    /// Iterations, or steps of [`explicit`], per component.
    pub iterations: [usize; 3],
}

/// Memory that solving takes, used again by the next problem whatever its size. What is found does not depend on what it held.
#[derive(Debug, Default)]
pub struct Workspace {
    system: System,
    /// b, then the right side of one component.
    b: Vec<f32>,
    right: Vec<f32>,
}

impl Workspace {
    /// Bytes that it has grown to.
    pub fn bytes(&self) -> usize {
        self.system.bytes() + (self.b.capacity() + self.right.capacity()) * size_of::<f32>()
    }
}

/// Grey levels of the images the paper's μ belongs to. A map scaled by s multiplies b by s², so μ on a map of unit height is μ/s².
const PAPER_GREY_LEVELS: f64 = 255.0;

/// The μ of an edge map of unit height and lengths in mm that stands for the paper's.
pub fn unit_mu(paper_mu: f64) -> f64 {
    paper_mu / (PAPER_GREY_LEVELS * PAPER_GREY_LEVELS)
}

thread_local! {
    static KEPT: Cell<Workspace> = Cell::default();
}

/// Gives back the workspace of this thread.
pub(super) fn forget() {
    drop(KEPT.take());
}

/// Solves for the flow of a border around it. Each thread keeps a workspace for the next border.
pub fn flow(grid: &Grid, border: &Border, parameters: &GvfParameters, monitor: &dyn Monitor) -> Result<Flow, PipelineError> {
    let window = Window::around(border, grid);
    let map = edge_map(&window, border);
    let mut workspace = KEPT.take();
    let solved = solve(&window.grid, &map, unit_mu(parameters.mu), parameters.tolerance, &mut workspace, monitor);
    KEPT.set(workspace);
    let Solution { field, residual, iterations } = solved?;
    Ok(Flow { window, field, residual, iterations })
}

/// Solves for the field of an edge map `[z, y, x]` on a whole grid: μ for a map of unit height and lengths in mm ([`unit_mu`]), to a relative
/// residual of `tolerance`, as far as f32 can hold it (see [`Solution::residual`]).
///
/// # Errors
/// [`PipelineError::Cancelled`] if the monitor says so, which is asked at every iteration.
pub fn solve(
    grid: &Grid,
    map: &Array3<f32>,
    mu: f64,
    tolerance: f64,
    workspace: &mut Workspace,
    monitor: &dyn Monitor,
) -> Result<Solution, PipelineError> {
    let Workspace { system, b, right } = workspace;
    let mut result = Solution { field: gradient(grid, map), residual: [0.0; 3], iterations: [0; 3] };
    squared_length(&result.field, b);
    system.set_up(grid.shape, couplings(grid, mu), b);
    for (axis, component) in result.field.components.iter_mut().enumerate() {
        // The gradient itself is the start: exact where b dominates.
        let component = contiguous(component);
        right.clear();
        right.extend(b.iter().zip(&*component).map(|(b, slope)| b * slope));
        let reached = system.solve(right, tolerance, component, || monitor::check(monitor))?;
        (result.residual[axis], result.iterations[axis]) = (reached.residual, reached.iterations);
    }
    Ok(result)
}

/// ∇f by central differences, a mm.
fn gradient(grid: &Grid, map: &Array3<f32>) -> VectorField {
    let [dz, dy, dx] = grid.spacing_mm;
    VectorField {
        grid: *grid,
        components: [central_difference(map, 2, dx), central_difference(map, 1, dy), central_difference(map, 0, dz)],
    }
}

/// b = |∇f|², in memory order.
fn squared_length(field: &VectorField, b: &mut Vec<f32>) {
    let [x, y, z] = &field.components;
    b.clear();
    b.extend(x.iter().zip(y).zip(z).map(|((x, y), z)| x * x + y * y + z * z));
}

/// μ/h² along z, y, x.
fn couplings(grid: &Grid, mu: f64) -> [f32; 3] {
    grid.spacing_mm.map(|h| (mu / (h * h)) as f32)
}

/// The numbers of an array in memory order.
fn contiguous(values: &mut Array3<f32>) -> &mut [f32] {
    if !values.is_standard_layout() {
        *values = values.as_standard_layout().into_owned();
    }
    values.as_slice_mut().unwrap_or_default()
}

/// 1 on the border's voxels, 0 elsewhere.
fn edge_map(window: &Window, border: &Border) -> Array3<f32> {
    let mut map = Array3::zeros(window.grid.shape);
    for point in &border.points {
        map[window.local(point.voxel)] = 1.0;
    }
    map
}
