//! Everything about a reconstruction that can be chosen, resolved: no optional field is left open but the region, which is estimated
//! where it is not given. [`Parameters::paper`] holds the values and says where each comes from; [`Parameters::clinical`] is the default.

use serde::{Deserialize, Serialize};

/// The parameters of one reconstruction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parameters {
    /// The named set the others started from.
    pub preset: Preset,
    /// The paper's manual marks (§8, steps 1 and 2); each one estimated where absent.
    pub region: RegionMarks,
    /// The ends of the long axis; each one estimated where absent (clinical preset).
    #[serde(default)]
    pub pose: PoseMarks,
    /// Edge detection (§7.1).
    pub edges: EdgeParameters,
    /// Gradient vector flow (§5).
    pub gvf: GvfParameters,
    /// The mesh (§7.3).
    pub mesh: MeshParameters,
    /// The deformable model and its solver (§3, §4).
    pub deform: DeformParameters,
    /// The model of the camera (clinical preset).
    #[serde(default)]
    pub refine: RefineParameters,
    /// What is derived from the result.
    #[serde(default)]
    pub analysis: AnalysisParameters,
    /// What is known of the patient's body.
    #[serde(default)]
    pub metadata: Metadata,
}

/// How the wall is told: which side is anterior, and what counts as a defect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnalysisParameters {
    /// A direction in the grid, `[x, y, z]` of any length, from the long axis to the anterior wall; by the patient's axes where absent.
    pub anterior: Option<[f64; 3]>,
    /// Below this part of the maximum, in percent, a piece of the wall is a perfusion defect.
    pub perfusion_threshold_percent: f64,
}

impl Default for AnalysisParameters {
    /// Sixty percent of the maximum: the threshold by which defects of sestamibi images were sized without a normal database (Gibbons et al.,
    /// Circulation 1989;80:1277).
    fn default() -> Self {
        Self { anterior: None, perfusion_threshold_percent: 60.0 }
    }
}

/// The patient's size, which volumes can be set against.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metadata {
    /// Height in m.
    pub height_m: Option<f64>,
    /// Weight in kg.
    pub weight_kg: Option<f64>,
}

/// A named set of defaults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Borders at sub-voxel precision along the ventricle's own axes, refined by a model of how the camera blurs the wall.
    Clinical,
    /// García & Susín's method as printed.
    Paper,
}

impl Preset {
    /// The name used in JSON and metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Clinical => "clinical",
            Self::Paper => "paper",
        }
    }
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

/// Ends of the long axis a user gives, in grid mm `[x, y, z]`; what is absent is estimated from the counts.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseMarks {
    /// The tip of the ventricle, in the middle of the wall.
    pub apex_mm: Option<[f64; 3]>,
    /// Where the long axis meets the valve plane.
    pub base_mm: Option<[f64; 3]>,
}

/// The model of the camera that surfaces are fitted with (`docs/numerics.md`). All but the first two are there to be measured: what each
/// is worth is the ablation table of `docs/accuracy.md`.
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of the published parameters")]
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefineParameters {
    /// Whether the gradient's surfaces are refined at all.
    pub enabled: bool,
    /// Full width at half maximum of the camera's point-spread function in mm; estimated where absent.
    pub psf_fwhm_mm: Option<f64>,
    /// Whether the valve plane may tilt against the long axis.
    pub base_tilt: bool,
    /// Whether the wall's volume is held nearly constant over the cycle.
    pub wall_conservation: bool,
    /// Whether neighbouring gates are held together in time.
    pub temporal_prior: bool,
    /// Whether shape and thickness are held to a smooth ventricle where the wall takes up little.
    pub shape_prior: bool,
    /// Whether the wall's uptake may vary.
    pub uptake_map: bool,
}

impl Default for RefineParameters {
    /// Everything on, the point-spread function estimated.
    fn default() -> Self {
        Self {
            enabled: true,
            psf_fwhm_mm: None,
            base_tilt: true,
            wall_conservation: true,
            temporal_prior: true,
            shape_prior: true,
            uptake_map: true,
        }
    }
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
    /// Threshold of the plain gradient operator, as a fraction of the largest gradient; Canny does not read it.
    pub threshold: f64,
    /// Whether a dome over the apex and a disc in the valve plane close the borders' ends.
    pub close_ends: bool,
}

/// The gradient operators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeOperator {
    /// Canny 1986: smoothed gradient, non-maximum suppression, hysteresis.
    Canny,
    /// The length of the counts' own gradient against one threshold: no Gaussian, no thinning, no hysteresis (what the paper compares
    /// Canny with in figure 6).
    Gradient,
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshParameters {
    /// Subdivisions of the icosahedron: 2, 3 or 4 for 162, 642 or 2562 vertices (Table 2).
    pub level: u32,
    /// What the evolution of each gate starts from.
    pub seed: Seed,
    /// The initial ellipsoid's axes over those of the one that bounds the border. The paper's printed meshes (Table 2) have 1.5.
    pub seed_scale: f64,
}

