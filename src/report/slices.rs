//! Slices of a study with the contours of both surfaces, so that a reader can judge how they lie on the counts. The pictures of the counts
//! themselves are made from the input, while it is kept.

use crate::{
    analysis::{
        Analysis, RotationSource,
        planes::{self, Plane},
    },
    pipeline::{Reconstruction, Surface},
    study::{Orientation, Study},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The value of `schema` in slices of this shape.
const SLICES_SCHEMA: &str = "ventricle.slices/1";

/// Pixels of planes that are laid about the ventricle, in mm: finer than the 2.5 to 7 mm of clinical studies.
const PIXEL_MM: f64 = 2.0;
/// Distance between short-axis slices in mm, about that of clinical studies; more where there would be too many.
const SLICE_MM: f64 = 6.0;
/// Most short-axis slices. Ventricles have some twenty.
const MOST_SLICES: f64 = 64.0;
/// What is shown around the outer surface at least, in mm.
const MARGIN_MM: f64 = 20.0;
/// Half the side of a picture at least, in mm: the same scale for all but very large ventricles.
const LEAST_HALF_MM: f64 = 70.0;
/// Half the side of a picture at most, in mm: what a mark that is far too wide makes of a surface is cut off.
const MOST_HALF_MM: f64 = 150.0;

/// Slices in three directions, and where both surfaces cut them at every gate.
///
/// A point `[x, y]` of a contour is in pixels, whole numbers at the pixels' middles. In grid mm it lies at
/// `origin_mm` + x · `pixel_mm[0]` · `right` + y · `pixel_mm[1]` · `down` + slice · `slice_mm` · `through`, slices counted from 0. Contours are closed lines that end with the point that
/// they begin with; that of a surface is the cut of its whole mesh, valve plane included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Slices {
    /// Version of this shape: `ventricle.slices/1`. Fields may be added under the same version.
    #[schema(example = "ventricle.slices/1")]
    pub schema: String,
    /// The reconstruction's id.
    pub id: String,
    /// Number of gates.
    pub gates: usize,
    /// Counts that the pictures show as white, in all gates and planes: twice the brightest on the outer surface, at most the brightest of all.
    pub white_counts: f64,
    /// `short_axis`, `long_axis` and `acquired`.
    pub planes: Vec<SlicePlane>,
}

/// A direction of slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PlaneName {
    /// Across the ventricle's axis, the apex first.
    ShortAxis,
    /// Two planes through the ventricle's axis.
    LongAxis,
    /// The input's own slices, pixel by pixel.
    Acquired,
}

/// Parallel slices, or the two planes of the long axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SlicePlane {
    /// `short_axis`: across the ventricle's axis, the apex first, the anterior wall up and the septum left. `long_axis`: two planes through the
    /// axis (`views`). `acquired`: the input's own slices.
    pub plane: PlaneName,
    /// Number of slices.
    pub slices: usize,
    /// Pixels of a slice from left to right.
    pub width: usize,
    /// Pixels of a slice from top to bottom.
    pub height: usize,
    /// Size of a pixel to the right and down, in mm.
    pub pixel_mm: [f64; 2],
    /// Distance between slices in mm; null for `long_axis`.
    #[schema(required)]
    pub slice_mm: Option<f64>,
    /// Middle of the first pixel of the first slice, `[x, y, z]` in grid mm; null for `long_axis`.
    #[schema(required)]
    pub origin_mm: Option<[f64; 3]>,
    /// Unit vector to the right in the grid; null for `long_axis`.
    #[schema(required)]
    pub right: Option<[f64; 3]>,
    /// Unit vector down in the grid; null for `long_axis`.
    #[schema(required)]
    pub down: Option<[f64; 3]>,
    /// Unit vector from slice to slice in the grid; null for `long_axis`.
    #[schema(required)]
    pub through: Option<[f64; 3]>,
    /// The two planes of `long_axis`, in the order of its slices; null for the others.
    #[schema(required)]
    pub views: Option<Vec<LongAxisView>>,
    /// What lies at the edges of the pictures. Of `short_axis` walls: `anterior`, `inferior`, `septal`, `lateral`. Of `acquired` the patient's
    /// directions: `left`, `right`, `front`, `back`, `head`, `feet`. Null where the study does not say how it lies in the patient, and for
    /// `long_axis`, whose views have their own.
    #[schema(required)]
    pub labels: Option<EdgeLabels>,
    /// The contours of each gate, the first gate first.
    pub gates: Vec<GateContours>,
}

