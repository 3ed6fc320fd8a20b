//! Pixel data → counts: samples of 8 or 16 bits, native in both byte orders, in RLE Lossless or compressed, rescaled by Rescale Slope and
//! Intercept.
//!
//! The DICOM library's own decoders are not used: they apply display transforms by default, and its RLE decoder allocates what a damaged
//! header declares (17 GB for one flipped byte) and panics on short segments. Here nothing is allocated beyond the declared frame, and what
//! `codecs` decodes is decoded in a process of its own.

use super::attributes::{Attributes, invalid, shown_uid};
use super::encapsulated;
use super::syntaxes::Encoding;
use crate::codecs::{self, Codec, DecodeError, HeaderError, Layout};
use crate::intake::prescan::{self, Scan};
use crate::intake::{IntakeError, Limits};
use crate::study::Warning;
use dicom_core::{Tag, VR};
use dicom_dictionary_std::tags;
use std::borrow::Cow;
use std::ops::Range;

/// PS3.5 G.5: a segment count and 15 offsets of 32 bits.
const RLE_HEADER_BYTES: usize = 64;

/// Where the samples are.
#[derive(Debug)]
enum Storage {
    Native(Range<usize>),
    /// One fragment a frame, uncompressed.
    Fragments(Vec<Range<usize>>),
    /// One fragment a frame.
    Rle(Vec<Range<usize>>),
    /// The fragments of each frame; their headers have been checked.
    Compressed {
        codec: Codec,
        layout: Layout,
        frames: Vec<Vec<Range<usize>>>,
    },
}

/// How samples become counts.
#[derive(Debug, Clone, Copy)]
struct Samples {
    bytes: usize,
    bits_stored: u32,
    signed: bool,
    big_endian: bool,
    /// 8-bit samples in OW words, big-endian: the pairs are swapped.
    swapped_pairs: bool,
    slope: f64,
    intercept: f64,
}

/// Pixel data that is known to be complete, not yet decoded.
#[derive(Debug)]
pub(super) struct Pixels<'a> {
    data: Cow<'a, [u8]>,
    storage: Storage,
    samples: Samples,
    frame_samples: usize,
}

impl<'a> Pixels<'a> {
    /// Checks the encoding and the length of pixel data of `[frames, rows, columns]`, and the headers of compressed frames.
    pub(super) fn locate(
        scan: Scan<'a>,
        attributes: &Attributes,
        [frames, rows, columns]: [usize; 3],
        limits: &Limits,
        warnings: &mut Vec<Warning>,
    ) -> Result<Self, IntakeError> {
        let uid = scan.encoding.uid.as_str();
        let unsupported = |name: &str| IntakeError::UnsupportedTransferSyntax { name: name.to_owned(), uid: shown_uid(uid) };
        let (encoding, name) = Encoding::of(uid).map_err(unsupported)?;
        let mut samples = Samples::of(attributes, scan.encoding.big_endian, warnings)?;
        let frame_samples = rows * columns;
        let storage = match (scan.pixels, encoding) {
            (prescan::Pixels::Absent, _) => {
                return Err(IntakeError::MissingAttribute {
                    name: "Pixel Data",
                    tag: tags::PIXEL_DATA.to_string(),
                    advice: "the file is a header without an image; send the whole file",
                });
            }
            (prescan::Pixels::Native { value, vr }, Encoding::Native) => {
                let expected = frames * frame_samples * samples.bytes;
                // A value of odd length is padded to an even one.
                if value.len() != expected && value.len() != expected + expected % 2 {
                    return Err(IntakeError::PixelDataLength { actual: value.len(), expected, frames, rows, columns });
                }
                samples.swapped_pairs = samples.bytes == 1 && samples.big_endian && vr == VR::OW;
                if samples.swapped_pairs && value.len() % 2 == 1 {
                    return Err(IntakeError::PixelDataLength { actual: value.len(), expected: expected + 1, frames, rows, columns });
                }
                Storage::Native(value)
            }
            (prescan::Pixels::Native { .. }, _) => {
                return Err(IntakeError::DamagedPixelData {
                    frame: 1,
                    reason: format!("the transfer syntax is {name}, but the pixel data is not encapsulated"),
                });
            }
            (prescan::Pixels::Encapsulated { .. }, Encoding::Native) => {
                return Err(unsupported(
                    "an uncompressed transfer syntax with encapsulated fragments (the declared transfer syntax is wrong)",
                ));
            }
            (prescan::Pixels::Encapsulated { fragments }, Encoding::Rle) => Storage::Rle(one_a_frame(&fragments, frames, name)?),
            (prescan::Pixels::Encapsulated { fragments }, Encoding::Fragments) => {
                let images = one_a_frame(&fragments, frames, name)?;
                let expected = frame_samples * samples.bytes;
                if let Some(wrong) = images.iter().find(|image| image.len() != expected && image.len() != expected + expected % 2) {
                    return Err(IntakeError::PixelDataLength { actual: wrong.len(), expected, frames: 1, rows, columns });
                }
                Storage::Fragments(images)
            }
            (prescan::Pixels::Encapsulated { fragments }, Encoding::Compressed { codec, lossy }) => {
                if limits.decoder.is_none() {
                    return Err(unsupported(name));
                }
                let layout = Layout {
                    rows: rows as u16,
                    columns: columns as u16,
                    bits_allocated: 8 * samples.bytes as u8,
                    bits_stored: samples.bits_stored as u8,
                };
                let frames = encapsulated::frames(&scan.data, &fragments, frames)?;
                for (index, frame) in frames.iter().enumerate() {
                    codecs::check(codec, layout, &joined(&scan.data, frame)).map_err(|error| match error {
                        HeaderError::Unsupported(name) => unsupported(name),
                        HeaderError::Damaged(reason) => IntakeError::DamagedPixelData { frame: index + 1, reason },
                    })?;
                }
                if lossy {
                    warnings.push(Warning::new(
                        "lossy_compression",
                        format!("The pixel data was sent as {name}, which may change counts; send a lossless one where there is a choice."),
                    ));
                }
                Storage::Compressed { codec, layout, frames }
            }
        };
        Ok(Self { data: scan.data, storage, samples, frame_samples })
    }

