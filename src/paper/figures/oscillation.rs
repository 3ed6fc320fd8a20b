//! Figure 5 (§7.1): the distance of particles to the border over time, without and with freezing.

use super::{
    super::{PaperError, experiment::Experiment},
    chart::Chart,
    svg::{Anchor, FAINT, INK, Sheet},
};
use crate::pipeline::{Surface, parameters::Parameters, trace::Trace};

/// Simulated time that is drawn, in s.
const SHOWN_S: f64 = 12.0;
/// Distances that are drawn, in mm.
const SHOWN_MM: (f64, f64) = (-6.0, 14.0);
/// Particles that are drawn.
const PARTICLES: usize = 6;
/// Colours of the particles (Okabe and Ito's, which the colour-blind tell apart).
const COLOURS: [&str; PARTICLES] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];

/// The free model on the outer surface of the paper's phantom with the parameters of §7.5, not smoothed, for as long as is drawn.
pub(super) fn draw() -> Result<String, PaperError> {
    let experiment = Experiment::paper_phantom()?;
    let surface = Surface::Epicardial;
    let mut parameters = Parameters::paper();
    parameters.deform.smoothing = false;
    parameters.deform.record_distances = true;
    // Nothing but the time ends the evolution: a quarter of the paper's step shows the turns between the samples.
    parameters.deform.time_step_s = 0.025;
    parameters.deform.damping_percent = 1.0;
    parameters.deform.rest_voxels = 0.0;
    parameters.deform.max_steps = (SHOWN_S / parameters.deform.time_step_s).ceil() as usize;
    let flow = experiment.flow(surface, &parameters)?;
    let mut sheet = Sheet::new(900.0, 440.0);
    sheet.text((450.0, 26.0), 16.0, Anchor::Middle, INK, "Distance of six particles to the border of the outer surface");
    for (panel, freezing) in [false, true].into_iter().enumerate() {
        parameters.deform.freezing = freezing;
        let trace = experiment.run(surface, &flow, &parameters, &mut |_| ())?.evolved.trace;
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
        if let Some(trace) = &trace {
            curves(&mut sheet, &chart, trace);
        }
    }
    legend(&mut sheet);
    Ok(sheet.finish())
}

fn curves(sheet: &mut Sheet, chart: &Chart, trace: &Trace) {
    for (particle, colour) in trace.particles.iter().zip(COLOURS) {
        chart.curve(sheet, times(trace).zip(particle.distance_mm.iter().copied()), colour, 1.4);
    }
    chart.curve(sheet, times(trace).zip(trace.mean_mm.iter().copied()), INK, 2.6);
}

/// The times of the samples, and the end of what is drawn: a mesh that has come to rest stays.
fn times(trace: &Trace) -> impl Iterator<Item = f64> + '_ {
    trace.time_s.iter().copied()
}

fn legend(sheet: &mut Sheet) {
    let y = 418.0;
    for (index, colour) in COLOURS.into_iter().enumerate() {
        let x = 150.0 + 22.0 * index as f64;
        sheet.line(&[(x, y - 4.0), (x + 18.0, y - 4.0)], colour, 2.0);
    }
    sheet.text((290.0, y), 13.0, Anchor::Start, INK, "single particles");
    sheet.line(&[(430.0, y - 4.0), (460.0, y - 4.0)], INK, 2.6);
    sheet.text((468.0, y), 13.0, Anchor::Start, INK, "mean of all 642 (distance without sign)");
    sheet.text((890.0, 436.0), 10.0, Anchor::End, FAINT, "free model, RK4, Δt 0.025 s, not smoothed");
}
