//! Sparse symmetric matrices of 3 × 3 blocks, a row a particle, and conjugate gradients on them.

use glam::{DMat3, DVec3};
use std::sync::Arc;

/// A matrix with one 3 × 3 block for each pair of particles in its pattern.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockMatrix {
    /// Where each row's blocks begin; shared, as `columns`, by all matrices of a pattern.
    starts: Arc<[usize]>,
    columns: Arc<[usize]>,
    blocks: Vec<DMat3>,
}

impl Default for BlockMatrix {
    /// Without rows.
    fn default() -> Self {
        Self::zero(&[])
    }
}

impl BlockMatrix {
    /// Zero, with the blocks of each row at these columns, ascending.
    pub fn zero(pattern: &[Vec<usize>]) -> Self {
        let mut starts = vec![0];
        for row in pattern {
            starts.push(starts[starts.len() - 1] + row.len());
        }
        let columns: Arc<[usize]> = pattern.iter().flatten().copied().collect();
        let blocks = vec![DMat3::ZERO; columns.len()];
        Self { starts: starts.into(), columns, blocks }
    }

    /// Adds to a block of the pattern.
    pub fn add(&mut self, row: usize, column: usize, block: DMat3) {
        let start = self.starts[row];
        if let Ok(at) = self.columns[start..self.starts[row + 1]].binary_search(&column) {
            self.blocks[start + at] += block;
        } else {
            debug_assert!(false, "block {row}, {column} is not in the pattern");
        }
    }

    /// This matrix times a, plus another of the same pattern times b, plus `diagonal` on the diagonal.
    #[must_use]
    pub fn combined(mut self, a: f64, other: &Self, b: f64, diagonal: f64) -> Self {
        for (block, other) in self.blocks.iter_mut().zip(&other.blocks) {
            *block = *block * a + *other * b;
        }
        for row in 0..self.rows() {
            self.add(row, row, DMat3::from_diagonal(DVec3::splat(diagonal)));
        }
        self
    }

    /// The product with a vector.
    pub fn times(&self, vector: &[DVec3]) -> Vec<DVec3> {
        (0..self.rows())
            .map(|row| {
                let range = self.starts[row]..self.starts[row + 1];
                self.columns[range.clone()].iter().zip(&self.blocks[range]).map(|(&column, block)| *block * vector[column]).sum()
            })
            .collect()
    }

    fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    fn diagonal(&self, row: usize) -> DMat3 {
        let start = self.starts[row];
        self.columns[start..self.starts[row + 1]].binary_search(&row).map_or(DMat3::ZERO, |at| self.blocks[start + at])
    }
}

/// The matrix is not positive definite: conjugate gradients met a direction without resistance, or what is not a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Indefinite;

/// Solves A x = b by conjugate gradients with the inverse diagonal blocks as preconditioner, x being zero at the `fixed` particles
/// (Baraff & Witkin's filtered method for constraints, §5.3), until the residual in the preconditioner's norm has fallen by `tolerance` or
/// after `most` iterations.
pub fn solve(a: &BlockMatrix, b: &[DVec3], fixed: &[bool], tolerance: f64, most: usize) -> Result<Vec<DVec3>, Indefinite> {
    let free = |vector: Vec<DVec3>| -> Vec<DVec3> {
        vector.into_iter().zip(fixed).map(|(value, &fixed)| if fixed { DVec3::ZERO } else { value }).collect()
    };
    let mut inverses = Vec::with_capacity(b.len());
    for (row, &fixed) in fixed.iter().enumerate() {
        let block = a.diagonal(row);
        if !fixed && !is_positive(block) {
            return Err(Indefinite);
        }
        inverses.push(if fixed { DMat3::ZERO } else { block.inverse() });
    }
    let precondition = |r: &[DVec3]| -> Vec<DVec3> { r.iter().zip(&inverses).map(|(r, inverse)| *inverse * *r).collect() };
    let mut x = vec![DVec3::ZERO; b.len()];
    let mut r = free(b.to_vec());
    let mut z = precondition(&r);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let enough = tolerance * tolerance * rz;
    for _ in 0..most {
        if rz <= enough {
            break;
        }
        let q = free(a.times(&p));
        let resistance = dot(&p, &q);
        // A right-hand side or block that is not a number would otherwise spread to every particle.
        if resistance.is_nan() || resistance <= 0.0 {
            return Err(Indefinite);
        }
        let alpha = rz / resistance;
        for i in 0..b.len() {
            x[i] += p[i] * alpha;
            r[i] -= q[i] * alpha;
        }
        z = precondition(&r);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        for (p, z) in p.iter_mut().zip(&z) {
            *p = *z + *p * beta;
        }
    }
    Ok(x)
}

/// Whether a symmetric block is positive definite: its leading minors are positive (Sylvester).
fn is_positive(block: DMat3) -> bool {
    let [xx, xy, _, _, yy, ..] = block.to_cols_array();
    xx > 0.0 && xx * yy - xy * xy > 0.0 && block.determinant() > 0.0
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain of particles joined by springs of this stiffness to the next, on a floor of 1.
    fn chain(count: usize, stiffness: f64) -> BlockMatrix {
        let pattern: Vec<Vec<usize>> = (0..count).map(|i| (i.saturating_sub(1)..=(i + 1).min(count - 1)).collect()).collect();
        let mut matrix = BlockMatrix::zero(&pattern);
        for i in 1..count {
            for (row, column, sign) in [(i - 1, i - 1, 1.0), (i, i, 1.0), (i - 1, i, -1.0), (i, i - 1, -1.0)] {
                matrix.add(row, column, DMat3::IDENTITY * (sign * stiffness));
            }
        }
        matrix.combined(1.0, &BlockMatrix::zero(&pattern), 0.0, 1.0)
    }

    #[test]
    fn a_solution_solves() {
        let a = chain(50, 300.0);
        let wanted: Vec<DVec3> = (0..50).map(|i| DVec3::new(f64::from(i).sin(), f64::from(i * i % 7), 1.0)).collect();
        let found = solve(&a, &a.times(&wanted), &[false; 50], 1e-12, 500).unwrap();
        let error = found.iter().zip(&wanted).map(|(found, wanted)| found.distance(*wanted)).fold(0.0, f64::max);
        assert!(error < 1e-9, "{error}");
    }

    #[test]
    fn fixed_particles_stay_and_the_others_do_not_see_their_rows() {
        let a = chain(5, 10.0);
        let fixed = [true, false, false, false, true];
        let found = solve(&a, &[DVec3::X; 5], &fixed, 1e-12, 100).unwrap();
        assert_eq!((found[0], found[4]), (DVec3::ZERO, DVec3::ZERO));
        let product = a.times(&found);
        assert!((1..4).all(|row| product[row].distance(DVec3::X) < 1e-9), "{product:?}");
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        assert_eq!(
            solve(&chain(5, -3.0), &[DVec3::X, DVec3::ZERO, DVec3::ZERO, DVec3::Y, DVec3::Z], &[false; 5], 1e-9, 100),
            Err(Indefinite)
        );
    }

    #[test]
    fn what_is_not_a_number_does_not_spread() {
        let mut force = [DVec3::X; 5];
        force[3].y = f64::NAN;
        assert_eq!(solve(&chain(5, 10.0), &force, &[false; 5], 1e-9, 100), Err(Indefinite));
        let fixed = [false, false, false, true, false];
        assert!(solve(&chain(5, 10.0), &force, &fixed, 1e-9, 100).unwrap().iter().all(|change| change.is_finite()));
    }
}
