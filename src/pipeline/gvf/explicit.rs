//! The paper's way to the same field: explicit steps of V̇ = b∇f − (b − μ∇·∇)V (Xu & Prince 1997, equations 15 and 16), here in mm. It
//! is the reference that [`solve`](super::solve) is compared with; the pipeline does not use it.

use super::{PipelineError, Solution, contiguous, couplings, gradient, monitor, monitor::Monitor, squared_length};
use crate::{pipeline::simd::vectorised, volume::Grid};
use ndarray::Array3;

/// The time step, as part of the largest that is stable, 2 / (max b + 4 Σ μ/h²).
const OF_STABLE: f64 = 0.98;
/// Steps from one look at the residual to the next.
const LOOK: usize = 50;

/// Steps from ∇f until the relative residual of every component is at most `tolerance`, or `most` times: map and μ as for
/// [`solve`](super::solve), and the same residual.
///
/// # Errors
/// [`PipelineError::Cancelled`] if the monitor says so, which is asked at every fiftieth step.
pub fn run(grid: &Grid, map: &Array3<f32>, mu: f64, tolerance: f64, most: usize, monitor: &dyn Monitor) -> Result<Solution, PipelineError> {
    let mut result = Solution { field: gradient(grid, map), residual: [0.0; 3], iterations: [0; 3] };
    let mut b = Vec::new();
    squared_length(&result.field, &mut b);
    let weights = couplings(grid, mu);
    let largest = b.iter().copied().fold(0.0, f32::max);
    let step = (OF_STABLE * 2.0 / (f64::from(largest) + 4.0 * weights.iter().map(|&weight| f64::from(weight)).sum::<f64>())) as f32;
    let lanes = Lanes { shape: grid.shape, weights: weights.map(|weight| step * weight) };
    let diagonal = lanes.diagonal(&b, step);
    let keep: Vec<f32> = diagonal.iter().map(|diagonal| 1.0 - diagonal).collect();
    for (axis, component) in result.field.components.iter_mut().enumerate() {
        let source: Vec<f32> = b.iter().zip(&*component).map(|(b, slope)| step * b * slope).collect();
        let scale = change(&source, None, &diagonal);
        let mut now = lanes.padded(contiguous(component));
        let mut next = now.clone();
        let mut steps = 0;
        loop {
            if scale <= 0.0 {
                break;
            }
            if steps % LOOK == 0 || steps == most {
                monitor::check(monitor)?;
                advance(&lanes, &now, &keep, &source, &mut next);
                result.residual[axis] = (change(lanes.inner(&next), Some(lanes.inner(&now)), &diagonal) / scale).sqrt();
                if result.residual[axis] <= tolerance || steps >= most {
                    break;
                }
            } else {
                advance(&lanes, &now, &keep, &source, &mut next);
            }
            std::mem::swap(&mut now, &mut next);
            steps += 1;
        }
        result.iterations[axis] = steps;
        contiguous(component).copy_from_slice(if scale > 0.0 { lanes.inner(&now) } else { &source });
    }
    Ok(result)
}

/// Numbers in memory order with one slice of zeros before and after them, so that every neighbour has a place.
struct Lanes {
    shape: [usize; 3],
    /// Δt μ/h² along z, y, x.
    weights: [f32; 3],
}

impl Lanes {
    fn slice(&self) -> usize {
        self.shape[1] * self.shape[2]
    }

    fn padded(&self, values: &[f32]) -> Vec<f32> {
        let none = vec![0.0; self.slice()];
        [&none, values, &none].concat()
    }

    fn inner<'a>(&self, padded: &'a [f32]) -> &'a [f32] {
        &padded[self.slice()..padded.len() - self.slice()]
    }

    /// Δt times the diagonal of b − μ∇·∇.
    fn diagonal(&self, b: &[f32], step: f32) -> Vec<f32> {
        let inner = |index: usize, length: usize| (usize::from(index > 0) + usize::from(index + 1 < length)) as f32;
        let [_, rows, columns] = self.shape;
        let place = |number: usize| [number / columns / rows, number / columns % rows, number % columns];
        let flows = |number: usize| (0..3).map(|axis| self.weights[axis] * inner(place(number)[axis], self.shape[axis])).sum::<f32>();
        b.iter().enumerate().map(|(number, b)| step * b + flows(number)).collect()
    }
}

/// Σ (a − b)²/d.
fn change(a: &[f32], b: Option<&[f32]>, diagonal: &[f32]) -> f64 {
    let squares = a.iter().zip(diagonal).enumerate().filter(|(_, (_, diagonal))| **diagonal > 0.0).map(|(i, (a, diagonal))| {
        let difference = f64::from(a - b.map_or(0.0, |b| b[i]));
        difference * difference / f64::from(*diagonal)
    });
    squares.sum()
}

vectorised! {
    /// One step of every voxel.
    fn advance(lanes: &Lanes, now: &[f32], keep: &[f32], source: &[f32], next: &mut [f32]) {
        let [slices, rows, columns] = lanes.shape;
        let [wz, wy, wx] = lanes.weights;
        let slice = rows * columns;
        for z in 0..slices {
            for y in 0..rows {
                let inner = (z * rows + y) * columns;
                let start = inner + slice;
                let row = |start: usize| &now[start..start + columns];
                // A row outside counts for nothing: the slice of zeros is one.
                let (here, below, above) = (row(start), row(start - slice), row(start + slice));
                let before = if y > 0 { row(start - columns) } else { row(0) };
                let after = if y + 1 < rows { row(start + columns) } else { row(0) };
                let (keep, source) = (&keep[inner..inner + columns], &source[inner..inner + columns]);
                let next = &mut next[start..start + columns];
                for x in 1..columns.max(1) - 1 {
                    let drawn = wx * (here[x - 1] + here[x + 1]) + wy * (before[x] + after[x]) + wz * (below[x] + above[x]);
                    next[x] = keep[x] * here[x] + (source[x] + drawn);
                }
                for x in [0, columns - 1] {
                    let left = if x > 0 { here[x - 1] } else { 0.0 };
                    let right = if x + 1 < columns { here[x + 1] } else { 0.0 };
                    let drawn = wx * (left + right) + wy * (before[x] + after[x]) + wz * (below[x] + above[x]);
                    next[x] = keep[x] * here[x] + (source[x] + drawn);
                }
            }
        }
    }
}
