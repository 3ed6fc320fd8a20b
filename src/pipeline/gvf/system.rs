//! Conjugate gradients for (b − μ∇·∇) V = right on the voxels of one colour.
//!
//! A voxel's neighbours all have the other colour, so the voxels of colour 1 follow from those of colour 0 one by one: what is left for
//! colour 0 is a system of half the size, symmetric and positive definite as the whole one, and its residual is all that the whole one
//! has. One multigrid cycle is its preconditioner (Golub & Van Loan, Matrix Computations, 4th ed., §11.5).

use super::{
    lattice::{Board, advance, reduced, relax, residual, turn},
    multigrid::{Floor, Hierarchy},
};
use crate::pipeline::simd::dot;

/// A solve that needs more has stopped converging: about four reach 10⁻⁴, fifteen what f32 can hold.
pub(super) const MOST_ITERATIONS: usize = 60;
/// Starts from what has been found, where the true residual is not yet the one that the iterations kept.
const MOST_STARTS: usize = 3;
/// A start must bring the true residual below this part of what it was, else f32 holds no more.
const WORTH_ANOTHER: f64 = 0.5;

/// How well a system was solved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reached {
    /// ‖right − A x‖ / ‖right‖, computed from the x that is returned, both norms weighted by the inverse diagonal.
    pub(super) residual: f64,
    pub(super) iterations: usize,
}

/// A matrix, the hierarchy that preconditions it, and the vectors of conjugate gradients. Memory is used again by the next problem.
#[derive(Debug, Default)]
pub(super) struct System {
    hierarchy: Hierarchy,
    right: Board,
    solution: Board,
    direction: Vec<f32>,
    product: Vec<f32>,
}

impl System {
    /// Sets up the matrix of b and couplings μ/h² along z, y, x.
    pub(super) fn set_up(&mut self, shape: [usize; 3], weights: [f32; 3], b: &[f32]) {
        self.hierarchy.set_up(shape, weights, b);
    }

    /// Bytes that are kept.
    pub(super) fn bytes(&self) -> usize {
        let vectors = self.right.iter().chain(&self.solution).chain([&self.direction, &self.product]);
        self.hierarchy.bytes() + vectors.map(Vec::capacity).sum::<usize>() * size_of::<f32>()
    }

    /// Solves for one right side, from what is in `solution`; `check` is asked before each iteration.
    pub(super) fn solve<E>(
        &mut self,
        right: &[f32],
        tolerance: f64,
        solution: &mut [f32],
        check: impl Fn() -> Result<(), E>,
    ) -> Result<Reached, E> {
        let finest = self.hierarchy.finest();
        finest.lattice.split(right, &mut self.right);
        finest.lattice.split(solution, &mut self.solution);
        finest.lattice.clear(&mut finest.right[1]);
        finest.lattice.clear(&mut self.direction);
        finest.lattice.clear(&mut self.product);
        // √(r·D⁻¹r): the plain norm sees only the voxels at the border, where b is 10³ times μ/h², and would stop before the field has
        // reached anything else.
        let scale = (0..2).map(|colour| weighted_square(&self.right[colour], &finest.inverse[colour])).sum::<f64>().sqrt();
        let mut reached = Reached { residual: 0.0, iterations: 0 };
        if scale == 0.0 {
            solution.fill(0.0);
            return Ok(reached);
        }
        reached.residual = f64::INFINITY;
        for _ in 0..MOST_STARTS {
            self.follow();
            let left = self.iterate(tolerance * scale, &mut reached.iterations, &check)?;
            self.follow();
            let before = std::mem::replace(&mut reached.residual, self.missing().sqrt() / scale);
            let stuck = reached.residual > WORTH_ANOTHER * before || left > tolerance * scale;
            if reached.residual <= tolerance || stuck {
                break;
            }
        }
        self.hierarchy.finest().lattice.join(&self.solution, solution);
        Ok(reached)
    }

    /// Conjugate gradients from the present solution, until the residual that they keep has fallen to `enough`; returns it.
    fn iterate<E>(&mut self, enough: f64, iterations: &mut usize, check: &impl Fn() -> Result<(), E>) -> Result<f64, E> {
        let finest = self.hierarchy.finest();
        let Floor { lattice, diagonal, inverse, right: left, .. } = finest;
        let mut norm = residual(lattice, 0, &self.solution, &self.right[0], &diagonal[0], &inverse[0], &mut left[0]).sqrt();
        let mut rz = 0.0;
        while norm > enough && *iterations < MOST_ITERATIONS {
            check()?;
            self.hierarchy.cycle();
            let Floor { lattice, diagonal, inverse, right: left, found, .. } = self.hierarchy.finest();
            let next = dot(&left[0], &found[0]);
            let beta = if rz > 0.0 { next / rz } else { 0.0 };
            rz = next;
            turn(&mut self.direction, &found[0], beta as f32);
            // What the direction draws the other colour to; `left[1]` is zero.
            relax(lattice, 1, &mut found[1], &self.direction, &left[1], &inverse[1]);
            let resistance = reduced(lattice, &self.direction, &found[1], &diagonal[0], &inverse[0], &mut self.product);
            let alpha = rz / resistance;
            if !(alpha.is_finite() && rz > 0.0) {
                break;
            }
            norm = advance(&mut self.solution[0], &mut left[0], &self.direction, &self.product, &inverse[0], alpha as f32).sqrt();
            *iterations += 1;
        }
        Ok(norm)
    }

    /// Lets the voxels of colour 1 follow from those of colour 0.
    fn follow(&mut self) {
        let Floor { lattice, inverse, .. } = self.hierarchy.finest();
        let [own, other] = &mut self.solution;
        relax(lattice, 1, other, own, &self.right[1], &inverse[1]);
    }

    /// Σ r²/d of the present solution over all voxels.
    fn missing(&mut self) -> f64 {
        let Floor { lattice, diagonal, inverse, residual: scratch, .. } = self.hierarchy.finest();
        (0..2)
            .map(|colour| residual(lattice, colour, &self.solution, &self.right[colour], &diagonal[colour], &inverse[colour], scratch))
            .sum()
    }
}

fn weighted_square(values: &[f32], weights: &[f32]) -> f64 {
    values.iter().zip(weights).map(|(&value, &weight)| f64::from(value) * f64::from(value) * f64::from(weight)).sum()
}
