//! Planes laid through a study: the counts on them, and where they cut the surfaces.

use crate::{
    mesh::Mesh,
    pipeline::{Reconstruction, Surface},
    study::Study,
    volume::{Volume, sample_scalar},
};
use glam::DVec3;
use std::collections::BTreeMap;

/// A rectangle of square or oblong pixels in the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Middle of the first pixel in grid mm.
    pub origin_mm: DVec3,
    /// Unit vector along rows of pixels.
    pub right: DVec3,
    /// Unit vector from row to row.
    pub down: DVec3,
    /// Size of a pixel along `right` and `down` in mm.
    pub pixel_mm: [f64; 2],
    /// Pixels along `right`.
    pub width: usize,
    /// Pixels along `down`.
    pub height: usize,
}

impl Plane {
    /// The same rectangle elsewhere.
    #[must_use]
    pub fn moved(self, by_mm: DVec3) -> Self {
        Self { origin_mm: self.origin_mm + by_mm, ..self }
    }

    /// A point of the plane, in pixels from the middle of the first, in grid mm.
    pub fn point_mm(&self, [x, y]: [f64; 2]) -> DVec3 {
        self.origin_mm + self.right * (x * self.pixel_mm[0]) + self.down * (y * self.pixel_mm[1])
    }

    /// A point in grid mm, dropped onto the plane, in pixels from the middle of the first.
    fn pixel(&self, point_mm: DVec3) -> [f64; 2] {
        let from_origin = point_mm - self.origin_mm;
        [from_origin.dot(self.right) / self.pixel_mm[0], from_origin.dot(self.down) / self.pixel_mm[1]]
    }

    /// Counts at the middle of each pixel, row by row, between voxels by trilinear interpolation; 0 outside of the grid.
    pub fn counts(&self, volume: &Volume) -> Vec<f32> {
        let mut counts = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let point = self.point_mm([x as f64, y as f64]);
                let inside = volume.grid.voxel_at(point).is_some();
                counts.push(if inside { sample_scalar(&volume.grid, &volume.counts, point) as f32 } else { 0.0 });
            }
        }
        counts
    }

    /// Where the plane (without its edges) cuts a mesh: lines in pixels from the middle of the first. One that is closed, as all cuts of a
    /// closed mesh are, ends with the point that it begins with.
    pub fn cut(&self, mesh: &Mesh) -> Vec<Vec<[f64; 2]>> {
        let normal = self.right.cross(self.down);
        let heights: Vec<f64> = mesh.positions.iter().map(|position| (*position - self.origin_mm).dot(normal)).collect();
        let below = |vertex: u32| heights[vertex as usize] < 0.0;
        // Half open, so that a vertex in the plane is crossed once: each triangle has none or two crossed edges.
        let crossed = |[a, b, c]: [u32; 3]| {
            let mut edges = [(a, b), (b, c), (c, a)].into_iter().filter(|&(from, to)| below(from) != below(to));
            Some([edges.next()?, edges.next()?].map(|(from, to)| (from.min(to), from.max(to))))
        };
        let segments: Vec<[Edge; 2]> = mesh.triangles.iter().filter_map(|&triangle| crossed(triangle)).collect();
        let place = |(a, b): Edge| {
            let (from, to) = (heights[a as usize], heights[b as usize]);
            self.pixel(mesh.positions[a as usize].lerp(mesh.positions[b as usize], from / (from - to)))
        };
        joined(&segments).into_iter().map(|line| line.into_iter().map(place).collect()).collect()
    }
}

/// Two vertices, the smaller first.
type Edge = (u32, u32);

/// Segments between edges, put end to end.
fn joined(segments: &[[Edge; 2]]) -> Vec<Vec<Edge>> {
    let mut at: BTreeMap<Edge, Vec<usize>> = BTreeMap::new();
    for (index, ends) in segments.iter().enumerate() {
        for end in ends {
            at.entry(*end).or_default().push(index);
        }
    }
    let mut used = vec![false; segments.len()];
    let mut next = |end: &Edge| {
        let index = at.get(end)?.iter().copied().find(|&index| !used[index])?;
        used[index] = true;
        let [a, b] = segments[index];
        Some(if a == *end { b } else { a })
    };
    // Open lines from their ends, should a mesh have a hole; then what is closed.
    let open = at.iter().filter(|(_, of)| of.len() == 1).map(|(end, _)| *end);
    let starts = open.chain(segments.iter().map(|[start, _]| *start)).collect::<Vec<_>>();
    let mut lines = Vec::new();
    for start in starts {
        let mut line = vec![start];
        while let Some(end) = line.last().and_then(&mut next) {
            line.push(end);
        }
        if line.len() > 1 {
            lines.push(line);
        }
    }
    lines
}

