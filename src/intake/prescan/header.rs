//! Headers of elements and items in the three encodings: implicit and explicit little-endian, explicit big-endian.

use super::ScanError;
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::{StandardDataDictionary, tags};
use std::ops::Range;

/// Length field that stands for "until the delimiter".
pub(super) const UNDEFINED: u32 = 0xFFFF_FFFF;

/// The header of an element or item.
pub(super) struct Header {
    pub(super) tag: Tag,
    pub(super) vr: VR,
    pub(super) length: u32,
    pub(super) offset: usize,
    pub(super) value_start: usize,
}

impl Header {
    /// The range of a value of defined length within a container.
    pub(super) fn value(&self, container_end: usize) -> Result<Range<usize>, ScanError> {
        let remaining = container_end - self.value_start;
        if self.length == UNDEFINED || self.length as usize > remaining {
            return Err(ScanError::Truncated { tag: self.tag, offset: self.offset, declared: self.length, remaining });
        }
        Ok(self.value_start..self.value_start + self.length as usize)
    }
}

/// Reads the header at an offset, none of it beyond `end`.
pub(super) fn read_header(data: &[u8], offset: usize, end: usize, explicit: bool, big_endian: bool) -> Result<Header, ScanError> {
    let ends_early = || ScanError::EndsEarly { offset: end, within: format!("the header of the element at byte {offset}") };
    let field = |from: usize, length: usize| {
        if from + length <= end { data.get(from..from + length).ok_or_else(ends_early) } else { Err(ends_early()) }
    };
    let u16_at =
        |from: usize| field(from, 2).map(|b| if big_endian { u16::from_be_bytes([b[0], b[1]]) } else { u16::from_le_bytes([b[0], b[1]]) });
    let u32_at = |from: usize| {
        field(from, 4)
            .map(|b| if big_endian { u32::from_be_bytes([b[0], b[1], b[2], b[3]]) } else { u32::from_le_bytes([b[0], b[1], b[2], b[3]]) })
    };
    let tag = Tag(u16_at(offset)?, u16_at(offset + 2)?);
    if tag.group() == 0xFFFE {
        return Ok(Header { tag, vr: VR::UN, length: u32_at(offset + 4)?, offset, value_start: offset + 8 });
    }
    if !explicit {
        let vr =
            if tag == tags::PIXEL_DATA { VR::OW } else { StandardDataDictionary.by_tag(tag).map_or(VR::UN, |entry| entry.vr().relaxed()) };
        return Ok(Header { tag, vr, length: u32_at(offset + 4)?, offset, value_start: offset + 8 });
    }
    let letters = field(offset + 4, 2)?;
    if !letters.iter().all(u8::is_ascii_uppercase) {
        return Err(ScanError::Malformed {
            offset,
            found: format!(
                "element {tag} has the bytes {:02X} {:02X} where explicit VR needs two letters (is the declared transfer syntax wrong?)",
                letters[0], letters[1]
            ),
        });
    }
    let vr = VR::from_binary([letters[0], letters[1]]).unwrap_or(VR::UN);
    if has_short_length(vr) {
        return Ok(Header { tag, vr, length: u32::from(u16_at(offset + 6)?), offset, value_start: offset + 8 });
    }
    Ok(Header { tag, vr, length: u32_at(offset + 8)?, offset, value_start: offset + 12 })
}

/// Whether the length field of a VR has 16 bits in explicit encodings (PS3.5 7.1.2).
fn has_short_length(vr: VR) -> bool {
    matches!(
        vr,
        VR::AE
            | VR::AS
            | VR::AT
            | VR::CS
            | VR::DA
            | VR::DS
            | VR::DT
            | VR::FL
            | VR::FD
            | VR::IS
            | VR::LO
            | VR::LT
            | VR::PN
            | VR::SH
            | VR::SL
            | VR::SS
            | VR::ST
            | VR::TM
            | VR::UI
            | VR::UL
            | VR::US
    )
}
