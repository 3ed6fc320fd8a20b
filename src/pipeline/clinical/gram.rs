//! Sums of outer products, for normal equations.

/// Sum of the outer products of rows, lower triangle: single precision within a batch of rows, double between batches.
pub(super) struct Gram {
    n: usize,
    /// Tiles of a row.
    tiles: usize,
    /// `[rows × tiles]`.
    batch: Vec<Tile>,
    /// `[tiles · TILE × tiles · TILE]`.
    sum: Vec<f64>,
}

/// Rows of a batch.
const BATCH: usize = 64;
/// Side of the tiles a batch is multiplied in.
pub(super) const TILE: usize = 8;
type Tile = [f32; TILE];

impl Gram {
    pub(super) fn new(n: usize) -> Self {
        let tiles = n.div_ceil(TILE);
        Self { n, tiles, batch: Vec::with_capacity(BATCH * tiles), sum: vec![0.0; (tiles * TILE).pow(2)] }
    }

    /// Adds a row, filled up with zeros to whole tiles.
    pub(super) fn push(&mut self, row: &[f32]) {
        self.batch.extend_from_slice(row.as_chunks().0);
        if self.batch.len() == BATCH * self.tiles {
            self.flush();
        }
    }

    fn flush(&mut self) {
        let Self { tiles, batch, sum, .. } = self;
        add_outer_products(batch, *tiles, sum);
        batch.clear();
    }

    /// `[n × n]`, lower triangle.
    pub(super) fn finish(mut self) -> Vec<f64> {
        self.flush();
        (0..self.n).flat_map(|i| self.sum[i * self.tiles * TILE..][..self.n].to_vec()).collect()
    }
}

/// Adds the lower triangle of `batchᵀ · batch`, tile by tile. Tiles are arrays, so that whole ones are multiplied and added at once.
fn add_outer_products(batch: &[Tile], tiles: usize, sum: &mut [f64]) {
    for a in 0..tiles {
        for b in 0..=a {
            let mut products = [[0.0_f32; TILE]; TILE];
            for row in batch.chunks_exact(tiles) {
                let (left, right) = (row[a], row[b]);
                for i in 0..TILE {
                    for j in 0..TILE {
                        products[i][j] += left[i] * right[j];
                    }
                }
            }
            for (i, line) in products.iter().enumerate() {
                for (to, &value) in sum[((a * TILE + i) * tiles + b) * TILE..][..TILE].iter_mut().zip(line) {
                    *to += f64::from(value);
                }
            }
        }
    }
}
