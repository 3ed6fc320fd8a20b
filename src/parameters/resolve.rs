//! From what a client wrote to the parameters of the pipeline.

use super::{
    Deform, EdgeMode, EdgeOperator, Edges, Model, ParameterError, Preset, Refine, Request, Seed, Solver, SpringDirection,
    idle::{self, refuse_idle},
    parse,
};
use crate::pipeline::parameters as chosen;

/// Time step of the plane model with implicit Euler where none is given: the paper's Table 1, column "Plane (2)".
const PLANE_TIME_STEP_S: f64 = 0.05;

/// The parameters of the pipeline: the preset's values where the request is silent.
///
/// Errors: [`ParameterError`] names what is out of range, and what does not go together.
pub fn resolve(mut request: Request) -> Result<chosen::Parameters, ParameterError> {
    // Of the job, not of the numbers.
    request.retention_seconds = None;
    request.keep_input = None;
    let written = serde_json::to_value(&request).map_err(|error| ParameterError::one("invalid_parameter", "", format!("{error}.")))?;
    parse(&written)?;
    let mut out = match request.preset.unwrap_or(Preset::Clinical) {
        Preset::Clinical => chosen::Parameters::clinical(),
        Preset::Paper => chosen::Parameters::paper(),
    };
    idle::refuse_of_other_preset(&written, &out)?;
    refine(&mut out.refine, &request.refine.unwrap_or_default());
    if !out.refine.enabled {
        idle::refuse_without_model(&written, &chosen::Parameters::clinical())?;
    }
    let region = request.region.unwrap_or_default();
    out.region = chosen::RegionMarks {
        centre_mm: region.centre_mm,
        radius_mm: region.radius_mm,
        first_slice: region.first_slice,
        last_slice: region.last_slice,
    };
    let pose = request.pose.unwrap_or_default();
    out.pose = chosen::PoseMarks { apex_mm: pose.apex_mm, base_mm: pose.base_mm };
    let analysis = request.analysis.unwrap_or_default();
    out.analysis.anterior = analysis.anterior;
    out.analysis.perfusion_threshold_percent = analysis.perfusion_threshold_percent.unwrap_or(out.analysis.perfusion_threshold_percent);
    let metadata = request.metadata.unwrap_or_default();
    out.metadata = chosen::Metadata { height_m: metadata.height_m, weight_kg: metadata.weight_kg };
    edges(&mut out.edges, &request.edges.unwrap_or_default())?;
    let gvf = request.gvf.unwrap_or_default();
    out.gvf.mu = gvf.mu.unwrap_or(out.gvf.mu);
    out.gvf.tolerance = gvf.tolerance.unwrap_or(out.gvf.tolerance);
    let mesh = request.mesh.unwrap_or_default();
    out.mesh.level = mesh.level.unwrap_or(out.mesh.level);
    out.mesh.seed = mesh.seed.map_or(out.mesh.seed, |seed| match seed {
        Seed::OwnEllipsoid => chosen::Seed::OwnEllipsoid,
        Seed::CommonEllipsoid => chosen::Seed::CommonEllipsoid,
        Seed::PreviousGate => chosen::Seed::PreviousGate,
    });
    out.mesh.seed_scale = mesh.seed_scale.unwrap_or(out.mesh.seed_scale);
    deform(&mut out.deform, &request.deform.unwrap_or_default())?;
    if let (Some(first), Some(last)) = (out.region.first_slice, out.region.last_slice)
        && first > last
    {
        let detail = format!("`region.first_slice` is {first} and must not lie after `region.last_slice`, which is {last}.");
        return Err(invalid("/region/first_slice", detail));
    }
    Ok(out)
}

fn refine(out: &mut chosen::RefineParameters, given: &Refine) {
    *out = chosen::RefineParameters {
        enabled: given.enabled.unwrap_or(out.enabled),
        psf_fwhm_mm: given.psf_fwhm_mm.or(out.psf_fwhm_mm),
        base_tilt: given.base_tilt.unwrap_or(out.base_tilt),
        wall_conservation: given.wall_conservation.unwrap_or(out.wall_conservation),
        temporal_prior: given.temporal_prior.unwrap_or(out.temporal_prior),
        shape_prior: given.shape_prior.unwrap_or(out.shape_prior),
        uptake_map: given.uptake_map.unwrap_or(out.uptake_map),
    };
}

