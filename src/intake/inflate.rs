//! Inflating with a cap: a deflate stream of one megabyte can hold a gigabyte of zeros.

use flate2::read::{DeflateDecoder, MultiGzDecoder};
use std::io::{self, Read};

/// Why a stream was not inflated.
#[derive(Debug)]
pub(super) enum Failure {
    /// It holds more than the cap.
    OverCap,
    /// It does not follow the format.
    Damaged(io::Error),
}

/// Inflates a raw deflate stream (RFC 1951), as DICOM's deflated transfer syntax has it.
pub(super) fn deflated(bytes: &[u8], cap: usize) -> Result<Vec<u8>, Failure> {
    capped(DeflateDecoder::new(bytes), cap)
}

/// Inflates a gzip stream (RFC 1952) of one or several members.
pub(super) fn gzipped(bytes: &[u8], cap: usize) -> Result<Vec<u8>, Failure> {
    capped(MultiGzDecoder::new(bytes), cap)
}

fn capped(stream: impl Read, cap: usize) -> Result<Vec<u8>, Failure> {
    let mut inflated = Vec::new();
    let mut limited = stream.take(cap as u64 + 1);
    limited.read_to_end(&mut inflated).map_err(Failure::Damaged)?;
    if inflated.len() > cap { Err(Failure::OverCap) } else { Ok(inflated) }
}