/// Where the mesh of a gate starts. The topology is the icosphere's in all three, so that a vertex is the same particle in every gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Seed {
    /// The ellipsoid that bounds the gate's own border (§7.3).
    OwnEllipsoid,
    /// The ellipsoid that bounds the borders of all gates.
    CommonEllipsoid,
    /// The result of the gate before; the first gate starts from its own ellipsoid.
    PreviousGate,
}

/// The deformable model and its evolution.
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of the published parameters")]
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeformParameters {
    /// Internal forces (§4).
    pub model: Model,
    /// Time integration (§3).
    pub solver: Solver,
    /// Time step in s.
    pub time_step_s: f64,
    /// Mass of a particle; the field pulls each with a force of 10 mass units × mm/s².
    pub mass: f64,
    /// Part of the velocity lost in a second, in percent.
    pub damping_percent: f64,
    /// Stretch: of springs (spring-mass models) or of triangles (plane model).
    pub stretch: Stiffness,
    /// Shear of triangles (plane model).
    pub shear: Stiffness,
    /// Bend between neighbouring triangles (plane model).
    pub bend: Stiffness,
    /// The part of the spring force that the restricted spring-mass model keeps.
    pub spring_direction: SpringDirection,
    /// Whether the mesh is smoothed while it moves and at its end.
    pub smoothing: bool,
    /// Whether a particle stops at the first border voxel it enters (§7.1).
    pub freezing: bool,
    /// Whether a frozen particle is moved to the edge's sub-voxel position.
    pub subvoxel: bool,
    /// The evolution ends when the moving particles' mean distance to the border changes by less than this a second, in voxels; 0: never.
    pub rest_voxels: f64,
    /// Steps after which the evolution ends whatever still moves.
    pub max_steps: usize,
    /// Whether the distance of particles to the border is kept over time (figure 5).
    pub record_distances: bool,
}

/// A spring constant and its damping.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stiffness {
    /// Spring constant, force a unit of the condition (mm; radians for bend).
    pub k: f64,
    /// Damping constant, force a unit of the condition's rate.
    pub kd: f64,
}

/// The internal forces of the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// No internal force; topology is kept by smoothing.
    Free,
    /// Hooke springs along the edges.
    SpringMass,
    /// Hooke springs of which only the part in one direction to the field acts.
    RestrictedSpringMass,
    /// Stretch, shear and bend of every triangle after Baraff & Witkin 1998.
    Plane,
}

/// The part of the spring force that acts in the restricted spring-mass model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpringDirection {
    /// Along the field, which is the normal of the border it comes from: springs even out how far neighbours have come.
    AlongField,
    /// Across the field: springs space the particles and leave the way to the border to the field.
    AcrossField,
}

/// The time integration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Solver {
    /// Explicit Euler, first order.
    Euler,
    /// The explicit midpoint rule, second order.
    Midpoint,
    /// The classic fourth-order Runge-Kutta method.
    Rk4,
    /// Linearly implicit Euler (Baraff & Witkin 1998, equation 6), first order, stable for stiff forces.
    ImplicitEuler,
}

impl Parameters {
    /// The clinical preset: of the paper's values only the mesh is used.
    pub fn clinical() -> Self {
        Self { preset: Preset::Clinical, ..Self::paper() }
    }

    /// The paper's values.
    pub fn paper() -> Self {
        Self {
            preset: Preset::Paper,
            region: RegionMarks::default(),
            pose: PoseMarks::default(),
            refine: RefineParameters::default(),
            analysis: AnalysisParameters::default(),
            metadata: Metadata::default(),
            // §7.1: "1.8 for the Gaussian, 0.3 for the low threshold and 0.8 for the high threshold".
            // The paper leaves the ends open; its meshes then fall in at the base (`docs/numerics.md`).
            edges: EdgeParameters {
                operator: EdgeOperator::Canny,
                sigma: 1.8,
                low: 0.3,
                high: 0.8,
                mode: EdgeMode::Slice,
                // Ours: the paper does not define the operator it compares with.
                threshold: 0.5,
                close_ends: true,
            },
            // §7.5: "a GVF balancing constant of 10"; the tolerance is ours: the field's direction no longer changes below it.
            gvf: GvfParameters { mu: 10.0, tolerance: 1e-4 },
            // §7.4: "the selected initial mesh is the one labelled as 2" (642 particles).
            mesh: MeshParameters { level: 3, seed: Seed::OwnEllipsoid, seed_scale: 1.0 },
            // §7.5: free model, RK4, "a damping factor of 1% and a time increment of 0.1 seconds"; table 1: the constants of stretch, shear
            // and bend. Ours: the cap on steps (ten times what phantoms need), and what ends the evolution (see `super::rest`).
            deform: DeformParameters {
                model: Model::Free,
                solver: Solver::Rk4,
                time_step_s: 0.1,
                mass: 1.0,
                damping_percent: 1.0,
                stretch: Stiffness { k: 10.0, kd: 1.0 },
                shear: Stiffness { k: 1.0, kd: 0.1 },
                bend: Stiffness { k: 10.0, kd: 1.0 },
                spring_direction: SpringDirection::AlongField,
                smoothing: true,
                freezing: true,
                subvoxel: true,
                rest_voxels: 0.05,
                max_steps: 2000,
                record_distances: false,
            },
        }
    }
}
