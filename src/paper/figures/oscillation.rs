//! Figure 5 (§7.1): the distance of particles to the border over time, without and with freezing.

use super::{
    super::{PaperError, experiment::Experiment},
    chart::Chart,
    svg::{Anchor, FAINT, INK, Sheet},
};
use crate::pipeline::{
    Surface,
    borders::Border,
    deform::Moment,
    parameters::Parameters,
    trace::{middle_mm, outside_mm},
};

/// Simulated time that is drawn, in s.
const SHOWN_S: f64 = 20.0;
/// Distances that are drawn, in mm.
const SHOWN_MM: (f64, f64) = (-30.0, 30.0);
/// Particles that are drawn, with their colours (Okabe and Ito's, which the colour-blind tell apart): corners of the icosahedron that see the
/// phantom from different sides, the others being their mirror images.
const PARTICLES: [(usize, &str); 5] = [(0, "#0072b2"), (4, "#d55e00"), (6, "#009e73"), (8, "#cc79a7"), (9, "#e69f00")];

/// Distances while a mesh moves: of the drawn particles with their sign, and the mean of all without.
#[derive(Default)]
struct Course {
    time_s: Vec<f64>,
    particles_mm: [Vec<f64>; PARTICLES.len()],
    mean_mm: Vec<f64>,
}

/// The free model on the outer surface of the paper's phantom, from an ellipsoid of the printed area, for as long as is drawn.
pub(super) fn draw() -> Result<String, PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let surface = Surface::Epicardial;
    let mut parameters = Parameters::paper();
    parameters.deform.smoothing = false;
    // Nothing but the time ends the evolution, and half the paper's step shows the turns.
    parameters.deform.time_step_s = 0.05;
    parameters.deform.rest_voxels = f64::NEG_INFINITY;
    parameters.deform.max_steps = (SHOWN_S / parameters.deform.time_step_s).ceil() as usize;
    let flow = experiment.flow(surface, &parameters)?;
    let seed = experiment.seed_of_printed_area(surface, parameters.mesh.level);
    let mut sheet = Sheet::new(900.0, 440.0);
    sheet.text((450.0, 26.0), 16.0, Anchor::Middle, INK, "Distance of particles to the border of the outer surface");
    for (panel, freezing) in [false, true].into_iter().enumerate() {
        parameters.deform.freezing = freezing;
        let mut course = Course::default();
        experiment.run_from(seed.clone(), surface, &flow, &parameters, &mut |moment| {
            course.take(moment, experiment.border(surface), parameters.deform.time_step_s);
        })?;
        course.hold();
        let title = if freezing { "frozen on the first border voxel" } else { "without freezing" };
        let chart = Chart {
            corner: (75.0 + 415.0 * panel as f64, 70.0),
            size: (385.0, 280.0),
            across: (0.0, SHOWN_S),
            upwards: SHOWN_MM,
            title: title.to_owned(),
            across_label: "simulated time (s)",
            upwards_label: (panel == 0).then_some("distance to the border (mm), positive outside"),
        };
        chart.axes(&mut sheet);
        chart.level(&mut sheet, 0.0, "border");
        let curve = |values: &[f64]| course.time_s.iter().copied().zip(values.iter().copied()).collect::<Vec<_>>();
        for ((_, colour), values) in PARTICLES.iter().zip(&course.particles_mm) {
            chart.curve(&mut sheet, curve(values), colour, 1.5);
        }
        chart.curve(&mut sheet, curve(&course.mean_mm), INK, 2.6);
    }
    legend(&mut sheet);
    Ok(sheet.finish())
}

impl Course {
    fn take(&mut self, moment: &Moment<'_>, border: &Border, time_step_s: f64) {
        let middle = middle_mm(border);
        self.time_s.push(moment.steps as f64 * time_step_s);
        for (values, (vertex, _)) in self.particles_mm.iter_mut().zip(PARTICLES) {
            values.push(outside_mm(moment.positions[vertex], border, middle));
        }
        let total: f64 = moment.positions.iter().map(|&position| outside_mm(position, border, middle).abs()).sum();
        self.mean_mm.push(total / moment.positions.len() as f64);
    }

    /// Carries the last values to the end of what is drawn: a frozen mesh stays.
    fn hold(&mut self) {
        self.time_s.push(SHOWN_S);
        for values in self.particles_mm.iter_mut().chain([&mut self.mean_mm]) {
            values.push(values.last().copied().unwrap_or(f64::NAN));
        }
    }
}

fn legend(sheet: &mut Sheet) {
    let y = 416.0;
    for (index, (_, colour)) in PARTICLES.iter().enumerate() {
        let x = 150.0 + 22.0 * index as f64;
        sheet.line(&[(x, y - 4.0), (x + 18.0, y - 4.0)], colour, 2.0);
    }
    sheet.text((268.0, y), 13.0, Anchor::Start, INK, "single particles");
    sheet.line(&[(400.0, y - 4.0), (430.0, y - 4.0)], INK, 2.6);
    sheet.text((438.0, y), 13.0, Anchor::Start, INK, "mean of all 642, without sign");
    sheet.text((890.0, 434.0), 10.0, Anchor::End, FAINT, "free model, RK4, Δt 0.05 s, damping 1 %, not smoothed");
}
