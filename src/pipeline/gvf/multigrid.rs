//! Multigrid for (b − μ∇·∇) V = right: relaxation takes out of the error what changes from voxel to voxel, coarser lattices the rest.
//!
//! Neighbours far apart are coupled weakly, and relaxation does not smooth along them; so only those axes are halved whose coupling is
//! near the strongest (semi-coarsening). A coarse lattice has the equation of its own spacing, multiplied by the volume of its voxels, and
//! the sum of b over the voxels that each stands for.
//!
//! Alone it converges only as long as b on the coarse lattices is not far too small, which nothing warrants; so it is the preconditioner
//! of conjugate gradients (`system`), and the same forwards and backwards, as these need it.

use super::{
    lattice::{Board, Lattice, product, relax, residual},
    transfer::{Rows, prolong, restrict},
};

/// Axes whose coupling is at least this part of the strongest are halved.
const STRONG: f32 = 0.5;
/// A lattice of no more voxels is not halved again.
const COARSEST_VOXELS: usize = 16;
/// Relaxations of it, both colours forwards, then as many backwards.
const COARSEST_SWEEPS: usize = 2;
/// On so many of the finest lattices the error is sought twice on the next coarser one (W-cycle).
const TWICE: usize = 2;

/// A lattice of the hierarchy, the matrix on it, and what is solved there.
#[derive(Debug, Default)]
pub(super) struct Floor {
    pub(super) lattice: Lattice,
    /// Axes that the next lattice halves.
    halved: [bool; 3],
    pub(super) diagonal: Board,
    /// One over the diagonal; 0 beyond the voxels.
    pub(super) inverse: Board,
    pub(super) right: Board,
    pub(super) found: Board,
    /// The residual at the voxels of colour 0.
    pub(super) residual: Vec<f32>,
}

/// The lattices over each other, and what passing from one to the next takes. Memory is used again by the next problem.
#[derive(Debug, Default)]
pub(super) struct Hierarchy {
    /// The finest first. Only the first `used` belong to the present problem.
    pub(super) floors: Vec<Floor>,
    used: usize,
    between: Between,
    /// b of a lattice and of the one below it.
    sums: [Vec<f32>; 2],
}

/// What passing from one lattice to the next takes.
#[derive(Debug, Default)]
struct Between {
    /// Numbers of one lattice in order x, y, z.
    numbers: Vec<f32>,
    rows: Rows,
}

impl Hierarchy {
    /// Sets up the lattices over one with couplings μ/h² along z, y, x.
    pub(super) fn set_up(&mut self, shape: [usize; 3], weights: [f32; 3], b: &[f32]) {
        let mut lattice = Lattice::new(shape, weights);
        let Between { numbers, rows } = &mut self.between;
        numbers.clear();
        numbers.resize(lattice.voxels(), 0.0);
        for row in rows {
            row.clear();
            row.resize(shape[2] + 2, 0.0);
        }
        self.sums[0].clear();
        self.sums[0].extend_from_slice(b);
        self.used = 0;
        loop {
            let long = |axis: usize| lattice.shape[axis] > 1;
            let strongest = (0..3).filter(|&axis| long(axis)).map(|axis| lattice.weights[axis]).fold(0.0, f32::max);
            let halved = std::array::from_fn(|axis| long(axis) && lattice.weights[axis] >= STRONG * strongest);
            let next = (lattice.voxels() > COARSEST_VOXELS).then(|| {
                let [b, sums] = &mut self.sums;
                coarser(&lattice, b, halved, sums)
            });
            if self.floors.len() == self.used {
                self.floors.push(Floor::default());
            }
            self.floors[self.used].set_up(lattice, halved, &self.sums[0], &mut self.between.numbers);
            self.used += 1;
            self.sums.swap(0, 1);
            match next {
                Some(coarser) => lattice = coarser,
                None => break,
            }
        }
    }

    /// The finest lattice.
    pub(super) fn finest(&mut self) -> &mut Floor {
        &mut self.floors[0]
    }

    /// One cycle from zero on the finest lattice: an approximate solution of its right side.
    pub(super) fn cycle(&mut self) {
        cycle(&mut self.floors[..self.used], &mut self.between, 0);
    }

    /// Bytes that are kept.
    pub(super) fn bytes(&self) -> usize {
        let of_floor = |floor: &Floor| {
            let boards = [&floor.diagonal, &floor.inverse, &floor.right, &floor.found];
            boards.into_iter().flatten().map(Vec::capacity).sum::<usize>() + floor.residual.capacity()
        };
        let numbers = self.floors.iter().map(of_floor).sum::<usize>() + self.between.numbers.capacity();
        (numbers + self.sums.iter().map(Vec::capacity).sum::<usize>()) * size_of::<f32>()
    }
}

