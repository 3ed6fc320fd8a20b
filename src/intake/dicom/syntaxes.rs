//! Transfer syntaxes: how the pixel data of each is read, and the names of those that are refused.

use crate::{codecs::Codec, intake::Limits};

/// How pixel data is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    /// One value with all frames.
    Native,
    /// One fragment a frame, uncompressed.
    Fragments,
    /// One fragment a frame, run lengths.
    Rle,
    /// Frames that a codec decodes.
    Compressed {
        codec: Codec,
        /// Whether the transfer syntax allows the writer to change values.
        lossy: bool,
    },
}

impl Encoding {
    /// How a transfer syntax is read, with its name; the name alone if it is not.
    pub(super) fn of(uid: &str) -> Result<(Self, &'static str), &'static str> {
        match READ.iter().find(|(known, ..)| *known == uid) {
            Some((_, name, encoding)) => Ok((*encoding, name)),
            None => Err(REFUSED.iter().find(|(known, _)| *known == uid).map_or("an encoding unknown here", |(_, name)| name)),
        }
    }
}

/// A transfer syntax that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TransferSyntax {
    /// Its UID.
    pub uid: &'static str,
    /// Whether it allows the writer to change values.
    pub lossy: bool,
}

/// The transfer syntaxes in which objects are read, within these limits.
pub fn transfer_syntaxes(limits: &Limits) -> Vec<TransferSyntax> {
    let read = |encoding: &Encoding| limits.decoder.is_some() || !matches!(encoding, Encoding::Compressed { .. });
    let syntaxes = READ.iter().filter(|(.., encoding)| read(encoding));
    syntaxes.map(|(uid, _, encoding)| TransferSyntax { uid, lossy: matches!(encoding, Encoding::Compressed { lossy: true, .. }) }).collect()
}

const fn lossless(codec: Codec) -> Encoding {
    Encoding::Compressed { codec, lossy: false }
}

const fn lossy(codec: Codec) -> Encoding {
    Encoding::Compressed { codec, lossy: true }
}

/// UID, name (PS3.6 A-1), way of reading.
const READ: [(&str, &str, Encoding); 14] = [
    ("1.2.840.10008.1.2", "Implicit VR Little Endian", Encoding::Native),
    ("1.2.840.10008.1.2.1", "Explicit VR Little Endian", Encoding::Native),
    ("1.2.840.10008.1.2.1.99", "Deflated Explicit VR Little Endian", Encoding::Native),
    ("1.2.840.10008.1.2.2", "Explicit VR Big Endian", Encoding::Native),
    ("1.2.840.10008.1.2.1.98", "Encapsulated Uncompressed Explicit VR Little Endian", Encoding::Fragments),
    ("1.2.840.10008.1.2.5", "RLE Lossless", Encoding::Rle),
    ("1.2.840.10008.1.2.4.50", "JPEG Baseline", lossy(Codec::Jpeg)),
    ("1.2.840.10008.1.2.4.51", "JPEG Extended", lossy(Codec::Jpeg)),
    ("1.2.840.10008.1.2.4.57", "JPEG Lossless", lossless(Codec::JpegLossless)),
    ("1.2.840.10008.1.2.4.70", "JPEG Lossless, first-order prediction", lossless(Codec::JpegLossless)),
    ("1.2.840.10008.1.2.4.80", "JPEG-LS Lossless", lossless(Codec::JpegLs)),
    ("1.2.840.10008.1.2.4.81", "JPEG-LS Near-lossless", lossy(Codec::JpegLs)),
    ("1.2.840.10008.1.2.4.90", "JPEG 2000 Lossless", lossless(Codec::Jpeg2000)),
    ("1.2.840.10008.1.2.4.91", "JPEG 2000", lossy(Codec::Jpeg2000)),
];

/// UID, name of what is refused by name.
const REFUSED: [(&str, &str); 20] = [
    ("1.2.840.10008.1.2.4.92", "JPEG 2000 Part 2 Lossless"),
    ("1.2.840.10008.1.2.4.93", "JPEG 2000 Part 2"),
    ("1.2.840.10008.1.2.4.94", "JPIP Referenced"),
    ("1.2.840.10008.1.2.4.95", "JPIP Referenced Deflate"),
    ("1.2.840.10008.1.2.4.100", "MPEG2"),
    ("1.2.840.10008.1.2.4.101", "MPEG2"),
    ("1.2.840.10008.1.2.4.102", "MPEG-4"),
    ("1.2.840.10008.1.2.4.103", "MPEG-4"),
    ("1.2.840.10008.1.2.4.107", "HEVC"),
    ("1.2.840.10008.1.2.4.108", "HEVC"),
    ("1.2.840.10008.1.2.4.110", "JPEG XL Lossless"),
    ("1.2.840.10008.1.2.4.111", "JPEG XL from JPEG"),
    ("1.2.840.10008.1.2.4.112", "JPEG XL"),
    ("1.2.840.10008.1.2.4.201", "High-Throughput JPEG 2000 Lossless"),
    ("1.2.840.10008.1.2.4.202", "High-Throughput JPEG 2000 Lossless, RPCL"),
    ("1.2.840.10008.1.2.4.203", "High-Throughput JPEG 2000"),
    ("1.2.840.10008.1.2.4.204", "JPIP Referenced, High-Throughput JPEG 2000"),
    ("1.2.840.10008.1.2.4.205", "JPIP Referenced Deflate, High-Throughput JPEG 2000"),
    ("1.2.840.10008.1.2.8.1", "Deflated Image Frame Compression"),
    ("1.2.840.113619.5.2", "GE private implicit VR big-endian"),
];
