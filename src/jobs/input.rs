//! The stored form of a study: what was parsed, not the file it came in, so that nothing that names a patient is ever on disk and the
//! file is parsed once.
//!
//! Layout: [`MAGIC`]; the length of the header in bytes, `u32` little-endian; the header, JSON; the counts of all gates in order,
//! `[slice, row, column]`, little-endian, `u16` if each is a whole number below 65536, else `f32`.

use crate::{
    study::{Acquisition, Gate, Orientation, Study, Warning},
    volume::{Grid, Volume},
};
use ndarray::Array3;
use serde::{Deserialize, Serialize};

/// Name and version of the form.
pub const MAGIC: [u8; 8] = *b"VENTRST1";

/// Media type of the form.
pub const MEDIA_TYPE: &str = "application/x-ventricle-study";

#[derive(Serialize, Deserialize)]
struct Header {
    grid: Grid,
    durations_ms: Vec<Option<f64>>,
    orientation: Option<Orientation>,
    acquisition: Acquisition,
    warnings: Vec<Warning>,
    counts: Encoding,
}

#[derive(Serialize, Deserialize, Clone, Copy, PartialEq, Debug)]
#[serde(rename_all = "snake_case")]
enum Encoding {
    U16,
    F32,
}

/// Why bytes are not a stored study.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// The bytes begin with something else.
    #[error("not a stored study")]
    Magic,
    /// The bytes end before the study does, or after.
    #[error("{found} bytes of counts where {expected} belong")]
    Length {
        /// What there is.
        found: usize,
        /// What the header says.
        expected: usize,
    },
    /// The header cannot be read or written.
    #[error("header: {0}")]
    Header(#[from] serde_json::Error),
    /// The header is too large or the grid is not that of the counts.
    #[error("{0}")]
    Shape(&'static str),
}

/// The study as bytes.
pub fn encode(study: &Study) -> Result<Vec<u8>, InputError> {
    let whole = |count: f32| f32::from(count as u16).to_bits() == count.to_bits();
    let counts = || study.gates.iter().flat_map(|gate| gate.volume.counts.iter().copied());
    if study.gates.iter().any(|gate| gate.volume.grid != study.grid || gate.volume.counts.dim() != shape(&study.grid)) {
        return Err(InputError::Shape("a gate is not on the study's grid"));
    }
    let encoding = if counts().all(whole) { Encoding::U16 } else { Encoding::F32 };
    let header = serde_json::to_vec(&Header {
        grid: study.grid,
        durations_ms: study.gates.iter().map(|gate| gate.duration_ms).collect(),
        orientation: study.orientation,
        acquisition: study.acquisition.clone(),
        warnings: study.warnings.clone(),
        counts: encoding,
    })?;
    let length = u32::try_from(header.len()).map_err(|_| InputError::Shape("the header is too large"))?;
    let mut bytes = Vec::with_capacity(12 + header.len() + study.gates.len() * study.grid.voxels() * encoding.width());
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(&header);
    match encoding {
        Encoding::U16 => counts().for_each(|count| bytes.extend_from_slice(&(count as u16).to_le_bytes())),
        Encoding::F32 => counts().for_each(|count| bytes.extend_from_slice(&count.to_le_bytes())),
    }
    Ok(bytes)
}

/// The study in these bytes. Counts are equal to those encoded to the last bit; the numbers of the header as `serde_json` reads them
/// (without its feature `float_roundtrip` some of seventeen digits differ in the last bit).
pub fn decode(bytes: &[u8]) -> Result<Study, InputError> {
    let rest = bytes.strip_prefix(&MAGIC).ok_or(InputError::Magic)?;
    let (length, rest) = rest.split_first_chunk::<4>().ok_or(InputError::Magic)?;
    let (header, counts) = rest.split_at_checked(u32::from_le_bytes(*length) as usize).ok_or(InputError::Magic)?;
    let header: Header = serde_json::from_slice(header)?;
    let gate_bytes = header
        .grid
        .shape
        .iter()
        .try_fold(header.counts.width(), |product, &extent| product.checked_mul(extent))
        .ok_or(InputError::Shape("the grid is too large"))?;
    let expected = gate_bytes.checked_mul(header.durations_ms.len()).ok_or(InputError::Shape("the grid is too large"))?;
    if counts.len() != expected || gate_bytes == 0 {
        return Err(InputError::Length { found: counts.len(), expected });
    }
    let gates = counts
        .chunks_exact(gate_bytes)
        .zip(&header.durations_ms)
        .map(|(chunk, &duration_ms)| {
            let counts = Array3::from_shape_vec(shape(&header.grid), header.counts.read(chunk))
                .map_err(|_| InputError::Shape("the counts do not fill the grid"))?;
            Ok(Gate { volume: Volume { grid: header.grid, counts }, duration_ms })
        })
        .collect::<Result<Vec<_>, InputError>>()?;
    Ok(Study { grid: header.grid, gates, orientation: header.orientation, acquisition: header.acquisition, warnings: header.warnings })
}

impl Encoding {
    /// Bytes of one count.
    fn width(self) -> usize {
        match self {
            Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    fn read(self, bytes: &[u8]) -> Vec<f32> {
        match self {
            Self::U16 => bytes.as_chunks::<2>().0.iter().map(|&count| f32::from(u16::from_le_bytes(count))).collect(),
            Self::F32 => bytes.as_chunks::<4>().0.iter().map(|&count| f32::from_le_bytes(count)).collect(),
        }
    }
}

fn shape(grid: &Grid) -> (usize, usize, usize) {
    let [z, y, x] = grid.shape;
    (z, y, x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::Format;
    use glam::DVec3;

    fn study(count: impl Fn(usize) -> f32) -> Study {
        let grid = Grid { shape: [2, 3, 4], spacing_mm: [5.74, 2.87, 0.1 + 0.2] };
        let gate = |gate: usize| Gate {
            volume: Volume { grid, counts: Array3::from_shape_fn(shape(&grid), |(z, y, x)| count(gate * 24 + z * 12 + y * 4 + x)) },
            duration_ms: (gate > 0).then_some(62.5),
        };
        Study {
            grid,
            gates: (0..3).map(gate).collect(),
            orientation: Some(Orientation {
                columns: DVec3::X,
                rows: DVec3::Y,
                slices: DVec3::Z,
                origin_mm: DVec3::new(0.1, -1e-9, 1.0 / 3.0),
            }),
            acquisition: Acquisition { study_instance_uid: Some("1.2.3".into()), ..Acquisition::unknown(Format::Dicom) },
            warnings: vec![Warning::at_gate(2, "odd", "Gate 2 is odd.")],
        }
    }

    #[test]
    fn whole_counts_take_two_bytes_and_come_back() {
        let study = study(|index| (index * 900) as f32);
        let bytes = encode(&study).expect("encodes");
        assert_eq!(decode(&bytes).expect("decodes"), study);
        let fractional = encode(&self::study(|index| index as f32 + 0.5)).expect("encodes");
        assert_eq!(fractional.len() - bytes.len(), 3 * 24 * 2);
    }

    #[test]
    fn other_counts_come_back_to_the_last_bit() {
        for odd in [0.1, -1.0, 65536.0, 1e30, -0.0] {
            let study = study(|index| if index == 7 { odd } else { 3.0 });
            let back = decode(&encode(&study).expect("encodes")).expect("decodes");
            assert_eq!(back, study);
            assert_eq!(back.gates[0].volume.counts[[0, 1, 3]].to_bits(), odd.to_bits());
        }
    }

    #[test]
    fn cut_or_foreign_bytes_are_refused() {
        let bytes = encode(&study(|_| 1.0)).expect("encodes");
        for length in 0..bytes.len() {
            assert!(decode(&bytes[..length]).is_err(), "{length} bytes");
        }
        assert!(matches!(decode(&[bytes.clone(), vec![0]].concat()), Err(InputError::Length { .. })));
        assert!(matches!(decode(&[0; 64]), Err(InputError::Magic)));
    }
}
