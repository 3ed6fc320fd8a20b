//! Puts the wall between both surfaces of a gate in order: no tetrahedron of it may be flat or inside out.
//!
//! The surfaces evolve without knowing of each other. Both end in the valve plane, where the wall between them is flat, and elsewhere
//! particles slide along their surfaces until a prism folds. Here every tetrahedron below a small volume is opened by the shortest motion of
//! its four vertices that does so to first order, along the gradient of its volume, one after the other in fixed order, again and again
//! until none is left (the volume constraint of position-based dynamics: Müller, Heidelberger, Hennix and Ratcliff, J Vis Commun Image
//! Represent 18:109, 2007). Inner and outer vertices move alike, so that neither surface pays for the other.
//!
//! The surfaces' own triangles are held as well: each spans a tetrahedron with the centre of its surface, which must not turn over.

use crate::{
    mesh::{
        Mesh,
        wall::{Wall, signed_volume_mm3},
    },
    study::Warning,
};
use glam::DVec3;

/// What putting the wall in order took, and what it left.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WallOrder {
    /// Tetrahedra that were flat or inside out when the surfaces had evolved.
    pub inverted_before: usize,
    /// Tetrahedra that still are: 0, or the result carries a warning.
    pub inverted: usize,
    /// Triangles of both surfaces that faced the wrong way when the surfaces had evolved.
    pub turned_before: usize,
    /// Triangles of both surfaces that still do.
    pub turned: usize,
    /// Sweeps over the wall in which something moved.
    pub sweeps: usize,
    /// The longest way of a vertex, in mm.
    pub largest_move_mm: f64,
    /// The mean way over the vertices of both surfaces, in mm.
    pub mean_move_mm: f64,
}

/// Least volume of a tetrahedron, as part of the mean one. It is what a file in single precision keeps apart from zero by far, and adds a
/// tenth of a mm to the wall in the valve plane at 642 vertices, so .3 % to the smallest cavities.
const LEAST_VOLUME: f64 = 0.01;
/// A tetrahedron is opened to this much more than the least volume: aiming at the limit itself, sweeps converge on it without end.
const BEYOND: f64 = 1.1;
/// Sweeps that hold the surfaces' triangles as well. The studies and phantoms in docs/numerics.md need at most 44 with the free model and 61
/// with the others.
const SWEEPS: usize = 300;
/// Sweeps after them for the wall alone, where it cannot be had with all triangles facing outward.
const WALL_SWEEPS: usize = 300;
/// After every so many sweeps, what is still below the least volume is taken for a knot, in which each tetrahedron closes another as it
/// opens, and is loosened. More than the free model's 44: only worse meshes see it.
const KNOT_SWEEPS: usize = 50;

/// Moves the vertices of both surfaces as little as it takes to give every tetrahedron between them a positive volume.
///
/// Meshes of different topology, and surfaces that enclose no wall at all, are left as they are: what to say of those is not decided here.
pub fn order(inner: &mut Mesh, outer: &mut Mesh) -> WallOrder {
    let Some(mut wall) = Wall::between(inner, outer) else { return WallOrder::default() };
    let mean_mm3 = wall.volumes_mm3().sum::<f64>() / wall.tetrahedra.len().max(1) as f64;
    let turned = |surface: &Mesh| surface.inverted_triangles(surface.centroid());
    let inverted_before = wall.inverted();
    let turned_before = turned(inner) + turned(outer);
    let unordered = WallOrder { inverted_before, inverted: inverted_before, turned_before, turned: turned_before, ..WallOrder::default() };
    if mean_mm3.is_nan() || mean_mm3 <= 0.0 {
        return unordered;
    }
    let evolved = wall.positions.clone();
    let across = inner.positions.len();
    let spanned = fans(inner, outer, &mut wall.positions);
    let joined = inner.neighbours();
    let least_mm3 = LEAST_VOLUME * mean_mm3;
    let mut sweeps = 0;
    for sweep in 0..SWEEPS + WALL_SWEEPS {
        let held = if sweep < SWEEPS { &spanned[..] } else { &[] };
        let mut moved = false;
        for tetrahedron in wall.tetrahedra.iter().chain(held) {
            moved |= open(&mut wall.positions, *tetrahedron, 2 * across, least_mm3);
        }
        if !moved {
            break;
        }
        sweeps = sweep + 1;
        if sweeps % KNOT_SWEEPS == 0 {
            loosen(&mut wall.positions, wall.tetrahedra.iter().chain(held), &joined, least_mm3);
        }
    }
    wall.positions.truncate(2 * across);
    let moves: Vec<f64> = evolved.iter().zip(&wall.positions).map(|(from, to)| from.distance(*to)).collect();
    inner.positions.copy_from_slice(&wall.positions[..across]);
    outer.positions.copy_from_slice(&wall.positions[across..]);
    WallOrder {
        inverted: wall.inverted(),
        turned: turned(inner) + turned(outer),
        sweeps,
        largest_move_mm: moves.iter().copied().fold(0.0, f64::max),
        mean_move_mm: moves.iter().sum::<f64>() / moves.len().max(1) as f64,
        ..unordered
    }
}

