//! What parent and child write to each other: one request, one answer, again and again.

use super::{Codec, Layout};
use std::io::{self, ErrorKind, Read, Write};

/// What the child writes first, once it has set its limits: another program would not.
pub(super) const READY: [u8; 18] = *b"ventricle frames 1";
/// Longest reason a child may give.
const LONGEST_REASON: usize = 300;
/// Codec, Bits Allocated, Bits Stored, rows, columns, bytes that follow.
const REQUEST_BYTES: usize = 11;

/// One frame to decode.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Request {
    pub(super) codec: Codec,
    pub(super) layout: Layout,
    pub(super) frame: Vec<u8>,
}

pub(super) fn write_request(to: &mut impl Write, codec: Codec, layout: Layout, frame: &[u8]) -> io::Result<()> {
    let codec = match codec {
        Codec::Jpeg => 1,
        Codec::JpegLossless => 2,
        Codec::JpegLs => 3,
        Codec::Jpeg2000 => 4,
    };
    let length = u32::try_from(frame.len()).map_err(|_| ErrorKind::InvalidInput)?;
    let mut head = vec![codec, layout.bits_allocated, layout.bits_stored];
    head.extend(layout.rows.to_le_bytes());
    head.extend(layout.columns.to_le_bytes());
    head.extend(length.to_le_bytes());
    to.write_all(&head)?;
    to.write_all(frame)?;
    to.flush()
}

/// The next request; `None` where the parent has no more.
pub(super) fn read_request(from: &mut impl Read) -> io::Result<Option<Request>> {
    let mut head = [0; REQUEST_BYTES];
    if from.read(&mut head[..1])? == 0 {
        return Ok(None);
    }
    from.read_exact(&mut head[1..])?;
    let [codec, bits_allocated, bits_stored, r0, r1, c0, c1, length @ ..] = head;
    let codec = match codec {
        1 => Codec::Jpeg,
        2 => Codec::JpegLossless,
        3 => Codec::JpegLs,
        4 => Codec::Jpeg2000,
        _ => return Err(ErrorKind::InvalidData.into()),
    };
    let layout = Layout { rows: u16::from_le_bytes([r0, r1]), columns: u16::from_le_bytes([c0, c1]), bits_allocated, bits_stored };
    let frame = read_bytes(from, u32::from_le_bytes(length) as usize)?;
    Ok(Some(Request { codec, layout, frame }))
}

pub(super) fn write_answer(to: &mut impl Write, answer: &Result<Vec<u8>, String>) -> io::Result<()> {
    let (kind, bytes) = match answer {
        Ok(samples) => (0_u8, samples.as_slice()),
        Err(reason) => (1, &reason.as_bytes()[..reason.len().min(LONGEST_REASON)]),
    };
    to.write_all(&[kind])?;
    to.write_all(&(bytes.len() as u32).to_le_bytes())?;
    to.write_all(bytes)?;
    to.flush()
}

/// An answer to a request for `expected` bytes of samples; the inner error is the decoder's reason.
pub(super) fn read_answer(from: &mut impl Read, expected: usize) -> io::Result<Result<Vec<u8>, String>> {
    let mut head = [0; 5];
    from.read_exact(&mut head)?;
    let [kind, length @ ..] = head;
    let length = u32::from_le_bytes(length) as usize;
    match kind {
        0 if length == expected => read_bytes(from, length).map(Ok),
        1 if length <= LONGEST_REASON => {
            let reason = read_bytes(from, length)?;
            let printable = String::from_utf8_lossy(&reason).chars().filter(|c| !c.is_control()).collect();
            Ok(Err(printable))
        }
        _ => Err(ErrorKind::InvalidData.into()),
    }
}

/// Takes memory as bytes arrive, not as they are announced.
fn read_bytes(from: &mut impl Read, length: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(length as u64).read_to_end(&mut bytes)?;
    if bytes.len() == length { Ok(bytes) } else { Err(ErrorKind::UnexpectedEof.into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { rows: 3, columns: 500, bits_allocated: 16, bits_stored: 12 };

    #[test]
    fn requests_arrive_as_they_were_sent() {
        let mut pipe = Vec::new();
        for codec in [Codec::Jpeg, Codec::JpegLossless, Codec::JpegLs, Codec::Jpeg2000] {
            write_request(&mut pipe, codec, LAYOUT, &[1, 2, 3]).unwrap();
        }
        let mut pipe = pipe.as_slice();
        for codec in [Codec::Jpeg, Codec::JpegLossless, Codec::JpegLs, Codec::Jpeg2000] {
            assert_eq!(read_request(&mut pipe).unwrap(), Some(Request { codec, layout: LAYOUT, frame: vec![1, 2, 3] }));
        }
        assert_eq!(read_request(&mut pipe).unwrap(), None);
    }

    #[test]
    fn a_wrong_answer_is_an_error_and_allocates_nothing() {
        let mut pipe = Vec::new();
        write_answer(&mut pipe, &Ok(vec![7; 6])).unwrap();
        write_answer(&mut pipe, &Err("broken".to_owned())).unwrap();
        let mut reader = pipe.as_slice();
        assert_eq!(read_answer(&mut reader, 6).unwrap(), Ok(vec![7; 6]));
        assert_eq!(read_answer(&mut reader, 6).unwrap(), Err("broken".to_owned()));
        assert_eq!(read_answer(&mut pipe.as_slice(), 7).unwrap_err().kind(), ErrorKind::InvalidData);
        let claims = [1, 0xFF, 0xFF, 0xFF, 0xFF];
        assert_eq!(read_answer(&mut claims.as_slice(), 6).unwrap_err().kind(), ErrorKind::InvalidData);
        assert_eq!(read_answer(&mut pipe[..8].as_ref(), 6).unwrap_err().kind(), ErrorKind::UnexpectedEof);
    }
}
