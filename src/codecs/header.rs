//! What a compressed frame says of itself, compared with what the DICOM attributes say, before anything decodes it.

use super::{Codec, Layout, jpeg, jpeg2000};

/// End of image (JPEG, JPEG-LS) and end of codestream (JPEG 2000).
const END: [u8; 2] = [0xFF, 0xD9];

/// Why a frame is not given to a decoder.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HeaderError {
    /// The header contradicts itself, or the attributes.
    #[error("{0}")]
    Damaged(String),
    /// A valid variety that is not decoded here; its name.
    #[error("{0}")]
    Unsupported(&'static str),
}

pub(super) fn damaged(reason: impl Into<String>) -> HeaderError {
    HeaderError::Damaged(reason.into())
}

/// What the header of a frame declares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Declared {
    pub(super) rows: u64,
    pub(super) columns: u64,
    pub(super) components: u16,
    pub(super) precision: u8,
}

/// Checks the header of a compressed frame against the attributes, and that the frame has its end.
///
/// Allocates nothing and reads no further than the first scan or tile.
///
/// # Errors
/// [`HeaderError`]: what contradicts what, or the name of a variety that is not decoded.
pub fn check(codec: Codec, layout: Layout, frame: &[u8]) -> Result<(), HeaderError> {
    let declared = match codec {
        Codec::Jpeg | Codec::JpegLossless | Codec::JpegLs => jpeg::declared(codec, frame)?,
        Codec::Jpeg2000 => jpeg2000::declared(frame)?,
    };
    agree(declared, layout)?;
    if without_padding(frame).ends_with(&END) { Ok(()) } else { Err(damaged("it ends without the marker FF D9")) }
}

/// A frame without what pads it: zeros, or after its end a single byte of any value, as dcmtk writes.
pub(super) fn without_padding(frame: &[u8]) -> &[u8] {
    let zeros = frame.iter().rev().take_while(|byte| **byte == 0).count();
    let trimmed = &frame[..frame.len() - zeros];
    match trimmed.split_last() {
        Some((_, rest)) if rest.ends_with(&END) && !trimmed.ends_with(&END) => rest,
        _ => trimmed,
    }
}

fn agree(declared: Declared, layout: Layout) -> Result<(), HeaderError> {
    let Declared { rows, columns, components, precision } = declared;
    if (rows, columns) != (u64::from(layout.rows), u64::from(layout.columns)) {
        return Err(damaged(format!(
            "its own header says {rows} rows and {columns} columns, Rows (0028,0010) and Columns (0028,0011) say {} and {}",
            layout.rows, layout.columns
        )));
    }
    if components != 1 {
        return Err(damaged(format!("its own header says {components} components, Samples per Pixel (0028,0002) says 1")));
    }
    // Some writers compress the bits allocated instead of those stored.
    if !(layout.bits_stored..=layout.bits_allocated).contains(&precision) {
        return Err(damaged(format!(
            "its own header says {precision} bits, Bits Stored (0028,0101) and Bits Allocated (0028,0100) say {} and {}",
            layout.bits_stored, layout.bits_allocated
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_must_agree_with_the_attributes() {
        let layout = Layout { rows: 64, columns: 32, bits_allocated: 16, bits_stored: 12 };
        let good = Declared { rows: 64, columns: 32, components: 1, precision: 12 };
        assert_eq!(agree(good, layout), Ok(()));
        assert_eq!(agree(Declared { precision: 16, ..good }, layout), Ok(()));
        for (wrong, named) in [
            (Declared { rows: 65, ..good }, "65 rows"),
            (Declared { columns: 65_535, ..good }, "65535 columns"),
            (Declared { components: 3, ..good }, "3 components"),
            (Declared { precision: 11, ..good }, "11 bits"),
            (Declared { precision: 17, ..good }, "17 bits"),
        ] {
            let error = agree(wrong, layout).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }

    #[test]
    fn padding_is_zeros_or_one_byte_after_the_end() {
        for padded in [[0xFF, 0xD9, 0, 0].as_slice(), &[0xFF, 0xD9, 0x31], &[0xFF, 0xD9, 0xD9], &[0xFF, 0xD9]] {
            assert_eq!(without_padding(padded), [0xFF, 0xD9], "{padded:?}");
        }
        assert_eq!(without_padding(&[0xFF, 0xD9, 1, 2]), [0xFF, 0xD9, 1, 2]);
        assert_eq!(without_padding(&[0, 0]), [0_u8; 0]);
        assert_eq!(without_padding(&[1, 0, 2]), [1, 0, 2]);
    }
}
