//! What becomes of a scene's nodes on the voxels: each a Gaussian, cut off where little is left of it.

use super::{
    basis::MAP_HARMONICS,
    exposure::{ACTIVITY, Activity, BACKGROUND, BLOOD, Crop, MAP},
    shape::{BASE, STRIDE},
};
use crate::pipeline::simd::{exp, vectorised};
use glam::DVec3;
use std::{
    f64::consts::TAU,
    sync::{Mutex, PoisonError},
};

/// A Gaussian is cut off at this many standard deviations: 4 ‰ of it lie beyond on each side of an axis, where the wall is thin.
const REACH: f64 = 3.2;
/// Most voxels a cut-off Gaussian reaches along an axis; grids finer than that are cut shorter.
const WIDEST: usize = 64;
/// Values are added so many at a time: a node's end with zeros, and so does every buffer they are added to.
const STEP: usize = 8;
/// Of the values a node of the wall carries, the one that its uptake is in; the harmonics of the map come before.
pub(super) const LIT: usize = MAP_HARMONICS;
pub(super) const LANES: usize = MAP_HARMONICS + 1;

/// Standard deviation of point-spread function and voxel box together. The box has variance h²/12; its shape beyond that is lost in the blur
/// (kurtosis 1.03 of 3 at the paper's grid).
pub(super) fn with_box(sigma_mm: f64, spacing_mm: f64) -> f64 {
    (sigma_mm * sigma_mm + spacing_mm * spacing_mm / 12.0).sqrt()
}

/// Voxels of a crop that are compared with counts: only these have derivatives.
#[derive(Debug, Clone, Default)]
pub(super) struct Compared {
    /// In memory order.
    pub(super) voxels: Vec<usize>,
    /// Each voxel's place among them, [`NOT_COMPARED`] for the others.
    places: Vec<u32>,
}

const NOT_COMPARED: u32 = u32::MAX;

impl Compared {
    /// Those of so many voxels for which `is_compared` says so.
    pub(super) fn of(voxels: usize, is_compared: impl Fn(usize) -> bool) -> Self {
        let mut compared = Self { voxels: Vec::new(), places: vec![NOT_COMPARED; voxels] };
        for voxel in (0..voxels).filter(|voxel| is_compared(*voxel)) {
            compared.places[voxel] = compared.voxels.len() as u32;
            compared.voxels.push(voxel);
        }
        compared
    }
}

/// What derivatives are asked for.
#[derive(Clone, Copy)]
pub(super) struct Derived<'a> {
    /// By the first so many columns.
    pub(super) columns: usize,
    pub(super) at: &'a Compared,
}

/// An image and its derivatives, and what they are collected in. Kept from one exposure to the next, so that memory is asked for once.
#[derive(Default)]
pub(super) struct Film {
    /// `[voxels]`; where there are derivatives only the voxels compared have values.
    pub(super) image: Vec<f32>,
    /// Derivatives `[compared × columns]`.
    pub(super) jacobian: Vec<f32>,
    /// Derivative by the logarithm of the point-spread function's width, `[compared]`.
    pub(super) by_width: Vec<f32>,
    /// Of the ring at hand: surface harmonics `[voxels × STRIDE]`; wall harmonics and uptake `[voxels × LANES]`.
    of_surface: Vec<f32>,
    of_wall: Vec<f32>,
    /// Of all rings, `[voxels]`: how much brighter than the background, where there are no derivatives, else cavity and derivative by the width.
    excess: Vec<f32>,
    cavity: Vec<f32>,
    width: Vec<f32>,
    /// Of all rings, `[compared]`: wall with uptake and without.
    lit: Vec<[f32; 2]>,
    /// What the rings left on the voxels compared, a ring after the other.
    rings: Vec<Ring>,
    exposed: Vec<Exposed>,
}

/// A ring of nodes: the splines that are not zero there, and the end of what it left.
struct Ring {
    first: usize,
    splines: [f32; 4],
    end: usize,
}

/// What a ring left on one of the voxels compared.
struct Exposed {
    place: u32,
    surface: [f32; STRIDE],
    wall: [f32; LANES],
}

