//! What a fit of a shell adds up over the counts around it, many points at a time.

use super::{
    super::simd::{exp, vectorised},
    shape::Shell,
};
use glam::{DMat3, DVec3};

/// Linear terms of the model.
pub(super) const TERMS: usize = 12;
/// Parameters that move.
pub(super) const MOVES: usize = 9;
/// Softness of the wall's end at the valve plane and of the cavity's border: a logistic function's scale, of the same spread as the blur.
pub(super) const EDGE_MM: f64 = 3.0;

/// Points are computed with so many at a time.
pub(super) const LANES: usize = 8;
pub(super) type Lanes = [f64; LANES];

/// Some points, their counts and their voices; the last are filled up with points without a voice.
#[derive(Default)]
pub(super) struct Samples {
    pub(super) x: Lanes,
    pub(super) y: Lanes,
    pub(super) z: Lanes,
    pub(super) value: Lanes,
    pub(super) weight: Lanes,
}

/// The moving parameters' values.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moved {
    pub(super) shell: Shell,
    pub(super) sigma_mm: f64,
}

pub(super) fn total_weight(samples: &[Samples]) -> f64 {
    samples.iter().flat_map(|samples| &samples.weight).sum()
}

/// Step for derivatives by the moves.
pub(super) const STEP: f64 = 0.02;

/// What solving for the coefficients takes: normal equations (lower triangle), right side, counts squared.
pub(super) struct Sums {
    pub(super) normal: [[f64; TERMS]; TERMS],
    pub(super) right: [f64; TERMS],
    pub(super) square: f64,
}

/// What a step of the moves takes: the matrix of the moves (lower triangle), their right side, and what they share with the terms.
pub(super) struct Slopes {
    pub(super) matrix: [[f64; MOVES]; MOVES],
    pub(super) downhill: [f64; MOVES],
    pub(super) overlap: [[f64; TERMS]; MOVES],
}

/// The sum of a product over lanes, in order.
fn in_order(lanes: Lanes) -> f64 {
    lanes.iter().sum()
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn add_product(to: &mut Lanes, a: &Lanes, b: &Lanes) {
    let before = *to;
    *to = std::array::from_fn(|i| before[i] + a[i] * b[i]);
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn predict(terms: &[Lanes; TERMS], coefficients: &[f64; TERMS]) -> Lanes {
    let mut sum = [0.0; LANES];
    for (term, coefficient) in terms.iter().zip(coefficients) {
        add_product(&mut sum, term, &[*coefficient; LANES]);
    }
    sum
}

vectorised! {
    pub(super) fn predict_all(samples: &[Samples], moved: &Moved, frame: &DMat3, coefficients: &[f64; TERMS], predicted: &mut [Lanes]) {
        for (samples, predicted) in samples.iter().zip(predicted) {
            *predicted = predict(&terms(moved, frame, samples), coefficients);
        }
    }
}

vectorised! {
    pub(super) fn add_up(samples: &[Samples], moved: &Moved, frame: &DMat3) -> Sums {
        let (mut normal, mut right, mut square) = ([[[0.0; LANES]; TERMS]; TERMS], [[0.0; LANES]; TERMS], [0.0; LANES]);
        for samples in samples {
            let terms = terms(moved, frame, samples);
            for i in 0..TERMS {
                let weighted: Lanes = std::array::from_fn(|lane| samples.weight[lane] * terms[i][lane]);
                add_product(&mut right[i], &weighted, &samples.value);
                for (sum, term) in normal[i][..=i].iter_mut().zip(&terms) {
                    add_product(sum, &weighted, term);
                }
            }
            let weighted: Lanes = std::array::from_fn(|lane| samples.weight[lane] * samples.value[lane]);
            add_product(&mut square, &weighted, &samples.value);
        }
        Sums { normal: normal.map(|row| row.map(in_order)), right: right.map(in_order), square: in_order(square) }
    }
}

vectorised! {
    pub(super) fn add_slopes(samples: &[Samples], here: &Moved, there: &[Moved; MOVES], frame: &DMat3, coefficients: &[f64; TERMS]) -> Slopes {
        let mut matrix = [[[0.0; LANES]; MOVES]; MOVES];
        let mut downhill = [[0.0; LANES]; MOVES];
        let mut overlap = [[[0.0; LANES]; TERMS]; MOVES];
        for samples in samples {
            let here = terms(here, frame, samples);
            let predicted = predict(&here, coefficients);
            let missing: Lanes = std::array::from_fn(|lane| samples.value[lane] - predicted[lane]);
            let mut slopes = [[0.0; LANES]; MOVES];
            for (slope, there) in slopes.iter_mut().zip(there) {
                let moved = predict(&terms(there, frame, samples), coefficients);
                *slope = std::array::from_fn(|lane| (moved[lane] - predicted[lane]) / STEP);
            }
            for k in 0..MOVES {
                let weighted: Lanes = std::array::from_fn(|lane| samples.weight[lane] * slopes[k][lane]);
                add_product(&mut downhill[k], &weighted, &missing);
                for (sum, slope) in matrix[k][..=k].iter_mut().zip(&slopes) {
                    add_product(sum, &weighted, slope);
                }
                for (sum, term) in overlap[k].iter_mut().zip(&here) {
                    add_product(sum, &weighted, term);
                }
            }
        }
        Slopes {
            matrix: matrix.map(|row| row.map(in_order)),
            downhill: downhill.map(in_order),
            overlap: overlap.map(|row| row.map(in_order)),
        }
    }
}

/// The model's linear terms at points: uptake over the wall (constant, across, along and their products), inside, everywhere, behind.
#[allow(clippy::inline_always)]
#[inline(always)]
#[expect(clippy::needless_range_loop, reason = "the loop that is vectorised")]
fn terms(moved: &Moved, frame: &DMat3, samples: &Samples) -> [Lanes; TERMS] {
    let mut terms = [[0.0; LANES]; TERMS];
    for lane in 0..LANES {
        let place = moved.shell.place(DVec3::new(samples.x[lane], samples.y[lane], samples.z[lane]));
        let over_base = logistic(place.height_mm / EDGE_MM);
        let part = place.outside_mm / moved.sigma_mm;
        let wall = exp(-0.5 * part * part) * over_base;
        let inside = logistic(-place.outside_mm / EDGE_MM) * over_base;
        let (u, v) = (place.across.dot(frame.x_axis) / moved.shell.radius_mm, place.across.dot(frame.y_axis) / moved.shell.radius_mm);
        let t = place.towards_tip;
        terms[0][lane] = wall;
        terms[1][lane] = wall * u;
        terms[2][lane] = wall * v;
        terms[3][lane] = wall * t;
        terms[4][lane] = wall * u * t;
        terms[5][lane] = wall * v * t;
        terms[6][lane] = wall * (u * u - v * v);
        terms[7][lane] = wall * 2.0 * u * v;
        terms[8][lane] = wall * (t * t - 0.33);
        terms[9][lane] = inside;
        terms[10][lane] = 1.0;
        terms[11][lane] = 1.0 - over_base;
    }
    terms
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + exp(-x.clamp(-30.0, 30.0)))
}
