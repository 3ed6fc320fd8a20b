//! What `surfaces.glb` says of the wall beyond its shape: the polar maps as textures that can be chosen (`KHR_materials_variants`), and every
//! quantity as an attribute of the vertices.
//!
//! A texture holds a polar map, anterior up and septal left; `TEXCOORD_0` is the place of a vertex in it. No map from a closed surface onto a
//! disc leaves the lid out, so each surface is two primitives on the same vertices: the wall, which is coloured, and the lid of the valve plane,
//! which is grey. The triangles between belong to the wall: their outer corners lie outside of the disc, so that the colours end at its rim.

use super::ExportError;
use crate::{
    analysis::{Analysis, Quantity, polar},
    drawing::{
        polar::{Disc, NEUTRAL, PolarField},
        scale::Scale,
        svg::hex,
    },
    pipeline::{Reconstruction, Surface},
};
use serde_json::{Value, json};

/// Stands where a vertex has no value, as in the lid: glTF has no way to leave one out.
pub const NO_VALUE: f32 = -9999.0;
/// Name of the variant without colours, which is also what is shown where none is chosen.
pub const PLAIN: &str = "plain";

/// Pixels along a side of a texture.
const TEXTURE_PIXELS: usize = 256;
/// Radius of the disc in a texture whose side is 1.
const DISC_RADIUS: f64 = 0.44;
/// Radius of the lid's vertices, in radii of the disc.
const LID_RADIUS: f64 = 1.12;
/// Colours told in the legend.
const LEGEND_COLOURS: usize = 9;

/// The colours of a reconstruction's surfaces.
pub(super) struct Variants {
    /// Place of each vertex in the textures.
    pub(super) places: Vec<[f32; 2]>,
    /// Which vertices are no wall.
    pub(super) in_lid: Vec<bool>,
    /// The quantities that there are.
    pub(super) quantities: Vec<Coloured>,
}

/// One quantity.
pub(super) struct Coloured {
    /// Which.
    pub(super) quantity: Quantity,
    /// Its map as a PNG picture.
    pub(super) texture: Vec<u8>,
    /// Its value at each vertex, or [`NO_VALUE`].
    pub(super) values: Vec<f32>,
}

impl Variants {
    /// Of a reconstruction.
    pub(super) fn of(reconstruction: &Reconstruction, analysis: &Analysis) -> Result<Self, ExportError> {
        let places = &analysis.places;
        let diastole = reconstruction.gates.get(analysis.end_diastole).ok_or(ExportError::Empty)?;
        let surface = |surface: Surface| &diastole.fits.get(surface).mesh.positions;
        let [anterior, septal, _] = places.axes;
        let middles = surface(Surface::Endocardial).iter().zip(surface(Surface::Epicardial)).map(|(inner, outer)| inner.midpoint(*outer));
        let in_texture = |radius: f64, degrees: f64| {
            let [right, up] = polar::in_disc(radius * DISC_RADIUS, degrees);
            [(0.5 + right) as f32, (0.5 - up) as f32]
        };
        let of_vertex = middles.zip(&places.of_vertex).map(|(middle, place)| {
            if let Some(place) = place {
                in_texture(place.radius, place.degrees)
            } else {
                let from = middle - places.centre_mm;
                in_texture(LID_RADIUS, from.dot(septal).atan2(from.dot(anterior)).to_degrees())
            }
        });
        let mut disc = None;
        let quantities = Quantity::ALL.into_iter().filter_map(|quantity| Some((quantity, quantity.of(analysis)?)));
        let coloured = quantities.map(|(quantity, values)| {
            let map = polar::map(values, places, quantity.average());
            let field = PolarField { values: &map, range: quantity.range(), scale: scale(quantity), cyclic: quantity.is_cyclic() };
            let disc = disc.get_or_insert_with(|| Disc::new(field.cells(), TEXTURE_PIXELS, DISC_RADIUS * TEXTURE_PIXELS as f64));
            let texture = disc.picture(&field, NEUTRAL).png()?;
            let values = values.iter().map(|value| value.map_or(NO_VALUE, |value| value as f32)).collect();
            Ok(Coloured { quantity, texture, values })
        });
        Ok(Self {
            places: of_vertex.collect(),
            in_lid: places.of_vertex.iter().map(Option::is_none).collect(),
            quantities: coloured.collect::<Result<_, ExportError>>()?,
        })
    }

    /// The names of the variants, the plain one first.
    pub(super) fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        std::iter::once(PLAIN).chain(self.quantities.iter().map(|coloured| coloured.quantity.name()))
    }

    /// What the colours of each variant and the numbers of each attribute mean.
    pub(super) fn legend(&self) -> Value {
        let one = |coloured: &Coloured| {
            let quantity = coloured.quantity;
            let colour = |step: usize| hex(scale(quantity).colour(step as f64 / (LEGEND_COLOURS - 1) as f64));
            json!({
                "variant": quantity.name(),
                "title": quantity.title(),
                "unit": quantity.unit(),
                "range": quantity.range(),
                "colour_scale": quantity.colour_scale(),
                "colours": (0..LEGEND_COLOURS).map(colour).collect::<Vec<_>>(),
                "attribute": format!("_{}", attribute(quantity)),
            })
        };
        self.quantities.iter().map(one).collect()
    }
}

/// Name of a quantity's vertex attribute, without the underscore that glTF has custom ones begin with.
pub(super) fn attribute(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Perfusion => "PERFUSION_PERCENT",
        Quantity::EndDiastolicThickness => "THICKNESS_ED_MM",
        Quantity::EndSystolicThickness => "THICKNESS_ES_MM",
        Quantity::Thickening => "THICKENING_PERCENT",
        Quantity::Motion => "MOTION_MM",
        Quantity::Phase => "PHASE_DEGREES",
    }
}

fn scale(quantity: Quantity) -> Scale {
    Scale::named(quantity.colour_scale()).unwrap_or(Scale::Viridis)
}
