//! A quantity on the polar disc of the left ventricle, anterior up and septal left, as pixels.

use super::{raster::Picture, scale::Scale};

/// Colour of what has no value.
pub const NEUTRAL: [f32; 3] = [0.72, 0.72, 0.72];

/// Values on rings and sectors of a disc, and their colours.
#[derive(Debug, Clone, Copy)]
pub struct PolarField<'a> {
    /// `[rings][sectors]`, in the middle of each cell; sectors from anterior over septal.
    pub values: &'a [Vec<Option<f64>>],
    /// Values at both ends of the scale.
    pub range: [f64; 2],
    /// The scale.
    pub scale: Scale,
    /// Whether values are directions in degrees.
    pub cyclic: bool,
}

/// Cells around a place, and their shares of it.
type Around = [(usize, f64); 4];

/// The four cells around a place on a disc of so many rings and sectors, counted ring by ring.
fn around((rings, sectors): (usize, usize), radius: f64, degrees: f64) -> Around {
    let ring = (radius * rings as f64 - 0.5).min(rings as f64 - 1.0);
    // Within the first ring's middle the neighbour is the cell across the tip.
    let (below, above, turned) = if ring < 0.0 { (0, 0, 180.0) } else { (ring as usize, (ring as usize + 1).min(rings - 1), 0.0) };
    let part = ring - ring.floor();
    let of_ring = |ring: usize, degrees: f64, part: f64| {
        let sector = (degrees / 360.0).rem_euclid(1.0) * sectors as f64 - 0.5;
        let (first, share) = (sector.floor(), sector - sector.floor());
        let cell = |sector: f64| ring * sectors + (sector as i64).rem_euclid(sectors as i64) as usize;
        [(cell(first), part * (1.0 - share)), (cell(first + 1.0), part * share)]
    };
    let ([a, b], [c, d]) = (of_ring(below, degrees + turned, 1.0 - part), of_ring(above, degrees, part));
    [a, b, c, d]
}

/// The pixels of a disc of so many rings and sectors in the middle of a square picture, with this radius in pixels: offset, and the cells around it.
fn places(cells: (usize, usize), pixels: usize, radius: f64) -> impl Iterator<Item = (usize, Around)> {
    let middle = (pixels as f64 - 1.0) / 2.0;
    let place = move |offset: usize| {
        let (right, up) = (((offset % pixels) as f64 - middle) / radius, (middle - (offset / pixels) as f64) / radius);
        let distance = right.hypot(up);
        // A little beyond the rim, which is drawn over.
        let within = distance * radius <= radius + 1.0;
        within.then(|| (offset, around(cells, distance.min(1.0), (-right).atan2(up).to_degrees())))
    };
    let all = if cells.0 * cells.1 == 0 { 0 } else { pixels * pixels };
    (0..all).filter_map(place)
}

/// Where a disc's cells lie in a square picture, to draw several quantities on: for one it is more to keep than to find.
pub struct Disc {
    pixels: usize,
    cells: (usize, usize),
    places: Vec<(usize, Around)>,
}

impl Disc {
    /// A disc of so many rings and sectors in the middle of a picture of so many pixels, with this radius in pixels.
    pub fn new(cells: (usize, usize), pixels: usize, radius: f64) -> Self {
        // Not fewer than are within, so that it is allocated once.
        let most = (std::f64::consts::PI * (radius + 2.0).powi(2)) as usize;
        let mut within = Vec::with_capacity(most.min(pixels * pixels));
        within.extend(places(cells, pixels, radius));
        Self { pixels, cells, places: within }
    }

    /// A field of as many rings and sectors, `outside` beyond the disc.
    pub fn picture(&self, field: &PolarField<'_>, outside: [f32; 3]) -> Picture {
        debug_assert_eq!(self.cells, field.cells(), "a disc is of fields of its own size");
        field.painted(self.places.iter().copied(), self.pixels, outside)
    }
}

