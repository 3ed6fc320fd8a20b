//! Pictures of meshes: an orthographic z-buffer rasteriser with Gouraud shading, several samples a pixel.

use crate::drawing::raster::Picture;
use crate::mesh::Mesh;
use glam::{DVec2, DVec3};

/// Where a picture is taken from, without perspective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    right: DVec3,
    up: DVec3,
    /// Away from the viewer.
    forward: DVec3,
    centre_mm: DVec3,
    mm_per_pixel: f64,
}

impl Camera {
    /// Looks along a direction with `up` upwards; `centre_mm` is the middle of the picture.
    pub fn towards(forward: DVec3, up: DVec3, centre_mm: DVec3, mm_per_pixel: f64) -> Self {
        let forward = forward.normalize();
        let right = forward.cross(up).normalize();
        Self { right, up: right.cross(forward), forward, centre_mm, mm_per_pixel }
    }

    /// Right, up and away of a point from the middle of the picture, in mm.
    fn seen(&self, point_mm: DVec3) -> DVec3 {
        let offset = point_mm - self.centre_mm;
        DVec3::new(offset.dot(self.right), offset.dot(self.up), offset.dot(self.forward))
    }
}

/// A picture in the making.
#[derive(Debug, Clone)]
pub struct Canvas {
    camera: Camera,
    width: usize,
    height: usize,
    colour: Vec<[f32; 3]>,
    /// Distance from the plane through the camera's centre, away from the viewer, in mm.
    depth: Vec<f32>,
}

/// Samples a pixel along each side.
const SAMPLES: usize = 3;
/// The light comes from the upper left, over the viewer's shoulder: (right, up, towards the viewer), not normalised.
const LIGHT: DVec3 = DVec3::new(-0.45, 0.65, 0.8);
/// Part of the light that comes from everywhere.
const AMBIENT: f64 = 0.45;
/// Levels a colour channel of a finished picture; fewer compress better, and these are hardly seen.
pub const FINE_LEVELS: u8 = 63;
/// Levels for pictures with many edges, which hide the steps.
pub const COARSE_LEVELS: u8 = 31;

impl Canvas {
    /// An empty white picture of a size in pixels.
    pub fn new(camera: Camera, width: usize, height: usize) -> Self {
        let samples = width * height * SAMPLES * SAMPLES;
        Self {
            camera,
            width: width * SAMPLES,
            height: height * SAMPLES,
            colour: vec![[1.0; 3]; samples],
            depth: vec![f32::INFINITY; samples],
        }
    }

    /// Sample coordinates (right, down) and depth of a point in mm.
    fn project(&self, point_mm: DVec3) -> (DVec2, f64) {
        let seen = self.camera.seen(point_mm) / self.camera.mm_per_pixel * SAMPLES as f64;
        (DVec2::new(self.width as f64 / 2.0 + seen.x, self.height as f64 / 2.0 - seen.y), self.camera.seen(point_mm).z)
    }

    /// Paints a mesh with a colour a vertex, shaded by its vertex normals.
    pub fn mesh(&mut self, mesh: &Mesh, colour: impl Fn(usize) -> [f32; 3]) {
        let normals = mesh.normals();
        for triangle in mesh.triangles.iter() {
            let corners = triangle.map(|vertex| {
                let vertex = vertex as usize;
                (mesh.positions[vertex], self.shaded(normals[vertex], colour(vertex)))
            });
            self.triangle(corners);
        }
    }

    /// Paints the edges of a mesh as thin lines in front of its faces.
    pub fn edges(&mut self, mesh: &Mesh, colour: [f32; 3]) {
        /// The lines stand this far before the faces that they bound.
        const LIFT_MM: f64 = 0.6;
        let lift = self.camera.forward * LIFT_MM;
        for &[a, b, c] in mesh.triangles.iter() {
            for (from, to) in [(a, b), (b, c), (c, a)].into_iter().filter(|(from, to)| from < to) {
                self.segment(mesh.positions[from as usize] - lift, mesh.positions[to as usize] - lift, colour);
            }
        }
    }

