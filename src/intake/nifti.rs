//! NIfTI-1 in one file, plain or gzipped: dimensions x, y, z and gate.
//!
//! The `nifti` crate reads the header; the voxels are read here, from bytes that are known to be there.

use super::{IntakeError, Limits, counts, inflate};
use crate::study::{Acquisition, Format, Orientation, Study, Warning};
use crate::volume::Grid;
use glam::{DMat3, DQuat, DVec3};
use ndarray::Array3;
use nifti::{Endianness, NiftiHeader};

/// Size of a NIfTI-1 header.
const HEADER_BYTES: usize = 348;
/// Where the voxels of a single file begin if the header does not say: after the header and four bytes that announce extensions.
const FIRST_VOXEL: usize = 352;
/// How far the columns of an affine may be from right angles.
const SHEAR_TOLERANCE: f64 = 0.01;
/// How far an affine's voxel size may be from pixdim, relatively.
const SIZE_TOLERANCE: f64 = 0.01;

/// Reads a gzipped file.
pub(super) fn read_gzipped(bytes: &[u8], limits: &Limits) -> Result<Study, IntakeError> {
    let inflated = inflate::gzipped(bytes, limits.inflated_bytes).map_err(|failure| match failure {
        inflate::Failure::OverCap => IntakeError::TooLarge { what: "the gzip stream", bytes: None, limit: limits.inflated_bytes },
        inflate::Failure::Damaged(reason) => IntakeError::DamagedGzip { reason: reason.to_string() },
    })?;
    read(&inflated, limits)
}

/// Reads a plain file.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<Study, IntakeError> {
    let malformed = |reason: String| IntakeError::MalformedNifti { reason };
    let unsupported = |received: &str| IntakeError::UnsupportedNifti { received: received.to_owned() };
    match (bytes.get(4..8), bytes.get(344..348)) {
        (Some(b"n+2\0" | b"ni2\0"), _) => return Err(unsupported("NIfTI-2")),
        (_, Some(b"ni1\0")) => return Err(unsupported("a NIfTI-1 header of a pair of files (.hdr and .img)")),
        (_, Some(b"n+1\0")) => {}
        (_, Some(_)) => return Err(malformed("there is no NIfTI-1 magic (n+1) at byte 344; only NIfTI may come gzipped".to_owned())),
        (_, None) => return Err(malformed(format!("it has {} bytes, less than a header of {HEADER_BYTES}", bytes.len()))),
    }
    let header = NiftiHeader::from_reader(&bytes[..HEADER_BYTES]).map_err(|error| malformed(error.to_string()))?;
    let mut warnings = Vec::new();

    let dim = header.dim;
    let (gates, shape) = extent(dim)?;
    counts::check_extent(gates, shape, limits)?;
    let sample = Sample::of(header.datatype)?;
    let grid = Grid { shape, spacing_mm: spacing_mm(&header, &mut warnings)? };
    counts::check_spacing(grid.spacing_mm, limits)?;

    let offset = voxel_offset(header.vox_offset)?;
    let expected = gates * grid.voxels() * sample.bytes();
    let voxels = bytes.get(offset..).unwrap_or_default();
    let voxels = voxels.get(..expected).ok_or_else(|| {
        let [slices, rows, columns] = shape;
        malformed(format!(
            "{gates} gates of {slices} slices, {rows} rows and {columns} columns need {expected} bytes after byte {offset}, and {} are there; send the whole file",
            voxels.len()
        ))
    })?;
    // Slope 0 means no scaling by the standard; NaN by custom of writers.
    let slope = if header.scl_slope.is_finite() && header.scl_slope != 0.0 { f64::from(header.scl_slope) } else { 1.0 };
    let unscaled = !header.scl_slope.is_finite() || header.scl_slope == 0.0;
    let intercept = if unscaled || !header.scl_inter.is_finite() { 0.0 } else { f64::from(header.scl_inter) };
    let big_endian = header.endianness == Endianness::Big;
    let volumes = voxels
        .chunks_exact(grid.voxels() * sample.bytes())
        .map(|gate| {
            let values =
                gate.chunks_exact(sample.bytes()).map(|value| (sample.read(value, big_endian) * slope + intercept) as f32).collect();
            Array3::from_shape_vec(shape, values).map_err(|error| malformed(error.to_string()))
        })
        .collect::<Result<Vec<_>, _>>()?;

    let duration_ms = gate_duration_ms(&header).filter(|_| gates > 1);
    let gates = counts::gates(grid, volumes, &vec![duration_ms; gates], &mut warnings)?;
    let orientation = orientation(&header, &grid, &mut warnings);
    let mut acquisition = Acquisition::unknown(Format::Nifti);
    acquisition.rr_interval_ms = duration_ms.map(|duration| duration * gates.len() as f64);
    Ok(Study { grid, gates, orientation, acquisition, warnings })
}