/// A plane through the ventricle's axis, the apex up, as in the apical views of echocardiography (Lang et al., J Am Soc Echocardiogr
/// 2015;28:1-39): `horizontal` (of four chambers) has the septum left and the lateral wall right, `vertical` (of two chambers) the inferior
/// wall left and the anterior wall right.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LongAxisView {
    /// `horizontal` or `vertical`.
    pub view: ViewName,
    /// Middle of the first pixel, `[x, y, z]` in grid mm.
    pub origin_mm: [f64; 3],
    /// Unit vector to the right in the grid.
    pub right: [f64; 3],
    /// Unit vector down in the grid.
    pub down: [f64; 3],
    /// What lies at the edges: walls, `apex` and `base`; walls are left out (null for all) where the study does not say how it lies in the patient.
    #[schema(required)]
    pub labels: Option<EdgeLabels>,
}

/// The planes of the long axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ViewName {
    /// Through septum and lateral wall.
    Horizontal,
    /// Through anterior and inferior wall.
    Vertical,
}

/// What lies at the edges of a picture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct EdgeLabels {
    /// At the left edge.
    pub left: String,
    /// At the right edge.
    pub right: String,
    /// At the top.
    pub top: String,
    /// At the bottom.
    pub bottom: String,
}

/// The contours of one gate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GateContours {
    /// Those of each slice, the first slice first.
    pub slices: Vec<SliceContours>,
}

/// The contours in one slice: lines of points `[x, y]` in pixels. None where a surface does not reach the slice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SliceContours {
    /// Of the inner surface.
    pub endocardial: Vec<Vec<[f64; 2]>>,
    /// Of the outer surface.
    pub epicardial: Vec<Vec<[f64; 2]>>,
}

impl Slices {
    /// Of a reconstruction; `id` is its id.
    pub fn of(id: &str, study: &Study, found: &Reconstruction, analysis: &Analysis) -> Self {
        let about = About::of(found, analysis);
        Self {
            schema: SLICES_SCHEMA.to_owned(),
            id: id.to_owned(),
            gates: found.gates.len(),
            white_counts: planes::white_counts(study, found, 0..found.gates.len()),
            planes: vec![about.short_axis(found), about.long_axis(found), acquired(study, found)],
        }
    }

    /// The rectangles of a plane's slices, in their order, and nothing where there is no such plane.
    pub fn rectangles(&self, name: PlaneName) -> Vec<Plane> {
        self.planes.iter().find(|plane| plane.plane == name).map(SlicePlane::rectangles).unwrap_or_default()
    }
}

impl SlicePlane {
    fn rectangles(&self) -> Vec<Plane> {
        let at = |origin: [f64; 3], right: [f64; 3], down: [f64; 3]| Plane {
            origin_mm: DVec3::from_array(origin),
            right: DVec3::from_array(right),
            down: DVec3::from_array(down),
            pixel_mm: self.pixel_mm,
            width: self.width,
            height: self.height,
        };
        if let Some(views) = &self.views {
            return views.iter().map(|view| at(view.origin_mm, view.right, view.down)).collect();
        }
        let (Some(origin), Some(right), Some(down), Some(through), Some(slice_mm)) =
            (self.origin_mm, self.right, self.down, self.through, self.slice_mm)
        else {
            return Vec::new();
        };
        let first = at(origin, right, down);
        (0..self.slices).map(|slice| first.moved(DVec3::from_array(through) * (slice as f64 * slice_mm))).collect()
    }
}

/// Parallel slices from the first one on.
fn stack(plane: PlaneName, first: Plane, through: DVec3, slice_mm: f64, slices: usize) -> SlicePlane {
    SlicePlane {
        plane,
        slices,
        width: first.width,
        height: first.height,
        pixel_mm: first.pixel_mm,
        slice_mm: Some(slice_mm),
        origin_mm: Some(first.origin_mm.to_array()),
        right: Some(first.right.to_array()),
        down: Some(first.down.to_array()),
        through: Some(through.to_array()),
        views: None,
        labels: None,
        gates: Vec::new(),
    }
}

