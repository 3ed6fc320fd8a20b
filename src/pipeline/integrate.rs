//! Time integration of particles, ẋ = v, m v̇ = f(x, v) (paper §3, figure 3): three explicit methods, and implicit Euler for stiff forces.

use super::{
    block_matrix::solve,
    models::{Curvature, Internal},
    parameters::Solver,
};
use glam::DVec3;

/// Positions in mm and velocities in mm/s.
#[derive(Debug, Clone, PartialEq)]
pub struct Particles {
    /// Positions in mm.
    pub positions: Vec<DVec3>,
    /// Velocities in mm/s.
    pub velocities: Vec<DVec3>,
}

/// What moves the particles.
pub struct Dynamics<'a> {
    /// Forces between them.
    pub internal: &'a Internal,
    /// The field's force at a place, in mass units × mm/s². Springs may be restricted by its direction.
    pub field: &'a (dyn Fn(DVec3) -> DVec3 + 'a),
    /// Mass of each particle.
    pub mass: f64,
    /// Drag c a unit of mass: −c m v, in 1/s.
    pub drag_per_s: f64,
    /// Particles that stay where they are.
    pub fixed: &'a [bool],
}

/// Relative residual of implicit Euler's linear system: well below the error of a first-order step.
const IMPLICIT_TOLERANCE: f64 = 1e-6;
/// Most iterations on it; a mesh of 2562 particles needs fewer than a hundred at the largest time step.
const IMPLICIT_ITERATIONS: usize = 500;

impl Dynamics<'_> {
    /// The force on every particle, zero where it is fixed.
    fn forces(&self, at: &Particles) -> Vec<DVec3> {
        let at_particle = |particle: usize| if self.fixed[particle] { DVec3::ZERO } else { (self.field)(at.positions[particle]) };
        let field: Vec<DVec3> = (0..at.positions.len()).map(at_particle).collect();
        let mut forces = if self.internal.is_empty() {
            vec![DVec3::ZERO; field.len()]
        } else {
            self.internal.forces(at, self.fixed, |particle| field[particle].normalize_or_zero())
        };
        for (particle, force) in forces.iter_mut().enumerate() {
            *force += field[particle] - at.velocities[particle] * (self.drag_per_s * self.mass);
            if self.fixed[particle] {
                *force = DVec3::ZERO;
            }
        }
        forces
    }
}

/// One step of `time_step_s`.
pub fn step(solver: Solver, from: &Particles, time_step_s: f64, dynamics: &Dynamics<'_>) -> Particles {
    let slope = |at: &Particles| Slope {
        velocities: at.velocities.clone(),
        accelerations: dynamics.forces(at).into_iter().map(|force| force / dynamics.mass).collect(),
    };
    match solver {
        Solver::Euler => along(from, &slope(from), time_step_s),
        Solver::Midpoint => along(from, &slope(&along(from, &slope(from), time_step_s / 2.0)), time_step_s),
        Solver::Rk4 => rk4(from, time_step_s, slope),
        Solver::ImplicitEuler => implicit_euler(from, time_step_s, dynamics),
    }
}

/// The rate of change of a state.
struct Slope {
    velocities: Vec<DVec3>,
    accelerations: Vec<DVec3>,
}

fn rk4(from: &Particles, h: f64, slope: impl Fn(&Particles) -> Slope) -> Particles {
    let k1 = slope(from);
    let k2 = slope(&along(from, &k1, h / 2.0));
    let k3 = slope(&along(from, &k2, h / 2.0));
    let k4 = slope(&along(from, &k3, h));
    let mean = |pick: fn(&Slope) -> &Vec<DVec3>| -> Vec<DVec3> {
        let [a, b, c, d] = [&k1, &k2, &k3, &k4].map(pick);
        (0..a.len()).map(|i| (a[i] + 2.0 * (b[i] + c[i]) + d[i]) / 6.0).collect()
    };
    let weighted = Slope { velocities: mean(|k| &k.velocities), accelerations: mean(|k| &k.accelerations) };
    along(from, &weighted, h)
}

fn along(from: &Particles, slope: &Slope, h: f64) -> Particles {
    let advance = |values: &[DVec3], rates: &[DVec3]| values.iter().zip(rates).map(|(value, rate)| value + rate * h).collect();
    Particles { positions: advance(&from.positions, &slope.velocities), velocities: advance(&from.velocities, &slope.accelerations) }
}

