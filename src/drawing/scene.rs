//! Shaded pictures of closed surfaces, by a depth buffer: an opaque one, and a translucent one around it.

use super::raster::Picture;
use glam::DVec3;
use std::ops::Range;

/// A point or direction `[x, y, z]`.
pub type Point = [f64; 3];

/// A surface: corners, their outward normals, triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Corners.
    pub points: Vec<DVec3>,
    /// Unit normals, one a corner.
    pub normals: Vec<DVec3>,
    /// Indices of corners, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Colour.
    pub colour: [f32; 3],
}

/// From where a scene is looked at, without perspective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Unit vector to the viewer.
    pub to_viewer: DVec3,
    /// Unit vector upwards in the picture, across `to_viewer`.
    pub up: DVec3,
    /// The point in the middle of the picture.
    pub centre: DVec3,
    /// From the middle to the upper edge, in the scene's units.
    pub reach: f64,
}

impl View {
    /// A view of all these points, with some room around them.
    pub fn around(points: &[DVec3], to_viewer: Point, up: Point, room: f64) -> Self {
        let (to_viewer, up) = (DVec3::from_array(to_viewer).normalize_or(DVec3::Z), DVec3::from_array(up));
        let up = (up - to_viewer * up.dot(to_viewer)).normalize_or(to_viewer.any_orthonormal_vector());
        let right = up.cross(to_viewer);
        let span = |axis: DVec3| {
            let along = points.iter().map(|point| point.dot(axis));
            along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
        };
        let (across, upwards) = (span(right), span(up));
        let middle = |(low, high): (f64, f64)| f64::midpoint(low, high);
        let reach = room * (across.1 - across.0).max(upwards.1 - upwards.0) / 2.0;
        Self { to_viewer, up, centre: right * middle(across) + up * middle(upwards), reach }
    }
}

/// Samples a pixel along each side.
const SAMPLES: usize = 2;
/// Rows of pixels that are drawn at once: what is nearest at each sample is then a few hundred kilobytes, and stays in the cache.
const BAND: usize = 16;
/// Background.
const GROUND: [f32; 3] = [1.0, 1.0, 1.0];

/// What is nearest at a sample.
#[derive(Clone, Copy)]
struct Hit {
    depth: f64,
    normal: DVec3,
}

/// A square picture of so many pixels: `inside` opaque, `around` translucent, denser where it is seen edgewise, as a glass is.
pub fn draw(inside: &Body, around: &Body, view: &View, pixels: usize) -> Picture {
    let side = pixels * SAMPLES;
    let (placed_inside, placed_around) = (placed(inside, view, side), placed(around, view, side));
    let mut picture = Picture::of_colour(pixels, pixels, GROUND);
    let (mut opaque, mut glass) = (Vec::new(), Vec::new());
    for y in 0..pixels {
        if y % BAND == 0 {
            let rows = y * SAMPLES..(y + BAND).min(pixels) * SAMPLES;
            hit(&mut opaque, inside, &placed_inside, view, side, &rows);
            hit(&mut glass, around, &placed_around, view, side, &rows);
        }
        for x in 0..pixels {
            let mut sum = [0.0_f32; 3];
            for sample in 0..SAMPLES * SAMPLES {
                let at = (y % BAND * SAMPLES + sample / SAMPLES) * side + x * SAMPLES + sample % SAMPLES;
                let mut colour = opaque[at].map_or(GROUND, |hit| shade(inside.colour, hit.normal, view));
                if let Some(front) = glass[at] {
                    let facing = front.normal.dot(view.to_viewer).clamp(0.0, 1.0);
                    let dense = (0.28 + 0.55 * (1.0 - facing).powi(2)) as f32;
                    // What of the inside stands out of the glass (it should not) is before it.
                    let covered = opaque[at].is_none_or(|hit| hit.depth <= front.depth);
                    if covered {
                        let over = shade(around.colour, front.normal, view);
                        for (below, over) in colour.iter_mut().zip(over) {
                            *below = *below * (1.0 - dense) + over * dense;
                        }
                    }
                }
                for (sum, part) in sum.iter_mut().zip(colour) {
                    *sum += part / (SAMPLES * SAMPLES) as f32;
                }
            }
            picture.set(x, y, sum);
        }
    }
    picture
}