impl PolarField<'_> {
    /// Rings and sectors.
    pub fn cells(&self) -> (usize, usize) {
        (self.values.len(), self.values.first().map_or(0, Vec::len))
    }

    /// The value at a radius (0 to 1) and an angle in degrees, between those of the four cells around; `None` where most of it is missing.
    #[cfg(test)]
    fn at(&self, radius: f64, degrees: f64) -> Option<f64> {
        let cells: Vec<_> = self.values.iter().flatten().map(|&value| self.vector(value)).collect();
        if cells.is_empty() { None } else { self.between(&cells, &around(self.cells(), radius, degrees)) }
    }

    /// A value as what can be averaged, with 1; all zero where it is missing.
    fn vector(&self, value: Option<f64>) -> [f64; 3] {
        let Some(value) = value else { return [0.0; 3] };
        let (sine, cosine) = if self.cyclic { value.to_radians().sin_cos() } else { (0.0, value) };
        [cosine, sine, 1.0]
    }

    /// The value between cells.
    fn between(&self, cells: &[[f64; 3]], around: &Around) -> Option<f64> {
        let mut sums = [0.0; 3];
        for &(cell, share) in around {
            for (sum, part) in sums.iter_mut().zip(cells.get(cell).copied().unwrap_or_default()) {
                *sum += share * part;
            }
        }
        let [sum, other, whole] = sums;
        if whole < 0.5 {
            None
        } else if self.cyclic {
            Some(other.atan2(sum).to_degrees().rem_euclid(360.0))
        } else {
            Some(sum / whole)
        }
    }

    /// Where a value lies on the scale, 0 to 1 within its range.
    fn part(&self, value: f64) -> f64 {
        let [low, high] = self.range;
        (value - low) / (high - low)
    }

    /// The colour of a value.
    #[cfg(test)]
    fn colour(&self, value: Option<f64>) -> [f32; 3] {
        value.map_or(NEUTRAL, |value| self.scale.colour(self.part(value)))
    }

    /// A square picture of so many pixels, the disc in its middle with this radius in pixels, `outside` beyond it.
    pub fn picture(&self, pixels: usize, radius: f64, outside: [f32; 3]) -> Picture {
        self.painted(places(self.cells(), pixels, radius), pixels, outside)
    }

    fn painted(&self, places: impl Iterator<Item = (usize, Around)>, pixels: usize, outside: [f32; 3]) -> Picture {
        let cells: Vec<_> = self.values.iter().flatten().map(|&value| self.vector(value)).collect();
        let colours = self.scale.levels();
        let mut picture = Picture::of_colour(pixels, pixels, outside);
        for (offset, around) in places {
            let colour = self.between(&cells, &around).map_or(NEUTRAL, |value| colours[self.scale.level(self.part(value))]);
            picture.set(offset % pixels, offset / pixels, colour);
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_lie_where_their_cells_are_and_between_them() {
        // 4 rings, 8 sectors: the value is 10 · ring + sector.
        let values: Vec<Vec<Option<f64>>> = (0..4).map(|ring| (0..8).map(|sector| Some(f64::from(10 * ring + sector))).collect()).collect();
        let field = PolarField { values: &values, range: [0.0, 40.0], scale: Scale::Viridis, cyclic: false };
        let near = |at: Option<f64>, expected: f64| assert!((at.unwrap() - expected).abs() < 1e-9, "{at:?} {expected}");
        near(field.at(1.5 / 4.0, 2.5 / 8.0 * 360.0), 12.0);
        near(field.at(2.0 / 4.0, 2.5 / 8.0 * 360.0), 17.0);
        near(field.at(1.5 / 4.0, 3.0 / 8.0 * 360.0), 12.5);
        near(field.at(1.0, 0.5 / 8.0 * 360.0), 30.0);
        // At the tip half of either side.
        near(field.at(0.0, 0.5 / 8.0 * 360.0), 2.0);
        // Septal (90°) is left.
        let picture = field.picture(33, 15.0, [1.0; 3]);
        let at = |x: usize, y: usize| picture.rgb[3 * (y * 33 + x)..][..3].to_vec();
        let bytes = |colour: [f32; 3]| colour.map(|part| (part * 255.0).round() as u8).to_vec();
        assert_eq!(at(3, 16), bytes(field.colour(field.at(13.0 / 15.0, 90.0))));
        assert_eq!(at(0, 0), [255; 3]);
    }

    #[test]
    fn directions_are_averaged_as_such_and_what_is_missing_is_neutral() {
        let values = vec![vec![Some(350.0), Some(10.0), None, None]];
        let field = PolarField { values: &values, range: [0.0, 360.0], scale: Scale::Cycle, cyclic: true };
        let between = field.at(1.0, 90.0).unwrap();
        assert!(!(1e-9..=360.0 - 1e-9).contains(&between), "{between}");
        assert_eq!(field.at(1.0, 270.0), None);
        assert_eq!(field.colour(None).map(f32::to_bits), NEUTRAL.map(f32::to_bits));
    }
}
