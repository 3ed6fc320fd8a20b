//! Where the solver keeps its numbers: the voxels of a lattice like a chess board, each colour in an array of its own.
//!
//! A voxel has the colour of the parity of z + y + x. All its neighbours have the other colour, so that one colour can be relaxed at once
//! from the other. A row holds every second voxel of a colour, so it is contiguous, and rows are padded with zeros to whole vectors:
//! faces of the lattice need no case of their own, since a neighbour that is not there is a zero.

#![expect(clippy::inline_always, reason = "what vectorised loops call is compiled for their instructions only inside of them")]

use crate::pipeline::simd::vectorised;

/// Numbers that are worked on at once.
pub(super) const LANES: usize = 8;

/// Zeros before the first row, which may be read one place before its start.
const LEAD: usize = LANES;

/// One number a voxel, those of either colour apart.
pub(super) type Board = [Vec<f32>; 2];

/// The size of a lattice and how strongly neighbours are coupled.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Lattice {
    /// Voxels along z, y, x.
    pub(super) shape: [usize; 3],
    /// Coupling of neighbours along z, y, x.
    pub(super) weights: [f32; 3],
    /// Voxels of a colour in a row, at most.
    pub(super) half: usize,
    /// Numbers from one row to the next.
    stride: usize,
    /// A row outside.
    zeros: Vec<f32>,
}

impl Lattice {
    pub(super) fn new(shape: [usize; 3], weights: [f32; 3]) -> Self {
        let half = shape[2].div_ceil(2);
        let stride = (half + 1).next_multiple_of(LANES);
        Self { shape, weights, half, stride, zeros: vec![0.0; stride] }
    }

    pub(super) fn voxels(&self) -> usize {
        self.shape.iter().product()
    }

    /// Zero at every voxel of a colour, in what was allocated before.
    pub(super) fn clear(&self, colour: &mut Vec<f32>) {
        colour.clear();
        colour.resize(2 * LEAD + self.shape[0] * self.shape[1] * self.stride, 0.0);
    }

    /// Where a row begins in the array of its colour.
    pub(super) fn start(&self, z: usize, y: usize) -> usize {
        LEAD + (z * self.shape[1] + y) * self.stride
    }

    /// Whether the voxels of a colour in a row have even (0) or odd (1) x.
    pub(super) fn parity(z: usize, y: usize, colour: usize) -> usize {
        (z + y + colour) & 1
    }

    /// Numbers of a row that are worked on: whole vectors, of which those beyond the voxels are and stay zero.
    fn length(&self) -> usize {
        self.half.next_multiple_of(LANES)
    }

    /// Numbers in order x, y, z → board.
    pub(super) fn split(&self, values: &[f32], board: &mut Board) {
        for colour in board.iter_mut() {
            self.clear(colour);
        }
        let [first, second] = board;
        split(self, values, first, second);
    }

    /// Board → numbers in order x, y, z.
    pub(super) fn join(&self, board: &Board, values: &mut [f32]) {
        join(self, &board[0], &board[1], values);
    }

    /// The six neighbours of the voxels of a colour in a row: whole rows of the other colour's array, shifted by a place for one.
    #[inline(always)]
    fn around<'a>(&'a self, other: &'a [f32], z: usize, y: usize, colour: usize) -> [&'a [[f32; LANES]]; 6] {
        let (start, length) = (self.start(z, y), self.length());
        let row = |start: usize| other[start..start + length].as_chunks::<LANES>().0;
        let none = self.zeros[..length].as_chunks::<LANES>().0;
        let slice = self.shape[1] * self.stride;
        [
            row(start),
            row(if Self::parity(z, y, colour) == 0 { start - 1 } else { start + 1 }),
            if y > 0 { row(start - self.stride) } else { none },
            if y + 1 < self.shape[1] { row(start + self.stride) } else { none },
            if z > 0 { row(start - slice) } else { none },
            if z + 1 < self.shape[0] { row(start + slice) } else { none },
        ]
    }

    /// The part of an array that belongs to a row, in vectors.
    #[inline(always)]
    fn row<'a>(&self, numbers: &'a [f32], z: usize, y: usize) -> &'a [[f32; LANES]] {
        let start = self.start(z, y);
        numbers[start..start + self.length()].as_chunks::<LANES>().0
    }

    #[inline(always)]
    fn row_mut<'a>(&self, numbers: &'a mut [f32], z: usize, y: usize) -> &'a mut [[f32; LANES]] {
        let start = self.start(z, y);
        numbers[start..start + self.length()].as_chunks_mut::<LANES>().0
    }
}

