//! Internal forces of the deformable mesh (paper §4): none (free), springs along the edges (spring-mass), springs of which only one part
//! acts (restricted), or stretch, shear and bend of the triangles (plane deformation, after Baraff & Witkin 1998). Undeformed is the mesh
//! that the evolution starts from.

use super::{
    block_matrix::BlockMatrix,
    conditions::{Bend, Condition, Shear, Spring, Stretch, dihedral_rad, outer, triangle},
    integrate::Particles,
    parameters::{DeformParameters, Model, SpringDirection, Stiffness},
};
use crate::mesh::Mesh;
use glam::DVec3;
use std::collections::BTreeMap;

/// The internal forces of one mesh.
#[derive(Debug, Clone, Default)]
pub struct Internal {
    springs: Vec<Bound<2, Spring>>,
    stretches: Vec<Bound<3, Stretch>>,
    shears: Vec<Bound<3, Shear>>,
    bends: Vec<Bound<4, Bend>>,
    stretch: Stiffness,
    shear: Stiffness,
    bend: Stiffness,
    /// The part of the springs' force that acts, if not all of it.
    restricted: Option<SpringDirection>,
    /// Zero, with a block for each pair of particles that share a condition: what the matrices of every step start from.
    zero: BlockMatrix,
}

/// A condition and the particles it is about.
#[derive(Debug, Clone, Copy)]
struct Bound<const N: usize, C> {
    particles: [usize; N],
    condition: C,
}

/// Which second derivatives of the conditions enter the stiffness matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Curvature {
    /// All: the derivative of the force.
    Whole,
    /// Only what cannot make the matrix indefinite: lengths under tension, and neither shear nor bend.
    Convex,
}

impl Internal {
    /// The forces of a model on a mesh that is undeformed as it is.
    pub fn new(deform: &DeformParameters, rest: &Mesh) -> Self {
        let mut all = Self { stretch: deform.stretch, shear: deform.shear, bend: deform.bend, ..Self::default() };
        match deform.model {
            Model::Free => {}
            Model::SpringMass => all.springs = springs(rest),
            Model::RestrictedSpringMass => {
                all.springs = springs(rest);
                all.restricted = Some(deform.spring_direction);
            }
            Model::Plane => {
                for &corners in rest.triangles.iter() {
                    let particles = corners.map(|vertex| vertex as usize);
                    let Some((stretches, shear)) = triangle(particles.map(|particle| rest.positions[particle])) else { continue };
                    all.stretches.extend(stretches.map(|condition| Bound { particles, condition }));
                    all.shears.push(Bound { particles, condition: shear });
                }
                all.bends = bends(rest);
            }
        }
        all.zero = BlockMatrix::zero(&all.joined(rest.positions.len()));
        all
    }

    /// Springs only, for systems whose solution is known.
    #[cfg(test)]
    pub(super) fn of_springs(count: usize, springs: &[([usize; 2], f64)], stiffness: Stiffness) -> Self {
        let springs = springs.iter().map(|&(particles, rest_mm)| Bound { particles, condition: Spring { rest_mm } }).collect();
        let mut all = Self { springs, stretch: stiffness, ..Self::default() };
        all.zero = BlockMatrix::zero(&all.joined(count));
        all
    }

    /// Whether there are no internal forces at all.
    pub fn is_empty(&self) -> bool {
        self.springs.is_empty() && self.stretches.is_empty()
    }

    /// The force on every particle that is not fixed, −(k C + kd Ċ) ∇C summed over its conditions, in mass units × mm/s². `direction` is the
    /// field's direction at a particle, a unit vector or zero. Conditions among fixed particles only move nothing and are passed over.
    pub fn forces(&self, at: &Particles, fixed: &[bool], direction: impl Fn(usize) -> DVec3) -> Vec<DVec3> {
        let mut forces = vec![DVec3::ZERO; at.positions.len()];
        add_forces(&self.springs, self.stretch, at, fixed, &mut forces);
        add_forces(&self.stretches, self.stretch, at, fixed, &mut forces);
        add_forces(&self.shears, self.shear, at, fixed, &mut forces);
        add_forces(&self.bends, self.bend, at, fixed, &mut forces);
        if let Some(kept) = self.restricted {
            for (particle, force) in forces.iter_mut().enumerate() {
                let along = direction(particle);
                let along = along * force.dot(along);
                *force = if kept == SpringDirection::AlongField { along } else { *force - along };
            }
        }
        forces
    }

    /// −∂f/∂x and −∂f/∂v. Of the damping's own change with the places only the symmetric part is kept, as Baraff & Witkin do (§4.5): with
    /// the other one conjugate gradients could not be used.
    pub fn derivatives(&self, at: &Particles, fixed: &[bool], curvature: Curvature) -> (BlockMatrix, BlockMatrix) {
        let (mut stiffness, mut damping) = (self.zero.clone(), self.zero.clone());
        let lengths = |tension: f64| if curvature == Curvature::Whole { tension } else { tension.max(0.0) };
        let others = |tension: f64| if curvature == Curvature::Whole { tension } else { 0.0 };
        let both = (&mut stiffness, &mut damping);
        add_derivatives(&self.springs, self.stretch, (at, fixed), lengths, (both.0, both.1));
        add_derivatives(&self.stretches, self.stretch, (at, fixed), lengths, (both.0, both.1));
        add_derivatives(&self.shears, self.shear, (at, fixed), others, (both.0, both.1));
        add_derivatives(&self.bends, self.bend, (at, fixed), others, (both.0, both.1));
        (stiffness, damping)
    }