/// Tetrahedra from the centre of each surface to its triangles; the centres are put behind the vertices.
fn fans(inner: &Mesh, outer: &Mesh, positions: &mut Vec<DVec3>) -> Vec<[u32; 4]> {
    let across = inner.positions.len() as u32;
    let mut spanned = Vec::with_capacity(2 * inner.triangles.len());
    for (surface, first) in [(inner, 0), (outer, across)] {
        let centre = positions.len() as u32;
        positions.push(surface.centroid());
        spanned.extend(surface.triangles.iter().map(|&[a, b, c]| [centre, a + first, b + first, c + first]));
    }
    spanned
}

/// Moves the vertices of a tetrahedron below the least volume; returns whether it was. Vertices from `fixed` on stay where they are.
fn open(positions: &mut [DVec3], tetrahedron: [u32; 4], fixed: usize, least_mm3: f64) -> bool {
    let corners @ [a, b, c, d] = tetrahedron.map(|vertex| positions[vertex as usize]);
    let volume = signed_volume_mm3(corners);
    if volume >= least_mm3 {
        return false;
    }
    let (of_b, of_c, of_d) = ((c - a).cross(d - a) / 6.0, (d - a).cross(b - a) / 6.0, (b - a).cross(c - a) / 6.0);
    let mut gradient = [-(of_b + of_c + of_d), of_b, of_c, of_d];
    for (part, vertex) in gradient.iter_mut().zip(tetrahedron) {
        if vertex as usize >= fixed {
            *part = DVec3::ZERO;
        }
    }
    let square: f64 = gradient.iter().map(|part| part.length_squared()).sum();
    if square > 0.0 {
        let way = (BEYOND * least_mm3 - volume) / square;
        for (part, vertex) in gradient.into_iter().zip(tetrahedron) {
            positions[vertex as usize] += part * way;
        }
    }
    true
}

/// Draws the vertices of tetrahedra below the least volume half way to the mean of their neighbours on their surface.
fn loosen<'a>(positions: &mut [DVec3], tetrahedra: impl Iterator<Item = &'a [u32; 4]>, joined: &[Vec<u32>], least_mm3: f64) {
    let across = joined.len();
    let mut knotted = vec![false; positions.len()];
    for tetrahedron in tetrahedra {
        if signed_volume_mm3(tetrahedron.map(|vertex| positions[vertex as usize])) < least_mm3 {
            for vertex in tetrahedron {
                knotted[*vertex as usize] = true;
            }
        }
    }
    for vertex in (0..2 * across).filter(|&vertex| knotted[vertex]) {
        let (first, neighbours) = if vertex < across { (0, &joined[vertex]) } else { (across, &joined[vertex - across]) };
        let mean = neighbours.iter().map(|&neighbour| positions[neighbour as usize + first]).sum::<DVec3>() / neighbours.len() as f64;
        positions[vertex] = positions[vertex].midpoint(mean);
    }
}