/// Gates and `[z, y, x]` of the header's dimensions.
fn extent(dim: [u16; 8]) -> Result<(usize, [usize; 3]), IntakeError> {
    let rank = usize::from(dim[0]);
    if !(3..=7).contains(&rank) {
        return Err(IntakeError::UnsupportedNifti { received: format!("a NIfTI-1 image of {rank} dimensions") });
    }
    let size = |axis: usize| if axis <= rank { usize::from(dim[axis]) } else { 1 };
    if let Some(axis) = (5..=rank).find(|&axis| size(axis) != 1) {
        return Err(IntakeError::UnsupportedNifti {
            received: format!("a NIfTI-1 image whose dimension {axis} has {} elements", size(axis)),
        });
    }
    Ok((size(4), [size(3), size(2), size(1)]))
}

/// Sample types that are read.
#[derive(Debug, Clone, Copy)]
enum Sample {
    U8,
    I16,
    U16,
    I32,
    F32,
    F64,
}

impl Sample {
    /// By the header's datatype code.
    fn of(datatype: i16) -> Result<Self, IntakeError> {
        match datatype {
            2 => Ok(Self::U8),
            4 => Ok(Self::I16),
            8 => Ok(Self::I32),
            16 => Ok(Self::F32),
            64 => Ok(Self::F64),
            512 => Ok(Self::U16),
            other => Err(IntakeError::UnsupportedNifti {
                received: format!("a NIfTI-1 image of datatype {other} (read are uint8, int16, uint16, int32, float32 and float64)"),
            }),
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn read(self, value: &[u8], big_endian: bool) -> f64 {
        let mut little = [0; 8];
        little[..value.len()].copy_from_slice(value);
        if big_endian {
            little[..value.len()].reverse();
        }
        let [a, b, c, d, ..] = little;
        match self {
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(little),
        }
    }
}

/// Spacing `[z, y, x]` in mm from pixdim and the unit of length.
fn spacing_mm(header: &NiftiHeader, warnings: &mut Vec<Warning>) -> Result<[f64; 3], IntakeError> {
    let unit_mm = length_unit_mm(header);
    if unit_mm.is_none() {
        warnings.push(Warning::new("unknown_unit", "The NIfTI header does not say its unit of length; millimetres were assumed."));
    }
    let mut spacing = [0.0; 3];
    for (slot, axis) in spacing.iter_mut().zip([3, 2, 1]) {
        let size = f64::from(header.pixdim[axis]).abs();
        if !(size.is_finite() && size > 0.0) {
            return Err(IntakeError::MalformedNifti {
                reason: format!("pixdim[{axis}], the distance between voxels, is {}; it must be a positive number", header.pixdim[axis]),
            });
        }
        // pixdim is f32: 3.2 must stay 3.2.
        *slot = (size * unit_mm.unwrap_or(1.0) * 1e6).round() / 1e6;
    }
    Ok(spacing)
}

/// Bits 0-2 of `xyzt_units`.
fn length_unit_mm(header: &NiftiHeader) -> Option<f64> {
    match header.xyzt_units & 7 {
        1 => Some(1000.0),
        2 => Some(1.0),
        3 => Some(0.001),
        _ => None,
    }
}

/// The fourth pixdim as the duration of a gate, if its unit (bits 3-5 of `xyzt_units`) is one of time and it is plausible.
fn gate_duration_ms(header: &NiftiHeader) -> Option<f64> {
    let unit_ms = match header.xyzt_units & 0x38 {
        8 => 1000.0,
        16 => 1.0,
        24 => 0.001,
        _ => return None,
    };
    let duration = (f64::from(header.pixdim[4]) * unit_ms * 1e3).round() / 1e3;
    (5.0..=1000.0).contains(&duration).then_some(duration)
}

fn voxel_offset(declared: f32) -> Result<usize, IntakeError> {
    if declared == 0.0 {
        return Ok(FIRST_VOXEL);
    }
    if declared >= FIRST_VOXEL as f32 && declared.fract() == 0.0 && declared < 1e9 {
        return Ok(declared as usize);
    }
    Err(IntakeError::MalformedNifti {
        reason: format!("vox_offset, where the voxels begin, is {declared}; in one file it is at least {FIRST_VOXEL}"),
    })
}

/// The affine map of the header (sform before qform) in DICOM's axes.
fn orientation(header: &NiftiHeader, grid: &Grid, warnings: &mut Vec<Warning>) -> Option<Orientation> {
    let unit_mm = length_unit_mm(header).unwrap_or(1.0);
    let rows = [header.srow_x, header.srow_y, header.srow_z].map(|row| row.map(f64::from));
    let (axes, origin) = if header.sform_code > 0 {
        let column = |j: usize| DVec3::new(rows[0][j], rows[1][j], rows[2][j]) * unit_mm;
        ([column(0), column(1), column(2)], column(3))
    } else if header.qform_code > 0 {
        quaternion_axes(header, grid, unit_mm)
    } else {
        warnings.push(Warning::new(
            "missing_orientation",
            "The NIfTI header has neither sform nor qform: surfaces are in grid axes, not the patient's, and nothing says that the slices are short-axis slices.",
        ));
        return None;
    };
    let step = grid.step_mm();
    let lengths = axes.map(DVec3::length);
    let finite = axes.iter().all(|axis| axis.is_finite()) && origin.is_finite() && lengths.iter().all(|length| *length > 0.0);
    let [x, y, z] = axes.map(DVec3::normalize_or_zero);
    let sheared = [x.dot(y), y.dot(z), z.dot(x)].iter().any(|cosine| cosine.abs() > SHEAR_TOLERANCE);
    if !finite || sheared {
        warnings.push(Warning::new(
            "invalid_orientation",
            "The affine map of the NIfTI header is degenerate or sheared and was ignored: surfaces are in grid axes, not the patient's.",
        ));
        return None;
    }
    if lengths.iter().zip(step.to_array()).any(|(length, spacing)| (length / spacing - 1.0).abs() > SIZE_TOLERANCE) {
        warnings.push(Warning::new(
            "voxel_size_disagrees",
            "The affine map of the NIfTI header and its pixdim give different voxel sizes; pixdim was taken.",
        ));
    }
    // NIfTI: x to the right, y to the front (RAS); DICOM: x to the left, y to the back (LPS).
    let lps = |v: DVec3| DVec3::new(0.0 - v.x, 0.0 - v.y, v.z);
    Some(Orientation { columns: lps(x), rows: lps(y), slices: lps(z), origin_mm: lps(origin) })
}

/// Axes and origin of the quaternion form (NIfTI-1, method 2).
fn quaternion_axes(header: &NiftiHeader, grid: &Grid, unit_mm: f64) -> ([DVec3; 3], DVec3) {
    let [b, c, d] = [header.quatern_b, header.quatern_c, header.quatern_d].map(f64::from);
    let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
    let rotation = DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize());
    let handedness = if header.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
    let step = grid.step_mm();
    let axes = [rotation.x_axis * step.x, rotation.y_axis * step.y, rotation.z_axis * step.z * handedness];
    let origin = DVec3::new(f64::from(header.quatern_x), f64::from(header.quatern_y), f64::from(header.quatern_z)) * unit_mm;
    (axes, origin)
}