/// Baraff & Witkin's step (equation 6): (M − h ∂f/∂v − h² ∂f/∂x) Δv = h (f + h ∂f/∂x v), then x + h (v + Δv). The field's own change with the
/// place is not in the matrix: its direction turns within a voxel and would make it indefinite.
///
/// Compressed triangles can make the matrix indefinite; then the second derivatives that can do so are left out.
fn implicit_euler(from: &Particles, h: f64, dynamics: &Dynamics<'_>) -> Particles {
    let forces = dynamics.forces(from);
    let inertia = dynamics.mass * (1.0 + h * dynamics.drag_per_s);
    for curvature in [Curvature::Whole, Curvature::Convex] {
        let (stiffness, damping) = dynamics.internal.derivatives(from, dynamics.fixed, curvature);
        let ahead = stiffness.times(&from.velocities);
        let matrix = stiffness.combined(h * h, &damping, h, inertia);
        let right: Vec<DVec3> = forces.iter().zip(ahead).map(|(force, ahead)| (force - ahead * h) * h).collect();
        if let Ok(change) = solve(&matrix, &right, dynamics.fixed, IMPLICIT_TOLERANCE, IMPLICIT_ITERATIONS) {
            let velocities: Vec<DVec3> = from.velocities.iter().zip(change).map(|(velocity, change)| velocity + change).collect();
            let positions = from.positions.iter().zip(&velocities).map(|(position, velocity)| position + velocity * h).collect();
            return Particles { positions, velocities };
        }
    }
    // The convex matrix is positive definite but for rounding; without a solution the particles keep their course.
    let slope = Slope { velocities: from.velocities.clone(), accelerations: vec![DVec3::ZERO; forces.len()] };
    along(from, &slope, h)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        mesh::Mesh,
        pipeline::parameters::{DeformParameters, Model, Parameters, Stiffness},
    };

    const REST_MM: f64 = 5.0;

    /// A particle on a spring along x, the other end fixed, pulled out by 1 mm: ẍ = −k x − d ẋ.
    fn oscillator(solver: Solver, stiffness: Stiffness, steps: u32, end_s: f64) -> f64 {
        let internal = Internal::of_springs(2, &[([0, 1], REST_MM)], stiffness);
        let dynamics = Dynamics { internal: &internal, field: &|_| DVec3::ZERO, mass: 1.0, drag_per_s: 0.0, fixed: &[true, false] };
        let mut state = Particles { positions: vec![DVec3::ZERO, DVec3::X * (REST_MM + 1.0)], velocities: vec![DVec3::ZERO; 2] };
        for _ in 0..steps {
            state = step(solver, &state, end_s / f64::from(steps), &dynamics);
        }
        assert_eq!(state.positions[0], DVec3::ZERO, "a fixed particle stays");
        state.positions[1].x - REST_MM
    }

    /// Distance at t = 4 from the closed form of ẍ = −x − ẋ/5.
    fn error(solver: Solver, steps: u32) -> f64 {
        let (damping, end): (f64, f64) = (0.2, 4.0);
        let omega = (1.0 - damping * damping / 4.0).sqrt();
        let exact = (-damping / 2.0 * end).exp() * ((omega * end).cos() + damping / (2.0 * omega) * (omega * end).sin());
        (oscillator(solver, Stiffness { k: 1.0, kd: damping }, steps, end) - exact).abs()
    }

    #[test]
    fn every_method_has_its_order() {
        for (solver, expected, steps) in
            [(Solver::Euler, 1.0, 4000), (Solver::Midpoint, 2.0, 400), (Solver::Rk4, 4.0, 40), (Solver::ImplicitEuler, 1.0, 4000)]
        {
            let order = (error(solver, steps) / error(solver, 2 * steps)).log2();
            assert!((order - expected).abs() < 0.1, "{solver:?}: {order}");
        }
    }

    /// The internal force left of a wrinkled ellipsoid of the plane model after 4 s, as part of that at the start.
    fn left_over(solver: Solver, time_step_s: f64) -> f64 {
        let rest = Mesh::icosphere(2).map(|unit| unit * DVec3::new(36.0, 36.0, 48.0));
        // Ten times the paper's K with its own damping.
        let stiff = |k| Stiffness { k: 10.0 * k, kd: k / 10.0 };
        let paper = Parameters::paper().deform;
        let deform = DeformParameters { model: Model::Plane, stretch: stiff(10.0), shear: stiff(1.0), bend: stiff(10.0), ..paper };
        let internal = Internal::new(&deform, &rest);
        let fixed = vec![false; rest.positions.len()];
        let dynamics = Dynamics { internal: &internal, field: &|_| DVec3::ZERO, mass: 1.0, drag_per_s: 0.0, fixed: &fixed };
        let wrinkled = |p: DVec3| p + DVec3::new((3.1 * p.x).sin(), (2.3 * p.y + 1.0).sin(), (1.7 * p.z).cos());
        let mut state = Particles { positions: rest.map(wrinkled).positions, velocities: vec![DVec3::ZERO; fixed.len()] };
        let force = |state: &Particles| internal.forces(state, &fixed, |_| DVec3::ZERO).iter().map(|force| force.length()).sum::<f64>();
        let before = force(&state);
        for _ in 0..(4.0 / time_step_s).round() as usize {
            state = step(solver, &state, time_step_s, &dynamics);
        }
        force(&state) / before
    }

    #[test]
    fn implicit_euler_is_stable_at_the_paper_s_step_where_explicit_euler_diverges() {
        let explicit = left_over(Solver::Euler, 0.05);
        assert!(!explicit.is_finite() || explicit > 1e3, "{explicit}");
        let implicit = left_over(Solver::ImplicitEuler, 0.05);
        assert!(implicit < 0.05, "{implicit}");
    }

    #[test]
    fn drag_takes_the_stated_part_of_the_velocity_a_second() {
        let internal = Internal::default();
        let dynamics = Dynamics { internal: &internal, field: &|_| DVec3::ZERO, mass: 3.0, drag_per_s: -(0.75_f64).ln(), fixed: &[false] };
        let mut state = Particles { positions: vec![DVec3::ZERO], velocities: vec![DVec3::X] };
        for _ in 0..100 {
            state = step(Solver::Rk4, &state, 0.01, &dynamics);
        }
        assert!((state.velocities[0].x - 0.75).abs() < 1e-9, "{}", state.velocities[0].x);
    }
}
