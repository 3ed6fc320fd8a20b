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

impl PolarField<'_> {
    /// The value at a radius (0 to 1) and an angle in degrees, between those of the four cells around; `None` where most of it is missing.
    pub fn at(&self, radius: f64, degrees: f64) -> Option<f64> {
        let (rings, sectors) = (self.values.len(), self.values.first()?.len());
        let ring = (radius * rings as f64 - 0.5).min(rings as f64 - 1.0);
        let (mut sum, mut other, mut whole) = (0.0, 0.0, 0.0);
        let mut add = |ring: usize, degrees: f64, part: f64| {
            let sector = (degrees / 360.0).rem_euclid(1.0) * sectors as f64 - 0.5;
            let first = sector.floor();
            for (offset, share) in [(0, 1.0 - (sector - first)), (1, sector - first)] {
                let index = (first as i64 + offset).rem_euclid(sectors as i64) as usize;
                let weight = part * share;
                let Some(value) = self.values[ring.min(rings - 1)].get(index).copied().flatten() else { continue };
                let (sine, cosine) = if self.cyclic { value.to_radians().sin_cos() } else { (0.0, value) };
                sum += weight * cosine;
                other += weight * sine;
                whole += weight;
            }
        };
        // Within the first ring's middle the neighbour is the cell across the tip.
        let (below, opposite) = if ring < 0.0 { (0, true) } else { (ring as usize, false) };
        let part = ring - ring.floor();
        if opposite {
            add(0, degrees, part);
            add(0, degrees + 180.0, 1.0 - part);
        } else {
            add(below, degrees, 1.0 - part);
            add(below + 1, degrees, part);
        }
        if whole < 0.5 {
            None
        } else if self.cyclic {
            Some(other.atan2(sum).to_degrees().rem_euclid(360.0))
        } else {
            Some(sum / whole)
        }
    }

    /// The colour of a value.
    pub fn colour(&self, value: Option<f64>) -> [f32; 3] {
        let [low, high] = self.range;
        value.map_or(NEUTRAL, |value| self.scale.colour((value - low) / (high - low)))
    }

    /// A square picture of so many pixels, the disc in its middle with this radius in pixels, `around` outside of it.
    pub fn picture(&self, pixels: usize, radius: f64, around: [f32; 3]) -> Picture {
        let mut picture = Picture::of_colour(pixels, pixels, around);
        let middle = (pixels as f64 - 1.0) / 2.0;
        for y in 0..pixels {
            for x in 0..pixels {
                let (right, up) = ((x as f64 - middle) / radius, (middle - y as f64) / radius);
                let distance = right.hypot(up);
                // A little beyond the rim, which is drawn over.
                if distance * radius <= radius + 1.0 {
                    picture.set(x, y, self.colour(self.at(distance.min(1.0), (-right).atan2(up).to_degrees())));
                }
            }
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
