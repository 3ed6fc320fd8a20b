//! What a client may write: one field a parameter, each optional, with its default and range in the schema.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How to reconstruct. Everything is optional; what is left out keeps the value of the preset. `mesh.level`, `region`, `analysis` and `metadata` are
/// of both presets, `pose` and `refine` of `clinical` alone, everything else of `paper` alone: its defaults are that preset's. What would change nothing is refused
/// by name, unless it is the default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Parameters, example = json!({"preset": "clinical", "mesh": {"level": 3}, "refine": {"psf_fwhm_mm": 12.5}}))]
pub struct Request {
    /// The method, and the named set the other values start from. `clinical` finds the ventricle in slices of any orientation, measures its borders
    /// along its own axes and refines them by a model of how the camera blurs the wall. `paper` is García and Susín's method as printed, for short-axis
    /// slices.
    #[schema(inline, default = "clinical")]
    pub preset: Option<Preset>,
    /// Where the slices cut the left ventricle. Each mark that is left out is estimated from the counts.
    #[schema(inline)]
    pub region: Option<Region>,
    /// The ends of the ventricle's long axis. Each one that is left out is estimated from the counts. Only with the preset `clinical`.
    #[schema(inline)]
    pub pose: Option<Pose>,
    /// Edge detection.
    #[schema(inline)]
    pub edges: Option<Edges>,
    /// Gradient vector flow, the field that draws the meshes to the borders.
    #[schema(inline)]
    pub gvf: Option<Gvf>,
    /// The meshes of both surfaces.
    #[schema(inline)]
    pub mesh: Option<Mesh>,
    /// The deformable model and its evolution.
    #[schema(inline)]
    pub deform: Option<Deform>,
    /// The model of the camera. Only with the preset `clinical`.
    #[schema(inline)]
    pub refine: Option<Refine>,
    /// What is derived from the surfaces.
    #[schema(inline)]
    pub analysis: Option<Analysis>,
    /// What is known of the patient's body, to set volumes against.
    #[schema(inline)]
    pub metadata: Option<Metadata>,
    /// Not for the reconstruction but for its job: seconds it is kept after its end, with all its data; then it is deleted. Left out it is kept as
    /// long as the service keeps all. The longest this service allows is the `maximum` in `GET /v1/parameters`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 60)]
    pub retention_seconds: Option<u64>,
    /// Not for the reconstruction but for its job: whether its input (counts and UIDs, no names) is kept after its end, as long as its results. Pictures of
    /// slices and another job on the same input (`…/again`) need it. Left out it is as the service keeps all: usually not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub keep_input: Option<bool>,
    /// Where a signed POST goes when the job has reached its final state (see the callback `jobEnded`). https, at most 2048 characters, without
    /// user name, password and fragment, to a public address or one that the operator allows; redirects are not followed. It changes nothing in the
    /// reconstruction. Left out: the operator's default, if there is one.
    #[schema(example = "https://receiver.example/ventricle")]
    pub callback_url: Option<String>,
}

/// Named sets of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Found in any orientation, fitted with a model of the camera.
    Clinical,
    /// García and Susín's method as printed.
    Paper,
}

/// The marks a user can give.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Centre of the ventricle, `[x, y]` in mm from the centre of the first voxel: x along a row, y down the columns.
    #[schema(min_items = 2, max_items = 2)]
    pub centre_mm: Option<[f64; 2]>,
    /// Radius in mm of the circle outside of which counts are rejected.
    #[schema(minimum = 10, maximum = 250)]
    pub radius_mm: Option<f64>,
    /// First slice of the ventricle, counted from 1.
    #[schema(minimum = 1, maximum = 4096)]
    pub first_slice: Option<usize>,
    /// Last slice of the ventricle, counted from 1; not before `first_slice`.
    #[schema(minimum = 1, maximum = 4096)]
    pub last_slice: Option<usize>,
}

/// The ends of the long axis that a user can give, in mm from the centre of the first voxel: x along a row, y down the columns, z from the first
/// slice to the last. Both must lie in the study, whose edge is half a voxel beyond the outermost centres, 25 to 140 mm apart.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// The tip of the ventricle in the middle of its wall, `[x, y, z]` in mm.
    #[schema(min_items = 3, max_items = 3)]
    pub apex_mm: Option<[f64; 3]>,
    /// Where the long axis meets the valve plane, `[x, y, z]` in mm.
    #[schema(min_items = 3, max_items = 3)]
    pub base_mm: Option<[f64; 3]>,
}

/// What is derived from the surfaces.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Analysis {
    /// Where the anterior wall is: a direction from the long axis, `[x, y, z]` along row, column and slices as `pose`, of any length. Left out it
    /// is taken from the patient's axes; where the study does not tell them, the first row is assumed to be anterior.
    #[schema(min_items = 3, max_items = 3)]
    pub anterior: Option<[f64; 3]>,
    /// Perfusion below this part of the maximum, in percent, is a defect.
    #[schema(minimum = 10, maximum = 90, default = 60.0)]
    pub perfusion_threshold_percent: Option<f64>,
}

