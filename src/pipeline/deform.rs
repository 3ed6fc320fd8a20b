//! The evolution of the deformable mesh (paper §3-§5, §7.1): particles under the direction of the gradient vector flow and the model's
//! internal forces, from an ellipsoid until they freeze on the border (see `freeze`) or get no farther (see `rest`).

use super::{
    PipelineError,
    borders::{Border, BorderPoint},
    freeze::Ice,
    gvf::Flow,
    integrate::{Dynamics, Particles, step},
    models::Internal,
    monitor,
    monitor::Monitor,
    parameters::{MeshParameters, Parameters},
    rest::{Rest, Stop},
    smooth,
    trace::{Recorder, Trace},
};
use crate::{mesh::Mesh, volume::Grid};
use glam::DVec3;

/// A mesh at the end of its evolution.
#[derive(Debug, Clone)]
pub struct Evolved {
    /// The surface in grid mm.
    pub mesh: Mesh,
    /// Time steps taken.
    pub steps: usize,
    /// What ended the evolution.
    pub stop: Stop,
    /// Fraction of particles frozen on the border.
    pub frozen: f64,
    /// Distances to the border over time, if they were asked for.
    pub trace: Option<Trace>,
}

/// What an evolution takes place in.
#[derive(Clone, Copy)]
pub struct Setting<'a> {
    /// The lattice.
    pub grid: &'a Grid,
    /// The border that particles are drawn to.
    pub border: &'a Border,
    /// The field that draws them.
    pub flow: &'a Flow,
    /// Everything that can be chosen.
    pub parameters: &'a Parameters,
    /// May end the evolution.
    pub monitor: &'a dyn Monitor,
}

/// The mesh after a step.
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a> {
    /// Steps taken; 0 is the seed.
    pub steps: usize,
    /// Where the particles are, in grid mm.
    pub positions: &'a [DVec3],
    /// Which of them are frozen on the border.
    pub frozen: &'a [bool],
}

/// Force of the field on a particle, in mass units × mm/s². The paper gives no unit: with this one a particle of unit mass crosses a
/// ventricle's radius in about thirty steps of the paper's 0.1 s.
const FIELD_FORCE: f64 = 10.0;
/// Longest way in a step, as part of the smallest voxel: no border voxel is jumped over.
const LONGEST_STEP: f64 = 0.5;
/// Simulated time between two smoothing passes over the particles that still move, in s: four steps of the paper's 0.1 s.
const SMOOTHING_INTERVAL_S: f64 = 0.4;

/// Evolves the mesh of one surface from its seed; `watch` sees the seed and every step.
pub fn evolve(seed: Mesh, setting: &Setting<'_>, watch: &mut dyn FnMut(&Moment<'_>)) -> Result<Evolved, PipelineError> {
    let Setting { grid, border, flow, parameters, monitor } = *setting;
    let deform = &parameters.deform;
    let joined = seed.neighbours();
    let internal = Internal::new(deform, &seed);
    let field = |place: DVec3| flow.direction(place) * FIELD_FORCE;
    let drag_per_s = -(1.0 - deform.damping_percent / 100.0).ln();
    let longest_mm = LONGEST_STEP * grid.smallest_spacing_mm();
    let smoothing_interval = ((SMOOTHING_INTERVAL_S / deform.time_step_s).round() as usize).max(1);
    let count = seed.positions.len();
    let mut particles = Particles { velocities: vec![DVec3::ZERO; count], positions: seed.positions };
    let mut ice = Ice::new(border, grid, count);
    let mut rest = Rest::new(border, grid, count, (deform.time_step_s, deform.mass), deform.rest_voxels * grid.smallest_spacing_mm());
    let mut recorder = deform.record_distances.then(|| Recorder::new(border, grid, deform.time_step_s));
    let mut steps = 0;
    let stop = loop {
        watch(&Moment { steps, positions: &particles.positions, frozen: &ice.frozen });
        if let Some(recorder) = &mut recorder {
            recorder.record(steps, &particles.positions);
        }
        if ice.holds_all() {
            break Stop::AllFrozen;
        }
        if steps == deform.max_steps {
            break Stop::StepLimit;
        }
        monitor::check(monitor)?;
        let dynamics = Dynamics { internal: &internal, field: &field, mass: deform.mass, drag_per_s, fixed: &ice.frozen };
        let next = step(deform.solver, &particles, deform.time_step_s, &dynamics);
        steps += 1;
        for vertex in 0..count {
            if !ice.frozen[vertex] {
                (particles.positions[vertex], particles.velocities[vertex]) =
                    limited(particles.positions[vertex], &next, vertex, longest_mm, deform.time_step_s);
            }
        }
        if deform.freezing {
            ice.freeze(&mut particles, flow, deform.subvoxel);
        }
        if deform.smoothing && steps % smoothing_interval == 0 {
            smooth::taubin(&mut particles.positions, &joined, |vertex| !ice.frozen[vertex]);
        }
        if let Some(means) = rest.observe(&particles.positions, &ice.frozen) {
            for (vertex, mean) in means.into_iter().enumerate().filter(|(vertex, _)| !ice.frozen[*vertex]) {
                particles.positions[vertex] = mean;
            }
            break Stop::AtRest;
        }
    };
    let mut mesh = Mesh { positions: particles.positions, triangles: seed.triangles };
    if deform.smoothing {
        smooth_whole(&mut mesh, &joined, smooth::final_passes(parameters.mesh.level));
    }
    Ok(Evolved { mesh, steps, stop, frozen: ice.part(), trace: recorder.map(Recorder::finish) })
}

