//! Pictures to judge a reconstruction by eye: the counts resliced about the ventricle's axis, with both surfaces' cuts drawn in.

use crate::{
    analysis::planes::{Plane, white_counts},
    drawing::raster::Picture,
    pipeline::{GateReconstruction, Reconstruction, Surface},
    report::Function,
    study::Study,
};
use glam::DVec3;
use ndarray::ArrayView2;

/// Pixels a mm.
const PIXELS_PER_MM: f64 = 2.0;
/// Side of a tile in mm: a dilated ventricle with its surroundings.
const SIDE_MM: f64 = 130.0;
/// Where short-axis slices are laid, as parts of the way from the epicardium's tip to its base.
const HEIGHTS: [f64; 6] = [0.12, 0.28, 0.44, 0.60, 0.76, 0.92];
/// Colour of the inner surface's cut.
const INNER: [f32; 3] = [0.25, 0.85, 1.0];
/// Colour of the outer one's.
const OUTER: [f32; 3] = [1.0, 0.75, 0.2];

/// End diastole above end systole (one row for one gate); in each six short-axis slices from apex to base, and two planes through the axis
/// with the apex down.
pub fn sheet(study: &Study, found: &Reconstruction) -> Picture {
    let cavity: Vec<f64> = found.gates.iter().map(|gate| gate.volume_ml(Surface::Endocardial)).collect();
    let rows: Vec<usize> =
        Function::of_cavity(&cavity).map_or_else(|| vec![0], |of| vec![of.end_diastolic_gate - 1, of.end_systolic_gate - 1]);
    let side = (SIDE_MM * PIXELS_PER_MM) as usize;
    let columns = HEIGHTS.len() + 2;
    let mut sheet = Picture::of_colour(columns * side, rows.len() * side, [0.0; 3]);
    for (row, &gate) in rows.iter().enumerate() {
        let Some(reconstructed) = found.gates.get(gate) else { continue };
        let white = white_counts(study, found, [gate]) as f32;
        for (column, view) in views(reconstructed, found.to_base, side).iter().enumerate() {
            let counts = view.counts(&study.gates[gate].volume);
            let Ok(values) = ArrayView2::from_shape((side, side), &counts) else { continue };
            let mut tile = Picture::grey(&values, 0.0, white);
            draw_cuts(&mut tile, reconstructed, view);
            sheet.paste(&tile, (column * side, row * side));
        }
    }
    sheet
}

fn views(gate: &GateReconstruction, to_base: DVec3, side: usize) -> Vec<Plane> {
    let across = if to_base.x.abs() < 0.8 { DVec3::X } else { DVec3::Y };
    let right = (across - to_base * across.dot(to_base)).normalize_or(DVec3::X);
    let down = to_base.cross(right);
    let outer = &gate.fits.epicardial.mesh;
    let centre = outer.centroid();
    let along = outer.positions.iter().map(|point| (point - centre).dot(to_base));
    let (low, high) = along.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    let first = 0.5 / PIXELS_PER_MM - SIDE_MM / 2.0;
    let about = |middle_mm: DVec3, right: DVec3, down: DVec3| {
        let origin_mm = middle_mm + (right + down) * first;
        Plane { origin_mm, right, down, pixel_mm: [1.0 / PIXELS_PER_MM; 2], width: side, height: side }
    };
    let short = HEIGHTS.iter().map(|part| about(centre + to_base * (low + part * (high - low)), right, down));
    let long = [right, down].map(|right| about(centre, right, -to_base));
    short.chain(long).collect()
}

fn draw_cuts(picture: &mut Picture, gate: &GateReconstruction, view: &Plane) {
    for (surface, colour) in [(Surface::Epicardial, OUTER), (Surface::Endocardial, INNER)] {
        for line in view.cut(&gate.fits.get(surface).mesh) {
            // Pixels are named by their middles there, and hold what is up to half a pixel from it.
            let points: Vec<(f64, f64)> = line.into_iter().map(|[x, y]| (x + 0.5, y + 0.5)).collect();
            points.windows(2).for_each(|ends| draw(picture, ends[0], ends[1], colour));
        }
    }
}

fn draw(picture: &mut Picture, from: (f64, f64), to: (f64, f64), colour: [f32; 3]) {
    let steps = (from.0 - to.0).abs().max((from.1 - to.1).abs()).ceil().max(1.0) * 2.0;
    for step in 0..=steps as usize {
        let part = step as f64 / steps;
        let (x, y) = (from.0 + (to.0 - from.0) * part, from.1 + (to.1 - from.1) * part);
        if x >= 0.0 && y >= 0.0 {
            picture.set(x as usize, y as usize, colour);
        }
    }
}