/// The patient's body.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Metadata {
    /// Height in m. Left out it is the DICOM file's, if that has it.
    #[schema(minimum = 0.3, maximum = 2.5)]
    pub height_m: Option<f64>,
    /// Weight in kg. Left out it is the DICOM file's, if that has it.
    #[schema(minimum = 2, maximum = 400)]
    pub weight_kg: Option<f64>,
}

/// Edge detection.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Edges {
    /// The operator: `canny` is smoothed gradient, non-maximum suppression and hysteresis; `gradient` is the plain gradient against one
    /// threshold, without `sigma`, `low` and `high`.
    #[schema(inline, default = "canny")]
    pub operator: Option<EdgeOperator>,
    /// Standard deviation of the Gaussian: in pixels for mode `slice`, in multiples of the pixel spacing for mode `volume`.
    #[schema(minimum = 0.3, maximum = 8.0, default = 1.8)]
    pub sigma: Option<f64>,
    /// Low hysteresis threshold as a fraction of the largest gradient; below `high`.
    #[schema(minimum = 0.0, maximum = 1.0, default = 0.3)]
    pub low: Option<f64>,
    /// High hysteresis threshold as a fraction of the largest gradient.
    #[schema(minimum = 0.0, maximum = 1.0, default = 0.8)]
    pub high: Option<f64>,
    /// Edges slice by slice, or in the volume with distances in mm.
    #[schema(inline, default = "slice")]
    pub mode: Option<EdgeMode>,
    /// Threshold of the `gradient` operator as a fraction of the largest gradient. Only with that operator.
    #[schema(minimum = 0.01, maximum = 1.0, default = 0.5)]
    pub threshold: Option<f64>,
    /// Closes the borders by a dome over the apex and a disc in the valve plane; `false` leaves them open, as the paper does.
    #[schema(default = true)]
    pub close_ends: Option<bool>,
}

/// Gradient operators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EdgeOperator {
    /// Canny 1986.
    Canny,
    /// Plain gradient against a threshold.
    Gradient,
}

/// Two or three dimensions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EdgeMode {
    /// Slice by slice.
    Slice,
    /// In the volume.
    Volume,
}

/// Gradient vector flow.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Gvf {
    /// Balance of diffusion against the edge map, for an edge map of grey levels 0-255.
    #[schema(minimum = 0.01, maximum = 10_000.0, default = 10.0)]
    pub mu: Option<f64>,
    /// Relative residual at which the linear solve stops.
    #[schema(minimum = 1e-10, maximum = 0.1, default = 1e-4)]
    pub tolerance: Option<f64>,
}

/// The meshes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Mesh {
    /// Subdivisions of the icosahedron: 2, 3 or 4 for 162, 642 or 2562 vertices a surface.
    #[schema(minimum = 2, maximum = 4, default = 3)]
    pub level: Option<u32>,
    /// What the mesh of a gate starts from: the ellipsoid that bounds its own border, the one that bounds the borders of all gates, or the
    /// result of the gate before.
    #[schema(inline, default = "own_ellipsoid")]
    pub seed: Option<Seed>,
    /// Size of the ellipsoid that the mesh starts from, over that of the one that bounds the border. The paper's text says 1, its printed
    /// meshes have 1.5: they start outside the heart. Not with the seed `previous_gate`, but for the first gate.
    #[schema(minimum = 0.5, maximum = 3.0, default = 1.0)]
    pub seed_scale: Option<f64>,
}

/// Where the mesh of a gate starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Seed {
    /// The ellipsoid about the gate's own border.
    OwnEllipsoid,
    /// The ellipsoid about the borders of all gates.
    CommonEllipsoid,
    /// The result of the gate before.
    PreviousGate,
}