/// One cycle from zero, the same forwards and backwards.
fn cycle(floors: &mut [Floor], between: &mut Between, depth: usize) {
    let Some((floor, beyond)) = floors.split_first_mut() else { return };
    product(&floor.right[0], &floor.inverse[0], &mut floor.found[0]);
    if beyond.is_empty() {
        // Two colours are relaxed in turn, so that backwards is the same without its first half.
        for _ in 0..2 * COARSEST_SWEEPS {
            floor.relax(1);
            floor.relax(0);
        }
        return;
    }
    for _ in 0..if (1..=TWICE).contains(&depth) { 2 } else { 1 } {
        floor.relax(1);
        floor.correct(beyond, between, depth);
        floor.relax(1);
        floor.relax(0);
    }
}

impl Floor {
    fn set_up(&mut self, lattice: Lattice, halved: [bool; 3], b: &[f32], numbers: &mut [f32]) {
        let [slices, rows, columns] = lattice.shape;
        let inner = |index: usize, length: usize| (usize::from(index > 0) + usize::from(index + 1 < length)) as f32;
        let [wz, wy, wx] = lattice.weights;
        let numbers = &mut numbers[..lattice.voxels()];
        for (number, (diagonal, b)) in numbers.chunks_exact_mut(columns).zip(b.chunks_exact(columns)).enumerate() {
            let across = wz * inner(number / rows, slices) + wy * inner(number % rows, rows);
            for (diagonal, b) in diagonal.iter_mut().zip(b) {
                *diagonal = b + (across + 2.0 * wx);
            }
            // The first and the last voxel have a neighbour less each.
            diagonal[0] = b[0] + (across + wx * inner(0, columns));
            diagonal[columns - 1] = b[columns - 1] + (across + wx * inner(columns - 1, columns));
        }
        lattice.split(numbers, &mut self.diagonal);
        for number in numbers.iter_mut() {
            *number = if *number > 0.0 { 1.0 / *number } else { 0.0 };
        }
        lattice.split(numbers, &mut self.inverse);
        for colour in self.right.iter_mut().chain(&mut self.found).chain([&mut self.residual]) {
            lattice.clear(colour);
        }
        (self.lattice, self.halved) = (lattice, halved);
    }

    /// Solves for the voxels of one colour with the others as they are.
    pub(super) fn relax(&mut self, colour: usize) {
        let [first, second] = &mut self.found;
        let (own, other) = if colour == 0 { (first, second) } else { (second, first) };
        relax(&self.lattice, colour, own, other, &self.right[colour], &self.inverse[colour]);
    }

    /// Seeks the error, where colour 1 has been relaxed last, on the coarser lattices, and takes it from colour 0; what colour 1 would be
    /// corrected by is overwritten when it is relaxed next.
    fn correct(&mut self, coarser: &mut [Self], between: &mut Between, depth: usize) {
        residual(&self.lattice, 0, &self.found, &self.right[0], &self.diagonal[0], &self.inverse[0], &mut self.residual);
        let next = &mut coarser[0];
        restrict(&self.lattice, self.halved, &self.residual, &next.lattice, &mut next.right, &mut between.rows);
        cycle(coarser, between, depth + 1);
        let next = &coarser[0];
        let numbers = &mut between.numbers[..next.lattice.voxels()];
        next.lattice.join(&next.found, numbers);
        prolong(&next.lattice, numbers, &self.lattice, self.halved, &mut self.found[0], &mut between.rows);
    }
}

/// The lattice of every second voxel along the halved axes, and b on it. Voxels of twice the width have twice the faces across the other
/// axes, and half the gradient along their own.
fn coarser(fine: &Lattice, b: &[f32], halved: [bool; 3], sums: &mut Vec<f32>) -> Lattice {
    let shape: [usize; 3] = std::array::from_fn(|axis| if halved[axis] { fine.shape[axis].div_ceil(2) } else { fine.shape[axis] });
    let volume: f32 = halved.iter().map(|&halved| if halved { 2.0 } else { 1.0 }).product();
    let weights = std::array::from_fn(|axis| fine.weights[axis] * volume / if halved[axis] { 4.0 } else { 1.0 });
    let [by_z, by_y, by_x] = halved.map(usize::from);
    sums.clear();
    sums.resize(shape.iter().product(), 0.0);
    for (number, b) in b.chunks_exact(fine.shape[2]).enumerate() {
        let (z, y) = (number / fine.shape[1], number % fine.shape[1]);
        let sums = &mut sums[((z >> by_z) * shape[1] + (y >> by_y)) * shape[2]..][..shape[2]];
        for (sum, b) in sums.iter_mut().zip(b.chunks(1 << by_x)) {
            *sum += b.iter().sum::<f32>();
        }
    }
    Lattice::new(shape, weights)
}
