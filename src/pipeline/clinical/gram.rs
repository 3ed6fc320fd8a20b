//! Sums of outer products, for normal equations.

use crate::pipeline::simd::vectorised;

/// Sum of the outer products of rows, lower triangle: single precision within a batch of rows, double between batches.
pub(super) struct Gram {
    n: usize,
    /// Of the batch at hand, a strip of columns after the other: `[strips × BATCH]`.
    strips: Vec<[Strip; BATCH]>,
    /// Rows in the batch.
    rows: usize,
    /// Strips with anything but zeros in the batch: a voxel far from a part of the wall knows nothing of its parameters.
    used: Vec<bool>,
    /// `[strips · WIDTH × strips · WIDTH]`.
    sum: Vec<f64>,
}

/// Rows of a batch.
const BATCH: usize = 64;
/// Columns of a strip: what the widest registers hold.
pub(super) const WIDTH: usize = 16;
type Strip = [f32; WIDTH];
/// Strips are multiplied with parts of this many columns of another: their products stay in registers.
const HEIGHT: usize = 8;

impl Gram {
    pub(super) fn new(n: usize) -> Self {
        let strips = n.div_ceil(WIDTH);
        Self { n, strips: vec![[[0.0; WIDTH]; BATCH]; strips], rows: 0, used: vec![false; strips], sum: vec![0.0; (strips * WIDTH).pow(2)] }
    }

    /// Adds a row, filled up with zeros to whole strips.
    pub(super) fn push(&mut self, row: &[f32]) {
        for ((strip, used), part) in self.strips.iter_mut().zip(&mut self.used).zip(row.as_chunks().0) {
            strip[self.rows] = *part;
            *used |= part.iter().any(|value| *value != 0.0);
        }
        self.rows += 1;
        if self.rows == BATCH {
            self.flush();
        }
    }

    fn flush(&mut self) {
        add_outer_products(&self.strips, self.rows, &self.used, &mut self.sum);
        self.rows = 0;
        self.used.fill(false);
    }

    /// `[n × n]`, lower triangle.
    pub(super) fn finish(mut self) -> Vec<f64> {
        self.flush();
        let stride = self.strips.len() * WIDTH;
        (0..self.n).flat_map(|i| self.sum[i * stride..][..self.n].to_vec()).collect()
    }
}

vectorised! {
    /// Adds the lower triangle of `batchᵀ · batch`, a part of a strip by a strip at a time.
    fn add_outer_products(strips: &[[Strip; BATCH]], rows: usize, used: &[bool], sum: &mut [f64]) {
        let stride = strips.len() * WIDTH;
        for (a, left) in strips.iter().enumerate().filter(|(a, _)| used[*a]) {
            for (b, right) in strips[..=a].iter().enumerate().filter(|(b, _)| used[*b]) {
                for from in (0..WIDTH).step_by(HEIGHT) {
                    let mut products = [[0.0_f32; WIDTH]; HEIGHT];
                    for (left, right) in left[..rows].iter().zip(&right[..rows]) {
                        for i in 0..HEIGHT {
                            for j in 0..WIDTH {
                                products[i][j] += left[from + i] * right[j];
                            }
                        }
                    }
                    for (i, line) in products.iter().enumerate() {
                        for (to, &value) in sum[(a * WIDTH + from + i) * stride + b * WIDTH..][..WIDTH].iter_mut().zip(line) {
                            *to += f64::from(value);
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::simd::{Level, use_at_most};

    #[test]
    fn the_lower_triangle_is_that_of_the_product_at_every_level() {
        // More than two batches; the third strip is zero in the first of them.
        let (n, rows) = (37, 150);
        let entry =
            |row: usize, column: usize| if row < BATCH && column >= 32 { 0.0 } else { ((row * 31 + column * 17) % 23) as f32 - 11.0 };
        let of_levels: Vec<Vec<f64>> = Level::ALL
            .iter()
            .map(|&most| {
                use_at_most(most);
                let mut gram = Gram::new(n);
                for row in 0..rows {
                    let mut values = [0.0; 48];
                    for (column, value) in values[..n].iter_mut().enumerate() {
                        *value = entry(row, column);
                    }
                    gram.push(&values);
                }
                gram.finish()
            })
            .collect();
        use_at_most(Level::Avx512);
        for i in 0..n {
            for j in 0..=i {
                let exact: f64 = (0..rows).map(|row| f64::from(entry(row, i)) * f64::from(entry(row, j))).sum();
                // Products of small whole numbers: sums are exact.
                assert!(of_levels.iter().all(|sums| sums[i * n + j].to_bits() == (exact + 0.0).to_bits()), "{i}, {j}");
            }
        }
    }
}
