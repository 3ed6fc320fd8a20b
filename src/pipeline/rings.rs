//! Telling the endocardial border from the epicardial one (paper §7.1): circumferences grow about the ventricle's axis, and the first
//! and second one that meet border all round are the endocardium and the epicardium.
//!
//! The paper counts border voxels; on coarse grids and gaps counts mislead, so coverage is counted by angular sectors. And since counts
//! rise across the endocardium and fall across the epicardium, each border has its own edges, with thresholds of its own: at the end of
//! systole the endocardial gradient is a fraction of the epicardial one and would not pass the common threshold.

use super::{
    Surface,
    canny::{EdgePoint, Gradient, edges},
    ends::median,
    parameters::Parameters,
    region::Extent,
};
use crate::volume::VoxelSet;
use std::f64::consts::{PI, TAU};

/// Angular sectors of a circumference: 10° each, about a pixel at the radius of a ventricle.
pub(super) const SECTORS: usize = 36;
/// Least part of a circumference that must meet border; a slice with less has none. A third of the wall is the largest defect
/// after which the rest still tells the radius.
const LEAST_COVERAGE: f64 = 0.4;
/// A circumference that meets border in this part of its sectors is a closed ring.
pub(super) const FULL_COVERAGE: f64 = 0.75;
/// Half the width of a circumference, as part of its radius, and at least this many pixels: ventricles are not round.
const BAND_OF_RADIUS: f64 = 0.3;
const BAND_PIXELS: f64 = 2.0;
/// How far a circumference may differ from the median of its neighbours', as part of it: a ventricle narrows by less within 10 mm.
const NEIGHBOURS_AGREE: f64 = 0.3;

/// Cosine of the greatest angle between the gradient and the direction from the axis: 45°. Where the wall ends at a defect, its border turns from
/// one surface to the other; each half of that turn belongs to its surface's side of the gap, not to its ring.
const ACROSS: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A slice whose strongest edge has less than this part of a typical slice's shows no wall. In one gate of each real study the weakest
/// epicardial slice has 0.4, and only the slice at the tip of the cavity less than this.
const FAINT: f32 = 0.2;

/// How far around, in sectors and in slices, a point of the border is compared with.
const AROUND: usize = 3;
/// How far a point may lie from the median of its surroundings, as part of that, and at least this many pixels.
const OUTLIER_OF_RADIUS: f64 = 0.15;
const OUTLIER_PIXELS: f64 = 1.25;

/// A border's radius in mm in each sector of a slice.
pub(super) type Radii = [Option<f64>; SECTORS];

/// The sectors of a circumference that meet border: a pixel hides all the sectors that it spans.
pub(super) fn seen_sectors(radii: &Radii, pixel_mm: f64) -> [bool; SECTORS] {
    let mut seen = [false; SECTORS];
    for (sector, radius) in radii.iter().enumerate() {
        let Some(radius_mm) = radius else { continue };
        let reach = spanned(*radius_mm, pixel_mm);
        for shift in 0..=2 * reach {
            seen[(sector + SECTORS + shift - reach) % SECTORS] = true;
        }
    }
    seen
}

/// The part of a circumference that meets border.
fn seen_part(radii: &Radii, pixel_mm: f64) -> f64 {
    seen_sectors(radii, pixel_mm).iter().filter(|&&seen| seen).count() as f64 / SECTORS as f64
}

/// Sectors that a pixel spans on either side of its own.
fn spanned(radius_mm: f64, pixel_mm: f64) -> usize {
    ((pixel_mm / radius_mm.max(pixel_mm / 2.0) * SECTORS as f64 / TAU / 2.0).round() as usize).min(SECTORS / 2)
}

/// A border voxel in the coordinates of its slice.
#[derive(Debug, Clone, Copy)]
struct Polar {
    radius_mm: f64,
    sector: usize,
}

/// The rings of one border.
pub(super) struct Rings {
    pub(super) surface: Surface,
    /// Mean radius of the border in each slice of the grid, if it has one.
    pub(super) radius_mm: Vec<Option<f64>>,
    pub(super) coverage: Vec<f64>,
    pub(super) points: Vec<EdgePoint>,
}

impl Rings {
    /// Mean part of the circumferences that met border.
    pub(super) fn mean_coverage(&self) -> f64 {
        let found: Vec<f64> = self.coverage.iter().zip(&self.radius_mm).filter(|(_, radius)| radius.is_some()).map(|(c, _)| *c).collect();
        found.iter().sum::<f64>() / found.len().max(1) as f64
    }

