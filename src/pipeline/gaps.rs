//! Borders found in part: where around the ventricle and over which slices no border was seen, for the reader of the result.

use super::{
    PerSurface, Surface,
    arc::longest_run,
    ends::APEX_TO_BASE,
    region::Extent,
    rings::{Rings, SECTORS, seen_sectors},
};
use crate::study::{Affected, AffectedArc, Orientation, Warning};
use glam::DVec3;

/// Mean part of the circumferences that met border, below which the gap is told.
const FULL_COVERAGE: f64 = 0.75;
/// How far the stack must run the usual way through the patient for the walls to be named, as a cosine: 60°.
const USUAL: f64 = 0.5;
/// The walls in the order of their angles from the lateral one, a quarter of a turn each, seen from the apex with the anterior wall above.
const WALLS: [&str; 4] = ["lateral", "inferior", "septal", "anterior"];
/// The edges of the image in the order of their angles.
const EDGES: [&str; 4] = ["last column", "last row", "first column", "first row"];

/// A region of one border in which nothing was seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gap {
    /// Its first and last slice, from 0.
    pub slices: [usize; 2],
    /// Its first sector of 10°, counted from the direction of the first column, and their number.
    pub sectors: [usize; 2],
}

/// What was not seen of a gate's borders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unseen {
    /// The largest contiguous gap of each border.
    pub gap: PerSurface<Option<Gap>>,
    /// Slices (from 0) between the end of the wall and the nearest ring, where the apex shows no wall.
    pub apex: Option<PerSurface<[usize; 2]>>,
}

/// The largest contiguous region of a border's sectors without border, between its first and last slice.
pub(super) fn largest(rings: &Rings, extent: &Extent, pixel_mm: f64) -> Option<Gap> {
    let with_ring = || (0..rings.radius_mm.len()).filter(|&slice| rings.radius_mm[slice].is_some());
    let (first, last) = (with_ring().min()?, with_ring().max()?);
    let missing: Vec<[bool; SECTORS]> =
        (first..=last).map(|slice| seen_sectors(&rings.radii(extent, slice), pixel_mm).map(|seen| !seen)).collect();
    let largest = regions(&missing).into_iter().max_by_key(Vec::len)?;
    // A sector belongs to the gap where it is missing in half of the gap's slices.
    let (low, high) = largest.iter().fold((usize::MAX, 0), |(low, high), &(slice, _)| (low.min(slice), high.max(slice)));
    let mut counts = [0; SECTORS];
    for &(_, sector) in &largest {
        counts[sector] += 1;
    }
    let (start, length) = longest_run(&counts.map(|count| 2 * count > high - low))?;
    let in_run = |sector: usize| (sector + SECTORS - start) % SECTORS < length;
    let affected = || (low..=high).filter(|&slice| 2 * largest.iter().filter(|cell| cell.0 == slice && in_run(cell.1)).count() >= length);
    Some(Gap { slices: [first + affected().min()?, first + affected().max()?], sectors: [start, length] })
}

/// Connected regions of missing cells `(slice, sector)`; sectors go round.
fn regions(missing: &[[bool; SECTORS]]) -> Vec<Vec<(usize, usize)>> {
    let mut left: Vec<[bool; SECTORS]> = missing.to_vec();
    let mut regions = Vec::new();
    for slice in 0..left.len() {
        for sector in 0..SECTORS {
            let mut region = Vec::new();
            let mut front = vec![(slice, sector)];
            while let Some((slice, sector)) = front.pop() {
                if slice < left.len() && std::mem::take(&mut left[slice][sector]) {
                    region.push((slice, sector));
                    front.extend([(slice, (sector + 1) % SECTORS), (slice, (sector + SECTORS - 1) % SECTORS), (slice + 1, sector)]);
                    front.extend(slice.checked_sub(1).map(|below| (below, sector)));
                }
            }
            if !region.is_empty() {
                regions.push(region);
            }
        }
    }
    regions
}