    /// Bytes that were inflated to get at the pixels.
    pub(super) fn inflated_bytes(&self) -> usize {
        match &self.data {
            Cow::Borrowed(_) => 0,
            Cow::Owned(data) => data.len(),
        }
    }

    /// Decodes a frame (counted from 0) into counts, row by row. Compressed ones need a session.
    pub(super) fn decode(&self, frame: usize, counts: &mut [f32], session: Option<&mut codecs::Session>) -> Result<(), IntakeError> {
        let damaged = |reason: String| IntakeError::DamagedPixelData { frame: frame + 1, reason };
        match &self.storage {
            Storage::Native(value) => {
                let length = self.frame_samples * self.samples.bytes;
                let pixels = &self.data[value.clone()];
                if self.samples.swapped_pairs {
                    for (index, count) in counts.iter_mut().enumerate() {
                        *count = self.samples.count(u16::from(pixels[(frame * length + index) ^ 1]));
                    }
                } else {
                    self.samples.decode(&pixels[frame * length..(frame + 1) * length], counts);
                }
            }
            Storage::Fragments(fragments) => self.samples.decode(&self.data[fragments[frame].clone()], counts),
            Storage::Compressed { codec, layout, frames } => {
                let unavailable = || IntakeError::DecoderUnavailable { reason: "there is no decoder".to_owned() };
                let bytes = joined(&self.data, &frames[frame]);
                let decoded = session.ok_or_else(unavailable)?.decode(*codec, *layout, &bytes).map_err(|error| match error {
                    DecodeError::Unavailable(_) => IntakeError::DecoderUnavailable { reason: error.to_string() },
                    DecodeError::Frame(reason) | DecodeError::Ended(reason) => damaged(reason),
                })?;
                self.samples.decode(&decoded, counts);
            }
            Storage::Rle(fragments) => {
                let bytes = unpack_frame(&self.data[fragments[frame].clone()], self.frame_samples, self.samples.bytes).map_err(damaged)?;
                Samples { big_endian: false, ..self.samples }.decode(&bytes, counts);
            }
        }
        Ok(())
    }
}