/// `right` and what flows in from the neighbours, for one vector of voxels.
#[inline(always)]
fn drawn(right: &[f32; LANES], around: &[&[[f32; LANES]]; 6], chunk: usize, [wz, wy, wx]: [f32; 3]) -> [f32; LANES] {
    let [a, b, c, d, e, f] = around.map(|row| &row[chunk]);
    std::array::from_fn(|i| right[i] + (wx * (a[i] + b[i]) + wy * (c[i] + d[i]) + wz * (e[i] + f[i])))
}

vectorised! {
    /// Solves for the voxels of one colour with the others as they are (Gauss-Seidel).
    pub(super) fn relax(lattice: &Lattice, colour: usize, own: &mut [f32], other: &[f32], right: &[f32], inverse: &[f32]) {
        for z in 0..lattice.shape[0] {
            for y in 0..lattice.shape[1] {
                let around = lattice.around(other, z, y, colour);
                let (right, inverse) = (lattice.row(right, z, y), lattice.row(inverse, z, y));
                for (chunk, own) in lattice.row_mut(own, z, y).iter_mut().enumerate() {
                    let drawn = drawn(&right[chunk], &around, chunk, lattice.weights);
                    *own = std::array::from_fn(|i| drawn[i] * inverse[chunk][i]);
                }
            }
        }
    }
}

vectorised! {
    /// What is missing to the solution, right − A x, at the voxels of one colour; returns Σ r²/d over them, d the diagonal.
    pub(super) fn residual(
        lattice: &Lattice, colour: usize, board: &Board, right: &[f32], diagonal: &[f32], inverse: &[f32], result: &mut [f32],
    ) -> f64 {
        let mut total = 0.0;
        for z in 0..lattice.shape[0] {
            for y in 0..lattice.shape[1] {
                let around = lattice.around(&board[1 - colour], z, y, colour);
                let (right, diagonal, inverse) = (lattice.row(right, z, y), lattice.row(diagonal, z, y), lattice.row(inverse, z, y));
                let own = lattice.row(&board[colour], z, y);
                let mut sums = [0.0_f32; LANES];
                for (chunk, result) in lattice.row_mut(result, z, y).iter_mut().enumerate() {
                    let drawn = drawn(&right[chunk], &around, chunk, lattice.weights);
                    for i in 0..LANES {
                        // Beyond the voxels the diagonal's inverse is zero, and so must the residual be.
                        let missing = drawn[i] - diagonal[chunk][i] * own[chunk][i];
                        result[i] = if inverse[chunk][i] > 0.0 { missing } else { 0.0 };
                        sums[i] += missing * missing * inverse[chunk][i];
                    }
                }
                total += f64::from(sums.iter().sum::<f32>());
            }
        }
        total
    }
}

vectorised! {
    /// d p − N t at the voxels of colour 0, where t is what p draws the other colour to; returns p · result.
    pub(super) fn reduced(lattice: &Lattice, p: &[f32], t: &[f32], diagonal: &[f32], inverse: &[f32], result: &mut [f32]) -> f64 {
        let none = [0.0; LANES];
        let mut total = 0.0;
        for z in 0..lattice.shape[0] {
            for y in 0..lattice.shape[1] {
                let around = lattice.around(t, z, y, 0);
                let (p, diagonal, inverse) = (lattice.row(p, z, y), lattice.row(diagonal, z, y), lattice.row(inverse, z, y));
                let mut sums = [0.0_f32; LANES];
                for (chunk, result) in lattice.row_mut(result, z, y).iter_mut().enumerate() {
                    let drawn = drawn(&none, &around, chunk, lattice.weights);
                    for i in 0..LANES {
                        let value = diagonal[chunk][i] * p[chunk][i] - drawn[i];
                        result[i] = if inverse[chunk][i] > 0.0 { value } else { 0.0 };
                        sums[i] += p[chunk][i] * result[i];
                    }
                }
                total += f64::from(sums.iter().sum::<f32>());
            }
        }
        total
    }
}

