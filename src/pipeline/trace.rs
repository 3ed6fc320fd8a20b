//! The distance of particles to the border over time (paper §7.1, figure 5), kept on request.

use super::{
    borders::{Border, BorderPoint},
    measure,
};
use crate::volume::Grid;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Distances to the border while the mesh moved.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Trace {
    /// Simulated time of each sample in s, from 0.
    pub time_s: Vec<f64>,
    /// Mean distance of all particles to the border without its sign, in mm, a sample each.
    pub mean_mm: Vec<f64>,
    /// Fraction of all particles within one voxel of the border, 0-1, a sample each.
    pub within_one_voxel: Vec<f64>,
    /// Single particles, the same ones in every gate and surface.
    pub particles: Vec<ParticleTrace>,
}

/// One particle's distance to the border.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParticleTrace {
    /// The vertex.
    pub vertex: usize,
    /// Distance to the border along the normal of its nearest point in mm, positive outside of it, a sample each. (The distance to the point
    /// itself does not become zero between two slices.)
    pub distance_mm: Vec<f64>,
}

/// Single particles that are followed: the corners of the icosahedron, which lie all round and are the first vertices at every level.
const FOLLOWED: usize = 12;
/// Most samples kept. When there are more, every second one is dropped and half as many taken from then on.
const MOST_SAMPLES: usize = 400;

/// Records a trace while the mesh moves.
pub struct Recorder<'a> {
    border: &'a Border,
    grid: &'a Grid,
    middle_mm: DVec3,
    time_step_s: f64,
    /// A sample is taken every so many steps.
    interval: usize,
    trace: Trace,
}

impl<'a> Recorder<'a> {
    /// Nothing recorded yet.
    pub fn new(border: &'a Border, grid: &'a Grid, time_step_s: f64) -> Self {
        let middle_mm = middle_mm(border);
        let particles = (0..FOLLOWED).map(|vertex| ParticleTrace { vertex, distance_mm: Vec::new() }).collect();
        Self { border, grid, middle_mm, time_step_s, interval: 1, trace: Trace { particles, ..Trace::default() } }
    }

    /// Takes in the mesh after so many steps.
    pub fn record(&mut self, steps: usize, positions: &[DVec3]) {
        if !steps.is_multiple_of(self.interval) {
            return;
        }
        if self.trace.time_s.len() == MOST_SAMPLES {
            self.thin();
            self.interval *= 2;
            if !steps.is_multiple_of(self.interval) {
                return;
            }
        }
        let measured = measure::distances(positions, self.border, self.grid);
        self.trace.time_s.push(steps as f64 * self.time_step_s);
        self.trace.within_one_voxel.push(measured.within_one_voxel);
        let distances_mm: Vec<f64> = positions.iter().map(|&position| outside_mm(position, self.border, self.middle_mm)).collect();
        self.trace.mean_mm.push(distances_mm.iter().map(|mm| mm.abs()).sum::<f64>() / distances_mm.len().max(1) as f64);
        for (particle, &distance_mm) in self.trace.particles.iter_mut().zip(&distances_mm) {
            particle.distance_mm.push(distance_mm);
        }
    }

    /// What was recorded.
    pub fn finish(self) -> Trace {
        self.trace
    }

    fn thin(&mut self) {
        let samples = [&mut self.trace.time_s, &mut self.trace.mean_mm, &mut self.trace.within_one_voxel];
        for list in samples.into_iter().chain(self.trace.particles.iter_mut().map(|particle| &mut particle.distance_mm)) {
            *list = list.iter().copied().step_by(2).collect();
        }
    }
}

/// The mean of a border's points, in grid mm.
pub fn middle_mm(border: &Border) -> DVec3 {
    border.points.iter().map(|point| point.position_mm).sum::<DVec3>() / border.points.len().max(1) as f64
}

/// How far outside the border a point lies, in mm, along the normal of the border's nearest point: between two slices the distance to the
/// point itself does not become zero. Outside is where the normal points once it is turned away from the border's middle.
pub fn outside_mm(position: DVec3, border: &Border, middle_mm: DVec3) -> f64 {
    let to = |point: &BorderPoint| position.distance_squared(point.position_mm);
    let nearest = border.points.iter().min_by(|a, b| to(a).total_cmp(&to(b)));
    nearest.map_or(f64::NAN, |point| {
        let outward = point.normal * point.normal.dot(point.position_mm - middle_mm).signum();
        (position - point.position_mm).dot(outward)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::gvf::tests::sphere;

    #[test]
    fn distances_are_signed_and_samples_bounded() {
        let grid = Grid { shape: [20, 20, 20], spacing_mm: [3.0; 3] };
        let centre = DVec3::splat(28.5);
        let border = sphere(grid, centre, 15.0);
        let mut recorder = Recorder::new(&border, &grid, 0.1);
        // Twelve particles that go from 25 mm inwards to 5 mm.
        for step in 0..3001_usize {
            let radius = 25.0 - 20.0 * step as f64 / 3000.0;
            let positions: Vec<DVec3> = crate::mesh::Mesh::icosphere(0).positions.iter().map(|unit| centre + *unit * radius).collect();
            recorder.record(step, &positions);
        }
        let trace = recorder.finish();
        assert!((MOST_SAMPLES / 2..=MOST_SAMPLES).contains(&trace.time_s.len()), "{}", trace.time_s.len());
        assert_eq!(trace.particles.len(), FOLLOWED);
        for particle in &trace.particles {
            assert_eq!(particle.distance_mm.len(), trace.time_s.len());
            for (time, distance) in trace.time_s.iter().zip(&particle.distance_mm) {
                let expected = 25.0 - 20.0 * time / 300.0 - 15.0;
                // Tangent planes of edge points up to half a voxel's diagonal beside the particle.
                assert!((distance - expected).abs() < 1.0, "{distance} for {expected}");
            }
        }
    }
}
