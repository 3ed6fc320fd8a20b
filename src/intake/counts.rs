//! The last step of every format: dimensions and spacing within the limits, counts finite and not negative.

use super::{IntakeError, Limits};
use crate::study::{Gate, Warning};
use crate::volume::{Grid, Volume};
use ndarray::Array3;
use std::fmt::Display;
use std::ops::RangeInclusive;

/// Checks a grid and a number of gates before anything of their size is allocated.
pub(super) fn check_extent(gates: usize, shape: [usize; 3], limits: &Limits) -> Result<(), IntakeError> {
    let [slices, rows, columns] = shape;
    within("gates", gates, &limits.gates)?;
    within("slices", slices, &limits.slices)?;
    within("rows", rows, &limits.rows_and_columns)?;
    within("columns", columns, &limits.rows_and_columns)?;
    let voxels = gates * slices * rows * columns;
    if voxels > limits.voxels {
        return Err(IntakeError::OutsideLimits {
            what: format!("{voxels} voxels in all gates"),
            accepted: format!("at most {}", limits.voxels),
        });
    }
    Ok(())
}

/// Checks that each spacing is a plausible distance in mm.
pub(super) fn check_spacing(spacing_mm: [f64; 3], limits: &Limits) -> Result<(), IntakeError> {
    for (axis, spacing) in ["slices", "rows", "columns"].into_iter().zip(spacing_mm) {
        if !limits.spacing_mm.contains(&spacing) {
            return Err(IntakeError::OutsideLimits {
                what: format!("{spacing} mm between {axis}"),
                accepted: format!("{} to {} mm", limits.spacing_mm.start(), limits.spacing_mm.end()),
            });
        }
    }
    Ok(())
}

/// Checks one number against its range.
pub(super) fn within<T: PartialOrd + Display + Copy>(what: &str, value: T, range: &RangeInclusive<T>) -> Result<(), IntakeError> {
    if range.contains(&value) {
        return Ok(());
    }
    let value = value.to_string();
    let what = if value == "1" { what.trim_end_matches('s') } else { what };
    Err(IntakeError::OutsideLimits { what: format!("{value} {what}"), accepted: format!("{} to {}", range.start(), range.end()) })
}

/// Makes gates of counts `[z, y, x]`: refuses what is no number, sets negative counts (left by filtered back-projection) to 0 and says so.
pub(super) fn gates(
    grid: Grid,
    volumes: Vec<Array3<f32>>,
    durations_ms: &[Option<f64>],
    warnings: &mut Vec<Warning>,
) -> Result<Vec<Gate>, IntakeError> {
    let mut negative = 0_usize;
    let mut positive = false;
    let mut gates = Vec::with_capacity(volumes.len());
    for (index, mut counts) in volumes.into_iter().enumerate() {
        for ((z, y, x), count) in counts.indexed_iter_mut() {
            if !count.is_finite() {
                return Err(IntakeError::NotFinite { gate: index + 1, voxel: [z, y, x], value: *count });
            }
            if *count < 0.0 {
                negative += 1;
                *count = 0.0;
            }
            positive |= *count > 0.0;
        }
        gates.push(Gate { volume: Volume { grid, counts }, duration_ms: durations_ms.get(index).copied().flatten() });
    }
    if !positive {
        return Err(IntakeError::NoCounts);
    }
    if negative > 0 {
        let percent = 100.0 * negative as f64 / (gates.len() * grid.voxels()) as f64;
        warnings.push(Warning::new(
            "negative_counts",
            format!("{negative} voxels ({percent:.1} %) had negative counts, which were taken as 0."),
        ));
    }
    Ok(gates)
}
