//! Studies as single-file NIfTI-1.
//!
//! The 348-byte header is written by hand: the `nifti` crate writes to paths only. Dimensions are `(x, y, z[, gate])`; the affine (`sform`,
//! scanner coordinates) takes voxel indices to RAS mm. Orientation-free studies get an `sform` code of 0 and the voxel sizes only.

use crate::study::Study;
use flate2::{Compression, GzBuilder};
use std::io::Write;

/// Where the voxels begin: header, and four bytes that announce no extension.
const VOXELS_AT: usize = 352;
/// `datatype` of 32-bit floats.
const FLOAT32: i16 = 16;
/// `xform` code of scanner coordinates.
const SCANNER: i16 = 1;
/// `xyzt_units`: millimetres and milliseconds.
const MM_MS: u8 = 2 | 16;

/// A study as NIfTI-1 with 32-bit floats, little endian: counts exactly as in memory.
pub fn write(study: &Study) -> Vec<u8> {
    let mut bytes = header(study);
    for gate in &study.gates {
        // Memory order is slice, row, column: the first NIfTI dimension, x, varies fastest.
        bytes.extend(gate.volume.counts.iter().flat_map(|count| count.to_le_bytes()));
    }
    bytes
}

/// [`write()`], gzipped; the same study gives the same bytes (no time stamp).
///
/// Errors: none in practice, writing to memory; passed on rather than hidden.
pub fn write_gzipped(study: &Study) -> std::io::Result<Vec<u8>> {
    let mut gzip = GzBuilder::new().write(Vec::new(), Compression::default());
    gzip.write_all(&write(study))?;
    gzip.finish()
}

/// The header and its four bytes of extension flags.
fn header(study: &Study) -> Vec<u8> {
    let mut bytes = vec![0; VOXELS_AT];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    let [nz, ny, nx] = study.grid.shape;
    let [dz, dy, dx] = study.grid.spacing_mm;
    put(0, &348_i32.to_le_bytes());
    let dimensions = [if study.is_gated() { 4 } else { 3 }, nx, ny, nz, study.gates.len(), 1, 1, 1];
    for (index, size) in dimensions.into_iter().enumerate() {
        put(40 + 2 * index, &(size as i16).to_le_bytes());
    }
    put(70, &FLOAT32.to_le_bytes());
    put(72, &32_i16.to_le_bytes());
    let duration_ms = study.gates.first().and_then(|gate| gate.duration_ms).unwrap_or(0.0);
    for (index, size) in [1.0, dx, dy, dz, duration_ms].into_iter().enumerate() {
        put(76 + 4 * index, &(size as f32).to_le_bytes());
    }
    put(108, &(VOXELS_AT as f32).to_le_bytes());
    put(112, &1_f32.to_le_bytes());
    put(123, &[MM_MS]);
    put(148, b"ventricle phantom");
    if let Some(orientation) = &study.orientation {
        put(254, &SCANNER.to_le_bytes());
        // LPS to RAS: x and y change sign.
        let columns = [orientation.columns * dx, orientation.rows * dy, orientation.slices * dz, orientation.origin_mm];
        for (row, sign) in [-1.0, -1.0, 1.0].into_iter().enumerate() {
            for (column, vector) in columns.iter().enumerate() {
                put(280 + 16 * row + 4 * column, &((sign * vector[row]) as f32).to_le_bytes());
            }
        }
    }
    put(344, b"n+1\0");
    bytes
}