/// The final smoothing: again while a triangle is inverted, up to four times.
fn smooth_whole(mesh: &mut Mesh, joined: &[Vec<u32>], passes: usize) {
    const MOST_ROUNDS: usize = 4;
    for round in 0..MOST_ROUNDS {
        if round > 0 && mesh.inverted_triangles(mesh.centroid()) == 0 {
            break;
        }
        for _ in 0..passes {
            smooth::taubin(&mut mesh.positions, joined, |_| true);
        }
    }
}

/// The sphere "scaled and translated" to the bounding box of the data (§7.3), enlarged by the seed's scale.
pub fn ellipsoid<'a>(points: impl IntoIterator<Item = &'a BorderPoint>, mesh: &MeshParameters) -> Mesh {
    let (low, high) = points
        .into_iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), point| (low.min(point.position_mm), high.max(point.position_mm)));
    Mesh::icosphere(mesh.level).map(|unit| (low + high) / 2.0 + unit * (high - low) / 2.0 * mesh.seed_scale)
}

/// The position and velocity after a step that may be no longer than `longest_mm`. A particle thrown to infinity, by the bend of a triangle
/// that has lost its area, stays where it was.
fn limited(from: DVec3, next: &Particles, vertex: usize, longest_mm: f64, time_step_s: f64) -> (DVec3, DVec3) {
    let (way, velocity) = (next.positions[vertex] - from, next.velocities[vertex]);
    if !way.is_finite() || !velocity.is_finite() {
        return (from, DVec3::ZERO);
    }
    (from + way.clamp_length_max(longest_mm), velocity.clamp_length_max(longest_mm / time_step_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{gvf, gvf::tests::sphere, monitor::Silent};
    use std::f64::consts::PI;

    const GRID: Grid = Grid { shape: [24, 40, 40], spacing_mm: [4.0, 2.8, 2.8] };
    const RADIUS_MM: f64 = 25.0;

    fn evolve_on(border: &Border, flow: &Flow, parameters: &Parameters) -> Evolved {
        let seed = ellipsoid(&border.points, &parameters.mesh);
        evolve(seed, &Setting { grid: &GRID, border, flow, parameters, monitor: &Silent }, &mut |_| ()).unwrap()
    }

    fn evolved(parameters: &Parameters) -> Evolved {
        let border = sphere(GRID, GRID.position_mm([12, 20, 20]), RADIUS_MM);
        let flow = gvf::flow(&GRID, &border, &parameters.gvf, &Silent).unwrap();
        evolve_on(&border, &flow, parameters)
    }

    #[test]
    fn every_particle_freezes_on_a_sphere_and_encloses_it() {
        let found = evolved(&Parameters::paper());
        assert!((found.frozen - 1.0).abs() < f64::EPSILON);
        assert!(found.steps < 200, "{}", found.steps);
        let exact = 4.0 / 3.0 * PI * RADIUS_MM.powi(3);
        // 642 flat-sided vertices hold 1 % less than the sphere, smoothing 1 % more.
        assert!((found.mesh.signed_volume_mm3() / exact - 1.0).abs() < 0.03, "{}", found.mesh.signed_volume_mm3() / exact);
        assert_eq!(found.mesh.inverted_triangles(found.mesh.centroid()), 0);
    }

    #[test]
    fn particles_reach_the_border_from_a_shape_half_outside_it() {
        // A border in part of the box: half a sphere. The bounding ellipsoid's other half starts inside the cut.
        let parameters = Parameters::paper();
        let mut border = sphere(GRID, GRID.position_mm([12, 20, 20]), RADIUS_MM);
        border.points.retain(|point| point.voxel[0] <= 12);
        let flow = gvf::flow(&GRID, &border, &parameters.gvf, &Silent).unwrap();
        let found = evolve_on(&border, &flow, &parameters);
        assert!(found.mesh.positions.iter().all(|position| position.is_finite()));
        let highest = found.mesh.positions.iter().map(|position| position.z).fold(f64::MIN, f64::max);
        assert!(highest < GRID.position_mm([14, 0, 0]).z, "{highest}: nothing draws particles above the border");
    }

    #[test]
    fn without_smoothing_particles_still_end_on_the_edge() {
        let mut parameters = Parameters::paper();
        parameters.deform.smoothing = false;
        let centre = GRID.position_mm([12, 20, 20]);
        let found = evolved(&parameters);
        let worst = found.mesh.positions.iter().map(|position| (position.distance(centre) - RADIUS_MM).abs()).fold(0.0, f64::max);
        // Each voxel's tangent plane leaves the sphere by at most half a voxel's diagonal squared over the diameter: .2 mm.
        assert!(worst < 0.5, "{worst}");
    }
}
