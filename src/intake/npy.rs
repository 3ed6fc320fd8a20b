//! NPY: one `NumPy` array `[gate, slice, row, column]` or `[slice, row, column]`. Its header is parsed strictly here: a general reader
//! allocates what the header declares, and 192 bytes can declare 80 GB.

use super::error::shown;
use super::{IntakeError, Limits, Options, counts};
use crate::study::{Acquisition, Format, Study};
use crate::volume::Grid;
use ndarray::Array3;

const MAGIC: &[u8] = b"\x93NUMPY";

/// Reads an array; its spacing comes with the request.
pub(super) fn read(bytes: &[u8], options: &Options, limits: &Limits) -> Result<Study, IntakeError> {
    let malformed = |reason: String| IntakeError::MalformedNpy { reason };
    let (header, data) = split(bytes)?;
    let header = Header::parse(header)?;
    if header.fortran_order {
        return Err(malformed("it is in Fortran order".to_owned()));
    }
    let (gates, shape) = match header.shape[..] {
        [slices, rows, columns] => (1, [slices, rows, columns]),
        [gates, slices, rows, columns] => (gates, [slices, rows, columns]),
        _ => return Err(malformed(format!("it has {} dimensions", header.shape.len()))),
    };
    let read: fn(&[u8]) -> f64 = match header.descr.as_str() {
        "|u1" | "<u1" => |b| f64::from(b[0]),
        "<u2" => |b| f64::from(u16::from_le_bytes([b[0], b[1]])),
        "<i2" => |b| f64::from(i16::from_le_bytes([b[0], b[1]])),
        "<f4" => |b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        "<f8" => |b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]),
        other => return Err(malformed(format!("its type is '{}'", shown(other)))),
    };
    let sample_bytes = usize::from(header.descr.as_bytes()[2] - b'0');
    counts::check_extent(gates, shape, limits)?;
    let gate_bytes = shape.iter().product::<usize>() * sample_bytes;
    let expected = gates * gate_bytes;
    if data.len() != expected {
        return Err(malformed(format!("its shape {:?} needs {expected} bytes of data, and {} are there", header.shape, data.len())));
    }
    let spacing_mm = options.spacing_mm.ok_or(IntakeError::MissingSpacing)?;
    counts::check_spacing(spacing_mm, limits)?;
    let grid = Grid { shape, spacing_mm };
    let volumes = data
        .chunks_exact(gate_bytes)
        .map(|gate| {
            let values = gate.chunks_exact(sample_bytes).map(|value| read(value) as f32).collect();
            Array3::from_shape_vec(shape, values).map_err(|error| malformed(error.to_string()))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut warnings = Vec::new();
    let gates = counts::gates(grid, volumes, &[], &mut warnings)?;
    Ok(Study { grid, gates, orientation: None, acquisition: Acquisition::unknown(Format::Npy), warnings })
}

/// The header's text and the data.
fn split(bytes: &[u8]) -> Result<(&str, &[u8]), IntakeError> {
    let malformed = |reason: &str| IntakeError::MalformedNpy { reason: reason.to_owned() };
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| malformed("there is no NUMPY magic"))?;
    let (length, rest) = match rest {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        [major, ..] => return Err(malformed(&format!("its format version is {major}"))),
        [] => return Err(malformed("it ends after the magic")),
    };
    let (header, data) = rest.split_at_checked(length).ok_or_else(|| malformed("it ends within its header"))?;
    Ok((std::str::from_utf8(header).map_err(|_| malformed("its header is no text"))?, data))
}

/// The Python dictionary in front of the data.
#[derive(Debug, Default, PartialEq)]
struct Header {
    descr: String,
    fortran_order: bool,
    shape: Vec<usize>,
}

impl Header {
    /// Parses `{'descr': '<u2', 'fortran_order': False, 'shape': (8, 24, 64, 64), }`, as `NumPy` writes it, keys in any order.
    fn parse(text: &str) -> Result<Self, IntakeError> {
        let malformed = || IntakeError::MalformedNpy { reason: "its header is not the dictionary that NumPy writes".to_owned() };
        let mut rest = text.trim().strip_prefix('{').and_then(|text| text.strip_suffix('}')).ok_or_else(malformed)?.trim();
        let mut header = Self::default();
        let mut seen = [false; 3];
        while !rest.is_empty() {
            let (key, after) = rest.strip_prefix('\'').and_then(|text| text.split_once('\'')).ok_or_else(malformed)?;
            let after = after.trim_start().strip_prefix(':').ok_or_else(malformed)?.trim_start();
            let (index, after) = match key {
                "descr" => {
                    let (descr, after) = after.strip_prefix('\'').and_then(|text| text.split_once('\'')).ok_or_else(malformed)?;
                    descr.clone_into(&mut header.descr);
                    (0, after)
                }
                "fortran_order" => {
                    header.fortran_order = after.starts_with("True");
                    (1, after.strip_prefix("True").or_else(|| after.strip_prefix("False")).ok_or_else(malformed)?)
                }
                "shape" => {
                    let (sizes, after) = after.strip_prefix('(').and_then(|text| text.split_once(')')).ok_or_else(malformed)?;
                    let sizes = sizes.trim().trim_end_matches(',');
                    header.shape = sizes.split(',').map(|size| size.trim().parse().map_err(|_| malformed())).collect::<Result<_, _>>()?;
                    (2, after)
                }
                _ => return Err(malformed()),
            };
            if std::mem::replace(&mut seen[index], true) {
                return Err(malformed());
            }
            let after = after.trim_start();
            rest = match after.strip_prefix(',') {
                Some(next) => next.trim_start(),
                None if after.is_empty() => after,
                None => return Err(malformed()),
            };
        }
        if seen == [true; 3] { Ok(header) } else { Err(malformed()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_is_parsed_as_numpy_writes_it_and_no_other_way() {
        let header = Header::parse("{'descr': '<u2', 'fortran_order': False, 'shape': (8, 24, 64, 64), }     \n").unwrap();
        assert_eq!(header, Header { descr: "<u2".to_owned(), fortran_order: false, shape: vec![8, 24, 64, 64] });
        assert!(Header::parse("{'shape':(4,),'fortran_order':True,'descr':'|u1'}").unwrap().fortran_order);
        for bad in [
            "",
            "{}",
            "{'descr': '<u2', 'fortran_order': False}",
            "{'descr': '<u2', 'descr': '<u2', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': '<u2', 'fortran_order': Maybe, 'shape': (1,)}",
            "{'descr': '<u2', 'fortran_order': False, 'shape': (-1, 99999999999999999999999)}",
            "{'descr': '<u2' 'fortran_order': False 'shape': (1,)}",
            "{'descr': [('a', '<u2')], 'fortran_order': False, 'shape': (1,)}",
        ] {
            assert!(Header::parse(bad).is_err(), "{bad}");
        }
    }
}
