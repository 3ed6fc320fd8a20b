//! The decoders of others. Called in the child process only.

use super::{Codec, Layout, header::without_padding, jpeg2000};
use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};

/// Decodes a frame whose header was checked: its samples row by row, little-endian, of [`Layout::sample_bytes`] each. Signed samples are in
/// two's complement, with no more bits right than the frame's own precision has.
///
/// # Errors
/// What the decoder says, or that it made something else than the layout asks for.
pub(super) fn samples(codec: Codec, layout: Layout, frame: &[u8]) -> Result<Vec<u8>, String> {
    let frame = without_padding(frame);
    let values = match codec {
        Codec::Jpeg | Codec::JpegLossless => jpeg(layout, frame)?,
        Codec::JpegLs => jpeg_ls(layout, frame)?,
        Codec::Jpeg2000 => jpeg_2000(frame)?,
    };
    if values.len() != layout.pixels() {
        return Err(format!("{} samples came out where {} were declared", values.len(), layout.pixels()));
    }
    match layout.sample_bytes() {
        1 => values.into_iter().map(|value| u8::try_from(value).map_err(|_| format!("the value {value} does not fit 8 bits"))).collect(),
        _ => Ok(values.into_iter().flat_map(u16::to_le_bytes).collect()),
    }
}

fn jpeg(layout: Layout, frame: &[u8]) -> Result<Vec<u16>, String> {
    let bytes = jpeg_decoder::Decoder::new(frame).decode().map_err(|error| error.to_string())?;
    // Up to 8 bits come as bytes, more in the machine's own order.
    if bytes.len() == layout.pixels() {
        return Ok(bytes.into_iter().map(u16::from).collect());
    }
    Ok(bytes.chunks_exact(2).map(|pair| u16::from_ne_bytes([pair[0], pair[1]])).collect())
}

fn jpeg_ls(layout: Layout, frame: &[u8]) -> Result<Vec<u16>, String> {
    let plain = without_fill(frame);
    let (values, ..) = jpegls::decode(&plain, layout.columns.into(), layout.rows.into()).map_err(|error| error.to_string())?;
    Ok(values)
}

/// A JPEG-LS frame without fill bytes before its last marker, which `pure_jpegls` 2.0.0 takes for damage. `CharLS`, and so dcmtk, writes one
/// where it makes a length even. Within the samples FF is never followed by FF (T.87 A.1), so nothing else goes.
fn without_fill(frame: &[u8]) -> Vec<u8> {
    let Some(samples) = frame.strip_suffix(&[0xFF, 0xD9]) else { return frame.to_vec() };
    let fill = samples.iter().rev().take_while(|byte| **byte == 0xFF).count();
    [&samples[..samples.len() - fill], &[0xFF, 0xD9]].concat()
}

fn jpeg_2000(frame: &[u8]) -> Result<Vec<u16>, String> {
    let settings = DecodeSettings { resolve_palette_indices: false, strict: true, target_resolution: None };
    let image = Image::new(frame, &settings).map_err(|error| error.to_string())?;
    let mut context = DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(|error| error.to_string())?;
    let [component] = decoded.components() else { return Err("there is not one component".to_owned()) };
    let largest = f64::from((1_u32 << component.bit_depth().min(16)) - 1);
    // hayro-jpeg2000 0.5.0 adds half the range to signed samples as well.
    let signed_offset = if jpeg2000::is_signed(frame) { 1_u16 << (component.bit_depth().clamp(1, 16) - 1) } else { 0 };
    // Lossy coding overshoots: T.800 G.1.2 leaves it to the decoder, and all clamp.
    let value = |sample: f32| (f64::from(sample).round().clamp(0.0, largest) as u16).wrapping_sub(signed_offset);
    Ok(component.samples().iter().map(|sample| value(*sample)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fill_bytes_before_the_end_are_dropped() {
        assert_eq!(without_fill(&[1, 2, 0xFF, 0xFF, 0xFF, 0xD9]), [1, 2, 0xFF, 0xD9]);
        assert_eq!(without_fill(&[1, 2, 0xFF, 0xD9]), [1, 2, 0xFF, 0xD9]);
        assert_eq!(without_fill(&[1, 2, 0xFF]), [1, 2, 0xFF]);
    }

    #[test]
    fn noise_is_an_error_in_every_decoder() {
        let layout = Layout { rows: 16, columns: 16, bits_allocated: 16, bits_stored: 16 };
        for codec in [Codec::Jpeg, Codec::JpegLossless, Codec::JpegLs, Codec::Jpeg2000] {
            assert!(samples(codec, layout, &[0xFF, 0xD8, 3, 4, 5, 6, 7, 8]).is_err(), "{codec:?}");
        }
    }
}
