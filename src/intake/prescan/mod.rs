//! Walks the structure of a DICOM file before any parser sees it.
//!
//! A general parser trusts declared lengths: 366 bytes that declare a value of 4 GiB make it take 4 GiB, and a few hundred nested
//! sequences overflow its stack. This walk is iterative, allocates in proportion to the elements that are really there, compares every
//! declared length with what remains of its container, and limits depth and number of elements. It ends at the Pixel Data of the
//! outermost data set; what follows there (padding, private trailers) is never read.

mod error;
mod header;

pub use error::ScanError;

use super::{Limits, inflate};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::tags;
use header::{Header, UNDEFINED, read_header};
use std::borrow::Cow;
use std::ops::Range;

const ITEM: Tag = Tag(0xFFFE, 0xE000);
const ITEM_END: Tag = Tag(0xFFFE, 0xE00D);
const SEQUENCE_END: Tag = Tag(0xFFFE, 0xE0DD);

/// How a data set is encoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::intake) struct Encoding {
    /// Transfer Syntax UID.
    pub(in crate::intake) uid: String,
    pub(in crate::intake) explicit: bool,
    pub(in crate::intake) big_endian: bool,
}

impl Encoding {
    fn of(uid: &str) -> Self {
        Self { uid: uid.to_owned(), explicit: uid != "1.2.840.10008.1.2", big_endian: uid == "1.2.840.10008.1.2.2" }
    }
}

/// Where the Pixel Data of the outermost data set is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::intake) enum Pixels {
    Absent,
    /// One value of defined length.
    Native {
        value: Range<usize>,
        vr: VR,
    },
    /// Fragments; the first is the offset table.
    Encapsulated {
        fragments: Vec<Range<usize>>,
    },
}

/// An element of the outermost data set.
#[derive(Debug, Clone)]
pub(in crate::intake) struct Element {
    pub(in crate::intake) tag: Tag,
    /// Header and value.
    pub(in crate::intake) bytes: Range<usize>,
    /// Where the value begins.
    pub(in crate::intake) value_start: usize,
    /// Whether another parser must read the same structure: not so when it holds UN of undefined length, which some read as explicit, or a
    /// value that is no whole number of its VR's units, of which some read the whole units and take what is left for the next header.
    pub(in crate::intake) unambiguous: bool,
}

/// What the walk found.
#[derive(Debug, Clone)]
pub(in crate::intake) struct Scan<'a> {
    pub(in crate::intake) encoding: Encoding,
    /// The bytes that all ranges refer to: the file, or the inflated data set.
    pub(in crate::intake) data: Cow<'a, [u8]>,
    pub(in crate::intake) elements: Vec<Element>,
    pub(in crate::intake) pixels: Pixels,
    /// Media Storage SOP Class UID (0002,0002).
    pub(in crate::intake) media_class: Option<String>,
    /// Whether it has the preamble of a Part-10 file.
    pub(in crate::intake) part_10: bool,
}

/// Where a DICOM file's first element may begin.
enum Start {
    /// File meta information at this offset.
    Meta(usize),
    /// A data set without file meta information, in this transfer syntax.
    DataSet(&'static str),
}

/// Whether a body is DICOM, perhaps without preamble or damaged at its beginning.
pub(in crate::intake) fn looks_like_dicom(bytes: &[u8]) -> bool {
    bytes.get(128..132) == Some(b"DICM") || start(bytes).is_some()
}

fn start(bytes: &[u8]) -> Option<Start> {
    if bytes.get(128..132) == Some(b"DICM") && bytes.get(132..134) == Some(&[2, 0]) {
        return Some(Start::Meta(132));
    }
    if bytes.starts_with(b"DICM\x02\0") {
        return Some(Start::Meta(4));
    }
    let head = bytes.get(..8)?;
    let has_vr = VR::from_binary([head[4], head[5]]).is_some();
    let short_length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) <= 1024;
    match [head[0], head[1], head[2], head[3]] {
        [2, 0, _, 0] if has_vr || short_length => Some(Start::Meta(0)),
        // Identifying group, elements up to Modality: every data set begins there.
        [8, 0, 0..=0x60, 0] if has_vr => Some(Start::DataSet("1.2.840.10008.1.2.1")),
        [8, 0, 0..=0x60, 0] if short_length => Some(Start::DataSet("1.2.840.10008.1.2")),
        [0, 8, 0, 0..=0x60] if has_vr => Some(Start::DataSet("1.2.840.10008.1.2.2")),
        _ => None,
    }
}