fn edges(out: &mut chosen::EdgeParameters, given: &Edges) -> Result<(), ParameterError> {
    let preset = *out;
    out.operator = given.operator.map_or(out.operator, |operator| match operator {
        EdgeOperator::Canny => chosen::EdgeOperator::Canny,
        EdgeOperator::Gradient => chosen::EdgeOperator::Gradient,
    });
    out.sigma = given.sigma.unwrap_or(out.sigma);
    out.low = given.low.unwrap_or(out.low);
    out.high = given.high.unwrap_or(out.high);
    out.threshold = given.threshold.unwrap_or(out.threshold);
    out.close_ends = given.close_ends.unwrap_or(out.close_ends);
    out.mode = given.mode.map_or(out.mode, |mode| match mode {
        EdgeMode::Slice => chosen::EdgeMode::Slice,
        EdgeMode::Volume => chosen::EdgeMode::Volume,
    });
    if out.low >= out.high {
        return Err(invalid("/edges/low", format!("`edges.low` is {} and must lie below `edges.high`, which is {}.", out.low, out.high)));
    }
    let canny = out.operator == chosen::EdgeOperator::Canny;
    let used = if canny { "canny" } else { "gradient" };
    let idle = [
        ("sigma", differs(out.sigma, preset.sigma) && !canny),
        ("low", differs(out.low, preset.low) && !canny),
        ("high", differs(out.high, preset.high) && !canny),
        ("threshold", differs(out.threshold, preset.threshold) && canny),
    ];
    refuse_idle(&idle, "edges", &format!("the operator `{used}`"))
}

fn deform(out: &mut chosen::DeformParameters, given: &Deform) -> Result<(), ParameterError> {
    let preset = *out;
    out.model = given.model.map_or(out.model, |model| match model {
        Model::Free => chosen::Model::Free,
        Model::SpringMass => chosen::Model::SpringMass,
        Model::RestrictedSpringMass => chosen::Model::RestrictedSpringMass,
        Model::Plane => chosen::Model::Plane,
    });
    if out.model == chosen::Model::Plane && given.solver.is_none_or(|solver| solver == Solver::ImplicitEuler) {
        (out.solver, out.time_step_s) = (chosen::Solver::ImplicitEuler, PLANE_TIME_STEP_S);
    }
    out.solver = given.solver.map_or(out.solver, |solver| match solver {
        Solver::Euler => chosen::Solver::Euler,
        Solver::Midpoint => chosen::Solver::Midpoint,
        Solver::Rk4 => chosen::Solver::Rk4,
        Solver::ImplicitEuler => chosen::Solver::ImplicitEuler,
    });
    out.spring_direction = given.spring_direction.map_or(out.spring_direction, |direction| match direction {
        SpringDirection::AcrossField => chosen::SpringDirection::AcrossField,
        SpringDirection::AlongField => chosen::SpringDirection::AlongField,
    });
    let stiffness = |out: &mut chosen::Stiffness, k: Option<f64>, kd: Option<f64>| {
        *out = chosen::Stiffness { k: k.unwrap_or(out.k), kd: kd.unwrap_or(out.kd) };
    };
    stiffness(&mut out.stretch, given.stretch.and_then(|stretch| stretch.k), given.stretch.and_then(|stretch| stretch.kd));
    stiffness(&mut out.shear, given.shear.and_then(|shear| shear.k), given.shear.and_then(|shear| shear.kd));
    stiffness(&mut out.bend, given.bend.and_then(|bend| bend.k), given.bend.and_then(|bend| bend.kd));
    out.time_step_s = given.time_step_s.unwrap_or(out.time_step_s);
    out.mass = given.mass.unwrap_or(out.mass);
    out.damping_percent = given.damping_percent.unwrap_or(out.damping_percent);
    out.smoothing = given.smoothing.unwrap_or(out.smoothing);
    out.freezing = given.freezing.unwrap_or(out.freezing);
    out.subvoxel = given.subvoxel.unwrap_or(out.subvoxel);
    out.rest_voxels = given.rest_voxels.unwrap_or(out.rest_voxels);
    out.max_steps = given.max_steps.unwrap_or(out.max_steps);
    out.record_distances = given.record_distances.unwrap_or(out.record_distances);
    if (out.model, out.solver) == (chosen::Model::RestrictedSpringMass, chosen::Solver::ImplicitEuler) {
        let detail = "`deform.solver` \"implicit_euler\" does not go with `deform.model` \"restricted_spring_mass\", whose force has no potential; \
                      choose `euler`, `midpoint` or `rk4`.";
        return Err(invalid("/deform/solver", detail.to_owned()));
    }
    let (model, used) = match out.model {
        chosen::Model::Free => (out.model, "free"),
        chosen::Model::SpringMass => (out.model, "spring_mass"),
        chosen::Model::RestrictedSpringMass => (out.model, "restricted_spring_mass"),
        chosen::Model::Plane => (out.model, "plane"),
    };
    let idle = [
        ("stretch", out.stretch != preset.stretch && model == chosen::Model::Free),
        ("shear", out.shear != preset.shear && model != chosen::Model::Plane),
        ("bend", out.bend != preset.bend && model != chosen::Model::Plane),
        ("spring_direction", out.spring_direction != preset.spring_direction && model != chosen::Model::RestrictedSpringMass),
    ];
    refuse_idle(&idle, "deform", &format!("the model `{used}`"))
}

fn differs(a: f64, b: f64) -> bool {
    (a - b).abs() > 0.0
}

fn invalid(pointer: &str, detail: String) -> ParameterError {
    ParameterError::one("invalid_parameter", pointer, detail)
}
