//! Gradient vector flow (paper §5, figure 2; Xu & Prince 1997): the field V that minimises
//! ∫ μ|∇V|² + |∇f|²|V − ∇f|², where f is the map of one border, 1 on it and 0 elsewhere.
//!
//! Its Euler equation is linear: (b − μ∇·∇) V = b ∇f with b = |∇f|², all lengths in mm, and no flow through the faces (Neumann).
//! The matrix is symmetric and positive definite, so the steady state is solved for, by conjugate gradients with the diagonal as
//! preconditioner, to a stated residual; the paper stepped towards it. 5.74 mm between slices against 2.87 mm between pixels is a
//! factor of four in the diffusion that unit spacing would lose.

use super::{PipelineError, borders::Border, canny::central_difference, monitor, monitor::Monitor, parameters::GvfParameters, simd};
use crate::volume::{Grid, VectorField};
use glam::DVec3;
use ndarray::{Array3, Zip};

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

/// Grey levels of the images the paper's μ belongs to. A map scaled by s multiplies b by s², so μ on a map of unit height is μ/s².
const PAPER_GREY_LEVELS: f64 = 255.0;

/// A solve that needs more has stopped converging: 150-390 iterations reach 1e-6 on the paper's grid.
const MAX_ITERATIONS: usize = 4000;

/// The μ of an edge map of unit height and lengths in mm that stands for the paper's.
pub fn unit_mu(paper_mu: f64) -> f64 {
    paper_mu / (PAPER_GREY_LEVELS * PAPER_GREY_LEVELS)
}

/// Solves for the flow of a border around it.
pub fn flow(grid: &Grid, border: &Border, parameters: &GvfParameters, monitor: &dyn Monitor) -> Result<Flow, PipelineError> {
    let window = Window::around(border, grid);
    let grid = window.grid;
    let map = edge_map(&window, border);
    let [dz, dy, dx] = grid.spacing_mm;
    let gradient = [central_difference(&map, 2, dx), central_difference(&map, 1, dy), central_difference(&map, 0, dz)];
    let mut b = Array3::<f32>::zeros(grid.shape);
    for component in &gradient {
        Zip::from(&mut b).and(component).for_each(|b, &g| *b += g * g);
    }
    let system = System::new(grid, b, unit_mu(parameters.mu) as f32);
    let mut result = Flow { window, field: VectorField { grid, components: gradient.clone() }, residual: [0.0; 3], iterations: [0; 3] };
    for (axis, component) in gradient.iter().enumerate() {
        let right = component * &system.b;
        // The gradient itself is the start: exact where b dominates.
        let solved = system.solve(&right, component.clone(), parameters.tolerance, monitor)?;
        result.field.components[axis] = solved.solution;
        result.residual[axis] = solved.residual;
        result.iterations[axis] = solved.iterations;
    }
    Ok(result)
}

/// 1 on the border's voxels, 0 elsewhere.
fn edge_map(window: &Window, border: &Border) -> Array3<f32> {
    let mut map = Array3::zeros(window.grid.shape);
    for point in &border.points {
        map[window.local(point.voxel)] = 1.0;
    }
    map
}

/// b − μ∇·∇ on a grid, as the seven-point stencil with h⁻² per axis.
struct System {
    b: Array3<f32>,
    /// μ/h² along z, y, x.
    weights: [f32; 3],
    diagonal: Array3<f32>,
}

struct Solved {
    solution: Array3<f32>,
    residual: f64,
    iterations: usize,
}

impl System {
    fn new(grid: Grid, b: Array3<f32>, mu: f32) -> Self {
        let weights = grid.spacing_mm.map(|h| mu / (h * h) as f32);
        let mut diagonal = b.clone();
        for ((z, y, x), value) in diagonal.indexed_iter_mut() {
            for (axis, index) in [z, y, x].into_iter().enumerate() {
                let inner = usize::from(index > 0) + usize::from(index + 1 < grid.shape[axis]);
                *value += weights[axis] * inner as f32;
            }
        }
        Self { b, weights, diagonal }
    }

    /// The matrix times a vector. The diagonal holds the number of neighbours, so that faces without one do not flow.
    fn apply(&self, v: &Array3<f32>, result: &mut Array3<f32>) {
        Zip::from(&mut *result).and(&self.diagonal).and(v).for_each(|r, &d, &v| *r = d * v);
        for axis in 0..3 {
            let weight = self.weights[axis];
            let length = v.len_of(ndarray::Axis(axis));
            if length < 2 {
                continue;
            }
            let low = ndarray::Slice::from(..length - 1);
            let high = ndarray::Slice::from(1..);
            let axis = ndarray::Axis(axis);
            result.slice_axis_mut(axis, low).zip_mut_with(&v.slice_axis(axis, high), |r, &v| *r -= weight * v);
            result.slice_axis_mut(axis, high).zip_mut_with(&v.slice_axis(axis, low), |r, &v| *r -= weight * v);
        }
    }