/// The deformable model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Deform {
    /// Internal forces: `free` has none and keeps the mesh whole by smoothing; `spring_mass` joins particles by springs;
    /// `restricted_spring_mass` lets the springs act only along the field; `plane` resists stretch, shear and bend of triangles.
    #[schema(inline, default = "free")]
    pub model: Option<Model>,
    /// Time integration: explicit `euler`, `midpoint` and `rk4`, or `implicit_euler`. Left out it is `rk4`, and `implicit_euler` for the model
    /// `plane`. Not together: `restricted_spring_mass` with `implicit_euler`.
    #[schema(inline, default = "rk4")]
    pub solver: Option<Solver>,
    /// Time step in s. The paper: 0.1 to 0.17 (free), 0.01 and 0.05 (plane), 0.0005 (springs). Left out with the model `plane`: 0.05.
    /// Explicit Euler is stable below kd/k (0.1 s with the defaults); a particle moves by half a voxel a step at most, so that a step too
    /// long shows as jitter.
    #[schema(minimum = 0.0001, maximum = 1.0, default = 0.1)]
    pub time_step_s: Option<f64>,
    /// Mass of a particle. The field pulls each with the force that accelerates mass 1 by 10 mm/s².
    #[schema(minimum = 0.01, maximum = 100.0, default = 1.0)]
    pub mass: Option<f64>,
    /// Part of the velocity lost in a second, in percent.
    #[schema(minimum = 0.0, maximum = 99.9, default = 1.0)]
    pub damping_percent: Option<f64>,
    /// Springs of the spring-mass models, stretch of the plane model. Not with the model `free`.
    #[schema(inline)]
    pub stretch: Option<Stretch>,
    /// Shear of triangles. Only with the model `plane`.
    #[schema(inline)]
    pub shear: Option<Shear>,
    /// Bend between triangles. Only with the model `plane`.
    #[schema(inline)]
    pub bend: Option<Bend>,
    /// The part of the spring force that acts: along the field or across it. Only with the model `restricted_spring_mass`.
    #[schema(inline, default = "along_field")]
    pub spring_direction: Option<SpringDirection>,
    /// Whether the mesh is smoothed while it moves and at its end.
    #[schema(default = true)]
    pub smoothing: Option<bool>,
    /// Whether a particle stops at the first border voxel it enters. Without it particles swing about the border until they rest.
    #[schema(default = true)]
    pub freezing: Option<bool>,
    /// Whether a stopped particle is moved to the border at sub-voxel precision; `false` leaves it where it stopped, as the paper does.
    #[schema(default = true)]
    pub subvoxel: Option<bool>,
    /// The evolution ends when the mean distance to the border of the particles that still move changes by less than this from one second to
    /// the next, twice in a row, in voxels. 0 switches this off.
    #[schema(minimum = 0.0, maximum = 1.0, default = 0.05)]
    pub rest_voxels: Option<f64>,
    /// Steps after which the evolution ends whatever still moves.
    #[schema(minimum = 1, maximum = 20_000, default = 2000)]
    pub max_steps: Option<usize>,
    /// Whether the report holds the distance to the border over time: of twelve particles, and the mean of all.
    #[schema(default = false)]
    pub record_distances: Option<bool>,
}

/// Internal forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// No internal force.
    Free,
    /// Springs along the edges.
    SpringMass,
    /// Springs that act in one direction to the field only.
    RestrictedSpringMass,
    /// Stretch, shear and bend of triangles.
    Plane,
}

/// Time integration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Solver {
    /// Explicit Euler.
    Euler,
    /// The explicit midpoint rule.
    Midpoint,
    /// The classic fourth-order Runge-Kutta method.
    Rk4,
    /// Linearly implicit Euler.
    ImplicitEuler,
}

/// The part of a spring's force that acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SpringDirection {
    /// Along the field.
    AlongField,
    /// Across the field.
    AcrossField,
}

/// Stretch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Stretch {
    /// Spring constant, in 1/s² for unit mass.
    #[schema(minimum = 0.0, maximum = 1e6, default = 10.0)]
    pub k: Option<f64>,
    /// Its damping, in 1/s for unit mass.
    #[schema(minimum = 0.0, maximum = 1e6, default = 1.0)]
    pub kd: Option<f64>,
}

/// Shear.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Shear {
    /// Spring constant, in 1/s² for unit mass.
    #[schema(minimum = 0.0, maximum = 1e6, default = 1.0)]
    pub k: Option<f64>,
    /// Its damping, in 1/s for unit mass.
    #[schema(minimum = 0.0, maximum = 1e6, default = 0.1)]
    pub kd: Option<f64>,
}

/// Bend.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Bend {
    /// Spring constant, in mm²/s² a radian for unit mass.
    #[schema(minimum = 0.0, maximum = 1e6, default = 10.0)]
    pub k: Option<f64>,
    /// Its damping, in mm²/s a radian for unit mass.
    #[schema(minimum = 0.0, maximum = 1e6, default = 1.0)]
    pub kd: Option<f64>,
}

/// The model of the camera. Each switch can be turned off to see what it is worth (`docs/accuracy.md`); for results leave them on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Refine {
    /// Whether the surfaces are those of the fitted model; `false` leaves those at the gradient's extrema.
    #[schema(default = true)]
    pub enabled: Option<bool>,
    /// Full width at half maximum of the camera's point-spread function at the heart, reconstruction filter included, in mm. Left out it is
    /// estimated from the counts. Volumes depend on it: how much is in the report (`model.psf.edv_percent_per_mm`).
    #[schema(minimum = 4.0, maximum = 30.0)]
    pub psf_fwhm_mm: Option<f64>,
    /// Whether the valve plane may tilt against the long axis.
    #[schema(default = true)]
    pub base_tilt: Option<bool>,
    /// Whether the wall's volume is held nearly constant over the cycle.
    #[schema(default = true)]
    pub wall_conservation: Option<bool>,
    /// Whether neighbouring gates are held together in time.
    #[schema(default = true)]
    pub temporal_prior: Option<bool>,
    /// Whether shape and thickness are held to a smooth ventricle where the wall takes up little.
    #[schema(default = true)]
    pub shape_prior: Option<bool>,
    /// Whether the wall's uptake may vary.
    #[schema(default = true)]
    pub uptake_map: Option<bool>,
}