    /// The particles that share a condition with each particle, itself included, ascending.
    fn joined(&self, particles: usize) -> Vec<Vec<usize>> {
        let mut joined: Vec<Vec<usize>> = (0..particles).map(|particle| vec![particle]).collect();
        let mut join = |group: &[usize]| {
            for &particle in group {
                joined[particle].extend_from_slice(group);
            }
        };
        self.springs.iter().for_each(|bound| join(&bound.particles));
        self.shears.iter().for_each(|bound| join(&bound.particles));
        self.bends.iter().for_each(|bound| join(&bound.particles));
        for list in &mut joined {
            list.sort_unstable();
            list.dedup();
        }
        joined
    }
}

/// A spring along each edge, as long as it is.
fn springs(rest: &Mesh) -> Vec<Bound<2, Spring>> {
    let neighbours = rest.neighbours();
    let edges = neighbours.iter().enumerate().flat_map(|(a, joined)| joined.iter().map(move |&b| [a, b as usize]));
    let once = edges.filter(|[a, b]| a < b);
    once.map(|particles| {
        let [a, b] = particles.map(|particle| rest.positions[particle]);
        Bound { particles, condition: Spring { rest_mm: a.distance(b) } }
    })
    .collect()
}

/// A bend about each edge, with the angle it has.
fn bends(rest: &Mesh) -> Vec<Bound<4, Bend>> {
    // The apex of the triangle that runs through each directed edge.
    let apices: BTreeMap<(usize, usize), usize> = rest
        .triangles
        .iter()
        .map(|triangle| triangle.map(|vertex| vertex as usize))
        .flat_map(|[a, b, c]| [((a, b), c), ((b, c), a), ((c, a), b)])
        .collect();
    let once = apices.iter().filter(|((a, b), _)| a < b);
    once.filter_map(|(&(a, b), &apex)| {
        let particles = [a, b, apex, *apices.get(&(b, a))?];
        Some(Bound { particles, condition: Bend { rest_rad: dihedral_rad(particles.map(|particle| rest.positions[particle])) } })
    })
    .collect()
}

fn add_forces<const N: usize, C: Condition<N>>(
    bound: &[Bound<N, C>],
    constants: Stiffness,
    at: &Particles,
    fixed: &[bool],
    forces: &mut [DVec3],
) {
    for Bound { particles, condition } in bound.iter().filter(|bound| moves(&bound.particles, fixed)) {
        let slope = condition.slope(particles.map(|particle| at.positions[particle]));
        let rate: f64 = particles.iter().zip(slope.gradient).map(|(&particle, gradient)| gradient.dot(at.velocities[particle])).sum();
        let tension = constants.k * slope.value + constants.kd * rate;
        for (&particle, gradient) in particles.iter().zip(slope.gradient) {
            forces[particle] -= gradient * tension;
        }
    }
}

/// Whether any of these particles may move.
fn moves(particles: &[usize], fixed: &[bool]) -> bool {
    particles.iter().any(|&particle| !fixed[particle])
}

