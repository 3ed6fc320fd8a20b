//! Time integration of particles, ẋ = v, v̇ = a(x, v) (paper §3, figure 3).

use super::parameters::Solver;
use glam::DVec3;

/// Positions in mm and velocities in mm/s.
#[derive(Debug, Clone, PartialEq)]
pub struct Particles {
    /// Positions in mm.
    pub positions: Vec<DVec3>,
    /// Velocities in mm/s.
    pub velocities: Vec<DVec3>,
}

/// One step of `time_step_s`; `acceleration` maps all positions and velocities to all accelerations in mm/s².
pub fn step(solver: Solver, from: &Particles, time_step_s: f64, acceleration: impl Fn(&Particles) -> Vec<DVec3>) -> Particles {
    match solver {
        Solver::Euler | Solver::Midpoint | Solver::ImplicitEuler | Solver::Rk4 => rk4(from, time_step_s, acceleration),
    }
}

/// The rate of change of a state.
struct Slope {
    velocities: Vec<DVec3>,
    accelerations: Vec<DVec3>,
}

fn rk4(from: &Particles, h: f64, acceleration: impl Fn(&Particles) -> Vec<DVec3>) -> Particles {
    let slope = |at: &Particles| Slope { velocities: at.velocities.clone(), accelerations: acceleration(at) };
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The damped oscillator ẍ = −x − ẋ/5 from x = 1 at rest, at t = 4, against its closed form.
    fn error(solver: Solver, steps: u32) -> f64 {
        let (damping, end): (f64, f64) = (0.2, 4.0);
        let mut state = Particles { positions: vec![DVec3::X], velocities: vec![DVec3::ZERO] };
        for _ in 0..steps {
            state = step(solver, &state, end / f64::from(steps), |at| vec![-at.positions[0] - damping * at.velocities[0]]);
        }
        let omega = (1.0 - damping * damping / 4.0).sqrt();
        let exact = (-damping / 2.0 * end).exp() * ((omega * end).cos() + damping / (2.0 * omega) * (omega * end).sin());
        (state.positions[0].x - exact).abs()
    }

    #[test]
    fn runge_kutta_is_of_fourth_order() {
        let order = (error(Solver::Rk4, 40) / error(Solver::Rk4, 80)).log2();
        assert!((order - 4.0).abs() < 0.2, "{order}");
    }
}