/// The warnings of one gate: at most one for each surface.
pub(super) fn warnings(
    gate: usize,
    coverage: &PerSurface<f64>,
    unseen: &Unseen,
    orientation: Option<&Orientation>,
    base_at_last_slice: bool,
) -> Vec<Warning> {
    let walls = orientation.and_then(|orientation| Walls::of(orientation, base_at_last_slice));
    Surface::BOTH
        .into_iter()
        .filter_map(|surface| {
            let (seen, name) = (*coverage.get(surface), surface.name());
            let gap = unseen.gap.get(surface).filter(|_| seen < FULL_COVERAGE);
            let apex = unseen.apex.as_ref().map(|apex| *apex.get(surface));
            let [first, last] = match (gap, apex) {
                (None, None) => return None,
                (Some(gap), None) => gap.slices,
                (None, Some(apex)) => apex,
                (Some(Gap { slices: [a, b], .. }), Some([c, d])) => [c.min(a), d.max(b)],
            };
            let arc = gap.as_ref().map(|gap| arc(gap, walls.as_ref()));
            let mut sentences = Vec::new();
            if let Some(arc) = &arc {
                let named = if arc.walls.is_empty() { String::new() } else { format!(" ({})", arc.walls.join(", ")) };
                sentences.push(format!(
                    "The {name} border was seen on {:.0} % of the circumferences; the surface bridges the rest, most of it towards the {}{named}.",
                    100.0 * seen,
                    arc.towards
                ));
            }
            if apex.is_some() {
                sentences.push(format!("No wall was seen at the apex: the {name} surface is closed where the wall around ends."));
            }
            let affected = Affected {
                surface: name.to_owned(),
                first_slice: first + 1,
                last_slice: last + 1,
                arc,
                apex_unseen: apex.is_some(),
            };
            Some(Warning { affected: Some(affected), ..Warning::at_gate(gate, "partial_border", sentences.join(" ")) })
        })
        .collect()
}

/// A gap's part of the circumference, in degrees from the last column towards the last row.
fn arc(gap: &Gap, walls: Option<&Walls>) -> AffectedArc {
    const DEGREES: usize = 360 / SECTORS;
    let [start, length] = gap.sectors;
    // Sectors are counted from the first column, half a turn from the last one.
    let from = (start * DEGREES + 180) % 360;
    let middle = from as f64 + (length * DEGREES) as f64 / 2.0;
    let towards = EDGES[(middle / 90.0).round() as usize % EDGES.len()];
    AffectedArc {
        from_degrees: from,
        to_degrees: (from + length * DEGREES - 1) % 360 + 1,
        towards: towards.to_owned(),
        walls: walls.map_or_else(Vec::new, |walls| walls.within(middle, (length * DEGREES) as f64 / 2.0)),
    }
}

/// Where the walls lie in the image, for a study that says where it lies in the patient.
struct Walls {
    /// Angle of the lateral wall in degrees.
    lateral: f64,
    /// +1 where angles grow from the lateral to the inferior wall.
    sense: f64,
}

impl Walls {
    /// The inferior wall lies towards the feet, the lateral one towards the patient's left, both across the long axis. Nothing where the stack
    /// does not run the usual way from apex to base.
    fn of(orientation: &Orientation, base_at_last_slice: bool) -> Option<Self> {
        let to_base = if base_at_last_slice { orientation.slices } else { -orientation.slices };
        if to_base.dot(APEX_TO_BASE) < USUAL {
            return None;
        }
        let inferior = DVec3::NEG_Z.reject_from(to_base).try_normalize()?;
        let lateral = inferior.cross(to_base);
        let angle = |direction: DVec3| direction.dot(orientation.rows).atan2(direction.dot(orientation.columns)).to_degrees();
        let turn = (angle(inferior) - angle(lateral)).rem_euclid(360.0);
        Some(Self { lateral: angle(lateral), sense: if turn < 180.0 { 1.0 } else { -1.0 } })
    }

