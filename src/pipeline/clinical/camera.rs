//! What becomes of a scene's nodes on the voxels: each a Gaussian, cut off where little is left of it.

use super::{
    exposure::{Activity, Crop},
    film::{Derived, Film, LANES, NOT_COMPARED, STEP},
    shape::{BASE, STRIDE},
};
use crate::pipeline::simd::{exp, vectorised};
use glam::DVec3;
use std::f64::consts::TAU;

/// A Gaussian is cut off at this many standard deviations: 4 ‰ of it lie beyond on each side of an axis, where the wall is thin.
const REACH: f64 = 3.2;
/// Most voxels a cut-off Gaussian reaches along an axis; grids finer than that are cut shorter.
const WIDEST: usize = 64;

/// Standard deviation of point-spread function and voxel box together. The box has variance h²/12; its shape beyond that is lost in the blur
/// (kurtosis 1.03 of 3 at the paper's grid).
pub(super) fn with_box(sigma_mm: f64, spacing_mm: f64) -> f64 {
    (sigma_mm * sigma_mm + spacing_mm * spacing_mm / 12.0).sqrt()
}

/// One axis of a Gaussian on the crop's voxels.
#[derive(Clone, Copy)]
struct AxisBlur {
    spacing_mm: f64,
    origin_mm: f64,
    /// The last voxel.
    last: f64,
    /// Voxels reached on each side.
    reach: f64,
    /// Spacing in standard deviations of point-spread function and voxel box together.
    step: f64,
    /// Height of the Gaussian a mm.
    scale: f64,
    /// exp(−h²) for the step h.
    fall: f64,
}

impl AxisBlur {
    fn new(crop: &Crop, axis: usize, sigma_mm: f64) -> Self {
        let spacing_mm = crop.spacing_mm[axis];
        let both_mm = with_box(sigma_mm, spacing_mm);
        let step = spacing_mm / both_mm;
        Self {
            spacing_mm,
            origin_mm: crop.origin_mm[axis],
            last: (crop.shape[axis] - 1) as f64,
            reach: (REACH / step).min((WIDEST / 2 - 1) as f64),
            step,
            scale: 1.0 / (both_mm * TAU.sqrt()),
            fall: (-step * step).exp(),
        }
    }
}

/// A Gaussian along an axis: from the first voxel it reaches on, `count` of them.
struct Along {
    first: usize,
    count: usize,
    /// Standard deviations from the Gaussian's middle to the first.
    start: f64,
    values: [f32; WIDEST],
}

impl Default for Along {
    fn default() -> Self {
        Self { first: 0, count: 0, start: 0.0, values: [0.0; WIDEST] }
    }
}

/// `values` times every one of `carried`, then zeros to a whole step; returns the whole steps.
#[allow(clippy::inline_always)]
#[inline(always)]
fn products<'a, const N: usize>(to: &'a mut [f32], values: &[f32], carried: &[f32; N]) -> &'a [[f32; STEP]] {
    for (lanes, value) in to.as_chunks_mut::<N>().0.iter_mut().zip(values) {
        for (lane, carried) in lanes.iter_mut().zip(carried) {
            *lane = value * carried;
        }
    }
    let count = values.len() * N;
    let whole = count.next_multiple_of(STEP);
    to[count..whole].fill(0.0);
    to[..whole].as_chunks().0
}

/// Adds `by` times a pattern.
#[allow(clippy::inline_always)]
#[inline(always)]
fn add(to: &mut [f32], pattern: &[[f32; STEP]], by: f32) {
    for (to, values) in to.as_chunks_mut::<STEP>().0.iter_mut().zip(pattern) {
        // All is read before anything is written: the compiler does not know that these are different places.
        let (before, values) = (*to, *values);
        *to = std::array::from_fn(|i| before[i] + by * values[i]);
    }
}