    /// The border's mean radius in each sector of a slice, where it was seen.
    pub(super) fn radii(&self, extent: &Extent, slice: usize) -> Radii {
        let mut sums = [(0.0, 0_u32); SECTORS];
        for point in self.points.iter().filter(|point| point.voxel[0] == slice) {
            let polar = polar(extent, point);
            sums[polar.sector].0 += polar.radius_mm;
            sums[polar.sector].1 += 1;
        }
        sums.map(|(sum, count)| (count > 0).then(|| sum / f64::from(count)))
    }

    /// Drops the points that stand out from their surroundings on the surface: the right ventricle's wall, the liver, noise.
    fn reject_outliers(&mut self, extent: &Extent, pixel_mm: f64) {
        let maps: Vec<Radii> = (0..self.radius_mm.len()).map(|slice| self.radii(extent, slice)).collect();
        let typical = |slice: usize, sector: usize| {
            let slices = slice.saturating_sub(AROUND)..=(slice + AROUND).min(maps.len() - 1);
            let mut around: Vec<f64> = slices
                .flat_map(|slice| (0..=2 * AROUND).map(move |shift| (slice, (sector + SECTORS + shift - AROUND) % SECTORS)))
                .filter_map(|(slice, sector)| maps[slice][sector])
                .collect();
            median(&mut around)
        };
        self.points.retain(|point| {
            let polar = polar(extent, point);
            let typical = typical(point.voxel[0], polar.sector);
            (polar.radius_mm - typical).abs() <= (OUTLIER_OF_RADIUS * typical).max(OUTLIER_PIXELS * pixel_mm)
        });
        for slice in 0..self.radius_mm.len() {
            let radii = self.radii(extent, slice);
            let seen: Vec<f64> = radii.iter().flatten().copied().collect();
            self.radius_mm[slice] = (!seen.is_empty()).then(|| seen.iter().sum::<f64>() / seen.len() as f64);
            self.coverage[slice] = seen_part(&radii, pixel_mm);
        }
    }

    /// Drops the rings next to the apex that are not closed: where the cavity or the wall ends obliquely, edges of its floor look like part of
    /// a ring.
    fn trim_apex(&mut self, extent: &Extent) {
        let mut slices: Vec<usize> = (0..self.radius_mm.len()).filter(|&slice| self.radius_mm[slice].is_some()).collect();
        if extent.towards_base() < 0.0 {
            slices.reverse();
        }
        let closed = slices.iter().position(|&slice| self.coverage[slice] >= FULL_COVERAGE).unwrap_or(0);
        for &slice in &slices[..closed] {
            self.radius_mm[slice] = None;
            self.points.retain(|point| point.voxel[0] != slice);
        }
    }
}

/// The edges of one border: those whose gradient has its sign, on the best circumference of each slice. A slice whose circumference
/// does not go with its neighbours' is searched again near theirs.
pub(super) fn rings(gradient: &Gradient, extent: &Extent, parameters: &Parameters, surface: Surface, outer_mm: &[Option<f64>]) -> Rings {
    let grid = gradient.field.grid;
    let pixel_mm = grid.spacing_mm[1].max(grid.spacing_mm[2]);
    let eligible = eligible(gradient, extent, surface, outer_mm);
    let mut slices: Vec<Vec<(EdgePoint, Polar)>> = vec![Vec::new(); grid.shape[0]];
    for point in edges(gradient, &eligible, &parameters.edges) {
        slices[point.voxel[0]].push((point, polar(extent, &point)));
    }
    drop_faint(&mut slices);
    let first: Vec<Option<f64>> = slices.iter().map(|points| circumference(points, pixel_mm, (pixel_mm, extent.radius_mm))).collect();
    // Radii and coverage follow from the points once those that stand out are gone.
    let mut rings = Rings { surface, radius_mm: vec![None; grid.shape[0]], coverage: vec![0.0; grid.shape[0]], points: Vec::new() };
    for (slice, points) in slices.iter().enumerate() {
        let limits = match median_around(&first, slice, grid.spacing_mm[0]) {
            Some(typical) => (typical * (1.0 - NEIGHBOURS_AGREE), typical * (1.0 + NEIGHBOURS_AGREE)),
            None => (pixel_mm, extent.radius_mm),
        };
        let Some(radius_mm) = circumference(points, pixel_mm, limits) else { continue };
        let band = band_mm(radius_mm, pixel_mm);
        let near = points.iter().filter(|(point, polar)| (polar.radius_mm - radius_mm).abs() <= band && runs_around(extent, point));
        rings.points.extend(near.map(|(point, _)| *point));
    }
    rings.reject_outliers(extent, pixel_mm);
    rings.trim_apex(extent);
    rings
}