/// The count that is drawn white, for some gates of a study alike: twice the brightest on the outer surface, which lies at about half of
/// the wall's brightness. By the brightest of all, a hot liver alone would leave the heart dark.
pub fn white_counts(study: &Study, found: &Reconstruction, gates: impl IntoIterator<Item = usize>) -> f64 {
    let (mut on_surface, mut brightest) = (0.0_f64, 0.0_f64);
    for gate in gates {
        let (Some(counts), Some(reconstructed)) = (study.gates.get(gate), found.gates.get(gate)) else { continue };
        let volume = &counts.volume;
        let surface = &reconstructed.fits.get(Surface::Epicardial).mesh.positions;
        on_surface = surface.iter().fold(on_surface, |most, &point| most.max(sample_scalar(&volume.grid, &volume.counts, point)));
        brightest = brightest.max(f64::from(volume.maximum()));
    }
    (2.0 * on_surface).min(brightest).max(f64::from(f32::MIN_POSITIVE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Grid;
    use ndarray::Array3;

    const PLANE: Plane =
        Plane { origin_mm: DVec3::new(-40.0, -40.0, 0.1), right: DVec3::X, down: DVec3::Y, pixel_mm: [2.0, 4.0], width: 41, height: 21 };

    #[test]
    fn a_plane_through_a_sphere_cuts_one_closed_circle() {
        let sphere = Mesh::icosphere(3).map(|p| p * 30.0);
        let lines = PLANE.cut(&sphere);
        assert_eq!(lines.len(), 1);
        let line = &lines[0];
        assert!(line.len() > 40 && line.first() == line.last(), "{} points", line.len());
        for [x, y] in line {
            let radius = (x * 2.0 - 40.0).hypot(y * 4.0 - 40.0);
            assert!((radius - 30.0).abs() < 0.4, "{radius}");
        }
        // One way round: neighbours are near, and the area is the circle's.
        let twice: f64 = line.windows(2).map(|w| w[0][0] * w[1][1] - w[1][0] * w[0][1]).sum();
        assert!((twice.abs() / 2.0 * 8.0 - std::f64::consts::PI * 900.0).abs() < 40.0, "{twice}");
        assert!(PLANE.moved(DVec3::Z * 31.0).cut(&sphere).is_empty());
    }

    #[test]
    fn a_plane_through_a_vertex_cuts_it_once() {
        let sphere = Mesh::icosphere(2).map(|p| p * 30.0);
        let through = sphere.positions.iter().map(|position| position.z).find(|z| z.abs() > 1.0).unwrap();
        let lines = Plane { origin_mm: DVec3::new(-40.0, -40.0, through), ..PLANE }.cut(&sphere);
        assert_eq!(lines.len(), 1);
        assert_eq!(lines[0].first(), lines[0].last());
    }

    #[test]
    fn two_bodies_are_two_lines_and_an_open_mesh_an_open_one() {
        let ball = Mesh::icosphere(2).map(|p| p * 8.0 - DVec3::X * 20.0);
        let (points, triangles) = (ball.positions.len() as u32, ball.triangles.to_vec());
        let other = triangles.iter().map(|corners| corners.map(|corner| corner + points));
        let both = Mesh {
            positions: ball.positions.iter().copied().chain(ball.positions.iter().map(|p| *p + DVec3::X * 40.0)).collect(),
            triangles: triangles.iter().copied().chain(other).collect(),
        };
        assert_eq!(PLANE.cut(&both).len(), 2);
        let half = Mesh { triangles: triangles.into_iter().filter(|t| ball.positions[t[0] as usize].x < -20.0).collect(), ..ball };
        let lines = PLANE.cut(&half);
        assert!(!lines.is_empty() && lines.iter().all(|line| line.first() != line.last()), "{lines:?}");
    }

    #[test]
    fn counts_are_those_of_the_voxels_and_black_outside() {
        let grid = Grid { shape: [2, 3, 4], spacing_mm: [6.0, 4.0, 2.0] };
        let volume = Volume { grid, counts: Array3::from_shape_fn((2, 3, 4), |(z, y, x)| (100 * z + 10 * y + x) as f32) };
        let plane = Plane { origin_mm: DVec3::new(0.0, 0.0, 6.0), width: 5, height: 3, ..PLANE };
        assert_eq!(plane.counts(&volume), [100., 101., 102., 103., 0., 110., 111., 112., 113., 0., 120., 121., 122., 123., 0.]);
    }
}
