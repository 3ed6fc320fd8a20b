//! Compressed frames → samples: JPEG, JPEG Lossless, JPEG-LS, JPEG 2000.
//!
//! Decoders read hostile bytes with code of others. Two guards stand around them:
//! a frame's own header must agree with what the DICOM attributes say, and is read here before anything decodes it ([`check`]);
//! and they run in a child process with limits on memory and time ([`Decoder`]), whose death is one refused file. The child is this very
//! program under a hidden subcommand, which knows nothing but [`serve`].

mod child;
mod decode;
mod header;
mod jpeg;
mod jpeg2000;
mod parent;
mod protocol;

pub use child::serve;
pub use header::{HeaderError, check};
pub use parent::{DecodeError, Decoder, Session, child_seconds};

/// The hidden subcommand of the binary that decodes frames.
pub const SUBCOMMAND: &str = "decode-frames";

/// How a frame is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    /// JPEG by cosine transform, sequential, Huffman-coded, 8 bits (ITU-T T.81, processes 1 and 2).
    Jpeg,
    /// JPEG by prediction, Huffman-coded, 2 to 16 bits (ITU-T T.81, process 14).
    JpegLossless,
    /// JPEG-LS, lossless or near-lossless, 2 to 16 bits (ITU-T T.87).
    JpegLs,
    /// A JPEG 2000 codestream, 1 to 16 bits (ITU-T T.800).
    Jpeg2000,
}

/// What the attributes of the DICOM object say of each of its frames, which have one sample a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Rows (0028,0010).
    pub rows: u16,
    /// Columns (0028,0011).
    pub columns: u16,
    /// Bits Allocated (0028,0100): 8 or 16.
    pub bits_allocated: u8,
    /// Bits Stored (0028,0101).
    pub bits_stored: u8,
}

impl Layout {
    /// Pixels of a frame.
    pub fn pixels(&self) -> usize {
        usize::from(self.rows) * usize::from(self.columns)
    }

    /// Bytes of a sample.
    pub fn sample_bytes(&self) -> usize {
        usize::from(self.bits_allocated).div_ceil(8)
    }

    /// Bytes of a decoded frame.
    pub fn frame_bytes(&self) -> usize {
        self.pixels() * self.sample_bytes()
    }
}