/// Voxels whose derivatives are collected at once: they stay in the nearest cache.
const CHUNK: usize = 32;

/// Films that are not in use: as many are made as threads expose at once.
#[derive(Default)]
pub(super) struct Films(Mutex<Vec<Film>>);

impl Films {
    /// Lends one.
    pub(super) fn with<T>(&self, work: impl FnOnce(&mut Film) -> T) -> T {
        let unused = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut film = unused().pop().unwrap_or_default();
        let result = work(&mut film);
        unused().push(film);
        result
    }
}

fn cleared<T: Clone>(values: &mut Vec<T>, count: usize, zero: T) {
    values.clear();
    values.resize(count, zero);
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
    /// What of the variance is the point-spread function's.
    own: f32,
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
            own: (sigma_mm / both_mm).powi(2) as f32,
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
    /// The relative derivative of each value by the logarithm of the point-spread function's width.
    widening: [f32; WIDEST],
}

impl Default for Along {
    fn default() -> Self {
        Self { first: 0, count: 0, start: 0.0, values: [0.0; WIDEST], widening: [0.0; WIDEST] }
    }
}

/// What a node adds along x, but for the weight of the row.
struct Pattern {
    /// The node's values times what it carries, `[voxels × lanes]`, or times its excess.
    lanes: Vec<f32>,
    excess: Vec<f32>,
    /// Likewise, times the widening along x.
    widened: Vec<f32>,
}

impl Default for Pattern {
    fn default() -> Self {
        Self { lanes: vec![0.0; WIDEST * LANES + STEP], excess: vec![0.0; WIDEST + STEP], widened: vec![0.0; WIDEST + STEP] }
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

/// Adds `by` times a pattern's widening along x, and along the other axes.
#[allow(clippy::inline_always)]
#[inline(always)]
fn add_widened(to: &mut [f32], (excess, widened): (&[[f32; STEP]], &[[f32; STEP]]), by: f32, widening: f32) {
    for (to, (values, own)) in to.as_chunks_mut::<STEP>().0.iter_mut().zip(excess.iter().zip(widened)) {
        let (before, values, own) = (*to, *values, *own);
        *to = std::array::from_fn(|i| before[i] + by * (own[i] + widening * values[i]));
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
        let (start, step) = (self.start as f32, axis.step as f32);
        for (k, slot) in self.widening[..self.count].iter_mut().enumerate() {
            let u = start + step * k as f32;
            *slot = (u * u - 1.0) * axis.own;
        }
    }
}

/// Collects nodes into voxels.
pub(super) struct Camera<'a> {
    crop: &'a Crop,
    derived: Option<Derived<'a>>,
    film: &'a mut Film,
    axes: [AxisBlur; 3],
    /// The node at hand, `[z, y, x]`, and what it adds.
    node: [Along; 3],
    pattern: Pattern,
    /// Voxels the ring at hand has reached, `[low, end]` along `[z, y, x]`.
    touched: [[usize; 2]; 3],
}

/// A row of voxels that a node reaches: its first voxel, and the node's weight and widening there.
struct Row {
    voxel: usize,
    weight: f32,
    widening: f32,
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
        let found = Row {
            voxel: row * nx + along_x.first,
            weight: along_z.values[self.z] * along_y.values[self.y],
            widening: along_z.widening[self.z] + along_y.widening[self.y],
        };
        self.y += 1;
        Some(found)
    }
}

