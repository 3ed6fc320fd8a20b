//! Between a lattice and the coarser one below it: linear interpolation between the coarse voxels' centres, and its transpose.

#![expect(clippy::inline_always, reason = "what vectorised loops call is compiled for their instructions only inside of them")]

use super::lattice::{Board, Lattice};
use crate::pipeline::simd::vectorised;

/// Parts of the voxel that a fine one lies in, and of the one beside it that is nearer.
const NEAR: f32 = 0.75;
const FAR: f32 = 0.25;

/// Two rows of any lattice, with a number more on either side.
pub(super) type Rows = [Vec<f32>; 2];

/// Where a fine index is interpolated from, with the parts: twice the same at the ends, beyond which the nearest counts.
#[inline(always)]
fn sources(fine: usize, halved: bool, coarse_length: usize) -> [(usize, f32); 2] {
    if !halved {
        return [(fine, 1.0), (fine, 0.0)];
    }
    let near = fine / 2;
    let far = if fine.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(coarse_length - 1) };
    [(near, NEAR), (far, FAR)]
}

/// The fine indices that a coarse one is interpolated to, with the parts.
#[inline(always)]
fn targets(coarse: usize, halved: bool, fine_length: usize, coarse_length: usize) -> ([(usize, f32); 4], usize) {
    let (mut found, mut count) = ([(0, 0.0); 4], 0);
    if !halved {
        found[0] = (coarse, 1.0);
        return (found, 1);
    }
    for fine in (2 * coarse).saturating_sub(1)..(2 * coarse + 3).min(fine_length) {
        let part: f32 = sources(fine, true, coarse_length).iter().filter(|(index, _)| *index == coarse).map(|(_, part)| part).sum();
        found[count] = (fine, part);
        count += 1;
    }
    (found, count)
}

vectorised! {
    /// The transpose of [`prolong`], of a residual that is zero but at colour 0.
    pub(super) fn restrict(fine: &Lattice, halved: [bool; 3], residual: &[f32], coarse: &Lattice, result: &mut Board, rows: &mut Rows) {
        let half = fine.half;
        // What rows whose voxels of colour 0 have even and odd x bring, with a zero on either side.
        let [even, odd] = rows;
        let mut sums = [&mut even[..half + 2], &mut odd[..half + 2]];
        for z in 0..coarse.shape[0] {
            let (slices, slice_count) = targets(z, halved[0], fine.shape[0], coarse.shape[0]);
            for y in 0..coarse.shape[1] {
                let (lines, line_count) = targets(y, halved[1], fine.shape[1], coarse.shape[1]);
                for sum in &mut sums {
                    sum.fill(0.0);
                }
                for &(fine_z, of_slice) in &slices[..slice_count] {
                    for &(fine_y, of_row) in &lines[..line_count] {
                        let start = fine.start(fine_z, fine_y);
                        let part = of_slice * of_row;
                        let to = &mut sums[Lattice::parity(fine_z, fine_y, 0)][1..=half];
                        for (to, from) in to.iter_mut().zip(&residual[start..start + half]) {
                            *to += part * from;
                        }
                    }
                }
                let start = coarse.start(z, y);
                let [even, odd] = &mut sums;
                let first = Lattice::parity(z, y, 0);
                if halved[2] {
                    // At the ends the nearest counts for what lies beyond.
                    let (before, after) = (FAR * even[1], if fine.shape[2].is_multiple_of(2) { FAR * odd[half] } else { 0.0 });
                    for i in 1..=half {
                        // In place: what is read of `odd` is one behind what is written.
                        even[i] = NEAR * (even[i] + odd[i]) + FAR * (even[i + 1] + odd[i - 1]);
                    }
                    even[1] += before;
                    even[half] += after;
                    for (colour, board) in result.iter_mut().enumerate() {
                        let parity = first ^ colour;
                        for (to, pair) in board[start..].iter_mut().zip(even[1 + parity..=half].chunks(2)) {
                            *to = pair[0];
                        }
                    }
                } else {
                    for (colour, board) in result.iter_mut().enumerate() {
                        let from = if first ^ colour == 0 { &even[1..=half] } else { &odd[1..=half] };
                        board[start..start + half].copy_from_slice(from);
                    }
                }
            }
        }
    }
}

vectorised! {
    /// Adds what is interpolated from the coarse numbers, in order x, y, z, to the voxels of colour 0.
    pub(super) fn prolong(coarse: &Lattice, numbers: &[f32], fine: &Lattice, halved: [bool; 3], result: &mut [f32], rows: &mut Rows) {
        let [_, coarse_rows, columns] = coarse.shape;
        // With the end's number again on either side.
        let mixed = &mut rows[0][..columns + 2];
        for z in 0..fine.shape[0] {
            for y in 0..fine.shape[1] {
                mixed[1..=columns].fill(0.0);
                for (coarse_z, of_slice) in sources(z, halved[0], coarse.shape[0]) {
                    for (coarse_y, of_row) in sources(y, halved[1], coarse_rows) {
                        let part = of_slice * of_row;
                        if part > 0.0 {
                            let from = &numbers[(coarse_z * coarse_rows + coarse_y) * columns..][..columns];
                            for (to, from) in mixed[1..=columns].iter_mut().zip(from) {
                                *to += part * from;
                            }
                        }
                    }
                }
                mixed[0] = mixed[1];
                mixed[columns + 1] = mixed[columns];
                let parity = Lattice::parity(z, y, 0);
                let voxels = (fine.shape[2] + 1 - parity) / 2;
                let own = &mut result[fine.start(z, y)..][..voxels];
                if halved[2] {
                    let near = &mixed[1..=voxels];
                    let far = &mixed[2 * parity..][..voxels];
                    for ((own, near), far) in own.iter_mut().zip(near).zip(far) {
                        *own += NEAR * near + FAR * far;
                    }
                } else {
                    for (own, pair) in own.iter_mut().zip(mixed[1 + parity..].chunks(2)) {
                        *own += pair[0];
                    }
                }
            }
        }
    }
}