/// With the contours of every gate.
fn with_contours(plane: SlicePlane, found: &Reconstruction) -> SlicePlane {
    let rectangles = plane.rectangles();
    let gates = found.gates.iter().map(|gate| {
        let lines = |rectangle: &Plane, surface: Surface| {
            let cut = rectangle.cut(&gate.fits.get(surface).mesh);
            cut.into_iter().map(|line| line.into_iter().map(|point| point.map(hundredths)).collect()).collect()
        };
        let slice = |rectangle| SliceContours {
            endocardial: lines(rectangle, Surface::Endocardial),
            epicardial: lines(rectangle, Surface::Epicardial),
        };
        GateContours { slices: rectangles.iter().map(slice).collect() }
    });
    SlicePlane { gates: gates.collect(), ..plane }
}

/// Rounded to two decimals; never the negative zero.
fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0 + 0.0
}

/// The input's own slices.
fn acquired(study: &Study, found: &Reconstruction) -> SlicePlane {
    let ([slices, height, width], [slice_mm, down_mm, right_mm]) = (study.grid.shape, study.grid.spacing_mm);
    let first = Plane { origin_mm: DVec3::ZERO, right: DVec3::X, down: DVec3::Y, pixel_mm: [right_mm, down_mm], width, height };
    let labels = study.orientation.as_ref().map(|orientation| EdgeLabels {
        left: towards(orientation, DVec3::NEG_X),
        right: towards(orientation, DVec3::X),
        top: towards(orientation, DVec3::NEG_Y),
        bottom: towards(orientation, DVec3::Y),
    });
    with_contours(SlicePlane { labels, ..stack(PlaneName::Acquired, first, DVec3::Z, slice_mm, slices) }, found)
}

/// The patient's direction that a direction of the grid is nearest to.
fn towards(orientation: &Orientation, in_grid: DVec3) -> String {
    let patient = orientation.direction(in_grid);
    let sizes = patient.abs();
    let name = if sizes.x >= sizes.y && sizes.x >= sizes.z {
        if patient.x > 0.0 { "left" } else { "right" }
    } else if sizes.y >= sizes.z {
        if patient.y > 0.0 { "back" } else { "front" }
    } else if patient.z > 0.0 {
        "head"
    } else {
        "feet"
    };
    name.to_owned()
}

/// Where the ventricle lies and how large it is, over all gates.
struct About {
    /// To the anterior and the septal wall and from apex to base.
    axes: [DVec3; 3],
    walls_known: bool,
    /// The middle of the outer surface at end diastole, in grid mm.
    middle_mm: DVec3,
    /// How far the outer surface reaches from there towards the apex (negative) and the base, in mm.
    along_mm: [f64; 2],
    /// How far it reaches from the line through the middle, in mm.
    radius_mm: f64,
}

impl About {
    fn of(found: &Reconstruction, analysis: &Analysis) -> Self {
        let axes @ [.., to_base] = analysis.places.axes;
        let outer = || found.gates.iter().map(|gate| &gate.fits.get(Surface::Epicardial).mesh);
        let middle_mm = outer().nth(analysis.end_diastole).map_or(DVec3::ZERO, crate::mesh::Mesh::centroid);
        let (mut along_mm, mut radius_mm) = ([0.0_f64; 2], 0.0_f64);
        for point in outer().flat_map(|mesh| mesh.positions.iter()) {
            let from_middle = *point - middle_mm;
            let height = from_middle.dot(to_base);
            along_mm = [along_mm[0].min(height), along_mm[1].max(height)];
            radius_mm = radius_mm.max((from_middle - to_base * height).length());
        }
        Self { axes, walls_known: analysis.places.rotation != RotationSource::Assumed, middle_mm, along_mm, radius_mm }
    }

    /// A square about a point.
    fn square(&self, middle_mm: DVec3, right: DVec3, down: DVec3) -> Plane {
        let [low, high] = self.along_mm;
        let half_mm = (self.radius_mm.max((high - low) / 2.0) + MARGIN_MM).clamp(LEAST_HALF_MM, MOST_HALF_MM);
        let half = (half_mm / PIXEL_MM).ceil();
        let origin_mm = middle_mm - (right + down) * ((half - 0.5) * PIXEL_MM);
        Plane { origin_mm, right, down, pixel_mm: [PIXEL_MM; 2], width: 2 * half as usize, height: 2 * half as usize }
    }

    fn labels(&self, [left, right, top, bottom]: [&str; 4]) -> Option<EdgeLabels> {
        let own = |name: &str| name.to_owned();
        self.walls_known.then(|| EdgeLabels { left: own(left), right: own(right), top: own(top), bottom: own(bottom) })
    }