impl Along {
    /// Finds the voxels that a Gaussian at a place reaches; returns the exponents of its first value and of the ratio of the next to it.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn reach(&mut self, axis: &AxisBlur, at_mm: f64) -> [f64; 2] {
        let at = (at_mm - axis.origin_mm) / axis.spacing_mm;
        let (low, high) = ((at - axis.reach).ceil().max(0.0), (at + axis.reach).floor().min(axis.last));
        self.first = low as usize;
        self.count = if low > high { 0 } else { (high - low) as usize + 1 };
        self.start = (low - at) * axis.step;
        [-0.5 * self.start * self.start, -self.start * axis.step - 0.5 * axis.step * axis.step]
    }

    /// exp(−(x + k·h)²/2) by two multiplications a voxel.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn fill(&mut self, axis: &AxisBlur, first: f64, mut ratio: f64) {
        let mut value = axis.scale * first;
        for slot in &mut self.values[..self.count] {
            *slot = value as f32;
            value *= ratio;
            ratio *= axis.fall;
        }
    }
}

/// Collects nodes into voxels.
pub(super) struct Camera<'a> {
    crop: &'a Crop,
    derived: Option<Derived<'a>>,
    film: &'a mut Film,
    axes: [AxisBlur; 3],
    /// The node at hand, `[z, y, x]`.
    node: [Along; 3],
    /// The node's values along x times what it carries.
    pattern: Vec<f32>,
    /// Voxels the ring at hand has reached, `[low, end]` along `[z, y, x]`.
    touched: [[usize; 2]; 3],
}

/// A row of voxels that a node reaches: its first voxel, and the node's weight there.
struct Row {
    voxel: usize,
    weight: f32,
}

/// The rows of voxels that a node reaches.
struct Rows<'a> {
    node: &'a [Along; 3],
    shape: [usize; 3],
    z: usize,
    y: usize,
}

impl Iterator for Rows<'_> {
    type Item = Row;

    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn next(&mut self) -> Option<Row> {
        let [along_z, along_y, along_x] = self.node;
        if self.y == along_y.count {
            (self.z, self.y) = (self.z + 1, 0);
        }
        if self.z >= along_z.count {
            return None;
        }
        let [_, ny, nx] = self.shape;
        let row = (along_z.first + self.z) * ny + along_y.first + self.y;
        let found = Row { voxel: row * nx + along_x.first, weight: along_z.values[self.z] * along_y.values[self.y] };
        self.y += 1;
        Some(found)
    }
}

impl<'a> Camera<'a> {
    pub(super) fn load(crop: &'a Crop, sigma_mm: f64, derived: Option<Derived<'a>>, film: &'a mut Film) -> Self {
        film.clear(crop.voxels(), derived);
        let axes = std::array::from_fn(|axis| AxisBlur::new(crop, axis, sigma_mm));
        Self {
            crop,
            derived,
            film,
            axes,
            node: Default::default(),
            pattern: vec![0.0; WIDEST * LANES + STEP],
            touched: [[usize::MAX, 0]; 3],
        }
    }

    /// Whether derivatives are asked for.
    pub(super) fn derives(&self) -> bool {
        self.derived.is_some()
    }

    /// A node of any kind, where there are no derivatives.
    pub(super) fn excess(&mut self, point_mm: DVec3, excess: f32) {
        expose_excess(self, point_mm, excess);
    }

    /// A node of the wall.
    pub(super) fn wall(&mut self, point_mm: DVec3, carried: &[f32; LANES]) {
        expose_wall(self, point_mm, carried);
    }

    /// A node of the cavity.
    pub(super) fn cavity(&mut self, point_mm: DVec3, volume: f32, excess: f32) {
        if self.derives() { expose_cavity(self, point_mm, volume) } else { expose_excess(self, point_mm, excess) }
    }

    /// A node of a surface.
    pub(super) fn surface(&mut self, point_mm: DVec3, carried: &[f32; STRIDE]) {
        expose_surface(self, point_mm, carried);
    }

