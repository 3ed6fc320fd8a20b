//! Internal forces of the deformable mesh (paper §4). The free model has none: its particles feel only the field, and smoothing keeps
//! the topology.

use super::{integrate::Particles, parameters::Model};
use glam::DVec3;

/// Internal force on every particle, in mm/s² for unit mass.
pub fn internal_forces(model: Model, particles: &Particles) -> Vec<DVec3> {
    match model {
        Model::SpringMass | Model::RestrictedSpringMass | Model::Plane | Model::Free => vec![DVec3::ZERO; particles.positions.len()],
    }
}
