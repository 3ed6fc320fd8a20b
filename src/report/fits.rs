//! How each surface was reached: convergence, what ended it, the mesh it left, the field it followed.

use crate::{
    mesh::TriangleQuality,
    pipeline::{Fit, rest::Stop, trace::Trace},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How both surfaces of a gate were reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SurfaceFits {
    /// Of the inner surface.
    pub endocardial: FitSummary,
    /// Of the outer surface.
    pub epicardial: FitSummary,
}

/// How a surface was reached. Says how far the evolution converged on the detected border, not how right the border is. With the preset
/// `clinical` no deformable model runs, and what belongs to it is null.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FitSummary {
    /// Particles less than one voxel from the border, in percent.
    #[schema(required)]
    pub within_one_voxel_percent: Option<f64>,
    /// Mean distance of the particles to the nearest border voxel, in mm.
    #[schema(required)]
    pub mean_distance_mm: Option<f64>,
    /// Time steps of the deformable model, or with the preset `clinical` Gauss-Newton steps of the model.
    pub steps: usize,
    /// What ended the evolution: `all_frozen` (every particle stopped on the border), `at_rest` (the others no longer get anywhere) or
    /// `step_limit` (`max_steps` taken).
    #[schema(value_type = Option<String>, required, example = "all_frozen")]
    pub stop: Option<Stop>,
    /// Particles that froze on the border, in percent.
    #[schema(required)]
    pub frozen_percent: Option<f64>,
    /// The solve of the field the particles followed.
    #[schema(required)]
    pub gvf: Option<GvfSummary>,
    /// Size and shape of the triangles.
    pub triangles: TriangleSummary,
    /// Distance of particles to the border over time; only with `deform.record_distances`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distances: Option<DistanceTrace>,
}

/// The linear solve of a gradient vector flow, one value a component (x, y, z).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GvfSummary {
    /// Relative residual at the end.
    pub residual: [f64; 3],
    /// Iterations.
    pub iterations: [usize; 3],
}

/// Triangles of a mesh, each value as mean, largest and smallest (Tables 2 and 3 of the paper).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TriangleSummary {
    /// Area in mm².
    pub area_mm2: Extremes,
    /// Area over longest edge in mm; .43 of the edge for an equilateral triangle.
    pub aspect_mm: Extremes,
}

/// A quantity over all triangles or vertices of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Extremes {
    /// The mean.
    pub mean: f64,
    /// The largest.
    pub max: f64,
    /// The smallest.
    pub min: f64,
}

/// Distances to the border while the mesh moved (figure 5 of the paper).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DistanceTrace {
    /// Simulated time of each sample in s.
    pub time_s: Vec<f64>,
    /// Mean distance of all particles to the border without its sign, in mm, a sample each.
    pub mean_mm: Vec<f64>,
    /// Particles within one voxel of the border in percent, a sample each.
    pub within_one_voxel_percent: Vec<f64>,
    /// Single particles.
    pub particles: Vec<ParticleDistances>,
}

/// One particle's distance to the border over time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParticleDistances {
    /// The vertex of the mesh.
    pub vertex: usize,
    /// Distance to the border along the normal of its nearest point in mm, positive outside, a sample each.
    pub distance_mm: Vec<f64>,
}

impl From<&Fit> for FitSummary {
    fn from(fit: &Fit) -> Self {
        let evolution = fit.evolution.as_ref();
        Self {
            within_one_voxel_percent: evolution.map(|it| 100.0 * it.within_one_voxel),
            mean_distance_mm: evolution.map(|it| it.mean_distance_mm),
            steps: fit.steps,
            stop: evolution.map(|it| it.stop),
            frozen_percent: evolution.map(|it| 100.0 * it.frozen),
            gvf: evolution.map(|it| GvfSummary { residual: it.gvf_residual, iterations: it.gvf_iterations }),
            triangles: fit.mesh.quality().into(),
            distances: evolution.and_then(|it| it.trace.as_ref()).map(DistanceTrace::from),
        }
    }
}

impl From<TriangleQuality> for TriangleSummary {
    fn from(quality: TriangleQuality) -> Self {
        let extremes = |[mean, max, min]: [f64; 3]| Extremes { mean, max, min };
        Self { area_mm2: extremes(quality.area_mm2), aspect_mm: extremes(quality.aspect_mm) }
    }
}

impl From<&Trace> for DistanceTrace {
    fn from(trace: &Trace) -> Self {
        Self {
            time_s: trace.time_s.clone(),
            mean_mm: trace.mean_mm.clone(),
            within_one_voxel_percent: trace.within_one_voxel.iter().map(|part| 100.0 * part).collect(),
            particles: trace
                .particles
                .iter()
                .map(|particle| ParticleDistances { vertex: particle.vertex, distance_mm: particle.distance_mm.clone() })
                .collect(),
        }
    }
}
