//! From a fitted shape to the meshes that everything after the pipeline sees.

use super::{
    basis::Angle,
    shape::{Shape, Space, Volumes},
};
use crate::{
    mesh::Mesh,
    pipeline::{PerSurface, Surface},
};
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI};

/// Points along the wall its length is measured with, and angles about the axis.
const ALONG: usize = 24;
const AROUND: usize = 16;
/// Vertices nearer to the rim than this part of the mean edge are moved onto it: no two ends of an edge along the wall can be.
const RIM_PART: f64 = 0.42;
/// Rounds of matching the mesh's volume to the shape's; each gains two digits.
const ROUNDS: usize = 3;

/// How the vertices of a sphere are laid on a ventricle: the same for both surfaces and all gates, so that a vertex is the same piece of the
/// wall everywhere.
pub(super) struct Layout {
    sphere: Mesh,
    places: Vec<Vertex>,
}

impl Layout {
    /// For an icosphere of some level. Wall and lid get their shares of it by their lengths, the mean over surfaces and gates.
    pub(super) fn of(shapes: &[Shape], space: &Space, level: u32) -> Self {
        let sphere = Mesh::icosphere(level);
        let edge = (4.0 * PI / sphere.positions.len() as f64).sqrt();
        let (mut wall_mm, mut lid_mm) = (0.0, 0.0);
        for shape in shapes {
            for surface in Surface::BOTH {
                wall_mm += wall_length_mm(shape, space, surface);
                lid_mm += rim_mm(shape, space, surface);
            }
        }
        let rim = PI * wall_mm / (wall_mm + lid_mm);
        let places = sphere.positions.iter().map(|&direction| Vertex::at(direction, rim, RIM_PART * edge)).collect();
        Self { sphere, places }
    }
}

/// The surfaces of a shape, closed by a flat lid in the valve plane. Triangles cut corners off a round surface; vertices are moved outwards, by
/// about a tenth of a mm, until the mesh encloses the shape's own volume.
pub(super) fn meshes(shape: &Shape, space: &Space, layout: &Layout) -> PerSurface<Mesh> {
    let volumes = Volumes::of(shape, space);
    PerSurface::of(|surface| {
        let wanted = *volumes.ml.get(surface);
        let mut scale = 1.0;
        let mut mesh = layout.sphere.map(|position| position);
        for _ in 0..ROUNDS {
            mesh.positions = layout.places.iter().map(|vertex| vertex.place(shape, space, surface, scale)).collect();
            // In two of three directions the volume grows with the scale.
            scale *= (wanted / mesh.volume_ml().max(f64::MIN_POSITIVE)).clamp(0.8, 1.25).powf(0.45);
        }
        mesh
    })
}

/// Where a vertex of the sphere goes.
enum Vertex {
    /// On the wall at a part of the way from apex to rim.
    Wall { part: f64, angle: Angle },
    /// In the lid at a part of the rim's radius.
    Lid { part: f64, angle: Angle },
}

impl Vertex {
    fn at(direction: DVec3, rim: f64, near: f64) -> Self {
        let theta = (-direction.z).clamp(-1.0, 1.0).acos();
        let angle = Angle::new(direction.y.atan2(direction.x));
        if theta < rim + near {
            Self::Wall { part: if theta > rim - near { 1.0 } else { theta / rim }, angle }
        } else {
            Self::Lid { part: (PI - theta) / (PI - rim), angle }
        }
    }

    fn place(&self, shape: &Shape, space: &Space, surface: Surface, scale: f64) -> DVec3 {
        let frame = &space.frame;
        match self {
            Self::Wall { part, angle } => {
                // Parts of the way are parts of s, which is about even in length.
                let end = frame.s_of_height(shape.base_mm());
                let s = part * end;
                if s < FRAC_PI_2 {
                    return frame.point(s, angle, scale * shape.radii(&space.basis.at(s, angle)).get(surface));
                }
                let (r, height, _) = shape.in_cylinder(space, surface, (s - FRAC_PI_2) / (end - FRAC_PI_2), angle);
                frame.point_at_height(height, angle, scale * r)
            }
            Self::Lid { part, angle } => {
                let r = part * shape.in_cylinder(space, surface, 1.0, angle).0;
                frame.point_at_height(shape.base_mm() + shape.base_slope(angle) * r, angle, scale * r)
            }
        }
    }
}

fn wall_length_mm(shape: &Shape, space: &Space, surface: Surface) -> f64 {
    let ring = |part: f64| -> Vec<DVec3> {
        Angle::around(AROUND).map(|angle| Vertex::Wall { part, angle }.place(shape, space, surface, 1.0)).collect()
    };
    let mut total = 0.0;
    let mut before = ring(0.0);
    for i in 1..=ALONG {
        let here = ring(i as f64 / ALONG as f64);
        total += here.iter().zip(&before).map(|(a, b)| a.distance(*b)).sum::<f64>();
        before = here;
    }
    total / AROUND as f64
}

fn rim_mm(shape: &Shape, space: &Space, surface: Surface) -> f64 {
    Angle::around(AROUND).map(|angle| shape.in_cylinder(space, surface, 1.0, &angle).0).sum::<f64>() / AROUND as f64
}
