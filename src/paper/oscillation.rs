//! The distances behind figure 5 (§7.1): particles about the border over time, without and with freezing.

use super::{PaperError, experiment::Experiment};
use crate::{
    drawing::markdown::{Table, signed},
    pipeline::{Surface, borders::Border, deform::Moment, parameters::Parameters, trace::outside_mm},
};

/// Simulated time that is followed, in s.
pub const FOLLOWED_S: f64 = 20.0;
/// Particles that are followed: corners of the icosahedron that see the phantom from different sides, the others being their mirror images.
pub const PARTICLES: [usize; 5] = [0, 4, 6, 8, 9];
/// Between two rows of the table, in s.
const ROW_S: f64 = 1.0;

/// Distances while a mesh moves, a sample a step: of the followed particles with their sign, and the mean of all without.
#[derive(Debug, Clone, Default)]
pub struct Course {
    /// Simulated time in s.
    pub time_s: Vec<f64>,
    /// Distance of each of [`PARTICLES`] to the border in mm, positive outside.
    pub particles_mm: [Vec<f64>; PARTICLES.len()],
    /// Mean distance of all particles without sign, in mm.
    pub mean_mm: Vec<f64>,
}

/// The free model on the outer surface of the paper's phantom, from an ellipsoid of the printed area: without freezing and with it.
///
/// Errors: what cannot be simulated or reconstructed.
pub fn measure() -> Result<[Course; 2], PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let surface = Surface::Epicardial;
    let mut parameters = Parameters::paper();
    parameters.deform.smoothing = false;
    // Nothing but the time ends the evolution, and half the paper's step shows the turns.
    parameters.deform.time_step_s = 0.05;
    parameters.deform.rest_voxels = 0.0;
    parameters.deform.max_steps = (FOLLOWED_S / parameters.deform.time_step_s).ceil() as usize;
    let flow = experiment.flow(surface, &parameters)?;
    let seed = experiment.seed_of_printed_area(surface, parameters.mesh.level);
    let mut courses = [Course::default(), Course::default()];
    for (course, freezing) in courses.iter_mut().zip([false, true]) {
        parameters.deform.freezing = freezing;
        experiment.run_from(seed.clone(), surface, &flow, &parameters, &mut |moment| {
            course.take(moment, experiment.border(surface), parameters.deform.time_step_s);
        })?;
        course.hold();
    }
    Ok(courses)
}

/// A table for each course, a row a second.
pub fn markdown([swinging, frozen]: &[Course; 2]) -> String {
    let table = |course: &Course| {
        let heads = PARTICLES.map(|vertex| format!("particle {vertex}"));
        let [a, b, c, d, e] = heads.each_ref().map(String::as_str);
        let mut table = Table::new(["time (s)", a, b, c, d, e, "mean of all 642, without sign"]);
        for row in 0..=(FOLLOWED_S / ROW_S) as u32 {
            let time_s = f64::from(row) * ROW_S;
            let particles = course.particles_mm.iter().map(|values| signed(course.at(values, time_s), 1));
            table.row([time_s.to_string()].into_iter().chain(particles).chain([format!("{:.1}", course.at(&course.mean_mm, time_s))]));
        }
        table
    };
    let unit = "distance to the border in mm, positive outside";
    format!("Without freezing, {unit}:\n\n{}\nFrozen on the first border voxel, {unit}:\n\n{}", table(swinging), table(frozen))
}

impl Course {
    fn take(&mut self, moment: &Moment<'_>, border: &Border, time_step_s: f64) {
        let middle = border.middle_mm();
        self.time_s.push(moment.steps as f64 * time_step_s);
        for (values, vertex) in self.particles_mm.iter_mut().zip(PARTICLES) {
            values.push(outside_mm(moment.positions[vertex], border, middle));
        }
        let total: f64 = moment.positions.iter().map(|&position| outside_mm(position, border, middle).abs()).sum();
        self.mean_mm.push(total / moment.positions.len() as f64);
    }

    /// The value at a time.
    fn at(&self, values: &[f64], time_s: f64) -> f64 {
        let sample = self.time_s.iter().rposition(|sample_s| *sample_s <= time_s + 1e-9);
        sample.and_then(|sample| values.get(sample)).copied().unwrap_or(f64::NAN)
    }

    /// Carries the last values to the end of what is drawn: a frozen mesh stays.
    fn hold(&mut self) {
        self.time_s.push(FOLLOWED_S);
        for values in self.particles_mm.iter_mut().chain([&mut self.mean_mm]) {
            values.push(values.last().copied().unwrap_or(f64::NAN));
        }
    }
}
