//! What a camera collects, and what becomes of it: an image and its derivatives.
//!
//! Derivatives by the coefficients of surfaces and map are many and a ring of nodes changes most of them: what a ring leaves on the voxels is put
//! aside, and handed to the columns for some voxels at a time, so that their derivatives stay in the nearest cache.

use super::{
    basis::MAP_HARMONICS,
    exposure::{ACTIVITY, Activity, BACKGROUND, BLOOD, Crop, MAP},
    shape::STRIDE,
};
use crate::pipeline::simd::vectorised;
use std::cell::RefCell;

/// Values are added so many at a time: a node's end with zeros, and so does every buffer they are added to.
pub(super) const STEP: usize = 8;
/// Of the values a node of the wall carries, the one that its uptake is in; the harmonics of the map come before.
pub(super) const LIT: usize = MAP_HARMONICS;
pub(super) const LANES: usize = MAP_HARMONICS + 1;

/// Voxels of a crop that are compared with counts: only these have derivatives.
#[derive(Debug, Clone, Default)]
pub(super) struct Compared {
    /// In memory order.
    pub(super) voxels: Vec<usize>,
    /// Each voxel's place among them, [`NOT_COMPARED`] for the others.
    pub(super) places: Vec<u32>,
}

pub(super) const NOT_COMPARED: u32 = u32::MAX;

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

/// An image and its derivatives, and what they are collected in.
#[derive(Default)]
pub(super) struct Film {
    /// `[voxels]`; where there are derivatives only the voxels compared have values.
    pub(super) image: Vec<f32>,
    /// Derivatives `[compared × columns]`.
    pub(super) jacobian: Vec<f32>,
    /// Of the ring at hand: surface harmonics `[voxels × STRIDE]`; wall harmonics and uptake `[voxels × LANES]`.
    pub(super) of_surface: Vec<f32>,
    pub(super) of_wall: Vec<f32>,
    /// Of all rings, `[voxels]`: how much brighter than the background, where there are no derivatives, else the cavity.
    pub(super) excess: Vec<f32>,
    pub(super) cavity: Vec<f32>,
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

impl Film {
    /// Bytes that it has grown to.
    fn bytes(&self) -> usize {
        let Self { image, jacobian, of_surface, of_wall, excess, cavity, lit, rings, exposed } = self;
        let floats = [image, jacobian, of_surface, of_wall, excess, cavity].map(Vec::capacity).iter().sum::<usize>();
        floats * size_of::<f32>()
            + lit.capacity() * size_of::<[f32; 2]>()
            + rings.capacity() * size_of::<Ring>()
            + exposed.capacity() * size_of::<Exposed>()
    }

    /// Makes it ready for the next exposure of so many voxels.
    pub(super) fn clear(&mut self, voxels: usize, derived: Option<Derived<'_>>) {
        if let Some(Derived { columns, at }) = derived {
            let compared = at.voxels.len();
            cleared(&mut self.jacobian, compared * columns, 0.0);
            cleared(&mut self.lit, compared, [0.0; 2]);
            self.rings.clear();
            self.exposed.clear();
            cleared(&mut self.cavity, voxels + STEP, 0.0);
            // Rings leave them empty.
            self.of_surface.resize(voxels * STRIDE + STEP, 0.0);
            self.of_wall.resize(voxels * LANES + STEP, 0.0);
        } else {
            cleared(&mut self.excess, voxels + STEP, 0.0);
        }
    }

    /// Puts aside what a ring left on the voxels it touched (`[low, end]` along `[z, y, x]`), with its first spline and the values of four.
    pub(super) fn put_aside(&mut self, crop: &Crop, at: &Compared, touched: [[usize; 2]; 3], (first, splines): (usize, [f32; 4])) {
        let [_, ny, nx] = crop.shape;
        let [[z0, z1], [y0, y1], [x0, x1]] = touched;
        let Film { of_surface, of_wall, rings, exposed, .. } = self;
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
        rings.push(Ring { first, splines, end: exposed.len() });
    }

    /// The image, and the derivatives by what the rings left and by the activities.
    pub(super) fn finish(&mut self, voxels: usize, derived: Option<Derived<'_>>, activity: &Activity) {
        if let Some(derived) = derived {
            develop(self, derived, activity.wall as f32);
        }
        let [wall, blood, background] = [activity.wall, activity.blood, activity.background].map(|counts| counts as f32);
        let Film { image, jacobian, excess, cavity, lit, .. } = self;
        image.clear();
        let Some(Derived { columns, at }) = derived else {
            image.extend(excess[..voxels].iter().map(|excess| background + excess));
            return;
        };
        image.resize(voxels, 0.0);
        for ((&voxel, row), &[lit, in_wall]) in at.voxels.iter().zip(jacobian.chunks_exact_mut(columns)).zip(&*lit) {
            let in_cavity = cavity[voxel];
            image[voxel] = background + (blood - background) * in_cavity + wall * lit - background * in_wall;
            row[ACTIVITY] = lit;
            row[BLOOD] = in_cavity;
            row[BACKGROUND] = 1.0 - in_wall - in_cavity;
        }
    }
}

/// Voxels whose derivatives are collected at once: they stay in the nearest cache.
const CHUNK: usize = 32;

/// A larger film is made anew every time, in bytes: several times that of a usual study.
const MOST_KEPT: usize = 64 << 20;

thread_local! {
    /// Films that are not in use.
    static UNUSED: RefCell<Vec<Film>> = const { RefCell::new(Vec::new()) };
}

/// Lends a film, which this thread keeps for the next exposure and the next study. What comes of it does not depend on what was on it.
pub(super) fn with_film<T>(work: impl FnOnce(&mut Film) -> T) -> T {
    let mut film = UNUSED.with_borrow_mut(Vec::pop).unwrap_or_default();
    let result = work(&mut film);
    if film.bytes() <= MOST_KEPT {
        UNUSED.with_borrow_mut(|unused| unused.push(film));
    }
    result
}

/// Gives back the films of this thread.
pub(super) fn forget() {
    drop(UNUSED.take());
}

fn cleared<T: Clone>(values: &mut Vec<T>, count: usize, zero: T) {
    values.clear();
    values.resize(count, zero);
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

const _: () = assert!(STRIDE == 8 && LANES == 12);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_keeps_films_of_usual_size_until_it_is_told_to_forget() {
        let exposed = |voxels: usize| with_film(|film| film.clear(voxels, None));
        forget();
        with_film(|one| with_film(|other| [one, other].map(|film| film.clear(1000, None))));
        assert!(with_film(|one| with_film(|other| one.bytes().min(other.bytes()))) >= 4000, "both are kept");
        forget();
        assert_eq!(with_film(|film| film.bytes()), 0);
        exposed(MOST_KEPT / size_of::<f32>() + 1);
        assert_eq!(with_film(|film| film.bytes()), 0, "one that is too large is not");
    }
}
