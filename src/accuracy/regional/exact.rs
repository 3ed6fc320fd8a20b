//! What is true of each part of a simulated heart: the definitions of `docs/report.md`, applied to the exact surfaces.

use super::family::Heart;
use crate::{
    analysis::{self, Analysis, Cycle, Phase, cycle::Rates},
    mesh::Mesh,
    phantom::{ExactSurfaces, Simulation},
    pipeline::{
        Fit, GateReconstruction, PerSurface, Reconstruction,
        parameters::Parameters,
        pose::{Pose, PoseConfidence},
        wall::WallOrder,
    },
};

/// A part of the wall is a defect where it takes up less than this part of the normal.
const DEFECT_UPTAKE: f64 = 0.6;
/// Half of the distance in R-R over which the continuous curve's slope is taken.
const SLOPE_STEP: f64 = 1e-5;

/// The truth of a heart.
pub struct Exact {
    /// Derived from the exact surfaces. `phase` is that of the thickness, `cycle` that of the exact volumes of the gates; what rests on counts
    /// (`perfusion`) is that of the simulated counts within the exact surfaces.
    pub analysis: Analysis,
    /// Rates of the continuous cycle.
    pub continuous: Option<Rates>,
    /// Share of the wall's area with a defect, in percent.
    pub defect_percent: f64,
    /// Volume of the cavity at each gate in ml.
    pub cavities_ml: Vec<f64>,
}

/// The truth of a simulated heart; `None` without a ventricle.
pub fn of(heart: &Heart, simulation: &Simulation) -> Option<Exact> {
    let gates = simulation.study.gates.len();
    let surfaces: Vec<ExactSurfaces> = (0..gates).map(|gate| heart.phantom.exact_surfaces(gate)).collect::<Option<_>>()?;
    let reconstruction = as_reconstruction(heart, &surfaces);
    let mut analysis = analysis::analyse(&simulation.study, &reconstruction);
    analysis.phase = Phase::of(&analysis.walls.thickness_mm, &analysis.places);
    let cavity_ml: Vec<f64> = simulation.truth.gates.iter().map(|gate| gate.endocardial_ml).collect();
    analysis.cycle = Cycle::of(&simulation.study, &cavity_ml);
    let volume = |t: f64| heart.phantom.cavity_ml(t).unwrap_or(0.0);
    let slope = |t: f64| (volume(t + SLOPE_STEP) - volume(t - SLOPE_STEP)) / (2.0 * SLOPE_STEP);
    let continuous = analysis.cycle.as_ref().map(|_| Rates::of(&volume, &slope));
    let uptake = &surfaces[analysis.end_diastole].uptake;
    let missing = analysis
        .places
        .of_vertex
        .iter()
        .zip(uptake)
        .filter_map(|(place, &uptake)| (uptake < DEFECT_UPTAKE).then_some(place.as_ref()?.area_mm2))
        .fold(0.0, |sum, area| sum + area);
    Some(Exact { defect_percent: 100.0 * missing / analysis.places.area_mm2(), analysis, continuous, cavities_ml: cavity_ml })
}

/// The exact surfaces in the form that a reconstruction has.
fn as_reconstruction(heart: &Heart, surfaces: &[ExactSurfaces]) -> Reconstruction {
    let fit = |mesh: &Mesh| Fit { mesh: mesh.clone(), steps: 0, evolution: None };
    let gates = surfaces
        .iter()
        .map(|gate| GateReconstruction {
            fits: PerSurface { endocardial: fit(&gate.endocardial), epicardial: fit(&gate.epicardial) },
            wall_order: WallOrder::default(),
        })
        .collect();
    let mean = |of: fn(&ExactSurfaces) -> glam::DVec3| surfaces.iter().map(of).sum::<glam::DVec3>() / surfaces.len() as f64;
    let (apex_mm, base_mm) = (mean(|gate| gate.mid_wall_tip_mm), mean(|gate| gate.base_mm));
    let confidence = PoseConfidence { score: 1.0, ridge: 1.0, explained: 1.0, flip_margin: 1.0, ends_given: true };
    let pose = Pose { apex_mm, base_mm, radius_mm: 0.0, confidence };
    Reconstruction {
        gates,
        region: None,
        to_base: pose.to_base(),
        pose: Some(pose),
        model: None,
        parameters: Parameters { analysis: heart.analysis(), ..Parameters::clinical() },
        warnings: Vec::new(),
    }
}