impl Samples {
    fn of(attributes: &Attributes, big_endian: bool, warnings: &mut Vec<Warning>) -> Result<Self, IntakeError> {
        let required = |tag: Tag, name: &'static str| {
            attributes.integer(tag, name)?.ok_or_else(|| IntakeError::MissingAttribute {
                name,
                tag: tag.to_string(),
                advice: "the pixels cannot be read without it",
            })
        };
        let samples = attributes.integer(tags::SAMPLES_PER_PIXEL, "Samples per Pixel")?.unwrap_or(1);
        if samples != 1 {
            return Err(invalid(
                tags::SAMPLES_PER_PIXEL,
                "Samples per Pixel",
                &samples.to_string(),
                "counts have one sample a pixel, not colours",
            ));
        }
        match attributes.text(tags::PHOTOMETRIC_INTERPRETATION).as_deref() {
            Some("MONOCHROME2" | "PALETTE COLOR") => {}
            None => warnings.push(Warning::new(
                "missing_photometric_interpretation",
                "Photometric Interpretation is missing; MONOCHROME2 was assumed.",
            )),
            Some("MONOCHROME1") => warnings.push(Warning::new(
                "monochrome1",
                "Photometric Interpretation is MONOCHROME1 (shown inverted); the stored values were taken as counts all the same.",
            )),
            Some(other) => {
                return Err(invalid(tags::PHOTOMETRIC_INTERPRETATION, "Photometric Interpretation", other, "counts are MONOCHROME2"));
            }
        }
        let allocated = required(tags::BITS_ALLOCATED, "Bits Allocated")?;
        if allocated != 8 && allocated != 16 {
            return Err(invalid(tags::BITS_ALLOCATED, "Bits Allocated", &allocated.to_string(), "it must be 8 or 16"));
        }
        let stored = attributes.integer(tags::BITS_STORED, "Bits Stored")?.unwrap_or(allocated);
        if !(1..=allocated).contains(&stored) {
            return Err(invalid(
                tags::BITS_STORED,
                "Bits Stored",
                &stored.to_string(),
                &format!("it must be 1 to Bits Allocated ({allocated})"),
            ));
        }
        let high = attributes.integer(tags::HIGH_BIT, "High Bit")?.unwrap_or(stored - 1);
        if high != stored - 1 {
            return Err(invalid(tags::HIGH_BIT, "High Bit", &high.to_string(), &format!("it must be Bits Stored − 1 ({})", stored - 1)));
        }
        let representation = attributes.integer(tags::PIXEL_REPRESENTATION, "Pixel Representation")?.unwrap_or(0);
        if representation != 0 && representation != 1 {
            return Err(invalid(tags::PIXEL_REPRESENTATION, "Pixel Representation", &representation.to_string(), "it must be 0 or 1"));
        }
        let slope = attributes.number(tags::RESCALE_SLOPE, "Rescale Slope")?.unwrap_or(1.0);
        if slope <= 0.0 {
            return Err(invalid(tags::RESCALE_SLOPE, "Rescale Slope", &slope.to_string(), "it must be positive"));
        }
        Ok(Self {
            bytes: allocated as usize / 8,
            bits_stored: stored as u32,
            signed: representation == 1,
            big_endian,
            swapped_pairs: false,
            slope,
            intercept: attributes.number(tags::RESCALE_INTERCEPT, "Rescale Intercept")?.unwrap_or(0.0),
        })
    }

    fn decode(&self, bytes: &[u8], counts: &mut [f32]) {
        if self.bytes == 1 {
            for (count, byte) in counts.iter_mut().zip(bytes) {
                *count = self.count(u16::from(*byte));
            }
        } else {
            for (count, pair) in counts.iter_mut().zip(bytes.chunks_exact(2)) {
                let pair = [pair[0], pair[1]];
                *count = self.count(if self.big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) });
            }
        }
    }

    /// A stored sample as a count: the bits above Bits Stored (overlays once lived there) are dropped, the sign is extended.
    fn count(&self, sample: u16) -> f32 {
        let unused = 16 - self.bits_stored;
        let shifted = sample << unused;
        let value = if self.signed { f64::from(shifted.cast_signed() >> unused) } else { f64::from(shifted >> unused) };
        (value * self.slope + self.intercept) as f32
    }
}

/// Fragments of encodings that have one a frame.
fn one_a_frame(fragments: &[Range<usize>], frames: usize, name: &str) -> Result<Vec<Range<usize>>, IntakeError> {
    let images = fragments.get(1..).unwrap_or_default();
    if images.len() == frames {
        return Ok(images.to_vec());
    }
    Err(IntakeError::InconsistentFrames {
        reason: format!("Number of Frames (0028,0008) says {frames}, but the {name} pixel data has {} fragments", images.len()),
    })
}

/// The bytes of a frame; copied only where it has several fragments.
fn joined<'d>(data: &'d [u8], fragments: &[Range<usize>]) -> Cow<'d, [u8]> {
    match fragments {
        [fragment] => Cow::Borrowed(&data[fragment.clone()]),
        several => Cow::Owned(several.iter().flat_map(|fragment| &data[fragment.clone()]).copied().collect()),
    }
}

