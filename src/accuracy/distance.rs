//! How far a found surface lies from the exact one.

use crate::{
    mesh::{Mesh, distance::Triangles},
    phantom::ExactSurfaces,
    pipeline::{PerSurface, Reconstruction},
};

/// Mean distances in mm between a found surface and the exact one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distances {
    /// The mean of both ways over the closed surfaces, lids in the valve plane included.
    pub closed_mm: f64,
    /// From the exact wall alone, without the lid, to the found closed surface.
    pub wall_mm: f64,
}

/// Both ways between closed surfaces: from every vertex of one to the nearest point of the other's triangles, weighted by the area that
/// belongs to the vertex, so that it does not matter how a mesh spreads its vertices. Nothing is left out; vertices of the exact mesh from
/// `lid_from` on are its lid. `None` where a vertex is not finite.
pub fn between(found: &Mesh, exact: &Mesh, lid_from: usize) -> Option<Distances> {
    let (of_found, of_exact) = (Triangles::of(found, |_| true), Triangles::of(exact, |_| true));
    let there = mean(found, &of_exact, |_| true)?;
    let back = mean(exact, &of_found, |_| true)?;
    let wall_mm = mean(exact, &of_found, |vertex| vertex < lid_from)?;
    Some(Distances { closed_mm: f64::midpoint(there, back), wall_mm })
}

/// Mean over the gates of both surfaces' distances from the exact ones of each gate. `None` where a gate has none, or a vertex is not finite.
pub fn over_the_cycle(found: &Reconstruction, exact: impl Fn(usize) -> Option<ExactSurfaces>) -> Option<PerSurface<Distances>> {
    let mut sums = PerSurface::of(|_| (0.0, 0.0));
    for (gate, reconstructed) in found.gates.iter().enumerate() {
        let exact = exact(gate)?;
        let endocardial = between(&reconstructed.fits.endocardial.mesh, &exact.endocardial, exact.lid_from)?;
        let epicardial = between(&reconstructed.fits.epicardial.mesh, &exact.epicardial, exact.lid_from)?;
        for (sum, one) in [(&mut sums.endocardial, endocardial), (&mut sums.epicardial, epicardial)] {
            sum.0 += one.closed_mm;
            sum.1 += one.wall_mm;
        }
    }
    let gates = found.gates.len() as f64;
    Some(PerSurface::of(|surface| {
        let (closed, wall) = *sums.get(surface);
        Distances { closed_mm: closed / gates, wall_mm: wall / gates }
    }))
}

/// Mean distance of a mesh's chosen vertices to triangles, weighted by area.
fn mean(from: &Mesh, to: &Triangles, chosen: impl Fn(usize) -> bool) -> Option<f64> {
    let mut areas = vec![0.0; from.positions.len()];
    for (triangle, [a, b, c]) in from.triangles.iter().zip(from.corners()) {
        let third = (b - a).cross(c - a).length() / 6.0;
        for &vertex in triangle {
            areas[vertex as usize] += third;
        }
    }
    let (mut sum, mut weight) = (0.0, 0.0);
    for (_, (&position, area)) in from.positions.iter().zip(areas).enumerate().filter(|(vertex, _)| chosen(*vertex)) {
        let distance = to.distance(position)?;
        sum += distance * area;
        weight += area;
    }
    (weight > 0.0).then(|| sum / weight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn spheres_one_in_another_are_apart_by_their_radii() {
        let sphere = |radius: f64| Mesh::icosphere(4).map(|p| p * radius);
        let found = between(&sphere(20.0), &sphere(30.0), usize::MAX).unwrap();
        assert!((found.closed_mm - 10.0).abs() < 0.05 && (found.wall_mm - 10.0).abs() < 0.05, "{found:?}");
        let same = between(&sphere(30.0), &sphere(30.0), usize::MAX).unwrap();
        assert!(same.closed_mm < 1e-9);
    }

    /// A sphere moved by a small d lies d |cos θ| away: d / 2 on average.
    #[test]
    fn a_small_shift_is_half_seen() {
        let sphere = Mesh::icosphere(4).map(|p| p * 30.0);
        let found = between(&sphere.map(|p| p + DVec3::X), &sphere, usize::MAX).unwrap();
        assert!((found.closed_mm - 0.5).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn a_vertex_that_is_no_number_gives_no_distance() {
        let sphere = Mesh::icosphere(1);
        let mut broken = sphere.clone();
        broken.positions[3].x = f64::NAN;
        assert_eq!(between(&broken, &sphere, usize::MAX), None);
    }
}