    /// A node of the valve plane.
    pub(super) fn plane(&mut self, point_mm: DVec3, carried: &[f32; 3]) {
        expose_plane(self, point_mm, carried);
    }

    /// Puts what a ring left aside, for [`Self::finish`].
    pub(super) fn end_ring(&mut self, (first, splines): &(usize, [f64; 4])) {
        let touched = std::mem::replace(&mut self.touched, [[usize::MAX, 0]; 3]);
        if let Some(Derived { at, .. }) = self.derived {
            self.film.put_aside(self.crop, at, touched, (*first, splines.map(|value| value as f32)));
        }
    }

    /// The rows of voxels that a node reaches, and its values along them; `None` where it reaches none.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn aim(&mut self, point_mm: DVec3) -> Option<(&mut Film, Rows<'_>, &mut [f32], &Along)> {
        let mut exponents = [0.0; 8];
        let (pairs, _) = exponents.as_chunks_mut::<2>();
        for (((along, axis), at_mm), pair) in self.node.iter_mut().zip(&self.axes).zip([point_mm.z, point_mm.y, point_mm.x]).zip(pairs) {
            *pair = along.reach(axis, at_mm);
        }
        if self.node.iter().any(|along| along.count == 0) {
            return None;
        }
        // All at once: one after the other they would take longer than all else about a node.
        for exponent in &mut exponents {
            *exponent = exp(*exponent);
        }
        for ((along, axis), [first, ratio]) in self.node.iter_mut().zip(&self.axes).zip(exponents.as_chunks::<2>().0) {
            along.fill(axis, *first, *ratio);
        }
        for (touched, along) in self.touched.iter_mut().zip(&self.node) {
            *touched = [touched[0].min(along.first), touched[1].max(along.first + along.count)];
        }
        let rows = Rows { node: &self.node, shape: self.crop.shape, z: 0, y: 0 };
        Some((self.film, rows, &mut self.pattern, &self.node[2]))
    }

    /// The image, and its derivatives.
    pub(super) fn finish(self, activity: &Activity) {
        self.film.finish(self.crop.voxels(), self.derived, activity);
    }
}

vectorised! {
    fn expose_excess(camera: &mut Camera<'_>, point_mm: DVec3, excess: f32) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let excess = products(pattern, &along.values[..along.count], &[excess]);
        for row in rows {
            add(&mut film.excess[row.voxel..], excess, row.weight);
        }
    }
}

vectorised! {
    fn expose_wall(camera: &mut Camera<'_>, point_mm: DVec3, carried: &[f32; LANES]) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let lanes = products(pattern, &along.values[..along.count], carried);
        for row in rows {
            add(&mut film.of_wall[row.voxel * LANES..], lanes, row.weight);
        }
    }
}

vectorised! {
    fn expose_cavity(camera: &mut Camera<'_>, point_mm: DVec3, volume: f32) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let volume = products(pattern, &along.values[..along.count], &[volume]);
        for row in rows {
            add(&mut film.cavity[row.voxel..], volume, row.weight);
        }
    }
}

vectorised! {
    fn expose_surface(camera: &mut Camera<'_>, point_mm: DVec3, carried: &[f32; STRIDE]) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let lanes = products(pattern, &along.values[..along.count], carried);
        for row in rows {
            add(&mut film.of_surface[row.voxel * STRIDE..], lanes, row.weight);
        }
    }
}

vectorised! {
    fn expose_plane(camera: &mut Camera<'_>, point_mm: DVec3, carried: &[f32; 3]) {
        let Some(Derived { columns, at }) = camera.derived else { return };
        let Some((film, rows, _, along)) = camera.aim(point_mm) else { return };
        for row in rows {
            for (place, value) in at.places[row.voxel..].iter().zip(&along.values[..along.count]) {
                if *place != NOT_COMPARED {
                    let to = &mut film.jacobian[*place as usize * columns + BASE..][..3];
                    for (to, what) in to.iter_mut().zip(carried) {
                        *to += row.weight * value * what;
                    }
                }
            }
        }
    }
}
