//! Pictures to judge a reconstruction by eye: the counts resliced about the ventricle's axis, with both surfaces' cuts drawn in.

use crate::{
    drawing::raster::Picture,
    mesh::Mesh,
    pipeline::{GateReconstruction, Reconstruction, Surface},
    report::Function,
    study::Study,
    volume::{Volume, sample_scalar},
};
use glam::DVec3;
use ndarray::Array2;

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

/// A plane that is shown: its middle and where the picture's right and down point.
struct View {
    middle_mm: DVec3,
    right: DVec3,
    down: DVec3,
}

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
        for (column, view) in views(reconstructed, found.to_base).iter().enumerate() {
            let tile = tile(&study.gates[gate].volume, reconstructed, view, side);
            sheet.paste(&tile, (column * side, row * side));
        }
    }
    sheet
}

fn views(gate: &GateReconstruction, to_base: DVec3) -> Vec<View> {
    let across = if to_base.x.abs() < 0.8 { DVec3::X } else { DVec3::Y };
    let right = (across - to_base * across.dot(to_base)).normalize_or(DVec3::X);
    let down = to_base.cross(right);
    let outer = &gate.fits.epicardial.mesh;
    let centre = outer.centroid();
    let along = outer.positions.iter().map(|point| (point - centre).dot(to_base));
    let (low, high) = along.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    let short = HEIGHTS.iter().map(|part| View { middle_mm: centre + to_base * (low + part * (high - low)), right, down });
    let long = [right, down].map(|right| View { middle_mm: centre, right, down: -to_base });
    short.chain(long).collect()
}

fn tile(volume: &Volume, gate: &GateReconstruction, view: &View, side: usize) -> Picture {
    let at = |pixel: usize| (pixel as f64 + 0.5) / PIXELS_PER_MM - SIDE_MM / 2.0;
    let grid = &volume.grid;
    let values = Array2::from_shape_fn((side, side), |(y, x)| {
        let point = view.middle_mm + view.right * at(x) + view.down * at(y);
        if grid.voxel_at(point).is_some() { sample_scalar(grid, &volume.counts, point) as f32 } else { 0.0 }
    });
    // The outer surface lies at about half of the wall's brightness, so twice the brightest count on it is white. By the volume's own
    // brightest, a hot liver alone would leave the heart dark.
    let surface = gate.fits.epicardial.mesh.positions.iter().map(|&point| sample_scalar(grid, &volume.counts, point));
    let white = 2.0 * surface.fold(0.0, f64::max) as f32;
    let mut picture = Picture::grey(&values.view(), 0.0, white.min(volume.maximum()).max(f32::MIN_POSITIVE));
    for (mesh, colour) in [(&gate.fits.epicardial.mesh, OUTER), (&gate.fits.endocardial.mesh, INNER)] {
        for [from, to] in cut(mesh, view) {
            draw(&mut picture, from, to, colour);
        }
    }
    picture
}

/// Where the view's plane cuts a mesh: segments in pixels.
fn cut(mesh: &Mesh, view: &View) -> Vec<[(f64, f64); 2]> {
    let normal = view.right.cross(view.down);
    let pixel = |point: DVec3| {
        let from_middle = point - view.middle_mm;
        let of = |mm: f64| (mm + SIDE_MM / 2.0) * PIXELS_PER_MM;
        (of(from_middle.dot(view.right)), of(from_middle.dot(view.down)))
    };
    let segment = |corners: [DVec3; 3]| {
        let height = corners.map(|corner| (corner - view.middle_mm).dot(normal));
        let crossings: Vec<(f64, f64)> = [(0, 1), (1, 2), (2, 0)]
            .into_iter()
            .filter(|&(a, b)| (height[a] < 0.0) != (height[b] < 0.0))
            .map(|(a, b)| pixel(corners[a].lerp(corners[b], height[a] / (height[a] - height[b]))))
            .collect();
        <[(f64, f64); 2]>::try_from(crossings).ok()
    };
    mesh.corners().filter_map(segment).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_through_a_sphere_cuts_a_circle() {
        let sphere = Mesh::icosphere(3).map(|p| p * 30.0);
        let view = View { middle_mm: DVec3::new(0.0, 0.0, 0.1), right: DVec3::X, down: DVec3::Y };
        let segments = cut(&sphere, &view);
        assert!(segments.len() > 40);
        let middle = SIDE_MM / 2.0 * PIXELS_PER_MM;
        for (x, y) in segments.into_iter().flatten() {
            let radius = (x - middle).hypot(y - middle) / PIXELS_PER_MM;
            assert!((radius - 30.0).abs() < 0.4, "{radius}");
        }
    }
}