    /// The walls whose middle lies within an arc; the one nearest the arc's middle always, and first.
    fn within(&self, middle: f64, half_width: f64) -> Vec<String> {
        let from_middle = |wall: usize| {
            let at = self.lateral + self.sense * 90.0 * wall as f64;
            ((at - middle + 180.0).rem_euclid(360.0) - 180.0).abs()
        };
        let mut walls: Vec<usize> = (0..WALLS.len()).collect();
        walls.sort_by(|&a, &b| from_middle(a).total_cmp(&from_middle(b)));
        walls
            .into_iter()
            .enumerate()
            .filter(|&(rank, wall)| rank == 0 || from_middle(wall) <= half_width)
            .map(|(_, wall)| WALLS[wall].to_owned())
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gap(from: usize, length: usize) -> Gap {
        Gap { slices: [3, 9], sectors: [from, length] }
    }

    #[test]
    fn arcs_are_told_in_degrees_and_by_the_image() {
        // Sector 3 begins 30° after the first column, towards the first row.
        let found = arc(&gap(3, 12), None);
        assert_eq!((found.from_degrees, found.to_degrees, found.towards.as_str()), (210, 330, "first row"));
        assert!(found.walls.is_empty());
        let over_zero = arc(&gap(15, 6), None);
        assert_eq!((over_zero.from_degrees, over_zero.to_degrees, over_zero.towards.as_str()), (330, 30, "last column"));
        let whole = arc(&gap(0, SECTORS), None);
        assert_eq!((whole.from_degrees, whole.to_degrees), (180, 180));
    }

    #[test]
    fn walls_are_named_by_the_patient_and_only_then() {
        let to_base = APEX_TO_BASE.normalize();
        let inferior = DVec3::NEG_Z.reject_from(to_base).normalize();
        let lateral = inferior.cross(to_base);
        let upright = Orientation { columns: lateral, rows: inferior, slices: to_base, origin_mm: DVec3::ZERO };
        let named = |orientation: &Orientation, base_at_last_slice: bool, gap: &Gap| {
            Walls::of(orientation, base_at_last_slice).map(|walls| arc(gap, Some(&walls)).walls)
        };
        assert_eq!(named(&upright, true, &gap(3, 12)), Some(vec!["anterior".to_owned()]));
        // A mirrored image has its septum at the last column.
        let mirrored = Orientation { columns: -lateral, ..upright };
        assert_eq!(named(&mirrored, true, &gap(17, 2)), Some(vec!["septal".to_owned()]));
        let turned = Orientation { columns: inferior, rows: -lateral, ..upright };
        assert_eq!(named(&turned, true, &gap(17, 2)), Some(vec!["inferior".to_owned()]));
        assert_eq!(named(&upright, true, &gap(0, 19)).unwrap().len(), 3);
        assert_eq!(named(&upright, false, &gap(3, 12)), None, "the base is not where the patient has it");
        let long_axis = Orientation { slices: lateral, ..upright };
        assert_eq!(named(&long_axis, true, &gap(3, 12)), None);
    }

    #[test]
    fn regions_go_round_and_over_slices() {
        let mut missing = [[false; SECTORS]; 5];
        for slice in &mut missing[1..4] {
            for sector in [34, 35, 0, 1] {
                slice[sector] = true;
            }
        }
        missing[4][20] = true;
        let mut sizes: Vec<usize> = regions(&missing).iter().map(Vec::len).collect();
        sizes.sort_unstable();
        assert_eq!(sizes, [1, 12]);
        assert_eq!(longest_run(&missing[2]), Some((34, 4)));
        assert_eq!(longest_run(&missing[0]), None);
        assert_eq!(longest_run(&[true; SECTORS]), Some((0, SECTORS)));
    }
}