/// One RLE frame as little-endian samples: a segment a byte plane, most significant first (PS3.5 G.2).
fn unpack_frame(fragment: &[u8], samples: usize, bytes_per_sample: usize) -> Result<Vec<u8>, String> {
    let Some((header, _)) = fragment.split_at_checked(RLE_HEADER_BYTES) else {
        return Err(format!("its header has {} of {RLE_HEADER_BYTES} bytes", fragment.len()));
    };
    let words: Vec<usize> = header.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]) as usize).collect();
    if words[0] != bytes_per_sample {
        return Err(format!("its header declares {} segments where {bytes_per_sample} are needed", words[0]));
    }
    let mut unpacked = vec![0; samples * bytes_per_sample];
    for segment in 0..bytes_per_sample {
        let start = words[1 + segment];
        let end = if segment + 1 < bytes_per_sample { words[2 + segment] } else { fragment.len() };
        let packed = fragment
            .get(start..end)
            .filter(|_| start >= RLE_HEADER_BYTES)
            .ok_or_else(|| format!("segment {} lies at {start}..{end} of {} bytes", segment + 1, fragment.len()))?;
        let plane = bytes_per_sample - 1 - segment;
        let written = unpack_bits(packed, unpacked[plane..].iter_mut().step_by(bytes_per_sample));
        if written != samples {
            return Err(format!("segment {} has {written} of {samples} bytes", segment + 1));
        }
    }
    Ok(unpacked)
}

/// `PackBits` (PS3.5 G.3) into `out`, never beyond it; returns the bytes written.
fn unpack_bits<'a>(packed: &[u8], mut out: impl Iterator<Item = &'a mut u8>) -> usize {
    let mut written = 0;
    let mut rest = packed.iter();
    while let Some(&control) = rest.next() {
        let (run, length) = match control {
            0..=127 => (None, usize::from(control) + 1),
            128 => continue,
            129..=255 => match rest.next() {
                Some(&value) => (Some(value), 257 - usize::from(control)),
                None => return written,
            },
        };
        for _ in 0..length {
            let Some(value) = run.or_else(|| rest.next().copied()) else { return written };
            let Some(slot) = out.next() else { return written };
            *slot = value;
            written += 1;
        }
    }
    written
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "small integers and halves are exact")]
mod tests {
    use super::*;

    fn samples(bytes: usize, bits_stored: u32, signed: bool, big_endian: bool) -> Samples {
        Samples { bytes, bits_stored, signed, big_endian, swapped_pairs: false, slope: 1.0, intercept: 0.0 }
    }

    #[test]
    fn samples_of_every_layout_become_counts() {
        let mut counts = [0.0; 2];
        samples(2, 16, false, false).decode(&[0x01, 0x02, 0xFF, 0xFF], &mut counts);
        assert_eq!(counts, [513.0, 65535.0]);
        samples(2, 16, true, true).decode(&[0x01, 0x02, 0xFF, 0xFF], &mut counts);
        assert_eq!(counts, [258.0, -1.0]);
        // 12 stored bits: the four above belong to an overlay.
        samples(2, 12, true, false).decode(&[0xFF, 0xAF, 0x00, 0x18], &mut counts);
        assert_eq!(counts, [-1.0, -2048.0]);
        samples(1, 8, true, false).decode(&[0x80, 0x7F], &mut counts);
        assert_eq!(counts, [-128.0, 127.0]);
        let rescaled = Samples { slope: 0.5, intercept: 10.0, ..samples(1, 8, false, false) };
        rescaled.decode(&[4, 255], &mut counts);
        assert_eq!(counts, [12.0, 137.5]);
    }

    #[test]
    fn pack_bits_follows_the_example_of_the_format_and_stops_at_the_frame() {
        // Apple's example of PackBits.
        let packed = [0xFE, 0xAA, 0x02, 0x80, 0x00, 0x2A, 0xFD, 0xAA, 0x03, 0x80, 0x00, 0x2A, 0x22, 0xF7, 0xAA];
        let mut out = [0; 24];
        assert_eq!(unpack_bits(&packed, out.iter_mut()), 24);
        assert_eq!(out[..8], [0xAA, 0xAA, 0xAA, 0x80, 0x00, 0x2A, 0xAA, 0xAA]);
        assert_eq!(unpack_bits(&packed, out[..5].iter_mut()), 5);
        assert_eq!(unpack_bits(&[0x05, 1, 2], out.iter_mut()), 2);
        assert_eq!(unpack_bits(&[0x81], out.iter_mut()), 0);
    }
}