/// `curved` turns the tension k C + kd Ċ into the factor of the second derivatives.
fn add_derivatives<const N: usize, C: Condition<N>>(
    bound: &[Bound<N, C>],
    constants: Stiffness,
    (at, fixed): (&Particles, &[bool]),
    curved: impl Fn(f64) -> f64,
    (stiffness, damping): (&mut BlockMatrix, &mut BlockMatrix),
) {
    for Bound { particles, condition } in bound.iter().filter(|bound| moves(&bound.particles, fixed)) {
        let places = particles.map(|particle| at.positions[particle]);
        let slope = condition.slope(places);
        let rate: f64 = particles.iter().zip(slope.gradient).map(|(&particle, gradient)| gradient.dot(at.velocities[particle])).sum();
        let factor = curved(constants.k * slope.value + constants.kd * rate);
        let curvature = condition.curvature(places);
        for (i, &row) in particles.iter().enumerate() {
            for (j, &column) in particles.iter().enumerate() {
                let steep = outer(slope.gradient[i], slope.gradient[j]);
                stiffness.add(row, column, steep * constants.k + curvature[i][j] * factor);
                damping.add(row, column, steep * constants.kd);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::parameters::Parameters;

    fn plane() -> (Internal, Particles) {
        let rest = Mesh::icosphere(1).map(|unit| unit * DVec3::new(20.0, 25.0, 40.0));
        let deform = DeformParameters { model: Model::Plane, ..Parameters::paper().deform };
        // Deformed by a few tenths of an edge, and moving.
        let positions: Vec<DVec3> =
            rest.positions.iter().map(|p| *p * 1.05 + DVec3::new(p.y.sin(), (2.0 * p.z).cos(), p.x.sin()) * 2.0).collect();
        let velocities = positions.iter().map(|p| DVec3::new(p.z.cos(), p.x.sin(), p.y.cos()) * 3.0).collect();
        (Internal::new(&deform, &rest), Particles { positions, velocities })
    }

    fn forces(internal: &Internal, at: &Particles) -> Vec<DVec3> {
        internal.forces(at, &vec![false; at.positions.len()], |_| DVec3::ZERO)
    }

    /// The matrix times a direction against the central difference of the forces along it.
    fn compare(product: &[DVec3], low: &[DVec3], high: &[DVec3], step: f64) {
        let largest = product.iter().map(|force| force.length()).fold(0.0, f64::max);
        assert!(largest > 1.0, "{largest}");
        for ((product, low), high) in product.iter().zip(low).zip(high) {
            let slope = (*low - *high) / (2.0 * step);
            assert!(product.distance(slope) < 1e-6 * largest, "{product} for {slope}");
        }
    }

    #[test]
    fn derivatives_of_the_plane_model_agree_with_finite_differences() {
        let (internal, at) = plane();
        let free = vec![false; at.positions.len()];
        let direction: Vec<DVec3> = at.positions.iter().map(|p| DVec3::new((3.0 * p.x).sin(), p.y.cos(), (p.z * p.x).sin())).collect();
        let shifted = |values: &[DVec3], by: f64| values.iter().zip(&direction).map(|(value, d)| value + d * by).collect::<Vec<_>>();
        // By the places, at rest: what depends on the velocity is not symmetric and left out by intent.
        let still = Particles { velocities: vec![DVec3::ZERO; at.positions.len()], ..at.clone() };
        let (stiffness, _) = internal.derivatives(&still, &free, Curvature::Whole);
        let step = 1e-5;
        let at_place = |by: f64| forces(&internal, &Particles { positions: shifted(&at.positions, by), ..still.clone() });
        compare(&stiffness.times(&direction), &at_place(-step), &at_place(step), step);
        // By the velocities.
        let (_, damping) = internal.derivatives(&at, &free, Curvature::Whole);
        let at_speed = |by: f64| forces(&internal, &Particles { velocities: shifted(&at.velocities, by), ..at.clone() });
        compare(&damping.times(&direction), &at_speed(-1.0), &at_speed(1.0), 1.0);
    }

    #[test]
    fn no_model_pushes_or_turns_the_whole_mesh() {
        let (_, at) = plane();
        let rest = Mesh::icosphere(1).map(|unit| unit * 25.0);
        for model in [Model::SpringMass, Model::Plane] {
            let internal = Internal::new(&DeformParameters { model, ..Parameters::paper().deform }, &rest);
            let forces = forces(&internal, &at);
            let total: DVec3 = forces.iter().sum();
            let turning: DVec3 = at.positions.iter().zip(&forces).map(|(place, force)| place.cross(*force)).sum();
            let size: f64 = forces.iter().map(|force| force.length()).sum();
            assert!(size > 100.0 && total.length() < 1e-9 * size && turning.length() < 1e-7 * size, "{model:?}: {total} {turning} {size}");
        }
    }

    #[test]
    fn an_undeformed_mesh_feels_nothing_and_the_free_model_never_does() {
        let (_, at) = plane();
        let rest = Mesh::icosphere(1).map(|unit| unit * 25.0);
        let still = Particles { velocities: vec![DVec3::ZERO; rest.positions.len()], positions: rest.positions.clone() };
        for model in [Model::Free, Model::SpringMass, Model::RestrictedSpringMass, Model::Plane] {
            let internal = Internal::new(&DeformParameters { model, ..Parameters::paper().deform }, &rest);
            assert!(forces(&internal, &still).iter().all(|force| force.length() < 1e-9), "{model:?}");
            assert_eq!(internal.is_empty(), model == Model::Free);
            let moved = internal.forces(&at, &vec![false; at.positions.len()], |_| DVec3::X);
            assert_eq!(moved.iter().all(|force| *force == DVec3::ZERO), model == Model::Free, "{model:?}");
        }
    }

    #[test]
    fn restricted_springs_act_in_one_direction_to_the_field() {
        let (_, at) = plane();
        let rest = Mesh::icosphere(1).map(|unit| unit * 25.0);
        let of = |model, spring_direction| {
            let deform = DeformParameters { model, spring_direction, ..Parameters::paper().deform };
            Internal::new(&deform, &rest).forces(&at, &vec![false; at.positions.len()], |particle| rest.positions[particle].normalize())
        };
        let whole = of(Model::SpringMass, SpringDirection::AcrossField);
        let across = of(Model::RestrictedSpringMass, SpringDirection::AcrossField);
        let along = of(Model::RestrictedSpringMass, SpringDirection::AlongField);
        for (particle, place) in rest.positions.iter().enumerate() {
            let out = place.normalize();
            assert!(across[particle].dot(out).abs() < 1e-9 && along[particle].cross(out).length() < 1e-9);
            assert!((across[particle] + along[particle]).distance(whole[particle]) < 1e-9);
        }
    }
}
