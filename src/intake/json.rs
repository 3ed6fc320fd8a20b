//! The JSON body of the HTTP contract: a grid, counts in base64, and parameters beside them.

use super::error::shown;
use super::{IntakeError, Limits, Received, counts};
use crate::study::{Acquisition, Format, Study};
use crate::volume::Grid;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ndarray::Array3;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::borrow::Cow;

/// The body. Counts are gate, slice, row, column, little-endian.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Body<'a, P> {
    grid: Extent,
    #[serde(borrow)]
    counts: Cow<'a, str>,
    dtype: Sample,
    #[serde(default = "none")]
    parameters: Option<P>,
}

fn none<P>() -> Option<P> {
    None
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "an object with `gates`, `shape` and `spacing_mm`")]
struct Extent {
    #[serde(default = "one")]
    gates: usize,
    shape: [usize; 3],
    spacing_mm: [f64; 3],
}

fn one() -> usize {
    1
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
enum Sample {
    Uint16,
    Float32,
}

/// Reads a body.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<Received, IntakeError> {
    let malformed = |reason: String| IntakeError::MalformedJson { reason };
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let syntax = |error: serde_json::Error| malformed(shown(&error.to_string()));
    // Parameters become values only after it is known that they are small: a parsed value takes many times its text.
    let body: Body<'_, IgnoredAny> = serde_json::from_slice(bytes).map_err(syntax)?;
    let overhead = bytes.len().saturating_sub(body.counts.len());
    if overhead > limits.json_overhead_bytes {
        return Err(IntakeError::TooLarge {
            what: "the JSON body without its counts",
            bytes: Some(overhead),
            limit: limits.json_overhead_bytes,
        });
    }
    let Extent { gates, shape, spacing_mm } = body.grid;
    counts::check_extent(gates, shape, limits)?;
    counts::check_spacing(spacing_mm, limits)?;
    let grid = Grid { shape, spacing_mm };

    let sample_bytes = match body.dtype {
        Sample::Uint16 => 2,
        Sample::Float32 => 4,
    };
    let expected = gates * grid.voxels() * sample_bytes;
    let encoded = expected.div_ceil(3) * 4;
    if body.counts.len() != encoded {
        return Err(malformed(format!(
            "counts has {} base64 characters where {gates} gates of shape {shape:?} need {encoded} ({expected} bytes)",
            body.counts.len()
        )));
    }
    let decoded = STANDARD.decode(body.counts.as_bytes()).map_err(|error| malformed(format!("counts is no base64: {error}")))?;
    if decoded.len() != expected {
        return Err(malformed(format!("counts holds {} bytes where {gates} gates of shape {shape:?} need {expected}", decoded.len())));
    }
    let value: fn(&[u8]) -> f32 = match body.dtype {
        Sample::Uint16 => |b| f32::from(u16::from_le_bytes([b[0], b[1]])),
        Sample::Float32 => |b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
    };
    let volumes = decoded
        .chunks_exact(grid.voxels() * sample_bytes)
        .map(|gate| {
            let values = gate.chunks_exact(sample_bytes).map(value).collect();
            Array3::from_shape_vec(shape, values).map_err(|error| malformed(error.to_string()))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut warnings = Vec::new();
    let gates = counts::gates(grid, volumes, &[], &mut warnings)?;
    let study = Study { grid, gates, orientation: None, acquisition: Acquisition::unknown(Format::Json), warnings };
    let parameters = match body.parameters {
        Some(IgnoredAny) => serde_json::from_slice::<Body<'_, serde_json::Value>>(bytes).map_err(syntax)?.parameters,
        None => None,
    };
    Ok(Received { study, parameters, subject: None })
}
