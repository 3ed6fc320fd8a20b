//! Figure 10 (§7.5): a reconstruction from the ellipsoid to the surface.

use super::{
    super::{PaperError, experiment::Experiment},
    FROZEN, MOVING,
    render::{COARSE_LEVELS, Camera, Canvas},
    view,
};
use crate::{
    drawing::svg::{Anchor, FAINT, INK, Sheet, hex},
    mesh::Mesh,
    phantom::Phantom,
    pipeline::{Surface, deform::Moment, parameters::Parameters},
};
use glam::DVec3;
use std::sync::Arc;

/// The stages: the first step at which this part of the particles is frozen.
const STAGES: [f64; 4] = [0.0, 0.2, 0.6, 0.9];
/// Pixels along each side of a rendered panel, and on the sheet.
const PANEL: (usize, f64) = (208, 144.0);

/// The mesh at a step.
struct Stage {
    steps: usize,
    mesh: Mesh,
    frozen: Vec<bool>,
}

/// The first gate of the simulated normal ventricle with the parameters of §7.5, both surfaces.
pub(super) fn draw() -> Result<String, PaperError> {
    let parameters = Parameters::paper();
    let experiment = Experiment::new(&Phantom::normal(), 0, &parameters)?;
    let (pixels, side) = PANEL;
    let mut sheet = Sheet::new(900.0, 430.0);
    sheet.text((450.0, 24.0), 16.0, Anchor::Middle, INK, "From the bounding ellipsoid to the surface");
    for (row, surface) in [Surface::Epicardial, Surface::Endocardial].into_iter().enumerate() {
        let stages = stages(&experiment, surface, &parameters)?;
        let border = &experiment.border(surface).points;
        let (low, high) =
            stages[0].mesh.positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &at| (low.min(at), high.max(at)));
        let camera = view((low + high) / 2.0, 1.28 * (high - low).max_element() / pixels as f64);
        let y = 66.0 + (side + 34.0) * row as f64;
        let name = if surface == Surface::Epicardial { "external" } else { "internal" };
        sheet.upright_text((20.0, y + side / 2.0), 13.0, name);
        for (column, stage) in stages.iter().enumerate() {
            let x = 30.0 + side * column as f64;
            sheet.picture((x, y), (side, side), &painted(stage, camera).picture(COARSE_LEVELS).png()?, false);
            let seconds = stage.steps as f64 * parameters.deform.time_step_s;
            let share = 100.0 * stage.frozen.iter().filter(|&&frozen| frozen).count() as f64 / stage.frozen.len() as f64;
            let caption =
                if column + 1 == stages.len() { "end, smoothed".to_owned() } else { format!("{seconds:.1} s, {share:.0} % frozen") };
            sheet.text((x + side / 2.0, y + side + 14.0), 12.0, Anchor::Middle, FAINT, &caption);
        }
        if let Some(last) = stages.last() {
            let mut canvas = painted(last, camera);
            for point in border {
                canvas.cuboid(experiment.grid().position_mm(point.voxel), DVec3::splat(0.8), [0.05; 3]);
            }
            let x = 30.0 + side * stages.len() as f64;
            sheet.picture((x, y), (side, side), &canvas.picture(COARSE_LEVELS).png()?, false);
            sheet.text((x + side / 2.0, y + side + 14.0), 12.0, Anchor::Middle, FAINT, "with the border voxels");
        }
    }
    for (x, colour, name) in [(330.0, MOVING, "still moving"), (470.0, FROZEN, "frozen on the border"), (660.0, [0.05; 3], "border voxels")]
    {
        sheet.rectangle((x, 40.0), (12.0, 12.0), &hex(colour));
        sheet.text((x + 18.0, 51.0), 13.0, Anchor::Start, INK, name);
    }
    Ok(sheet.finish())
}

/// The stages and the finished surface.
fn stages(experiment: &Experiment, surface: Surface, parameters: &Parameters) -> Result<Vec<Stage>, PaperError> {
    let flow = experiment.flow(surface, parameters)?;
    let triangles = experiment.seed(surface, parameters.mesh.level).triangles;
    let mut stages: Vec<Stage> = Vec::new();
    let mut frozen = Vec::new();
    let run = experiment.run(surface, &flow, parameters, &mut |moment: &Moment<'_>| {
        let share = moment.frozen.iter().filter(|&&frozen| frozen).count() as f64 / moment.frozen.len() as f64;
        if STAGES.get(stages.len()).is_some_and(|&least| share >= least) {
            let mesh = Mesh { positions: moment.positions.to_vec(), triangles: Arc::clone(&triangles) };
            stages.push(Stage { steps: moment.steps, mesh, frozen: moment.frozen.to_vec() });
        }
        frozen.clear();
        frozen.extend_from_slice(moment.frozen);
    })?;
    stages.push(Stage { steps: run.evolved.steps, mesh: run.evolved.mesh, frozen });
    Ok(stages)
}

fn painted(stage: &Stage, camera: Camera) -> Canvas {
    let (pixels, _) = PANEL;
    let mut canvas = Canvas::new(camera, pixels, pixels);
    canvas.mesh(&stage.mesh, |vertex| if stage.frozen[vertex] { FROZEN } else { MOVING });
    canvas.edges(&stage.mesh, [0.25; 3]);
    canvas
}