/// Drops the edges of slices without wall: thresholds are relative to the slice, and in an empty one noise passes them.
fn drop_faint(slices: &mut [Vec<(EdgePoint, Polar)>]) {
    let strongest: Vec<f32> = slices.iter().map(|points| points.iter().map(|(point, _)| point.strength).fold(0.0, f32::max)).collect();
    let mut sorted: Vec<f32> = strongest.iter().copied().filter(|&strength| strength > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    // The upper quartile: up to three quarters of the slices may be empty.
    let Some(typical) = sorted.get(sorted.len() * 3 / 4) else { return };
    for (points, strongest) in slices.iter_mut().zip(strongest) {
        if strongest < FAINT * typical {
            points.clear();
        }
    }
}

/// Whether a border runs around the axis rather than towards it, as at the sides of a gap in the wall.
fn runs_around(extent: &Extent, point: &EdgePoint) -> bool {
    let out = extent.from_axis_mm(point.position_mm).normalize_or_zero();
    out.dot(point.uphill.truncate().normalize_or_zero()).abs() >= ACROSS
}

/// Median radius of the slices within 10 mm.
fn median_around(radii: &[Option<f64>], slice: usize, spacing_z_mm: f64) -> Option<f64> {
    let reach = (10.0 / spacing_z_mm).ceil() as usize;
    let around = &radii[slice.saturating_sub(reach)..=(slice + reach).min(radii.len() - 1)];
    let mut found: Vec<f64> = around.iter().flatten().copied().collect();
    (!found.is_empty()).then(|| median(&mut found))
}

fn band_mm(radius_mm: f64, pixel_mm: f64) -> f64 {
    (BAND_OF_RADIUS * radius_mm).max(BAND_PIXELS * pixel_mm)
}

/// Voxels of the useful slices inside the filtering circle across which counts rise outwards (endocardium) or fall (epicardium).
fn eligible(gradient: &Gradient, extent: &Extent, surface: Surface, outer_mm: &[Option<f64>]) -> VoxelSet {
    let grid = gradient.field.grid;
    let [gx, gy, _] = &gradient.field.components;
    let mut set = VoxelSet::empty(grid.shape);
    for z in (0..grid.shape[0]).filter(|&z| extent.is_useful(z)) {
        let outer = outer_mm[z];
        if surface == Surface::Endocardial && outer.is_none() {
            continue;
        }
        for y in 0..grid.shape[1] {
            for x in 0..grid.shape[2] {
                let out = extent.from_axis_mm(grid.position_mm([z, y, x]));
                let radius = out.length();
                if radius > extent.radius_mm || !extent.known.member[[z, y, x]] {
                    continue;
                }
                let rise = f64::from(gx[[z, y, x]]) * out.x + f64::from(gy[[z, y, x]]) * out.y;
                set.member[[z, y, x]] = match surface {
                    Surface::Endocardial => rise > 0.0 && outer.is_some_and(|outer| radius < outer),
                    Surface::Epicardial => rise < 0.0,
                };
            }
        }
    }
    set
}

fn polar(extent: &Extent, point: &EdgePoint) -> Polar {
    let out = extent.from_axis_mm(point.position_mm);
    let turn = (out.y.atan2(out.x) + PI) / TAU;
    Polar { radius_mm: out.length(), sector: ((turn * SECTORS as f64) as usize).min(SECTORS - 1) }
}

/// Grows a circumference in steps of half a pixel; the one that meets border in most sectors wins, the smaller on a tie.
fn circumference(points: &[(EdgePoint, Polar)], pixel_mm: f64, (smallest_mm, largest_mm): (f64, f64)) -> Option<f64> {
    let mut best: Option<(f64, f64)> = None;
    let mut radius_mm = smallest_mm;
    while radius_mm <= largest_mm {
        let band = band_mm(radius_mm, pixel_mm);
        let mut met = [0.0_f64; SECTORS];
        for (_, point) in points {
            // A point at the middle of the band counts fully, one at its rim half: of several equal coverages the centred one wins.
            let off = (point.radius_mm - radius_mm).abs() / band;
            if off <= 1.0 {
                // A pixel hides all the sectors that it spans, the more the nearer it is.
                let reach = spanned(point.radius_mm, pixel_mm);
                for shift in 0..=2 * reach {
                    let sector = (point.sector + SECTORS + shift - reach) % SECTORS;
                    met[sector] = met[sector].max(1.0 - 0.5 * off);
                }
            }
        }
        let score = met.iter().sum::<f64>() / SECTORS as f64;
        let coverage = met.iter().filter(|&&met| met > 0.0).count() as f64 / SECTORS as f64;
        if coverage >= LEAST_COVERAGE && best.is_none_or(|(_, most)| score > most + 1e-9) {
            best = Some((radius_mm, score));
        }
        radius_mm += pixel_mm / 2.0;
    }
    best.map(|(radius_mm, _)| radius_mm)
}

/// The angle about the axis of a place among the sectors.
pub(super) fn angle_of(sector: f64) -> f64 {
    (sector + 0.5) / SECTORS as f64 * TAU - PI
}
