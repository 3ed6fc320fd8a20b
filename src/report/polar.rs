//! The polar maps as numbers: what the pictures of them are drawn from.

use super::regional::Rotation;
use crate::analysis::{
    Analysis,
    polar::{self, RINGS, SECTORS},
    segments,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use crate::analysis::Quantity;

/// The value of `schema` in polar maps of this shape.
pub const POLAR_SCHEMA: &str = "ventricle.polar-maps/1";

/// Polar maps: the wall unrolled onto a disc, the tip in its middle, the valve plane at its edge, the anterior wall up, the septum left.
///
/// A map is cut into `rings` of equal width and `sectors` of equal angle. `values[ring][sector]` is the value in the middle of a cell: at
/// `radii[ring]` (0 the tip, 1 the valve plane) and at `degrees[sector]` about the long axis, 0 anterior, 90 septal, 180 inferior, 270 lateral. In
/// a picture with y upwards the cell is at x = −radius · sin(degrees), y = radius · cos(degrees).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PolarMaps {
    /// Version of this shape: `ventricle.polar-maps/1`. Fields may be added under the same version.
    #[schema(example = "ventricle.polar-maps/1")]
    pub schema: String,
    /// The reconstruction's id.
    pub id: String,
    /// Number of rings, the first about the tip.
    pub rings: usize,
    /// Number of sectors, the first beside the middle of the anterior wall, going to the septum.
    pub sectors: usize,
    /// Radius of each ring's middle.
    pub radii: Vec<f64>,
    /// Angle of each sector's middle in degrees.
    pub degrees: Vec<f64>,
    /// Radii at which the apex, the apical and the mid segments end: ¼, ½ and ¾; basal segments end at 1.
    pub segment_radii: [f64; 3],
    /// How the anterior wall was told from the others.
    pub rotation: Rotation,
    /// The maps: perfusion and `end_diastolic_thickness` for every study; the others need a cycle, phase one of four gates.
    pub maps: Vec<PolarMap>,
}

/// The map of one quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PolarMap {
    /// What it shows: `perfusion`, `end_diastolic_thickness`, `end_systolic_thickness`, `thickening`, `motion` or `phase`.
    #[schema(value_type = String, example = "perfusion")]
    pub quantity: Quantity,
    /// `%`, `mm` or `degrees`.
    #[schema(example = "%")]
    pub unit: String,
    /// Values at both ends of the colours, the same for every study. What lies beyond has the colour of the end.
    pub range: [f64; 2],
    /// The colours of the pictures: `inferno` or `viridis` (perceptually uniform, from dark to bright), or `cycle` (0 and 360 are one colour).
    #[schema(example = "inferno")]
    pub colour_scale: String,
    /// `[rings][sectors]`; null where nothing near has a value.
    #[schema(value_type = Vec<Vec<Option<f64>>>)]
    pub values: Vec<Vec<Option<f64>>>,
    /// Means over the seventeen segments, weighted by area, segment 1 first; null where a segment has no value.
    pub segments: Vec<Option<f64>>,
}

impl PolarMaps {
    /// Of an analysis; `id` is the reconstruction's.
    pub fn of(id: &str, analysis: &Analysis) -> Self {
        let places = &analysis.places;
        let map = |quantity: Quantity| {
            let values = quantity.of(analysis)?;
            Some(PolarMap {
                quantity,
                unit: quantity.unit().to_owned(),
                range: quantity.range(),
                colour_scale: quantity.colour_scale().to_owned(),
                values: polar::map(values, places, quantity.average()),
                segments: segments::means(values, places, quantity.average()),
            })
        };
        Self {
            schema: POLAR_SCHEMA.to_owned(),
            id: id.to_owned(),
            rings: RINGS,
            sectors: SECTORS,
            radii: (0..RINGS).map(|ring| (ring as f64 + 0.5) / RINGS as f64).collect(),
            degrees: (0..SECTORS).map(|sector| 360.0 * (sector as f64 + 0.5) / SECTORS as f64).collect(),
            segment_radii: [0.25, 0.5, 0.75],
            rotation: Rotation::of(places),
            maps: Quantity::ALL.into_iter().filter_map(map).collect(),
        }
    }

    /// The map of a quantity, if there is one.
    pub fn map(&self, quantity: Quantity) -> Option<&PolarMap> {
        self.maps.iter().find(|map| map.quantity == quantity)
    }
}
