//! Everything about a reconstruction that can be chosen, resolved: no optional field is left open but the region, which is estimated
//! where it is not given. [`Parameters::paper`] holds the defaults and says where each comes from.

use serde::{Deserialize, Serialize};

/// The parameters of one reconstruction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parameters {
    /// The named set the others started from.
    pub preset: Preset,
    /// The paper's manual marks (§8, steps 1 and 2); each one estimated where absent.
    pub region: RegionMarks,
    /// Edge detection (§7.1).
    pub edges: EdgeParameters,
    /// Gradient vector flow (§5).
    pub gvf: GvfParameters,
    /// The mesh (§7.3).
    pub mesh: MeshParameters,
    /// The deformable model and its solver (§3, §4).
    pub deform: DeformParameters,
}

/// A named set of defaults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// García & Susín's method as printed.
    Paper,
}

/// Marks a user gives; what is absent is estimated from the counts.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionMarks {
    /// Centre of the ventricle `[x, y]` in grid mm (voxel `[0, 0]`'s centre is the origin).
    pub centre_mm: Option<[f64; 2]>,
    /// Radius of the filtering circle in mm: counts outside are rejected.
    pub radius_mm: Option<f64>,
    /// First useful slice, counted from 1.
    pub first_slice: Option<usize>,
    /// Last useful slice, counted from 1.
    pub last_slice: Option<usize>,
}

/// Parameters of the edge detector.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EdgeParameters {
    /// The gradient operator.
    pub operator: EdgeOperator,
    /// Standard deviation of the Gaussian: pixels in `slice` mode (as the paper), multiples of the in-plane spacing in `volume` mode.
    pub sigma: f64,
    /// Low hysteresis threshold, as a fraction of the largest gradient inside the filtering circle.
    pub low: f64,
    /// High hysteresis threshold, likewise.
    pub high: f64,
    /// Two or three dimensions.
    pub mode: EdgeMode,
    /// Whether a dome over the apex and a disc in the valve plane close the borders' ends.
    pub close_ends: bool,
}

/// The gradient operators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeOperator {
    /// Canny 1986: smoothed gradient, non-maximum suppression, hysteresis.
    Canny,
}

/// Where edges are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeMode {
    /// Slice by slice, as the paper.
    Slice,
    /// In the volume, with distances in mm.
    Volume,
}

/// Parameters of the gradient vector flow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GvfParameters {
    /// Balance of diffusion against the edge map, as the paper counts it: for an edge map of grey levels 0-255 (see [`super::gvf`]).
    pub mu: f64,
    /// Relative residual at which the linear solve stops.
    pub tolerance: f64,
}

/// The mesh of both surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshParameters {
    /// Subdivisions of the icosahedron: 2, 3 or 4 for 162, 642 or 2562 vertices (Table 2).
    pub level: u32,
}

/// The deformable model and its evolution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeformParameters {
    /// Internal forces (§4).
    pub model: Model,
    /// Time integration (§3).
    pub solver: Solver,
    /// Time step in s.
    pub time_step_s: f64,
    /// Part of the velocity lost in a step, in percent.
    pub damping_percent: f64,
    /// Whether the mesh is smoothed while it moves and at its end.
    pub smoothing: bool,
    /// Steps after which the evolution ends whatever still moves.
    pub max_steps: usize,
}

/// The internal forces of the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// No internal force; topology is kept by smoothing.
    Free,
}

/// The time integration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Solver {
    /// The classic fourth-order Runge-Kutta method.
    Rk4,
}

impl Parameters {
    /// The paper's values.
    pub fn paper() -> Self {
        Self {
            preset: Preset::Paper,
            region: RegionMarks::default(),
            // §7.1: "1.8 for the Gaussian, 0.3 for the low threshold and 0.8 for the high threshold".
            // The paper leaves the ends open; its meshes then fall in at the base (`docs/numerics.md`).
            edges: EdgeParameters {
                operator: EdgeOperator::Canny,
                sigma: 1.8,
                low: 0.3,
                high: 0.8,
                mode: EdgeMode::Slice,
                close_ends: true,
            },
            // §7.5: "a GVF balancing constant of 10"; the tolerance is ours: the field's direction no longer changes below it.
            gvf: GvfParameters { mu: 10.0, tolerance: 1e-4 },
            // §7.4: "the selected initial mesh is the one labelled as 2" (642 particles).
            mesh: MeshParameters { level: 3 },
            // §7.5: RK4, "a damping factor of 1% and a time increment of 0.1 seconds". The cap on steps is ours: ten times what phantoms need.
            deform: DeformParameters {
                model: Model::Free,
                solver: Solver::Rk4,
                time_step_s: 0.1,
                damping_percent: 1.0,
                smoothing: true,
                max_steps: 2000,
            },
        }
    }
}
