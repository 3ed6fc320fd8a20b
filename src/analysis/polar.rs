//! Polar maps: a quantity of the wall unrolled onto a disc, the tip in its middle, anterior up, septal left.

use super::{places::Places, segments::Average};

/// Rings of a map, from the tip to the valve plane.
pub const RINGS: usize = 20;
/// Sectors of a map, from the anterior over the septal wall.
pub const SECTORS: usize = 60;
/// Nearest vertices that a cell is made of.
const NEAREST: usize = 4;

/// A map, `[RINGS][SECTORS]`: the value in the middle of each cell; `None` where no vertex near has one.
pub type Map = Vec<Vec<Option<f64>>>;

/// The map of a quantity: in each cell the mean of the nearest vertices, weighted by the inverse square of their distance in the disc.
pub fn map(values: &[Option<f64>], places: &Places, average: Average) -> Map {
    let points: Vec<([f64; 2], f64)> = values
        .iter()
        .zip(&places.of_vertex)
        .filter_map(|(value, place)| {
            let place = place.as_ref()?;
            Some((in_disc(place.radius, place.degrees), (*value)?))
        })
        .collect();
    (0..RINGS)
        .map(|ring| {
            (0..SECTORS)
                .map(|sector| {
                    let at = in_disc((ring as f64 + 0.5) / RINGS as f64, 360.0 * (sector as f64 + 0.5) / SECTORS as f64);
                    cell(&points, at, average)
                })
                .collect()
        })
        .collect()
}

/// The place in a disc of radius 1, `[to the right, up]`: anterior up, septal left.
pub fn in_disc(radius: f64, degrees: f64) -> [f64; 2] {
    let (sine, cosine) = degrees.to_radians().sin_cos();
    [-radius * sine, radius * cosine]
}

fn cell(points: &[([f64; 2], f64)], at: [f64; 2], average: Average) -> Option<f64> {
    let mut near: Vec<(f64, f64)> =
        points.iter().map(|(point, value)| ((point[0] - at[0]).powi(2) + (point[1] - at[1]).powi(2), *value)).collect();
    if near.is_empty() {
        return None;
    }
    let count = NEAREST.min(near.len());
    near.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    near.truncate(count);
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let weighted = near.iter().map(|&(distance, value)| (value, 1.0 / (distance + 1e-6)));
    if average == Average::Circular {
        return super::phase::circular_mean(weighted);
    }
    let (sum, weight) = weighted.fold((0.0, 0.0), |(sum, whole), (value, weight)| (sum + value * weight, whole + weight));
    Some(sum / weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anterior_is_up_and_septal_left() {
        let near = |[x, y]: [f64; 2], to: [f64; 2]| (x - to[0]).abs() < 1e-12 && (y - to[1]).abs() < 1e-12;
        assert!(near(in_disc(1.0, 0.0), [0.0, 1.0]) && near(in_disc(1.0, 90.0), [-1.0, 0.0]) && near(in_disc(0.5, 270.0), [0.5, 0.0]));
    }

    #[test]
    fn a_cell_is_the_mean_of_what_is_near_also_for_angles() {
        let points = [([0.0, 0.1], 350.0), ([0.0, -0.1], 20.0)];
        let angle = cell(&points, [0.0, 0.0], Average::Circular).unwrap();
        assert!((angle - 5.0).abs() < 1e-9, "{angle}");
        assert!((cell(&points, [0.0, 0.0], Average::Plain).unwrap() - 185.0).abs() < 1e-9);
        assert_eq!(cell(&[], [0.0, 0.0], Average::Plain), None);
    }
}
