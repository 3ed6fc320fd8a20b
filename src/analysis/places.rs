//! Where each vertex lies on the wall: its segment, its place in the polar map, its share of the wall's area.

use super::segments;
use crate::{
    mesh::Mesh,
    pipeline::{PerSurface, Reconstruction, thickness},
    study::{Orientation, Study},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What tells the anterior wall from the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RotationSource {
    /// The request says where the anterior wall is.
    Given,
    /// The patient's axes: the anterior wall is the one towards the head, as slices are reoriented.
    Patient,
    /// Nothing: the first row is taken for anterior and the first column for septal, as most stacks are laid out.
    Assumed,
}

/// A vertex of the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Segment, 1 to 17.
    pub segment: usize,
    /// Angle about the long axis from the anterior (0) towards the septal wall (90), 0 to 360.
    pub degrees: f64,
    /// Distance from the middle of the polar map, 0 (tip) to 1 (valve plane): the apex ends at ¼, apical and mid segments at ½ and ¾.
    pub radius: f64,
    /// The vertex's share of the area of the surface in the middle of the wall at end diastole, in mm².
    pub area_mm2: f64,
}

/// All vertices of a reconstruction, and the frame they are told in.
#[derive(Debug, Clone, PartialEq)]
pub struct Places {
    /// `[vertices]`; `None` in the lid.
    pub of_vertex: Vec<Option<Place>>,
    /// Unit vectors in the grid: from the axis to the anterior wall, to the septal wall, from apex to base.
    pub axes: [DVec3; 3],
    /// A point of the long axis in grid mm.
    pub centre_mm: DVec3,
    /// What tells the anterior wall.
    pub rotation: RotationSource,
}

/// A disc's worth of the polar map that the apex takes.
const APEX_RADIUS: f64 = 0.25;
/// Sine of the smallest angle between the long axis and the direction that tells the anterior wall.
const LEAST_ACROSS: f64 = 0.1;

impl Places {
    /// Of a reconstruction, told at the gate of end diastole.
    pub fn of(study: &Study, reconstruction: &Reconstruction, end_diastole: usize) -> Self {
        let to_base = reconstruction.to_base.normalize();
        let (anterior, septal, rotation) =
            across(study.orientation.as_ref(), to_base, reconstruction.parameters.analysis.anterior.map(DVec3::from_array));
        let gate = &reconstruction.gates[end_diastole];
        let (inner, outer) = (&gate.fits.endocardial.mesh, &gate.fits.epicardial.mesh);
        let lids = PerSurface::of(|surface| thickness::lid(&gate.fits.get(surface).mesh, to_base));
        let centre_mm = match &reconstruction.pose {
            Some(pose) => pose.base_mm,
            None => inner.centroid(),
        };
        let middle = inner.map_with(outer, |a, b| (a + b) / 2.0);
        let areas = middle.vertex_areas_mm2();
        let in_wall = |vertex: usize| !lids.endocardial[vertex] && !lids.epicardial[vertex];
        let heights = |mesh: &Mesh| -> Vec<f64> { mesh.positions.iter().map(|position| (*position - centre_mm).dot(to_base)).collect() };
        let (of_inner, of_middle) = (heights(inner), heights(&middle));
        let tip = of_inner.iter().copied().fold(f64::INFINITY, f64::min);
        let base = median((0..of_inner.len()).filter(|&vertex| lids.endocardial[vertex]).map(|vertex| of_inner[vertex]).collect())
            .unwrap_or_else(|| of_inner.iter().copied().fold(f64::NEG_INFINITY, f64::max));
        let length_mm = (base - tip).max(f64::MIN_POSITIVE);
        let height = |vertex: usize| (of_middle[vertex] - tip) / length_mm;
        let lowest = (0..of_middle.len()).map(height).fold(0.0, f64::min);
        let of_vertex = (0..of_middle.len())
            .map(|vertex| {
                in_wall(vertex).then(|| {
                    let from = middle.positions[vertex] - centre_mm;
                    let degrees = from.dot(septal).atan2(from.dot(anterior)).to_degrees().rem_euclid(360.0);
                    let height = height(vertex);
                    // The tip is a bowl: its radius goes with the root of the height.
                    let radius = if height < 0.0 {
                        APEX_RADIUS * ((height - lowest) / -lowest).max(0.0).sqrt()
                    } else {
                        APEX_RADIUS + (1.0 - APEX_RADIUS) * height.min(1.0)
                    };
                    Place { segment: segments::at(height, degrees), degrees, radius, area_mm2: areas[vertex] }
                })
            })
            .collect();
        Self { of_vertex, axes: [anterior, septal, to_base], centre_mm, rotation }
    }