    /// From a slice below the tip to one above the base.
    fn short_axis(&self, found: &Reconstruction) -> SlicePlane {
        let [anterior, septal, to_base] = self.axes;
        let [low, high] = self.along_mm;
        let slices = ((high - low) / SLICE_MM).ceil() + 2.0;
        let (slices, slice_mm) = if slices > MOST_SLICES { (MOST_SLICES, (high - low) / (MOST_SLICES - 2.0)) } else { (slices, SLICE_MM) };
        // What is left over is shared by both ends.
        let lowest = f64::midpoint(low, high) - (slices - 1.0) * slice_mm / 2.0;
        let first = self.square(self.middle_mm + to_base * lowest, -septal, -anterior);
        let labels = self.labels(["septal", "lateral", "anterior", "inferior"]);
        with_contours(SlicePlane { labels, ..stack(PlaneName::ShortAxis, first, to_base, slice_mm, slices as usize) }, found)
    }

    fn long_axis(&self, found: &Reconstruction) -> SlicePlane {
        let [anterior, septal, to_base] = self.axes;
        let [low, high] = self.along_mm;
        let middle_mm = self.middle_mm + to_base * f64::midpoint(low, high);
        let view = |view: ViewName, right: DVec3, [to_left, to_right]: [&str; 2]| {
            let plane = self.square(middle_mm, right, to_base);
            LongAxisView {
                view,
                origin_mm: plane.origin_mm.to_array(),
                right: plane.right.to_array(),
                down: plane.down.to_array(),
                labels: self.labels([to_left, to_right, "apex", "base"]),
            }
        };
        let views =
            vec![view(ViewName::Horizontal, -septal, ["septal", "lateral"]), view(ViewName::Vertical, anterior, ["inferior", "anterior"])];
        let size = self.square(middle_mm, -septal, to_base);
        let plane = SlicePlane {
            slice_mm: None,
            origin_mm: None,
            right: None,
            down: None,
            through: None,
            slices: views.len(),
            views: Some(views),
            ..stack(PlaneName::LongAxis, size, to_base, SLICE_MM, 0)
        };
        with_contours(plane, found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_named_by_the_patients_directions_they_are_nearest_to() {
        let turned = Orientation {
            columns: DVec3::new(-0.8, 0.6, 0.0),
            rows: DVec3::new(0.0, 0.0, -1.0),
            slices: DVec3::new(0.6, 0.8, 0.0),
            origin_mm: DVec3::ZERO,
        };
        for (in_grid, name) in [
            (DVec3::X, "right"),
            (DVec3::NEG_X, "left"),
            (DVec3::Y, "feet"),
            (DVec3::NEG_Y, "head"),
            (DVec3::Z, "back"),
            (DVec3::NEG_Z, "front"),
        ] {
            assert_eq!(towards(&turned, in_grid), name);
        }
    }

    #[test]
    fn a_surface_of_any_length_has_slices_of_bounded_number_and_size_that_reach_beyond_it() {
        for length_mm in [30.0, 95.0, 140.0, 3000.0] {
            let axes = [DVec3::NEG_Y, DVec3::NEG_X, DVec3::Z];
            let (along_mm, middle_mm) = ([-0.6 * length_mm, 0.4 * length_mm], DVec3::new(90.0, 80.0, 70.0));
            let about = About { axes, walls_known: false, middle_mm, along_mm, radius_mm: length_mm / 3.0 };
            let found = Reconstruction {
                gates: Vec::new(),
                region: None,
                to_base: DVec3::Z,
                pose: None,
                model: None,
                parameters: crate::pipeline::parameters::Parameters::clinical(),
                warnings: Vec::new(),
            };
            let plane = about.short_axis(&found);
            let rectangles = plane.rectangles();
            assert_eq!(rectangles.len(), plane.slices);
            assert!(plane.slices <= 64 && (70..=150).contains(&plane.width) && plane.width == plane.height, "{plane:?}");
            let heights = rectangles.iter().map(|rectangle| rectangle.origin_mm.z - middle_mm.z).collect::<Vec<_>>();
            assert!(heights[0] < along_mm[0] && *heights.last().unwrap() > along_mm[1], "{length_mm}: {heights:?}");
            let centre = rectangles[0].point_mm([(plane.width - 1) as f64 / 2.0; 2]);
            assert!(centre.truncate().distance(middle_mm.truncate()) < 1e-9, "the axis is in the middle");
            assert_eq!(plane.labels, None);
            assert_eq!(about.long_axis(&found).rectangles().len(), 2);
        }
    }
}