    /// Preconditioned conjugate gradients. Scalars are summed in f64 in memory order: the same result at any thread count.
    fn solve(&self, right: &Array3<f32>, start: Array3<f32>, tolerance: f64, monitor: &dyn Monitor) -> Result<Solved, PipelineError> {
        // √(r·D⁻¹r): the plain norm sees only the voxels at the border, where b is 10³ times μ/h², and would stop before the field has
        // reached anything else.
        let scale = dot(right, &(right / &self.diagonal)).sqrt();
        if scale == 0.0 {
            return Ok(Solved { solution: Array3::zeros(right.raw_dim()), residual: 0.0, iterations: 0 });
        }
        let mut solution = start;
        let mut product = Array3::zeros(right.raw_dim());
        self.apply(&solution, &mut product);
        let mut residual = right - &product;
        let mut preconditioned = &residual / &self.diagonal;
        let mut direction = preconditioned.clone();
        let mut rz = dot(&residual, &preconditioned);
        let mut relative = rz.sqrt() / scale;
        let mut iterations = 0;
        while relative > tolerance && iterations < MAX_ITERATIONS {
            if iterations % 16 == 0 {
                monitor::check(monitor)?;
            }
            self.apply(&direction, &mut product);
            let alpha = (rz / dot(&direction, &product)) as f32;
            solution.zip_mut_with(&direction, |s, &d| *s += alpha * d);
            residual.zip_mut_with(&product, |r, &p| *r -= alpha * p);
            Zip::from(&mut preconditioned).and(&residual).and(&self.diagonal).for_each(|p, &r, &d| *p = r / d);
            let next = dot(&residual, &preconditioned);
            let beta = (next / rz) as f32;
            rz = next;
            direction.zip_mut_with(&preconditioned, |d, &p| *d = p + beta * *d);
            relative = rz.sqrt() / scale;
            iterations += 1;
        }
        Ok(Solved { solution, residual: relative, iterations })
    }
}

fn dot(a: &Array3<f32>, b: &Array3<f32>) -> f64 {
    match (a.as_slice(), b.as_slice()) {
        (Some(a), Some(b)) => simd::dot(a, b),
        _ => a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::pipeline::{borders::BorderPoint, monitor::Silent, parameters::Parameters};

    /// The border of a ball, two voxels thick at most.
    pub(in crate::pipeline) fn sphere(grid: Grid, centre: DVec3, radius: f64) -> Border {
        let thickness = grid.spacing_mm.iter().fold(0.0, |a: f64, &b| a.max(b)) / 2.0;
        let all = Array3::from_elem(grid.shape, ());
        let points = all
            .indexed_iter()
            .map(|((z, y, x), ())| [z, y, x])
            .filter(|&voxel| (grid.position_mm(voxel).distance(centre) - radius).abs() <= thickness)
            .map(|voxel| {
                let out = (grid.position_mm(voxel) - centre).normalize();
                BorderPoint { voxel, position_mm: centre + out * radius, normal: out }
            })
            .collect();
        Border { points }
    }

    #[test]
    fn the_flow_points_at_the_border_from_both_sides_everywhere() {
        let grid = Grid { shape: [20, 36, 36], spacing_mm: [5.0, 2.8, 2.8] };
        let centre = grid.position_mm([10, 18, 18]);
        let border = sphere(grid, centre, 25.0);
        let flow = flow(&grid, &border, &Parameters::paper().gvf, &Silent).unwrap();
        assert!(flow.residual.iter().all(|&residual| residual <= 1e-4), "{:?}", flow.residual);
        for radius in [8.0, 14.0, 31.0, 35.0] {
            for k in 0..24 {
                let (polar, turn) = (f64::from(k) / 24.0 * 2.0 + 0.5, f64::from(k) * 0.7);
                let out = DVec3::new(polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos());
                let field = flow.direction(centre + out * radius);
                let towards = if radius < 25.0 { out } else { -out };
                assert!(field.dot(towards) > 0.75, "r {radius}, {out}: {field}");
            }
        }
    }

    #[test]
    fn the_solution_satisfies_the_equation_of_the_dense_system() {
        // A grid small enough to write the matrix out and check A V = b ∇f entry by entry.
        let grid = Grid { shape: [3, 4, 5], spacing_mm: [2.0, 1.0, 1.5] };
        let b = Array3::from_shape_fn(grid.shape, |(z, y, x)| ((z * 7 + y * 3 + x) % 5) as f32 * 0.1);
        let mu = 0.3_f64;
        let system = System::new(grid, b.clone(), mu as f32);
        let right = Array3::from_shape_fn(grid.shape, |(z, y, x)| ((z + 2 * y + 3 * x) % 4) as f32 - 1.5);
        let v = system.solve(&right, Array3::zeros(grid.shape), 1e-6, &Silent).unwrap().solution;
        for ((z, y, x), &right) in right.indexed_iter() {
            let mut sum = f64::from(b[[z, y, x]]) * f64::from(v[[z, y, x]]);
            for (axis, h) in grid.spacing_mm.into_iter().enumerate() {
                for step in [-1_isize, 1] {
                    let mut other = [z, y, x];
                    let Some(moved) = other[axis].checked_add_signed(step).filter(|&i| i < grid.shape[axis]) else { continue };
                    other[axis] = moved;
                    sum += mu / (h * h) * (f64::from(v[[z, y, x]]) - f64::from(v[other]));
                }
            }
            assert!((sum - f64::from(right)).abs() < 1e-4, "{sum} {right}");
        }
    }
}
