//! The seventeen segments of the left ventricle (Cerqueira et al., Circulation 2002;105:539, "AHA") and the territories of the coronary
//! arteries that the same statement assigns them to.

use super::{
    phase::circular_mean,
    places::{Place, Places},
};

/// Number of segments.
pub const SEGMENTS: usize = 17;

/// A segment, counted from 1 as the statement does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// 1 to 17.
    pub number: usize,
    /// As the statement names it, in lower case.
    pub name: &'static str,
    /// The artery it is assigned to.
    pub territory: Territory,
}

/// The coronary arteries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Territory {
    /// Left anterior descending.
    Lad,
    /// Right coronary artery.
    Rca,
    /// Left circumflex.
    Lcx,
}

impl Territory {
    /// All three.
    pub const ALL: [Self; 3] = [Self::Lad, Self::Rca, Self::Lcx];

    /// As it is written.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lad => "LAD",
            Self::Rca => "RCA",
            Self::Lcx => "LCX",
        }
    }
}

const fn segment(number: usize, name: &'static str, territory: Territory) -> Segment {
    Segment { number, name, territory }
}

/// All segments, number 1 first.
pub const ALL: [Segment; SEGMENTS] = [
    segment(1, "basal anterior", Territory::Lad),
    segment(2, "basal anteroseptal", Territory::Lad),
    segment(3, "basal inferoseptal", Territory::Rca),
    segment(4, "basal inferior", Territory::Rca),
    segment(5, "basal inferolateral", Territory::Lcx),
    segment(6, "basal anterolateral", Territory::Lcx),
    segment(7, "mid anterior", Territory::Lad),
    segment(8, "mid anteroseptal", Territory::Lad),
    segment(9, "mid inferoseptal", Territory::Rca),
    segment(10, "mid inferior", Territory::Rca),
    segment(11, "mid inferolateral", Territory::Lcx),
    segment(12, "mid anterolateral", Territory::Lcx),
    segment(13, "apical anterior", Territory::Lad),
    segment(14, "apical septal", Territory::Lad),
    segment(15, "apical inferior", Territory::Rca),
    segment(16, "apical lateral", Territory::Lcx),
    segment(17, "apex", Territory::Lad),
];

/// The number of the segment at a height above the tip of the cavity, as a part of its length (below 0: the apex, where there is no cavity),
/// and an angle in degrees from the anterior towards the septal wall.
pub fn at(height: f64, degrees: f64) -> usize {
    let sector = |first: usize, count: usize| {
        let width = 360.0 / count as f64;
        first + ((degrees + width / 2.0).rem_euclid(360.0) / width) as usize % count
    };
    match height {
        height if height < 0.0 => 17,
        height if height < 1.0 / 3.0 => sector(13, 4),
        height if height < 2.0 / 3.0 => sector(7, 6),
        _ => sector(1, 6),
    }
}

/// How values are averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Average {
    /// As numbers.
    Plain,
    /// As directions in degrees.
    Circular,
}

/// Means over each segment, weighted by the wall's area; `None` where a segment has no vertex with a value. `[SEGMENTS]`.
pub fn means(values: &[Option<f64>], places: &Places, average: Average) -> Vec<Option<f64>> {
    ALL.iter().map(|segment| mean_where(values, places, average, |place| place.segment == segment.number)).collect()
}

/// Means over each territory likewise, in the order of [`Territory::ALL`].
pub fn territory_means(values: &[Option<f64>], places: &Places, average: Average) -> Vec<Option<f64>> {
    Territory::ALL
        .iter()
        .map(|&territory| mean_where(values, places, average, |place| ALL[place.segment - 1].territory == territory))
        .collect()
}

/// The mean over the vertices of some places, weighted by the wall's area.
pub fn mean_where(values: &[Option<f64>], places: &Places, average: Average, wanted: impl Fn(&Place) -> bool) -> Option<f64> {
    let of_wanted = values.iter().zip(&places.of_vertex).filter_map(|(value, place)| {
        let place = place.as_ref().filter(|place| wanted(place))?;
        Some(((*value)?, place.area_mm2))
    });
    if average == Average::Circular {
        return circular_mean(of_wanted);
    }
    let (sum, area) = of_wanted.fold((0.0, 0.0), |(sum, whole), (value, area)| (sum + value * area, whole + area));
    (area > 0.0).then(|| sum / area)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_lie_where_the_statement_has_them() {
        // Degrees from anterior (0) over septal (90) and inferior (180) to lateral (270).
        let basal: Vec<usize> = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0].iter().map(|&degrees| at(0.8, degrees)).collect();
        assert_eq!(basal, [1, 2, 3, 4, 5, 6]);
        assert_eq!([0.0, 90.0, 180.0, 270.0].map(|degrees| at(0.2, degrees)), [13, 14, 15, 16]);
        assert_eq!((at(0.5, -29.0), at(0.5, 31.0), at(0.5, 330.5), at(0.5, 329.0)), (7, 8, 7, 12));
        assert_eq!((at(-0.01, 200.0), at(1.2, 359.9), at(0.0, 46.0)), (17, 1, 14));
    }

    #[test]
    fn numbers_are_in_order_and_territories_as_assigned() {
        assert!(ALL.iter().enumerate().all(|(index, segment)| segment.number == index + 1));
        let of = |territory| ALL.iter().filter(|segment| segment.territory == territory).map(|segment| segment.number).collect::<Vec<_>>();
        assert_eq!(of(Territory::Lad), [1, 2, 7, 8, 13, 14, 17]);
        assert_eq!(of(Territory::Rca), [3, 4, 9, 10, 15]);
        assert_eq!(of(Territory::Lcx), [5, 6, 11, 12, 16]);
    }
}