    /// Paints a box with sides parallel to the grid, flat.
    pub fn cuboid(&mut self, centre_mm: DVec3, half_mm: DVec3, colour: [f32; 3]) {
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let mut normal = DVec3::ZERO;
                normal[axis] = side;
                if normal.dot(self.camera.forward) >= 0.0 {
                    continue;
                }
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let corner = |along_u: f64, along_v: f64| {
                    let mut offset = normal * half_mm[axis];
                    offset[u] = along_u * half_mm[u];
                    offset[v] = along_v * half_mm[v];
                    (centre_mm + offset, self.shaded(normal, colour))
                };
                let square = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
                self.triangle([square[0], square[1], square[2]]);
                self.triangle([square[0], square[2], square[3]]);
            }
        }
    }

    /// Paints a small ball.
    pub fn ball(&mut self, centre_mm: DVec3, radius_mm: f64, colour: [f32; 3]) {
        let (centre, depth) = self.project(centre_mm);
        let radius = radius_mm / self.camera.mm_per_pixel * SAMPLES as f64;
        let [columns, rows] = self.samples(centre - radius, centre + radius);
        for y in rows {
            for x in columns.clone() {
                let offset = (DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - centre) / radius;
                let towards = 1.0 - offset.length_squared();
                if towards >= 0.0 {
                    let towards = towards.sqrt();
                    let light = brightness(DVec3::new(offset.x, -offset.y, towards));
                    self.put(x, y, depth - towards * radius_mm, colour.map(|part| part * light as f32));
                }
            }
        }
    }

    fn shaded(&self, normal: DVec3, colour: [f32; 3]) -> [f32; 3] {
        let camera = &self.camera;
        let light = brightness(DVec3::new(normal.dot(camera.right), normal.dot(camera.up), -normal.dot(camera.forward)));
        colour.map(|part| part * light as f32)
    }

    /// The samples `[columns, rows]` between two corners.
    fn samples(&self, low: DVec2, high: DVec2) -> [std::ops::Range<usize>; 2] {
        let range = |low: f64, high: f64, most: usize| low.floor().max(0.0) as usize..(high.ceil().max(0.0) as usize).min(most);
        [range(low.x, high.x, self.width), range(low.y, high.y, self.height)]
    }

    fn put(&mut self, x: usize, y: usize, depth: f64, colour: [f32; 3]) {
        let at = y * self.width + x;
        if (depth as f32) < self.depth[at] {
            self.depth[at] = depth as f32;
            self.colour[at] = colour;
        }
    }

    fn triangle(&mut self, corners: [(DVec3, [f32; 3]); 3]) {
        let [(a, near_a), (b, near_b), (c, near_c)] = corners.map(|(point, _)| self.project(point));
        let area = (b - a).perp_dot(c - a);
        if area.abs() < 1e-12 {
            return;
        }
        let [columns, rows] = self.samples(a.min(b).min(c), a.max(b).max(c));
        for y in rows {
            for x in columns.clone() {
                let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let weights = [(c - b).perp_dot(at - b) / area, (a - c).perp_dot(at - c) / area, (b - a).perp_dot(at - a) / area];
                if weights.iter().any(|&weight| weight < 0.0) {
                    continue;
                }
                let colour = std::array::from_fn(|part| (0..3).map(|corner| weights[corner] as f32 * corners[corner].1[part]).sum());
                self.put(x, y, weights[0] * near_a + weights[1] * near_b + weights[2] * near_c, colour);
            }
        }
    }

    fn segment(&mut self, from_mm: DVec3, to_mm: DVec3, colour: [f32; 3]) {
        let ((from, near), (to, far)) = (self.project(from_mm), self.project(to_mm));
        let steps = (2.0 * from.distance(to)).ceil().max(1.0) as u32;
        for step in 0..=steps {
            let part = f64::from(step) / f64::from(steps);
            let at = from.lerp(to, part);
            if at.x >= 0.0 && at.y >= 0.0 && (at.x as usize) < self.width && (at.y as usize) < self.height {
                self.put(at.x as usize, at.y as usize, near + part * (far - near), colour);
            }
        }
    }

    /// The finished picture: the mean of every pixel's samples, in so many levels a channel.
    pub fn picture(&self, levels: u8) -> Picture {
        let levels = f32::from(levels);
        let (width, height) = (self.width / SAMPLES, self.height / SAMPLES);
        let mut picture = Picture::of_colour(width, height, [1.0; 3]);
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0_f32; 3];
                for sample in 0..SAMPLES * SAMPLES {
                    let at = (y * SAMPLES + sample / SAMPLES) * self.width + x * SAMPLES + sample % SAMPLES;
                    for (sum, part) in sum.iter_mut().zip(self.colour[at]) {
                        *sum += part;
                    }
                }
                picture.set(x, y, sum.map(|sum| (sum / (SAMPLES * SAMPLES) as f32 * levels).round() / levels));
            }
        }
        picture
    }
}

/// How bright a face with a normal (right, up, towards the viewer) is, 0-1.
fn brightness(normal: DVec3) -> f64 {
    AMBIENT + (1.0 - AMBIENT) * normal.dot(LIGHT.normalize()).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(picture: &Picture, x: usize, y: usize) -> [u8; 3] {
        let at = 3 * (y * picture.width + x);
        [picture.rgb[at], picture.rgb[at + 1], picture.rgb[at + 2]]
    }

    fn camera() -> Camera {
        Camera::towards(DVec3::Y, DVec3::Z, DVec3::new(50.0, 50.0, 50.0), 1.0)
    }

    #[test]
    fn a_ball_fills_its_circle_and_is_lit_from_the_upper_left() {
        let drawn = |colour: f32| {
            let mut canvas = Canvas::new(camera(), 100, 100);
            canvas.mesh(&Mesh::icosphere(4).map(|unit| DVec3::splat(50.0) + unit * 30.0), |_| [colour; 3]);
            canvas.picture(FINE_LEVELS)
        };
        // A black ball on white: what is missing of the white is the part of a pixel that is covered.
        let black = drawn(0.0);
        let covered: f64 = (0..100 * 100).map(|at| 1.0 - f64::from(pixel(&black, at % 100, at / 100)[0]) / 255.0).sum();
        let exact = std::f64::consts::PI * 30.0_f64.powi(2);
        assert!((covered / exact - 1.0).abs() < 0.01, "{covered} of {exact}");
        let white = drawn(1.0);
        assert!(pixel(&white, 40, 35)[0] > pixel(&white, 65, 70)[0]);
    }

    #[test]
    fn what_is_nearer_hides_what_is_behind_whatever_came_first() {
        let (near, far) = (DVec3::new(50.0, 20.0, 50.0), DVec3::new(50.0, 80.0, 50.0));
        for order in [[(near, [1.0, 0.0, 0.0]), (far, [0.0, 0.0, 1.0])], [(far, [0.0, 0.0, 1.0]), (near, [1.0, 0.0, 0.0])]] {
            let mut canvas = Canvas::new(camera(), 100, 100);
            for (centre, colour) in order {
                canvas.cuboid(centre, DVec3::splat(10.0), colour);
            }
            let [r, _, b] = pixel(&canvas.picture(FINE_LEVELS), 50, 50);
            assert!(r > 50 && b == 0, "{r} {b}");
        }
    }
}
