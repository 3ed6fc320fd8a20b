//! Pictures of the stored surfaces at both ends of the cycle: the cavity inside the translucent outer surface.

use crate::{
    archive::ArchiveError,
    drawing::scene::{self, Body, Point, View},
    export::stored::{StoredCycle, StoredSurface},
    pipeline::Surface,
    report::Report,
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use std::fmt::Write as _;

/// Pixels along a side of a picture: at the page's size 220 an inch.
const PIXELS: usize = 264;
/// Room around the surfaces.
const MARGIN: f64 = 1.04;
/// As in the stored glTF, brighter since the light here is.
const COLOURS: [[f32; 3]; 2] = [[0.80, 0.20, 0.17], [0.90, 0.76, 0.64]];

/// Two views at end diastole and, for a cycle, at end systole, all at one scale.
pub(super) fn pictures(report: &Report, glb: &[u8]) -> Result<String, ArchiveError> {
    let cycle = StoredCycle::open(glb)?;
    let gates: Vec<(usize, &str)> = report.function.as_ref().map_or_else(
        || vec![(1, "")],
        |function| vec![(function.end_diastolic_gate, "End diastole"), (function.end_systolic_gate, "End systole")],
    );
    let mut bodies = Vec::with_capacity(gates.len());
    for &(gate, _) in &gates {
        let body = |surface, colour| Ok::<_, ArchiveError>(body(cycle.surface(surface, gate)?, colour));
        bodies.push([body(Surface::Endocardial, COLOURS[0])?, body(Surface::Epicardial, COLOURS[1])?]);
    }
    let mut html = String::from("<div class=\"surfaces\">");
    for (name, to_viewer, up) in views(&cycle) {
        let view = View::around(&bodies[0][1].points, to_viewer, up, MARGIN);
        for ((gate, phase), [inside, around]) in gates.iter().zip(&bodies) {
            let picture = STANDARD.encode(scene::draw(inside, around, &view, PIXELS).png()?);
            let comma = if phase.is_empty() { "" } else { ", " };
            let _ = write!(
                html,
                "<figure><img alt=\"Surfaces of gate {gate}, {name}\" src=\"data:image/png;base64,{picture}\"><figcaption>{phase}{comma}{name}\
                 </figcaption></figure>"
            );
        }
    }
    html.push_str("</div>");
    Ok(html)
}

fn body(surface: StoredSurface, colour: [f32; 3]) -> Body {
    let StoredSurface { points, normals, triangles } = surface;
    Body { points, normals, triangles, colour }
}

/// Name, direction to the viewer and direction upwards of two views: the patient's front and left side; where it is not known how the heart lies in
/// the patient, its lateral wall and its apex, anterior up.
fn views(cycle: &StoredCycle<'_>) -> [(&'static str, Point, Point); 2] {
    let (left, head, front) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    match cycle.walls() {
        Some(walls) if !cycle.in_patient_frame() => {
            let opposite = |direction: [f64; 3]| direction.map(|part| -part);
            [("lateral wall", opposite(walls.septal), walls.anterior), ("from the apex", opposite(walls.base), walls.anterior)]
        }
        _ => [("from the front", front, head), ("from the left", left, head)],
    }
}
