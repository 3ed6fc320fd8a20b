//! The distance of particles to the border over time (paper §7.1, figure 5), kept on request.

use serde::{Deserialize, Serialize};

/// Distances to the border while the mesh moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// Simulated time of each sample in s, from 0.
    pub time_s: Vec<f64>,
    /// Mean distance of all particles to the border, in mm, a sample each.
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
    /// Distance to the nearest border voxel's edge in mm, positive outside of the border, a sample each.
    pub distance_mm: Vec<f64>,
}