/// What the reader of a gate's result (counted from 1) should know.
pub(super) fn warning(gate: usize, order: &WallOrder) -> Option<Warning> {
    (order.inverted > 0).then(|| {
        let message = format!(
            "{} tetrahedra of the wall are flat or inside out: the surfaces fold there, and what is computed on the wall is unreliable.",
            order.inverted
        );
        Warning::at_gate(gate, "wall_inverted", message)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two spheres cut off by one plane, as the valve plane cuts both surfaces; the inner one stands out of it by `out_mm`.
    fn cut(level: u32, out_mm: f64) -> (Mesh, Mesh) {
        let surface = |radius: f64, top: f64| Mesh::icosphere(level).map(|p| (p * radius).with_z((p.z * radius).min(top)));
        (surface(25.0, 15.0 + out_mm), surface(35.0, 15.0))
    }

    #[test]
    fn a_flat_lid_is_opened_and_the_volumes_stay() {
        for (level, out_mm) in [(2, 0.0), (3, 0.0), (3, 1.6), (4, 1.6)] {
            let (mut inner, mut outer) = cut(level, out_mm);
            let before = [inner.volume_ml(), outer.volume_ml()];
            let mean_mm3 = 1000.0 * (before[1] - before[0]) / (3 * inner.triangles.len()) as f64;
            let order = order(&mut inner, &mut outer);
            assert!(order.inverted_before > 0 && order.sweeps > 0, "{order:?}");
            assert_eq!((order.inverted, order.turned), (0, 0), "level {level}, {out_mm} mm: {order:?}");
            let wall = Wall::between(&inner, &outer).unwrap();
            let smallest = wall.quality().volume_mm3[2];
            assert!(smallest >= LEAST_VOLUME * mean_mm3 * (1.0 - 1e-6), "{smallest} of {mean_mm3} mm³");
            for (before, after) in before.into_iter().zip([inner.volume_ml(), outer.volume_ml()]) {
                assert!((after / before - 1.0).abs() < 0.02, "{before} became {after}");
            }
        }
    }

    #[test]
    fn a_wall_in_order_is_left_alone() {
        let (mut inner, mut outer) = (Mesh::icosphere(3).map(|p| p * 20.0), Mesh::icosphere(3).map(|p| p * 30.0));
        let before = (inner.clone(), outer.clone());
        assert_eq!(order(&mut inner, &mut outer), WallOrder::default());
        assert_eq!((inner, outer), before);
    }

    #[test]
    fn a_folded_surface_is_unfolded() {
        let (mut inner, mut outer) = (Mesh::icosphere(3).map(|p| p * 20.0), Mesh::icosphere(3).map(|p| p * 30.0));
        // Two neighbours change places.
        let other = inner.neighbours()[100][0] as usize;
        inner.positions.swap(100, other);
        let order = order(&mut inner, &mut outer);
        assert!(order.turned_before > 0 && order.inverted_before > 0, "{order:?}");
        assert_eq!((order.inverted, order.turned), (0, 0), "{order:?}");
    }

    #[test]
    fn what_cannot_be_ordered_is_counted_and_told() {
        // The inner surface sticks out of the outer one by half its size: no small motion makes a wall of that.
        let (mut inner, mut outer) = (Mesh::icosphere(3).map(|p| p * 20.0 + DVec3::X * 40.0), Mesh::icosphere(3).map(|p| p * 30.0));
        outer.positions[7] = DVec3::NAN;
        let order = order(&mut inner, &mut outer);
        assert!(order.inverted > 0);
        let warning = warning(3, &order).unwrap();
        assert_eq!((warning.code.as_str(), warning.gate), ("wall_inverted", Some(3)));
        assert!(warning.message.starts_with(&order.inverted.to_string()), "{}", warning.message);
        assert_eq!(super::warning(3, &WallOrder::default()), None);
    }
}