/// Walks a DICOM file.
///
/// # Errors
/// [`ScanError`] for the first thing that contradicts itself or exceeds a limit.
pub(in crate::intake) fn scan<'a>(bytes: &'a [u8], limits: &Limits) -> Result<Scan<'a>, ScanError> {
    let (meta, part_10) = match start(bytes) {
        Some(Start::Meta(offset)) => (read_meta(bytes, offset)?, offset == 132),
        Some(Start::DataSet(uid)) => (Meta { transfer_syntax: Some(uid.to_owned()), media_class: None, end: 0 }, false),
        None => {
            return Err(ScanError::Malformed {
                offset: 132,
                found: "no file meta information (group 0002) follows the preamble".to_owned(),
            });
        }
    };
    let uid = meta.transfer_syntax.ok_or(ScanError::NoTransferSyntax)?;
    let encoding = Encoding::of(&uid);
    let (data, from) = if matches!(uid.as_str(), "1.2.840.10008.1.2.1.99" | "1.2.840.10008.1.2.4.95" | "1.2.840.10008.1.2.4.205") {
        (Cow::Owned(inflated(&bytes[meta.end..], limits)?), 0)
    } else {
        (Cow::Borrowed(bytes), meta.end)
    };
    let mut walk = Walk { data: &data, encoding: &encoding, limits, elements: Vec::new(), pixels: Pixels::Absent, count: 0 };
    walk.run(from)?;
    let Walk { elements, pixels, .. } = walk;
    Ok(Scan { encoding, elements, pixels, media_class: meta.media_class, part_10, data })
}

fn inflated(bytes: &[u8], limits: &Limits) -> Result<Vec<u8>, ScanError> {
    inflate::deflated(bytes, limits.inflated_bytes).map_err(|failure| match failure {
        inflate::Failure::OverCap => ScanError::InflatesTooLarge { limit: limits.inflated_bytes },
        inflate::Failure::Damaged(reason) => ScanError::DamagedDeflate { reason: reason.to_string() },
    })
}

struct Meta {
    transfer_syntax: Option<String>,
    media_class: Option<String>,
    end: usize,
}

/// Reads the file meta information: group 0002, little-endian, explicit VR by the standard, implicit in some old files. The group length
/// is not trusted; the group ends where another begins.
fn read_meta(bytes: &[u8], offset: usize) -> Result<Meta, ScanError> {
    let mut meta = Meta { transfer_syntax: None, media_class: None, end: offset };
    let explicit = bytes.get(offset + 4..offset + 6).is_some_and(|vr| VR::from_binary([vr[0], vr[1]]).is_some());
    while bytes.get(meta.end..meta.end + 2) == Some(&[2, 0]) {
        let header = read_header(bytes, meta.end, bytes.len(), explicit, false)?;
        let value = header.value(bytes.len())?;
        let text =
            || Some(String::from_utf8_lossy(&bytes[value.clone()]).trim_end_matches(['\0', ' ']).to_owned()).filter(|uid| !uid.is_empty());
        match header.tag {
            tags::TRANSFER_SYNTAX_UID => meta.transfer_syntax = text(),
            tags::MEDIA_STORAGE_SOP_CLASS_UID => meta.media_class = text(),
            _ => {}
        }
        meta.end = value.end;
    }
    Ok(meta)
}

/// Bytes of one value of a VR; 1 where values have no fixed size (PS3.5 6.2).
fn unit_bytes(vr: VR) -> usize {
    match vr {
        VR::SS | VR::US | VR::OW => 2,
        VR::AT | VR::FL | VR::OF | VR::OL | VR::SL | VR::UL => 4,
        VR::FD | VR::OD | VR::OV | VR::SV | VR::UV => 8,
        _ => 1,
    }
}

/// What an open container holds.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Holds {
    Items,
    Elements,
}

/// A sequence or item that has begun and not ended.
struct Container {
    holds: Holds,
    /// Its end; the end of the enclosing container if only a delimiter ends it.
    end: usize,
    delimited: bool,
    explicit: bool,
}

struct Walk<'a> {
    data: &'a [u8],
    encoding: &'a Encoding,
    limits: &'a Limits,
    elements: Vec<Element>,
    pixels: Pixels,
    count: usize,
}

