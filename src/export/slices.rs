//! The counts on slices as a picture.

use super::ExportError;
use crate::{analysis::planes::Plane, study::Study};

/// Media type of the picture.
pub const MEDIA_TYPE: &str = "image/png";

/// The counts of one gate (from 1) on slices, one under another: a PNG of 8-bit grey, 0 black and `white_counts` white, without gamma. All
/// slices have the size of the first.
///
/// Errors: the study has no such gate, or the encoder's.
pub fn png(study: &Study, gate: usize, slices: &[Plane], white_counts: f64) -> Result<Vec<u8>, ExportError> {
    let volume = match gate.checked_sub(1).and_then(|index| study.gates.get(index)) {
        Some(gate) => &gate.volume,
        None => return Err(ExportError::NoSuchGate { gate, gates: study.gates.len() }),
    };
    let first = slices.first().ok_or(ExportError::Empty)?;
    let grey = |count: f32| (f64::from(count) / white_counts * 255.0).round().clamp(0.0, 255.0) as u8;
    let mut pixels = Vec::with_capacity(slices.len() * first.width * first.height);
    for slice in slices {
        let counts = Plane { width: first.width, height: first.height, ..*slice }.counts(volume);
        pixels.extend(counts.into_iter().map(grey));
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, first.width as u32, (first.height * slices.len()) as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Balanced);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    writer.finish()?;
    Ok(bytes)
}