vectorised! {
    /// Element by element.
    pub(super) fn product(a: &[f32], b: &[f32], result: &mut [f32]) {
        for ((result, a), b) in result.iter_mut().zip(a).zip(b) {
            *result = a * b;
        }
    }
}

vectorised! {
    /// p ← z + β p.
    pub(super) fn turn(p: &mut [f32], z: &[f32], beta: f32) {
        for (p, z) in p.iter_mut().zip(z) {
            *p = z + beta * *p;
        }
    }
}

vectorised! {
    /// x ← x + α p, r ← r − α q; returns Σ r²/d.
    pub(super) fn advance(x: &mut [f32], r: &mut [f32], p: &[f32], q: &[f32], inverse: &[f32], alpha: f32) -> f64 {
        const BLOCK: usize = 64 * LANES;
        let mut total = 0.0;
        for ((((x, r), p), q), inverse) in
            x.chunks_mut(BLOCK).zip(r.chunks_mut(BLOCK)).zip(p.chunks(BLOCK)).zip(q.chunks(BLOCK)).zip(inverse.chunks(BLOCK))
        {
            let mut sums = [0.0_f32; LANES];
            let (x, r) = (x.as_chunks_mut::<LANES>().0, r.as_chunks_mut::<LANES>().0);
            let (p, q, inverse) = (p.as_chunks::<LANES>().0, q.as_chunks::<LANES>().0, inverse.as_chunks::<LANES>().0);
            for ((((x, r), p), q), inverse) in x.iter_mut().zip(r).zip(p).zip(q).zip(inverse) {
                for i in 0..LANES {
                    x[i] += alpha * p[i];
                    r[i] -= alpha * q[i];
                    sums[i] += r[i] * r[i] * inverse[i];
                }
            }
            total += f64::from(sums.iter().sum::<f32>());
        }
        total
    }
}

vectorised! {
    fn split(lattice: &Lattice, values: &[f32], first: &mut [f32], second: &mut [f32]) {
        for (number, row) in values.chunks_exact(lattice.shape[2]).enumerate() {
            let (z, y) = (number / lattice.shape[1], number % lattice.shape[1]);
            let start = lattice.start(z, y);
            let (first, second) = (&mut first[start..start + lattice.half], &mut second[start..start + lattice.half]);
            let (even, odd) = if Lattice::parity(z, y, 0) == 0 { (first, second) } else { (second, first) };
            let (pairs, single) = row.as_chunks::<2>();
            for ((even, odd), pair) in even.iter_mut().zip(odd).zip(pairs) {
                (*even, *odd) = (pair[0], pair[1]);
            }
            if let (Some(last), [single]) = (even.last_mut(), single) {
                *last = *single;
            }
        }
    }
}

vectorised! {
    fn join(lattice: &Lattice, first: &[f32], second: &[f32], values: &mut [f32]) {
        for (number, row) in values.chunks_exact_mut(lattice.shape[2]).enumerate() {
            let (z, y) = (number / lattice.shape[1], number % lattice.shape[1]);
            let start = lattice.start(z, y);
            let (first, second) = (&first[start..start + lattice.half], &second[start..start + lattice.half]);
            let (even, odd) = if Lattice::parity(z, y, 0) == 0 { (first, second) } else { (second, first) };
            let (pairs, single) = row.as_chunks_mut::<2>();
            for ((even, odd), pair) in even.iter().zip(odd).zip(pairs) {
                *pair = [*even, *odd];
            }
            if let (Some(last), [single]) = (even.last(), single) {
                *single = *last;
            }
        }
    }
}