impl Walk<'_> {
    fn run(&mut self, from: usize) -> Result<(), ScanError> {
        let mut at = from;
        let root = Container { holds: Holds::Elements, end: self.data.len(), delimited: false, explicit: self.encoding.explicit };
        let mut open = vec![root];
        while let Some(container) = open.last() {
            let (holds, end, delimited, explicit) = (container.holds, container.end, container.delimited, container.explicit);
            if at == end || (open.len() == 1 && self.is_padding(at)) {
                if delimited {
                    return Err(ScanError::EndsEarly { offset: at, within: "a sequence or item that has no delimiter".to_owned() });
                }
                open.pop();
                self.close_element(&open, at);
                continue;
            }
            let header = read_header(self.data, at, end, explicit, self.encoding.big_endian)?;
            self.count += 1;
            if self.count > self.limits.elements {
                return Err(ScanError::TooManyElements { limit: self.limits.elements });
            }
            at = match (holds, header.tag) {
                (Holds::Items, ITEM) => self.open(&mut open, &header, Holds::Elements, explicit)?,
                (Holds::Items, SEQUENCE_END) | (Holds::Elements, ITEM_END) if delimited => {
                    open.pop();
                    self.close_element(&open, header.value_start);
                    header.value_start
                }
                (Holds::Items, tag) => {
                    return Err(ScanError::Malformed { offset: at, found: format!("{tag} stands where an item of a sequence must begin") });
                }
                (Holds::Elements, Tag(0xFFFE, _)) => {
                    return Err(ScanError::Malformed {
                        offset: at,
                        found: format!("the delimiter {} stands where an element must begin", header.tag),
                    });
                }
                (Holds::Elements, tag) if open.len() == 1 && tag == tags::PIXEL_DATA => {
                    self.pixels = self.pixel_data(&header, end)?;
                    return Ok(());
                }
                (Holds::Elements, tag) => {
                    if open.len() == 1 {
                        self.elements.push(Element { tag, bytes: at..at, value_start: header.value_start, unambiguous: true });
                    }
                    self.element(&mut open, &header, end, explicit)?
                }
            };
        }
        Ok(())
    }

    /// Whether a header of zeros, or too few bytes for any header, remain: some writers pad files to a block.
    fn is_padding(&self, at: usize) -> bool {
        self.data.get(at..at + 8).is_none_or(|next| next == [0; 8])
    }

    /// Steps over a plain element or into a sequence; returns where to go on.
    fn element(&mut self, open: &mut Vec<Container>, header: &Header, end: usize, explicit: bool) -> Result<usize, ScanError> {
        let undefined = header.length == UNDEFINED;
        if header.vr == VR::SQ {
            return self.open(open, header, Holds::Items, explicit);
        }
        if undefined {
            // PS3.5 6.2.2: UN of undefined length holds items in implicit VR.
            if let Some(element) = self.elements.last_mut().filter(|_| explicit) {
                element.unambiguous = false;
            }
            if header.tag == tags::PIXEL_DATA {
                let fragments = self.fragments(header, end)?;
                return Ok(fragments.1);
            }
            return self.open(open, header, Holds::Items, explicit && header.vr != VR::UN);
        }
        let value = header.value(end)?;
        if let Some(element) = self.elements.last_mut().filter(|_| value.len() % unit_bytes(header.vr) != 0) {
            element.unambiguous = false;
        }
        self.close_element(open, value.end);
        Ok(value.end)
    }

    fn open(&self, open: &mut Vec<Container>, header: &Header, holds: Holds, explicit: bool) -> Result<usize, ScanError> {
        // A sequence and its item are two containers and one level of depth.
        if open.len() > 2 * self.limits.depth {
            return Err(ScanError::TooDeep { offset: header.offset, limit: self.limits.depth });
        }
        let container_end = open.last().map_or(self.data.len(), |container| container.end);
        let delimited = header.length == UNDEFINED;
        let end = if delimited { container_end } else { header.value(container_end)?.end };
        open.push(Container { holds, end, delimited, explicit });
        Ok(header.value_start)
    }

    /// Notes the end of an element of the outermost data set.
    fn close_element(&mut self, open: &[Container], end: usize) {
        if open.len() == 1
            && let Some(element) = self.elements.last_mut()
        {
            element.bytes.end = end;
        }
    }

    fn pixel_data(&mut self, header: &Header, end: usize) -> Result<Pixels, ScanError> {
        if header.length == UNDEFINED {
            return Ok(Pixels::Encapsulated { fragments: self.fragments(header, end)?.0 });
        }
        Ok(Pixels::Native { value: header.value(end)?, vr: header.vr })
    }

    /// The fragments of encapsulated pixel data and where they end.
    fn fragments(&mut self, pixel_data: &Header, end: usize) -> Result<(Vec<Range<usize>>, usize), ScanError> {
        let mut fragments = Vec::new();
        let mut at = pixel_data.value_start;
        loop {
            if at == end {
                return Err(ScanError::EndsEarly { offset: at, within: "encapsulated Pixel Data (7FE0,0010)".to_owned() });
            }
            let header = read_header(self.data, at, end, self.encoding.explicit, self.encoding.big_endian)?;
            self.count += 1;
            if self.count > self.limits.elements {
                return Err(ScanError::TooManyElements { limit: self.limits.elements });
            }
            match header.tag {
                ITEM => {
                    let value = header.value(end)?;
                    at = value.end;
                    fragments.push(value);
                }
                SEQUENCE_END => return Ok((fragments, header.value_start)),
                tag => {
                    return Err(ScanError::Malformed {
                        offset: at,
                        found: format!("{tag} stands where a fragment of Pixel Data must begin"),
                    });
                }
            }
        }
    }
}
