//! Figure 8 (§7.5): both surfaces over a cardiac cycle.

use super::{
    super::{PaperError, cycle},
    EXTERNAL, INTERNAL,
    render::{Canvas, FINE_LEVELS},
    view,
};
use crate::{
    drawing::svg::{Anchor, FAINT, INK, Sheet},
    pipeline::Surface,
};
use glam::DVec3;

/// Pixels along each side of a rendered panel, and on the sheet.
const PANEL: (usize, f64) = (216, 108.0);

/// The simulated normal ventricle of Table 5: outer surfaces above, inner ones below, all to one scale.
pub(super) fn draw() -> Result<String, PaperError> {
    let cycle = cycle::measure()?;
    let first = &cycle.found.gates[0].fits.epicardial.mesh;
    let (low, high) = first.positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &at| (low.min(at), high.max(at)));
    let (pixels, side) = PANEL;
    let camera = view((low + high) / 2.0, 1.12 * (high - low).max_element() / pixels as f64);
    let mut sheet = Sheet::new(900.0, 330.0);
    sheet.text((450.0, 24.0), 16.0, Anchor::Middle, INK, "A cardiac cycle of eight gates (simulated normal ventricle)");
    for (gate, found) in cycle.found.gates.iter().enumerate() {
        let x = 30.0 + side * gate as f64;
        sheet.text((x + side / 2.0, 50.0), 12.0, Anchor::Middle, FAINT, &format!("gate {}", gate + 1));
        for (row, (surface, colour)) in [(Surface::Epicardial, EXTERNAL), (Surface::Endocardial, INTERNAL)].into_iter().enumerate() {
            let mut canvas = Canvas::new(camera, pixels, pixels);
            canvas.mesh(&found.fits.get(surface).mesh, |_| colour);
            let y = 56.0 + (side + 24.0) * row as f64;
            sheet.picture((x, y), (side, side), &canvas.picture(FINE_LEVELS).png()?, false);
            sheet.text((x + side / 2.0, y + side + 12.0), 12.0, Anchor::Middle, INK, &format!("{:.1} ml", found.volume_ml(surface)));
        }
    }
    for (row, name) in ["external", "internal"].into_iter().enumerate() {
        sheet.upright_text((20.0, 56.0 + side / 2.0 + (side + 24.0) * row as f64), 13.0, name);
    }
    Ok(sheet.finish())
}
