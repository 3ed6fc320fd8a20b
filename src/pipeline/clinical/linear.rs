//! Small dense positive definite systems, and the arrow-shaped one of a study: a block a gate, bordered by what all gates share.

use rayon::prelude::*;

/// Lower Cholesky factor of a row-major `[n × n]` matrix in place; `None` if it is not positive definite.
fn factorise(mut matrix: Vec<f64>, n: usize) -> Option<Vec<f64>> {
    for j in 0..n {
        for i in j..n {
            let (row_i, row_j) = (i * n, j * n);
            let dot: f64 = matrix[row_i..row_i + j].iter().zip(&matrix[row_j..row_j + j]).map(|(a, b)| a * b).sum();
            let rest = matrix[row_i + j] - dot;
            if i == j {
                if rest <= 0.0 || !rest.is_finite() {
                    return None;
                }
                matrix[row_i + j] = rest.sqrt();
            } else {
                matrix[row_i + j] = rest / matrix[row_j + j];
            }
        }
    }
    Some(matrix)
}

fn forward(factor: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        let dot: f64 = factor[i * n..i * n + i].iter().zip(&x[..i]).map(|(a, b)| a * b).sum();
        x[i] = (x[i] - dot) / factor[i * n + i];
    }
}

fn backward(factor: &[f64], n: usize, x: &mut [f64]) {
    for i in (0..n).rev() {
        x[i] /= factor[i * n + i];
        let (above, at) = x.split_at_mut(i);
        for (value, entry) in above.iter_mut().zip(&factor[i * n..i * n + i]) {
            *value -= entry * at[0];
        }
    }
}

/// Solves `matrix · x = right` for a symmetric positive definite matrix, row-major; `None` if it is not.
pub(super) fn solve_positive(matrix: Vec<f64>, mut right: Vec<f64>) -> Option<Vec<f64>> {
    let n = right.len();
    let factor = factorise(matrix, n)?;
    forward(&factor, n, &mut right);
    backward(&factor, n, &mut right);
    Some(right)
}

/// One gate's part of the normal equations.
#[derive(Debug, Clone)]
pub(super) struct Block {
    /// `[local × local]`.
    pub(super) own: Vec<f64>,
    /// `[local × shared]`.
    pub(super) border: Vec<f64>,
}

/// The normal equations of a study, factorised.
pub(super) struct Arrow {
    local: usize,
    shared: usize,
    /// Cholesky factor of each gate's block, and L⁻¹ · border, column by column `[shared × local]`.
    gates: Vec<(Vec<f64>, Vec<f64>)>,
    /// Cholesky factor of what is left of the shared block.
    corner: Vec<f64>,
}

impl Arrow {
    /// `shared_block` is `[shared × shared]` row-major. `None` if the system is not positive definite.
    pub(super) fn factorise(local: usize, blocks: Vec<Block>, shared_block: Vec<f64>, shared: usize) -> Option<Self> {
        let reduced: Vec<Option<(Vec<f64>, Vec<f64>)>> = blocks
            .into_par_iter()
            .map(|block| {
                let factor = factorise(block.own, local)?;
                let mut columns = vec![0.0; shared * local];
                for (column, x) in columns.chunks_exact_mut(local).enumerate() {
                    for (i, value) in x.iter_mut().enumerate() {
                        *value = block.border[i * shared + column];
                    }
                    forward(&factor, local, x);
                }
                Some((factor, columns))
            })
            .collect();
        let gates = reduced.into_iter().collect::<Option<Vec<_>>>()?;
        let mut corner = shared_block;
        for (_, columns) in &gates {
            for a in 0..shared {
                for b in 0..=a {
                    let (left, right) = (&columns[a * local..][..local], &columns[b * local..][..local]);
                    let dot: f64 = left.iter().zip(right).map(|(x, y)| x * y).sum();
                    corner[a * shared + b] -= dot;
                    if a != b {
                        corner[b * shared + a] -= dot;
                    }
                }
            }
        }
        Some(Self { local, shared, gates, corner: factorise(corner, shared)? })
    }

    /// Solves for right sides `gates` and `shared`, in place.
    pub(super) fn solve(&self, gates: &mut [Vec<f64>], shared: &mut [f64]) {
        for ((factor, columns), x) in self.gates.iter().zip(gates.iter_mut()) {
            forward(factor, self.local, x);
            for (value, column) in shared.iter_mut().zip(columns.chunks_exact(self.local)) {
                *value -= column.iter().zip(x.iter()).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        forward(&self.corner, self.shared, shared);
        backward(&self.corner, self.shared, shared);
        for ((factor, columns), x) in self.gates.iter().zip(gates.iter_mut()) {
            for (value, column) in shared.iter().zip(columns.chunks_exact(self.local)) {
                for (to, entry) in x.iter_mut().zip(column) {
                    *to -= entry * value;
                }
            }
            backward(factor, self.local, x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arrow_solves_what_the_whole_matrix_solves() {
        let (local, shared, gates) = (3, 2, 2);
        let n = gates * local + shared;
        // A · Aᵀ + 4 I of a fixed pattern, its gates uncoupled.
        let entry = |i: usize, j: usize| ((7 * i + 3 * j) % 5) as f64 - 2.0;
        let mut whole = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                let apart = i < gates * local && j < gates * local && i / local != j / local;
                if !apart {
                    whole[i * n + j] = (0..n).map(|k| entry(i, k) * entry(j, k)).sum::<f64>() * 0.1 + if i == j { 12.0 } else { 0.0 };
                }
            }
        }
        let right: Vec<f64> = (0..n).map(|i| i as f64 - 3.0).collect();
        let expected = solve_positive(whole.clone(), right.clone()).unwrap();
        let blocks = (0..gates)
            .map(|g| Block {
                own: (0..local * local).map(|k| whole[(g * local + k / local) * n + g * local + k % local]).collect(),
                border: (0..local * shared).map(|k| whole[(g * local + k / shared) * n + gates * local + k % shared]).collect(),
            })
            .collect();
        let corner = (0..shared * shared).map(|k| whole[(gates * local + k / shared) * n + gates * local + k % shared]).collect();
        let arrow = Arrow::factorise(local, blocks, corner, shared).unwrap();
        let mut of_gates: Vec<Vec<f64>> = (0..gates).map(|g| right[g * local..][..local].to_vec()).collect();
        let mut of_all = right[gates * local..].to_vec();
        arrow.solve(&mut of_gates, &mut of_all);
        for (found, expected) in of_gates.concat().iter().chain(&of_all).zip(&expected) {
            assert!((found - expected).abs() < 1e-10, "{found} {expected}");
        }
    }

    #[test]
    fn what_is_not_positive_is_refused() {
        assert_eq!(solve_positive(vec![1.0, 2.0, 2.0, 1.0], vec![1.0, 1.0]), None);
        assert_eq!(solve_positive(vec![f64::NAN], vec![1.0]), None);
    }
}
