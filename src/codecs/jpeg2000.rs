//! The first segment of a JPEG 2000 codestream, SIZ (ITU-T T.800 A.5.1).

use super::header::{Declared, HeaderError, damaged};

/// Start of codestream, then SIZ.
const BEGINNING: [u8; 4] = [0xFF, 0x4F, 0xFF, 0x51];
/// The signature of a JP2 file, which DICOM does not hold.
const JP2: [u8; 8] = *b"\0\0\0\x0cjP  ";
/// Tiles that one frame may have; a codestream can have 65 535.
const MOST_TILES: u64 = 1024;

/// What SIZ declares, for one component that fills the reference grid.
pub(super) fn declared(bytes: &[u8]) -> Result<Declared, HeaderError> {
    if bytes.starts_with(&JP2) {
        return Err(HeaderError::Unsupported("a JP2 file inside of DICOM"));
    }
    let Some(segment) = bytes.strip_prefix(&BEGINNING) else {
        return Err(damaged("it does not begin with the markers FF 4F FF 51"));
    };
    let ends = || damaged("it ends within its header");
    let u32_at =
        |at: usize| segment.get(at..at + 4).and_then(|bytes| bytes.first_chunk::<4>()).map(|bytes| u64::from(u32::from_be_bytes(*bytes)));
    let u16_at = |at: usize| segment.get(at..at + 2).map(|bytes| u16::from_be_bytes([bytes[0], bytes[1]]));
    let [width, height, left, top, tile_width, tile_height, tile_left, tile_top] = {
        let mut values = [0; 8];
        for (index, value) in values.iter_mut().enumerate() {
            *value = u32_at(4 + 4 * index).ok_or_else(ends)?;
        }
        values
    };
    let components = u16_at(36).ok_or_else(ends)?;
    let &[precision, step_x, step_y] = segment.get(38..41).and_then(|bytes| bytes.first_chunk::<3>()).ok_or_else(ends)?;
    let consistent = left < width
        && top < height
        && tile_left <= left
        && tile_top <= top
        && tile_left + tile_width > left
        && tile_top + tile_height > top
        && u16_at(0) == components.checked_mul(3).and_then(|bytes| bytes.checked_add(38));
    if !consistent || [step_x, step_y] != [1, 1] {
        return Err(damaged("its header (SIZ) contradicts itself, or its component does not fill the image"));
    }
    let tiles = (width - tile_left).div_ceil(tile_width) * (height - tile_top).div_ceil(tile_height);
    if tiles > MOST_TILES {
        return Err(damaged(format!("its header declares {tiles} tiles, more than the {MOST_TILES} that a frame may have")));
    }
    // The highest bit says whether samples are signed.
    Ok(Declared { rows: height - top, columns: width - left, components, precision: (precision & 0x7F) + 1 })
}

/// Whether the samples of a codestream with a valid header are signed.
pub(super) fn is_signed(bytes: &[u8]) -> bool {
    bytes.get(42).is_some_and(|precision| precision & 0x80 != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(sizes: [u32; 8], components: u16, of_component: [u8; 3]) -> Vec<u8> {
        let mut bytes = BEGINNING.to_vec();
        bytes.extend((38 + 3 * components).to_be_bytes());
        bytes.extend([0, 0]);
        bytes.extend(sizes.iter().flat_map(|size| size.to_be_bytes()));
        bytes.extend(components.to_be_bytes());
        bytes.extend(of_component);
        bytes
    }

    #[test]
    fn the_image_lies_between_its_offset_and_the_end_of_the_grid() {
        let plain = stream([64, 48, 0, 0, 64, 48, 0, 0], 1, [15, 1, 1]);
        assert_eq!(declared(&plain), Ok(Declared { rows: 48, columns: 64, components: 1, precision: 16 }));
        assert!(!is_signed(&plain));
        let shifted = stream([70, 50, 6, 2, 32, 32, 6, 2], 1, [0x8B, 1, 1]);
        assert_eq!(declared(&shifted), Ok(Declared { rows: 48, columns: 64, components: 1, precision: 12 }));
        assert!(is_signed(&shifted));
        for length in 0..plain.len() {
            assert!(declared(&plain[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn impossible_grids_are_damaged() {
        for (sizes, of_component) in [
            ([64, 48, 64, 0, 64, 48, 0, 0], [15, 1, 1]),
            ([64, 48, 0, 0, 0, 48, 0, 0], [15, 1, 1]),
            ([64, 48, 0, 0, 64, 48, 1, 0], [15, 1, 1]),
            ([64, 48, 0, 0, 1, 1, 0, 0], [15, 1, 1]),
            ([64, 48, 0, 0, 64, 48, 0, 0], [15, 2, 1]),
            ([u32::MAX, u32::MAX, 0, 0, 1, 1, 0, 0], [15, 1, 1]),
        ] {
            assert!(matches!(declared(&stream(sizes, 1, of_component)), Err(HeaderError::Damaged(_))), "{sizes:?} {of_component:?}");
        }
        let jp2 = declared(b"\0\0\0\x0cjP  \r\n").unwrap_err();
        assert_eq!(jp2, HeaderError::Unsupported("a JP2 file inside of DICOM"));
    }
}