/// Diffuse light from the upper left of the viewer, a little from everywhere, and a soft highlight.
fn shade(colour: [f32; 3], normal: DVec3, view: &View) -> [f32; 3] {
    let right = view.up.cross(view.to_viewer);
    let light = (view.to_viewer + 0.55 * view.up - 0.45 * right).normalize();
    let diffuse = normal.dot(light).max(0.0);
    let half = (light + view.to_viewer).normalize();
    let highlight = 0.18 * normal.dot(half).max(0.0).powi(24);
    colour.map(|part| (f64::from(part) * (0.36 + 0.68 * diffuse) + highlight).min(1.0) as f32)
}

/// The corners of a body in a square picture of so many samples along a side: right, down, to the viewer.
fn placed(body: &Body, view: &View, side: usize) -> Vec<DVec3> {
    let right = view.up.cross(view.to_viewer);
    let scale = side as f64 / (2.0 * view.reach);
    let project = |point: DVec3| {
        let from = point - view.centre;
        DVec3::new(side as f64 / 2.0 + from.dot(right) * scale, side as f64 / 2.0 - from.dot(view.up) * scale, from.dot(view.to_viewer))
    };
    body.points.iter().copied().map(project).collect()
}

/// Finds the front of a body, whose corners are placed so, at every sample of some rows.
fn hit(hits: &mut Vec<Option<Hit>>, body: &Body, placed: &[DVec3], view: &View, side: usize, rows: &Range<usize>) {
    hits.clear();
    hits.resize(rows.len() * side, None);
    for triangle in &body.triangles {
        let [a, b, c] = triangle.map(|corner| corner as usize);
        let (Some(&pa), Some(&pb), Some(&pc)) = (placed.get(a), placed.get(b), placed.get(c)) else { continue };
        // y downwards turns what faces the viewer clockwise.
        let area = (pb.x - pa.x) * (pc.y - pa.y) - (pb.y - pa.y) * (pc.x - pa.x);
        if area >= 0.0 {
            continue;
        }
        let span = |values: [f64; 3]| {
            let (low, high) = (values[0].min(values[1]).min(values[2]), values[0].max(values[1]).max(values[2]));
            (low.floor().max(0.0) as usize, (high.ceil().max(0.0) as usize).min(side))
        };
        let ((left, end), (top, bottom)) = (span([pa.x, pb.x, pc.x]), span([pa.y, pb.y, pc.y]));
        for y in top.max(rows.start)..bottom.min(rows.end) {
            for x in left..end {
                let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                let of_b = ((px - pa.x) * (pc.y - pa.y) - (py - pa.y) * (pc.x - pa.x)) / area;
                let of_c = ((pb.x - pa.x) * (py - pa.y) - (pb.y - pa.y) * (px - pa.x)) / area;
                let of_a = 1.0 - of_b - of_c;
                if of_a < 0.0 || of_b < 0.0 || of_c < 0.0 {
                    continue;
                }
                let depth = of_a * pa.z + of_b * pb.z + of_c * pc.z;
                let at = &mut hits[(y - rows.start) * side + x];
                if at.is_none_or(|hit| hit.depth < depth) {
                    let normal = body.normals[a] * of_a + body.normals[b] * of_b + body.normals[c] * of_c;
                    *at = Some(Hit { depth, normal: normal.normalize_or(view.to_viewer) });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An octahedron of this radius.
    fn body(radius: f64, colour: [f32; 3]) -> Body {
        let normals = vec![DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
        let triangles = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        Body { points: normals.iter().map(|normal| *normal * radius).collect(), normals, triangles, colour }
    }

    #[test]
    fn the_inside_is_seen_through_what_is_around_it() {
        let view = View { to_viewer: DVec3::Z, up: DVec3::Y, centre: DVec3::ZERO, reach: 1.25 };
        let picture = draw(&body(0.5, [0.9, 0.1, 0.1]), &body(1.0, [0.9, 0.8, 0.7]), &view, 50);
        let at = |x: usize, y: usize| [0, 1, 2].map(|part| i32::from(picture.rgb[3 * (y * 50 + x) + part]));
        let (middle, wall, ground) = (at(25, 25), at(25, 9), at(2, 2));
        assert!(middle[0] > middle[1] + 40, "red through the wall: {middle:?}");
        assert!(wall[0] < 252 && wall[0] - wall[1] < 40, "the wall alone: {wall:?}");
        assert_eq!(ground, [255; 3]);
        // Corners up and down, left and right, of a body as large as it is.
        assert!(at(25, 4) == [255; 3] && at(25, 6) != [255; 3] && at(4, 25) == [255; 3] && at(6, 25) != [255; 3]);
    }
}
