//! What the paper prints, with its place, and what follows from the printed numbers alone.

use crate::report::Function;
use std::f64::consts::PI;

/// §6, figure 4: the PHANTOM's radii and height as printed, in mm.
pub const R1_MM: f64 = 20.0;
/// §6, figure 4.
pub const R2_MM: f64 = 35.0;
/// §6, figure 4.
pub const R3_MM: f64 = 45.0;
/// §6, figure 4.
pub const H_MM: f64 = 55.0;
/// §6: "external and internal volumes of 305301.4 mm³ and 89794 mm³".
pub const EXTERNAL_MM3: f64 = 305_301.4;
/// §6.
pub const INTERNAL_MM3: f64 = 89_794.0;

/// Table 1: particles within one voxel in percent: plane (Δt .01 s), plane (Δt .05 s), spring-mass, free.
pub const WITHIN_ONE_VOXEL_PERCENT: [f64; 4] = [77.0, 74.5, 73.6, 97.0];

/// A mesh of Table 2 or 3: area in mm² and area over longest edge in mm, each as mean, largest, smallest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrintedTriangles {
    /// Areas.
    pub area_mm2: [f64; 3],
    /// Areas over longest edges ("normalized").
    pub aspect_mm: [f64; 3],
}

/// Table 2: initial meshes 1, 2, 3.
pub const INITIAL_MESHES: [PrintedTriangles; 3] = [
    PrintedTriangles { area_mm2: [133.38, 183.87, 111.8], aspect_mm: [6.95, 8.28, 6.25] },
    PrintedTriangles { area_mm2: [33.82, 47.85, 28.18], aspect_mm: [3.49, 3.96, 3.12] },
    PrintedTriangles { area_mm2: [8.48, 12.2, 7.05], aspect_mm: [1.75, 1.99, 1.55] },
];

/// Table 2: triangles of the meshes.
pub const TRIANGLES: [usize; 3] = [320, 1280, 5120];

/// Table 3: the same meshes after the reconstruction.
pub const RECONSTRUCTIONS: [PrintedTriangles; 3] = [
    PrintedTriangles { area_mm2: [84.03, 170.02, 23.15], aspect_mm: [5.1, 7.73, 1.99] },
    PrintedTriangles { area_mm2: [22.5, 116.4, 0.82], aspect_mm: [2.57, 5.24, 0.09] },
    PrintedTriangles { area_mm2: [6.24, 72.38, 0.0007], aspect_mm: [1.29, 4.95, 0.0005] },
];

/// §7.4: volume of the voxels of at least 20 % of the maximum, in mm³.
pub const THRESHOLDED_MM3: f64 = 368_782.0;
/// §7.4: "This volume differs from the theoretical one in a 12%."
pub const THRESHOLDED_EXCESS_PERCENT: f64 = 12.0;
/// §7.4: the threshold, as a fraction of the maximum.
pub const THRESHOLD: f64 = 0.2;

/// A row of Table 4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrintedSolver {
    /// Error against the thresholded volume in percent (the paper prints no sign).
    pub error_percent: f64,
    /// Time step in s.
    pub time_step_s: f64,
    /// Computing time in s.
    pub seconds: f64,
}

/// Table 4: Euler, midpoint, RK4.
pub const SOLVERS: [PrintedSolver; 3] = [
    PrintedSolver { error_percent: 1.44, time_step_s: 0.1, seconds: 0.322 },
    PrintedSolver { error_percent: 0.68, time_step_s: 0.12, seconds: 0.14 },
    PrintedSolver { error_percent: 1.53, time_step_s: 0.17, seconds: 0.111 },
];

/// Table 5: internal volumes of the eight gates in mm³.
pub const CYCLE_INTERNAL_MM3: [f64; 8] = [74_741.0, 45_677.0, 36_523.0, 32_956.0, 47_237.0, 55_825.0, 79_581.0, 63_133.0];
/// Table 5: external volumes in mm³.
pub const CYCLE_EXTERNAL_MM3: [f64; 8] = [443_762.0, 316_804.0, 254_112.0, 250_131.0, 299_779.0, 345_830.0, 473_608.0, 451_525.0];
/// Table 5: wall volumes in mm³.
pub const CYCLE_WALL_MM3: [f64; 8] = [369_021.0, 271_127.0, 217_589.0, 217_175.0, 252_542.0, 290_005.0, 394_027.0, 388_392.0];
/// Figure 9: the ejection fraction in percent.
pub const EJECTION_FRACTION_PERCENT: f64 = 58.6;

/// A row of Table 6.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrintedMissing {
    /// Share of the wall that was emptied, in percent (§7.6).
    pub emptied_percent: f64,
    /// Recovered volume in mm³.
    pub volume_mm3: f64,
    /// The same as a percentage of the first row.
    pub of_total_percent: f64,
    /// "Relative error" in the text below the table; none for the whole object.
    pub relative_error: Option<f64>,
}

/// Table 6. The text names the errors of the third row (.09) and "the other test examples" (.45 and .24) in this order.
pub const MISSING: [PrintedMissing; 4] = [
    PrintedMissing { emptied_percent: 0.0, volume_mm3: 265_501.0, of_total_percent: 100.0, relative_error: None },
    PrintedMissing { emptied_percent: 10.0, volume_mm3: 250_944.0, of_total_percent: 94.5, relative_error: Some(0.45) },
    PrintedMissing { emptied_percent: 32.0, volume_mm3: 188_360.0, of_total_percent: 70.9, relative_error: Some(0.09) },
    PrintedMissing { emptied_percent: 53.0, volume_mm3: 159_970.0, of_total_percent: 60.2, relative_error: Some(0.24) },
];

/// Volume in mm³ of a cylinder with a hemisphere of its radius.
pub fn capped_cylinder_mm3(radius_mm: f64, height_mm: f64) -> f64 {
    PI * radius_mm * radius_mm * (height_mm + 2.0 / 3.0 * radius_mm)
}

/// How far the thresholded volume lies above the external one, in percent, by the printed volumes.
pub fn thresholded_excess_percent() -> f64 {
    100.0 * (THRESHOLDED_MM3 / EXTERNAL_MM3 - 1.0)
}

/// The function of Table 5's ventricle by the rule of the report.
pub fn cycle_function() -> Option<Function> {
    Function::of_cavity(&CYCLE_INTERNAL_MM3.map(|volume_mm3| volume_mm3 / 1000.0))
}

/// The wall volumes that follow from Table 5's other rows, in mm³.
pub fn cycle_wall_mm3() -> [f64; 8] {
    std::array::from_fn(|gate| CYCLE_EXTERNAL_MM3[gate] - CYCLE_INTERNAL_MM3[gate])
}

impl PrintedMissing {
    /// The recovered volume as a percentage of the whole object's, from the printed volumes.
    pub fn recovered_percent(&self) -> f64 {
        100.0 * self.volume_mm3 / MISSING[0].volume_mm3
    }
}

/// The paper's relative error of a reconstruction under missing data: how far the volume that the surface lost is from the share that was
/// emptied, relative to that share (§7.6: "29.1% against the 32%").
pub fn relative_error(emptied_percent: f64, recovered_percent: f64) -> f64 {
    (100.0 - recovered_percent - emptied_percent).abs() / emptied_percent
}

/// Area in mm² of a printed initial mesh (0, 1, 2): its mean triangle times their number.
pub fn initial_area_mm2(mesh: usize) -> f64 {
    INITIAL_MESHES[mesh].area_mm2[0] * TRIANGLES[mesh] as f64
}