impl<'a> Camera<'a> {
    pub(super) fn load(crop: &'a Crop, sigma_mm: f64, derived: Option<Derived<'a>>, film: &'a mut Film) -> Self {
        let voxels = crop.voxels();
        if let Some(Derived { columns, at }) = derived {
            let compared = at.voxels.len();
            cleared(&mut film.jacobian, compared * columns, 0.0);
            cleared(&mut film.lit, compared, [0.0; 2]);
            film.rings.clear();
            film.exposed.clear();
            cleared(&mut film.width, voxels + STEP, 0.0);
            cleared(&mut film.cavity, voxels + STEP, 0.0);
            // Rings leave them empty.
            film.of_surface.resize(voxels * STRIDE + STEP, 0.0);
            film.of_wall.resize(voxels * LANES + STEP, 0.0);
        } else {
            cleared(&mut film.excess, voxels + STEP, 0.0);
        }
        let axes = std::array::from_fn(|axis| AxisBlur::new(crop, axis, sigma_mm));
        Self { crop, derived, film, axes, node: Default::default(), pattern: Pattern::default(), touched: [[usize::MAX, 0]; 3] }
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
    pub(super) fn wall(&mut self, point_mm: DVec3, carried: &[f32; LANES], excess: f32) {
        expose_wall(self, point_mm, carried, excess);
    }

    /// A node of the cavity.
    pub(super) fn cavity(&mut self, point_mm: DVec3, volume: f32, excess: f32) {
        if self.derives() { expose_cavity(self, point_mm, volume, excess) } else { expose_excess(self, point_mm, excess) }
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
        let Some(Derived { at, .. }) = self.derived else { return };
        let [_, ny, nx] = self.crop.shape;
        let [[z0, z1], [y0, y1], [x0, x1]] = touched;
        let Film { of_surface, of_wall, rings, exposed, .. } = &mut *self.film;
        for z in z0..z1 {
            for y in y0..y1 {
                let row = (z * ny + y) * nx;
                let (from, to) = (row + x0, row + x1);
                let (surfaces, _) = of_surface[from * STRIDE..to * STRIDE].as_chunks_mut::<STRIDE>();
                let (walls, _) = of_wall[from * LANES..to * LANES].as_chunks_mut::<LANES>();
                for ((surface, wall), &place) in surfaces.iter_mut().zip(walls).zip(&at.places[from..to]) {
                    let (surface, wall) = (std::mem::replace(surface, [0.0; STRIDE]), std::mem::replace(wall, [0.0; LANES]));
                    // The middle of a wide ring is reached by none of its nodes.
                    if place != NOT_COMPARED && (surface[0] != 0.0 || wall[0] != 0.0) {
                        exposed.push(Exposed { place, surface, wall });
                    }
                }
            }
        }
        rings.push(Ring { first: *first, splines: splines.map(|value| value as f32), end: exposed.len() });
    }

    /// The rows of voxels that a node reaches, and its values along them; `None` where it reaches none.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn aim(&mut self, point_mm: DVec3) -> Option<(&mut Film, Rows<'_>, &mut Pattern, &Along)> {
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

    /// The image, and the derivatives by what the rings left and by the activities.
    pub(super) fn finish(self, activity: &Activity) {
        if let Some(derived) = self.derived {
            develop(self.film, derived, activity.wall as f32);
        }
        let [wall, blood, background] = [activity.wall, activity.blood, activity.background].map(|counts| counts as f32);
        let voxels = self.crop.voxels();
        let Film { image, jacobian, by_width, excess, width, cavity, lit, .. } = self.film;
        image.clear();
        let Some(Derived { columns, at }) = self.derived else {
            image.extend(excess[..voxels].iter().map(|excess| background + excess));
            return;
        };
        image.resize(voxels, 0.0);
        by_width.clear();
        for ((&voxel, row), &[lit, in_wall]) in at.voxels.iter().zip(jacobian.chunks_exact_mut(columns)).zip(&*lit) {
            let in_cavity = cavity[voxel];
            image[voxel] = background + (blood - background) * in_cavity + wall * lit - background * in_wall;
            row[ACTIVITY] = lit;
            row[BLOOD] = in_cavity;
            row[BACKGROUND] = 1.0 - in_wall - in_cavity;
            by_width.push(width[voxel]);
        }
    }
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn add_scaled<const N: usize>(to: &mut [f32; N], what: &[f32; N], by: f32) {
    let (before, what) = (*to, *what);
    *to = std::array::from_fn(|i| before[i] + by * what[i]);
}

/// Adds what a ring left to its four splines, one after the other: a loop over them would be vectorised across, which is slow.
#[allow(clippy::inline_always)]
#[inline(always)]
fn add_to_four<const N: usize>(strides: &mut [[f32; N]], what: &[f32; N], splines: &[f32; 4], by: f32) {
    let [a, b, c, d, ..] = strides else { return };
    add_scaled(a, what, splines[0] * by);
    add_scaled(b, what, splines[1] * by);
    add_scaled(c, what, splines[2] * by);
    add_scaled(d, what, splines[3] * by);
}

/// A node's excess along x, and the same times its widening.
#[allow(clippy::inline_always)]
#[inline(always)]
fn light<'a>(
    pattern_excess: &'a mut [f32],
    pattern_widened: &'a mut [f32],
    along: &Along,
    excess: f32,
) -> (&'a [[f32; STEP]], &'a [[f32; STEP]]) {
    let values = &along.values[..along.count];
    let steps = products(pattern_excess, values, &[excess]);
    let widened = &mut pattern_widened[..steps.len() * STEP];
    for (to, (value, own)) in widened.iter_mut().zip(steps.as_flattened().iter().zip(&along.widening)) {
        *to = value * own;
    }
    (steps, widened.as_chunks().0)
}

vectorised! {
    fn expose_excess(camera: &mut Camera<'_>, point_mm: DVec3, excess: f32) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let excess = products(&mut pattern.excess, &along.values[..along.count], &[excess]);
        for row in rows {
            add(&mut film.excess[row.voxel..], excess, row.weight);
        }
    }
}

vectorised! {
    fn expose_wall(camera: &mut Camera<'_>, point_mm: DVec3, carried: &[f32; LANES], excess: f32) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let lanes = products(&mut pattern.lanes, &along.values[..along.count], carried);
        let light = light(&mut pattern.excess, &mut pattern.widened, along, excess);
        for row in rows {
            add(&mut film.of_wall[row.voxel * LANES..], lanes, row.weight);
            add_widened(&mut film.width[row.voxel..], light, row.weight, row.widening);
        }
    }
}

vectorised! {
    fn expose_cavity(camera: &mut Camera<'_>, point_mm: DVec3, volume: f32, excess: f32) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let light = light(&mut pattern.excess, &mut pattern.widened, along, excess);
        let volume = products(&mut pattern.lanes, &along.values[..along.count], &[volume]);
        for row in rows {
            add(&mut film.cavity[row.voxel..], volume, row.weight);
            add_widened(&mut film.width[row.voxel..], light, row.weight, row.widening);
        }
    }
}

vectorised! {
    fn expose_surface(camera: &mut Camera<'_>, point_mm: DVec3, carried: &[f32; STRIDE]) {
        let Some((film, rows, pattern, along)) = camera.aim(point_mm) else { return };
        let lanes = products(&mut pattern.lanes, &along.values[..along.count], carried);
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

vectorised! {
    /// Hands what the rings left to the columns of their splines.
    fn develop(film: &mut Film, derived: Derived<'_>, activity: f32) {
        let columns = derived.columns;
        let Film { jacobian, lit, rings, exposed, .. } = film;
        let mut at: Vec<usize> = rings.iter().scan(0, |end, ring| Some(std::mem::replace(end, ring.end))).collect();
        for (chunk, (lines, lit)) in jacobian.chunks_mut(CHUNK * columns).zip(lit.chunks_mut(CHUNK)).enumerate() {
            for (ring, at) in rings.iter().zip(&mut at) {
                while let Some(Exposed { place, surface, wall }) = exposed[*at..ring.end].first()
                    && (*place as usize) < (chunk + 1) * CHUNK
                {
                    *at += 1;
                    let place = *place as usize - chunk * CHUNK;
                    let line = &mut lines[place * columns..][..columns];
                    let (strides, _) = line[ring.first * STRIDE..].as_chunks_mut::<STRIDE>();
                    add_to_four(strides, surface, &ring.splines, 1.0);
                    if columns > MAP {
                        let (strides, _) = line[MAP + ring.first * LANES..].as_chunks_mut::<LANES>();
                        add_to_four(strides, wall, &ring.splines, activity);
                    }
                    add_scaled(&mut lit[place], &[wall[LIT], wall[0]], 1.0);
                }
            }
        }
    }
}

const _: () = assert!(STRIDE == 8 && LANES == 12);
