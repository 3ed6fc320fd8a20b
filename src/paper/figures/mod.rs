//! The paper's figures, redone: SVG sheets with their text and charts as vectors and their pictures embedded as PNG.

mod borders;
mod cycle;
mod operators;
mod oscillation;
mod process;
pub mod render;

use super::PaperError;
use glam::DVec3;

/// A figure and the name of its file.
#[derive(Debug, Clone)]
pub struct Figure {
    /// File name, with its ending.
    pub file: &'static str,
    /// The SVG document.
    pub svg: String,
}

/// The numbers of the paper's figures that are redone. Figure 9 is a formula, and goes with Table 5.
pub const FIGURES: [usize; 5] = [5, 6, 7, 8, 10];

/// Makes a figure by its number; `None` if it is not among [`FIGURES`].
///
/// Errors: what cannot be simulated, reconstructed or encoded.
pub fn figure(number: usize) -> Result<Option<Figure>, PaperError> {
    Ok(Some(match number {
        5 => Figure { file: "figure-5.svg", svg: oscillation::draw()? },
        6 => Figure { file: "figure-6.svg", svg: operators::draw()? },
        7 => Figure { file: "figure-7.svg", svg: borders::draw()? },
        8 => Figure { file: "figure-8.svg", svg: cycle::draw()? },
        10 => Figure { file: "figure-10.svg", svg: process::draw()? },
        _ => return Ok(None),
    }))
}

/// The colour of the outer border and surface in the pictures, as in the paper's figure 7.
const EXTERNAL: [f32; 3] = [0.18, 0.62, 0.30];
/// The colour of the inner border and surface.
const INTERNAL: [f32; 3] = [0.16, 0.36, 0.78];
/// Particles and triangles that are frozen on the border (figure 10).
const FROZEN: [f32; 3] = [0.82, 0.16, 0.14];
/// Particles and triangles that still move.
const MOVING: [f32; 3] = [0.30, 0.52, 0.90];

/// The view of a heart in the pictures: apex down, a little from above.
fn view(centre_mm: DVec3, mm_per_pixel: f64) -> render::Camera {
    render::Camera::towards(DVec3::new(0.62, 0.60, -0.50), DVec3::Z, centre_mm, mm_per_pixel)
}
