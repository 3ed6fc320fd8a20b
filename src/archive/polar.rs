//! The polar maps as pictures: bull's-eyes with segments, means and a colour bar, as PNG and as SVG.

use super::ArchiveError;
use crate::{
    drawing::{
        bulls_eye::{BullsEye, SHEET, SMALL, number},
        marks,
        polar::PolarField,
        scale::Scale,
        svg::Sheet,
    },
    report::{PolarMap, PolarMaps, Quantity, RotationSource},
};

/// Media type of a PNG picture.
pub const PNG: &str = "image/png";
/// Media type of an SVG drawing.
pub const SVG: &str = "image/svg+xml";

/// Pixels of the PNG picture a unit of the drawing: 900 by 800 in all.
const PIXELS: f64 = 2.0;

/// What is said where the anterior wall was only assumed.
const ASSUMED: &str = "Rotation unknown: first row taken for anterior, first column for septal.";

/// The picture of a quantity; `None` where there is no map of it.
///
/// # Errors
/// That of the PNG encoder.
pub fn png(maps: &PolarMaps, quantity: Quantity) -> Result<Option<Vec<u8>>, ArchiveError> {
    let Some(map) = maps.map(quantity) else { return Ok(None) };
    Ok(Some(marks::as_picture(SHEET, PIXELS, &bulls_eye(maps, map).sheet()).png()?))
}

/// The drawing of a quantity, self-contained; `None` where there is no map of it.
///
/// # Errors
/// That of the PNG encoder, which makes the colours of the disc.
pub fn svg(maps: &PolarMaps, quantity: Quantity) -> Result<Option<String>, ArchiveError> {
    let Some(map) = maps.map(quantity) else { return Ok(None) };
    Ok(Some(drawn(maps, map, SHEET, &bulls_eye(maps, map).sheet())?))
}

/// The small drawing for a page.
pub(super) fn small(maps: &PolarMaps, map: &PolarMap) -> Result<String, ArchiveError> {
    drawn(maps, map, SMALL, &bulls_eye(maps, map).small())
}

fn drawn(maps: &PolarMaps, map: &PolarMap, (width, height): (f64, f64), marks: &[marks::Mark]) -> Result<String, ArchiveError> {
    let mut sheet = Sheet::new(width, height);
    marks::on_sheet(&mut sheet, marks)?;
    let title = format!("{} of the left ventricle, polar map", map.quantity.title());
    Ok(sheet.described(map.quantity.name(), &title, &description(maps, map)))
}

/// The segments' means in words, for those who do not see the picture.
fn description(maps: &PolarMaps, map: &PolarMap) -> String {
    let unit = shown_unit(map.quantity);
    let means = (1..).zip(&map.segments).map(|(segment, mean)| match mean {
        Some(mean) => format!("{segment}: {} {unit}", number(*mean, decimals(map.quantity))),
        None => format!("{segment}: none"),
    });
    let means: Vec<String> = means.collect();
    let [low, high] = map.range;
    let note = if maps.rotation.source == RotationSource::Assumed { format!(" {ASSUMED}") } else { String::new() };
    format!(
        "Apex in the middle, anterior wall up, septum left. Colours ({}) from {low} to {high} {unit}. Means of the 17 segments: {}.{note}",
        map.colour_scale,
        means.join(", ")
    )
}

fn bulls_eye<'a>(maps: &PolarMaps, map: &'a PolarMap) -> BullsEye<'a> {
    let scale = Scale::named(&map.colour_scale).unwrap_or(Scale::Viridis);
    BullsEye {
        field: PolarField { values: &map.values, range: map.range, scale, cyclic: map.quantity.is_cyclic() },
        segments: &map.segments,
        title: map.quantity.title(),
        unit: shown_unit(map.quantity),
        decimals: decimals(map.quantity),
        note: if maps.rotation.source == RotationSource::Assumed { ASSUMED } else { "" },
    }
}

/// As it is written at a number.
pub(super) fn shown_unit(quantity: Quantity) -> &'static str {
    match quantity.unit() {
        "degrees" => "°",
        unit => unit,
    }
}

/// Digits after the point: a tenth of a millimetre, whole percents and degrees.
fn decimals(quantity: Quantity) -> usize {
    usize::from(quantity.unit() == "mm")
}
