//! Which fragments of encapsulated pixel data make which frame (PS3.5 A.4).

use crate::intake::IntakeError;
use std::ops::Range;

/// What a JPEG or JPEG-LS frame begins with, and a JPEG 2000 codestream.
const BEGINNINGS: [[u8; 2]; 2] = [[0xFF, 0xD8], [0xFF, 0x4F]];

/// The fragments of each frame. Of all fragments, the first is the Basic Offset Table, which may be empty.
///
/// One fragment a frame is the rule. Where there are more, the table says which belong together; without one, each frame begins where a
/// fragment begins as compressed frames do.
///
/// # Errors
/// The fragments do not make so many frames.
pub(super) fn frames(data: &[u8], fragments: &[Range<usize>], frames: usize) -> Result<Vec<Vec<Range<usize>>>, IntakeError> {
    let inconsistent = |reason: String| IntakeError::InconsistentFrames { reason };
    let (table, images) = fragments.split_first().ok_or_else(|| inconsistent("the pixel data has no fragments".to_owned()))?;
    let alone = || images.iter().map(|fragment| vec![fragment.clone()]).collect();
    if images.len() == frames {
        return Ok(alone());
    }
    if images.len() < frames {
        return Err(inconsistent(format!(
            "Number of Frames (0028,0008) says {frames}, but the compressed pixel data has {} fragments",
            images.len()
        )));
    }
    if frames == 1 {
        return Ok(vec![images.to_vec()]);
    }
    let first = images[0].start;
    let offsets: Vec<usize> =
        data[table.clone()].chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]) as usize).collect();
    let begins = |index: usize, fragment: &Range<usize>| {
        if offsets.is_empty() {
            index == 0 || BEGINNINGS.iter().any(|beginning| data[fragment.clone()].starts_with(beginning))
        } else {
            offsets.binary_search(&(fragment.start - first)).is_ok()
        }
    };
    let mut grouped: Vec<Vec<Range<usize>>> = Vec::with_capacity(frames);
    for (index, fragment) in images.iter().enumerate() {
        match grouped.last_mut() {
            Some(frame) if !begins(index, fragment) => frame.push(fragment.clone()),
            _ => grouped.push(vec![fragment.clone()]),
        }
    }
    let whole_table = offsets.is_empty() || (offsets.len() == frames && offsets[0] == 0);
    if grouped.len() != frames || !whole_table {
        return Err(inconsistent(format!(
            "Number of Frames (0028,0008) says {frames}, but the {} fragments of the compressed pixel data make {} by {}",
            images.len(),
            grouped.len(),
            if offsets.is_empty() { "their own beginnings" } else { "the Basic Offset Table" }
        )));
    }
    Ok(grouped)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Items with these contents, the first as the offset table: all bytes, and where each content lies.
    fn items(contents: &[&[u8]]) -> (Vec<u8>, Vec<Range<usize>>) {
        let (mut data, mut places) = (vec![0xAA; 20], Vec::new());
        for content in contents {
            data.extend([0; 8]);
            places.push(data.len()..data.len() + content.len());
            data.extend(*content);
        }
        (data, places)
    }

    fn lengths(grouped: &[Vec<Range<usize>>]) -> Vec<usize> {
        grouped.iter().map(Vec::len).collect()
    }

    #[test]
    fn one_fragment_a_frame_needs_no_table() {
        let (data, places) = items(&[&[], &[1, 2], &[3, 4]]);
        assert_eq!(lengths(&frames(&data, &places, 2).unwrap()), [1, 1]);
        assert_eq!(lengths(&frames(&data, &places, 1).unwrap()), [2]);
        assert!(frames(&data, &places, 3).unwrap_err().to_string().contains("2 fragments"));
        assert!(frames(&data, &[], 1).is_err());
    }

    #[test]
    fn the_table_groups_fragments() {
        // The second frame begins after two items of 8 and 2 bytes.
        let table: Vec<u8> = [0_u32, 20].iter().flat_map(|offset| offset.to_le_bytes()).collect();
        let (data, places) = items(&[&table, &[1, 2], &[3, 4], &[5, 6]]);
        let grouped = frames(&data, &places, 2).unwrap();
        assert_eq!(lengths(&grouped), [2, 1]);
        assert_eq!(data[grouped[1][0].clone()], [5, 6]);
        for wrong in [[0_u32, 21], [4, 20], [0, 0]] {
            let table: Vec<u8> = wrong.iter().flat_map(|offset| offset.to_le_bytes()).collect();
            let (data, places) = items(&[&table, &[1, 2], &[3, 4], &[5, 6]]);
            assert!(frames(&data, &places, 2).unwrap_err().to_string().contains("Basic Offset Table"), "{wrong:?}");
        }
    }

    #[test]
    fn without_a_table_frames_begin_as_their_encoding_does() {
        let (data, places) = items(&[&[], &[0xFF, 0xD8, 1], &[2], &[3], &[0xFF, 0xD8, 4]]);
        assert_eq!(lengths(&frames(&data, &places, 2).unwrap()), [3, 1]);
        assert!(frames(&data, &places, 3).unwrap_err().to_string().contains("make 2"));
    }
}