    /// Height of the middle of a surface's lid along the long axis in mm; `None` without a lid.
    pub(super) fn base_height_mm(&self, mesh: &Mesh) -> Option<f64> {
        let lid: Vec<f64> = (mesh.positions.iter().zip(&self.of_vertex))
            .filter(|(_, place)| place.is_none())
            .map(|(&position, _)| (position - self.centre_mm).dot(self.axes[2]))
            .collect();
        (!lid.is_empty()).then(|| lid.iter().sum::<f64>() / lid.len() as f64)
    }

    /// Area of the wall, half way through it, in mm².
    pub fn area_mm2(&self) -> f64 {
        self.of_vertex.iter().flatten().map(|place| place.area_mm2).sum()
    }
}

/// Directions in the grid to the anterior and the septal wall.
///
/// Seen from the apex with the anterior wall up, the septal wall is on the left (Cerqueira 2002).
fn across(orientation: Option<&Orientation>, to_base: DVec3, given: Option<DVec3>) -> (DVec3, DVec3, RotationSource) {
    let flat = |direction: DVec3| {
        let across = direction - to_base * to_base.dot(direction);
        (across.length() > LEAST_ACROSS * direction.length()).then(|| across.normalize())
    };
    let handed = orientation.map_or(1.0, |orientation| if orientation.mirrors() { -1.0 } else { 1.0 });
    let septal_of = |anterior: DVec3| anterior.cross(to_base) * handed;
    if let Some(anterior) = given.and_then(flat) {
        return (anterior, septal_of(anterior), RotationSource::Given);
    }
    if let Some(orientation) = orientation {
        // Head, or where the heart stands upright the chest.
        let in_grid =
            |patient: DVec3| DVec3::from_array([orientation.columns, orientation.rows, orientation.slices].map(|axis| axis.dot(patient)));
        if let Some(anterior) = flat(in_grid(DVec3::Z)).or_else(|| flat(in_grid(DVec3::NEG_Y))) {
            return (anterior, septal_of(anterior), RotationSource::Patient);
        }
    }
    let anterior = flat(DVec3::NEG_Y).or_else(|| flat(DVec3::NEG_Z)).unwrap_or(DVec3::NEG_Y);
    let to_first_column = flat(DVec3::NEG_X).unwrap_or_else(|| septal_of(anterior));
    let septal = septal_of(anterior);
    // Which way the stack runs is as unknown as the rest: the septum is on the side of the first column.
    let septal = if septal.dot(to_first_column) < 0.0 { -septal } else { septal };
    (anterior, septal, RotationSource::Assumed)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_lie_as_in_the_patient_in_either_handedness() {
        // To the base: right, back and up, as hearts lie. Anterior then faces up, the septum to the right and front.
        let to_base = DVec3::new(-0.6, 0.6, 0.5).normalize();
        for slices in [DVec3::Z, DVec3::NEG_Z] {
            let orientation = Orientation { columns: DVec3::X, rows: DVec3::Y, slices, origin_mm: DVec3::ZERO };
            let in_grid = |p: DVec3| DVec3::new(p.x, p.y, p.z * slices.z);
            let (anterior, septal, source) = across(Some(&orientation), in_grid(to_base), None);
            let (anterior, septal) = (orientation.direction(anterior), orientation.direction(septal));
            assert_eq!(source, RotationSource::Patient);
            assert!(anterior.z > 0.8 && septal.x < -0.6 && septal.y < -0.6, "{anterior} {septal}");
            assert!(anterior.dot(to_base).abs() < 1e-12 && septal.dot(to_base).abs() < 1e-12 && septal.dot(anterior).abs() < 1e-12);
        }
    }

    #[test]
    fn without_an_orientation_rows_and_columns_are_assumed_unless_told() {
        for to_base in [DVec3::Z, DVec3::NEG_Z] {
            let (anterior, septal, source) = across(None, to_base, None);
            assert_eq!((anterior, septal, source), (DVec3::NEG_Y, DVec3::NEG_X, RotationSource::Assumed));
        }
        let (anterior, septal, source) = across(None, DVec3::Z, Some(DVec3::new(2.0, 0.0, 1.0)));
        assert_eq!((anterior, septal, source), (DVec3::X, DVec3::NEG_Y, RotationSource::Given));
    }
}
