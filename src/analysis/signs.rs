//! Signs that speak against a study or its reconstruction: what surrounds the wall, what of it the image does not hold, how the gates go together,
//! what the valve plane does. They are judged by `report::quality`, which says where the limits come from.

use super::{
    counts,
    perfusion::Perfusion,
    places::{Place, Places},
    segments::{self, Average},
};
use crate::{
    pipeline::{Reconstruction, Surface},
    study::Study,
    volume::{Grid, sample_scalar},
};
use glam::DVec3;
use rayon::prelude::*;

/// How far from the outer surface something bright is looked for, in full widths at half maximum of the point-spread function: a wall's own blur leaves
/// 1 % of its counts there.
const BESIDE: f64 = 1.0;
/// The width where no model of the camera was fitted, in mm: between usual cameras' 8 and 14.
const USUAL_FWHM_MM: f64 = 11.0;
/// Part of the wall's brightest counts from which on something beside it is bright: more than a right ventricle's.
const BRIGHT: f64 = 0.6;
/// Distance from the middle of the polar map from which on the wall is its ring at the valve plane.
const RING: f64 = 0.9;
/// Where the apex ends in it, and where the middle third of the wall lies.
const APEX: f64 = 0.3;
const MIDDLE: (f64, f64) = (0.5, 0.75);

/// What speaks against a study or its reconstruction.
#[derive(Debug, Clone, PartialEq)]
pub struct Signs {
    /// Of the gates and their order; `None` for fewer than four.
    pub gating: Option<GatingSigns>,
    /// Part of the wall's area whose outer surface, at end diastole, lies outside of the grid or where no gate has a count, in percent.
    pub unseen_percent: f64,
    /// The same of its ring at the valve plane, the outer tenth of the polar map.
    pub unseen_base_percent: f64,
    /// Mean counts of that ring in percent of the wall's largest.
    pub base_counts_percent: f64,
    /// Part of the wall's area beside which, one width of the point-spread function from the outer surface, something has more than .6 of the wall's
    /// largest counts, in percent.
    pub bright_beside_percent: f64,
    /// How far the middle of the valve plane moves towards the apex from end diastole to end systole, in mm; `None` for one gate.
    pub base_motion_mm: Option<f64>,
    /// How much opposite sides of the wall, both, have fewer counts than what lies between them, in percent of the mean: what the image of a
    /// patient who moved has. Across the axis: the second harmonic of the counts around it less the first (which one dim side has); along it: the
    /// counts of the middle less those of the brighter end.
    pub opposed_percent: f64,
}

/// What speaks against the gates or their order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GatingSigns {
    /// Counts of the poorest gate in percent of the median gate's.
    pub least_gate_percent: f64,
    /// Where the cavity is largest: from the R wave, which is where the first gate begins, to that gate's begin, as part of the cycle, −½ to ½.
    pub end_diastole: f64,
    /// From the largest to the smallest cavity as part of the cycle, 0 to 1.
    pub systole: f64,
    /// All ways of the volume up and down over the cycle over twice the stroke volume; 1: once down, once up.
    pub turns: f64,
}

impl Signs {
    /// Of a reconstruction with these cavities in ml; `ends` are the gates of end diastole and end systole, counted from 0.
    pub(super) fn of(
        study: &Study,
        reconstruction: &Reconstruction,
        places: &Places,
        perfusion: &Perfusion,
        cavity_ml: &[f64],
        ends: (usize, usize),
    ) -> Self {
        let in_ring = |place: &Place| place.radius > RING;
        let inner = |gate: usize| &reconstruction.gates[gate].fits.get(Surface::Endocardial).mesh;
        let base_mm = |gate: usize| places.base_height_mm(inner(gate)).unwrap_or(0.0);
        let lit = lit(study);
        let outer = &reconstruction.gates[ends.0].fits.get(Surface::Epicardial).mesh.positions;
        let unseen: Vec<Option<f64>> =
            outer.iter().map(|&point| Some(if is_lit(&lit, &study.grid, point) { 0.0 } else { 100.0 })).collect();
        let bright = BRIGHT * perfusion.maximum_counts;
        let beside = beside(study, reconstruction);
        let bright: Vec<Option<f64>> = beside.iter().map(|&counts| Some(if counts > bright { 100.0 } else { 0.0 })).collect();
        Self {
            opposed_percent: opposed_percent(&perfusion.percent, places),
            gating: GatingSigns::of(study, cavity_ml, ends),
            unseen_percent: mean(&unseen, places, |_| true),
            unseen_base_percent: mean(&unseen, places, in_ring),
            base_counts_percent: mean(&perfusion.percent, places, in_ring),
            bright_beside_percent: mean(&bright, places, |_| true),
            base_motion_mm: (reconstruction.gates.len() > 1).then(|| base_mm(ends.0) - base_mm(ends.1)),
        }
    }
}

impl GatingSigns {
    fn of(study: &Study, cavity_ml: &[f64], (diastole, systole): (usize, usize)) -> Option<Self> {
        let gates = cavity_ml.len();
        if gates < 4 {
            return None;
        }
        let mut totals: Vec<f64> = study.gates.iter().map(|gate| gate.volume.total()).collect();
        totals.sort_by(f64::total_cmp);
        let median = f64::midpoint(totals[(gates - 1) / 2], totals[gates / 2]);
        let ways_ml: f64 = (0..gates).map(|gate| (cavity_ml[(gate + 1) % gates] - cavity_ml[gate]).abs()).sum();
        let stroke_ml = cavity_ml[diastole] - cavity_ml[systole];
        let from_wave = diastole as f64 / gates as f64;
        Some(Self {
            least_gate_percent: if median > 0.0 { 100.0 * totals[0] / median } else { 0.0 },
            end_diastole: if from_wave > 0.5 { from_wave - 1.0 } else { from_wave },
            systole: ((systole + gates - diastole) % gates) as f64 / gates as f64,
            turns: if stroke_ml > 0.0 { ways_ml / (2.0 * stroke_ml) } else { 1.0 },
        })
    }
}

/// The mean of a quantity over some places of the wall, weighted by area; 0 without any.
fn mean(values: &[Option<f64>], places: &Places, chosen: impl Fn(&Place) -> bool) -> f64 {
    segments::mean_where(values, places, Average::Plain, chosen).unwrap_or(0.0)
}

/// See [`Signs::opposed_percent`]. Around the axis the wall between the apical third and the ring counts, along it apex, middle and base.
fn opposed_percent(percent: &[Option<f64>], places: &Places) -> f64 {
    let of_band = |low: f64, high: f64| mean(percent, places, |place| (low..high).contains(&place.radius));
    let around = of_band(MIDDLE.0, RING);
    if around <= 0.0 {
        return 0.0;
    }
    // Of what differs from the mean: the wall's area is not spread evenly over the angles.
    let harmonic = |order: f64| {
        let part = |wave: fn(f64) -> f64| {
            let weighted: Vec<Option<f64>> = (percent.iter().zip(&places.of_vertex))
                .map(|(value, place)| Some(((*value)? - around) * wave((order * place.as_ref()?.degrees).to_radians())))
                .collect();
            mean(&weighted, places, |place| (MIDDLE.0..RING).contains(&place.radius))
        };
        2.0 * part(f64::cos).hypot(part(f64::sin))
    };
    let across = harmonic(2.0) - harmonic(1.0);
    let along = of_band(MIDDLE.0, MIDDLE.1) - of_band(0.0, APEX).max(of_band(MIDDLE.1, RING));
    100.0 * across.max(along).max(0.0) / around
}

/// Which voxels have a count at some gate, slice by slice.
fn lit(study: &Study) -> Vec<bool> {
    let mut lit = vec![false; study.grid.voxels()];
    for gate in &study.gates {
        lit.iter_mut().zip(&gate.volume.counts).for_each(|(lit, &count)| *lit |= count > 0.0);
    }
    lit
}

fn is_lit(lit: &[bool], grid: &Grid, point_mm: DVec3) -> bool {
    let [_, rows, columns] = grid.shape;
    grid.voxel_at(point_mm).is_some_and(|[slice, row, column]| lit[(slice * rows + row) * columns + column])
}

/// Counts beside the wall at every vertex: the mean over the gates, each on its own surface and brought to the gates' mean total. 0 outside of the grid.
fn beside(study: &Study, reconstruction: &Reconstruction) -> Vec<f64> {
    let away_mm = BESIDE * reconstruction.model.as_ref().map_or(USUAL_FWHM_MM, |model| model.psf.fwhm_mm);
    let of_gates: Vec<Vec<f64>> = (study.gates.par_iter().zip(&reconstruction.gates).zip(&counts::levels(study)))
        .map(|((gate, result), level)| {
            let mesh = &result.fits.get(Surface::Epicardial).mesh;
            let at = |(&position, normal): (&DVec3, DVec3)| {
                let point = position + normal * away_mm;
                let inside = study.grid.voxel_at(point).is_some();
                if inside { sample_scalar(&study.grid, &gate.volume.counts, point) / level } else { 0.0 }
            };
            mesh.positions.iter().zip(mesh.normals()).map(at).collect()
        })
        .collect();
    (0..of_gates[0].len()).map(|vertex| of_gates.iter().map(|gate| gate[vertex]).sum::<f64>() / of_gates.len() as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        analysis::RotationSource,
        study::{Acquisition, Format, Gate},
        volume::Volume,
    };

    fn study(totals: &[f32]) -> Study {
        let grid = Grid { shape: [2, 2, 2], spacing_mm: [4.0; 3] };
        let gate = |&total: &f32| {
            let mut volume = Volume::zeros(grid);
            volume.counts.fill(total / 8.0);
            Gate { volume, duration_ms: None }
        };
        Study {
            grid,
            gates: totals.iter().map(gate).collect(),
            orientation: None,
            acquisition: Acquisition::unknown(Format::Json),
            warnings: Vec::new(),
        }
    }

    fn gating(totals: &[f32], cavity_ml: &[f64]) -> Option<GatingSigns> {
        GatingSigns::of(&study(totals), cavity_ml, super::super::ends(cavity_ml))
    }

    #[test]
    fn a_cycle_in_order_goes_down_and_up_once() {
        let signs = gating(&[80.0; 8], &[120.0, 100.0, 70.0, 50.0, 60.0, 80.0, 100.0, 110.0]).unwrap();
        assert_eq!((signs.end_diastole, signs.systole, signs.least_gate_percent), (0.0, 0.375, 100.0));
        assert!((signs.turns - 1.0).abs() < 1e-12, "{signs:?}");
        assert_eq!(gating(&[80.0; 3], &[3.0, 1.0, 2.0]), None);
    }

    #[test]
    fn exchanged_gates_turn_more_often_and_late_ones_are_seen_against_the_wave() {
        // 120 → 50 → 100 → 70 → 60 → 80 → 100 → 110 → 120: 70 + 50 + 30 + 10 + 20 + 20 + 10 + 10 over twice 70.
        let exchanged = gating(&[80.0; 8], &[120.0, 50.0, 100.0, 70.0, 60.0, 80.0, 100.0, 110.0]).unwrap();
        assert!((exchanged.turns - 220.0 / 140.0).abs() < 1e-12 && (exchanged.systole - 0.125).abs() < 1e-12, "{exchanged:?}");
        let rotated = gating(&[80.0; 8], &[70.0, 50.0, 60.0, 80.0, 100.0, 110.0, 120.0, 100.0]).unwrap();
        assert!((rotated.end_diastole + 0.25).abs() < 1e-12 && (rotated.systole - 0.375).abs() < 1e-12, "{rotated:?}");
    }

    #[test]
    fn a_gate_without_its_beats_is_measured_by_the_median_gate() {
        let signs = gating(&[80.0, 80.0, 80.0, 20.0], &[4.0, 2.0, 3.0, 4.0]).unwrap();
        assert!((signs.least_gate_percent - 25.0).abs() < 1e-4, "{signs:?}");
        assert!(gating(&[0.0; 4], &[4.0, 2.0, 3.0, 4.0]).unwrap().least_gate_percent.abs() < 1e-12);
    }

    /// Vertices every 5° on rings of the polar map, more area on one side.
    fn rings() -> Places {
        let place = |ring: usize, step: usize| {
            let degrees = 5.0 * step as f64;
            let area_mm2 = 10.0 + 6.0 * (2.0 * degrees.to_radians()).cos();
            Some(Place { segment: 1, degrees, radius: 0.05 + 0.1 * ring as f64, area_mm2 })
        };
        Places {
            of_vertex: (0..10).flat_map(|ring| (0..72).map(move |step| place(ring, step))).collect(),
            axes: [DVec3::X, DVec3::Y, DVec3::Z],
            centre_mm: DVec3::ZERO,
            rotation: RotationSource::Given,
        }
    }

    fn opposed(counts: impl Fn(&Place) -> f64) -> f64 {
        let places = rings();
        let percent: Vec<Option<f64>> = places.of_vertex.iter().flatten().map(|place| Some(counts(place))).collect();
        opposed_percent(&percent, &places)
    }

    #[test]
    fn opposite_sides_that_are_dim_are_seen_and_one_side_or_an_uneven_mesh_is_not() {
        assert!(opposed(|_| 80.0) < 1e-9);
        let wave = |order: f64| move |place: &Place| 80.0 + 16.0 * (order * place.degrees.to_radians()).cos();
        let (both, one) = (opposed(wave(2.0)), opposed(wave(1.0)));
        assert!(both > 15.0 && one < 1e-9, "{both} {one}");
        let ends = opposed(|place| if (0.5..0.75).contains(&place.radius) { 90.0 } else { 60.0 });
        let apex = opposed(|place| if place.radius < 0.3 { 60.0 } else { 90.0 });
        assert!(ends > 30.0 && apex < 1e-9, "{ends} {apex}");
    }

    #[test]
    fn voxels_without_a_count_at_any_gate_are_unseen() {
        let mut study = study(&[8.0, 8.0]);
        study.gates[0].volume.counts[[0, 0, 1]] = 0.0;
        for gate in &mut study.gates {
            gate.volume.counts[[1, 0, 0]] = 0.0;
        }
        let lit = lit(&study);
        assert!(is_lit(&lit, &study.grid, DVec3::new(4.0, 0.0, 0.0)), "one gate has it");
        assert!(!is_lit(&lit, &study.grid, DVec3::new(0.0, 0.0, 4.0)), "none has it");
        assert!(!is_lit(&lit, &study.grid, DVec3::new(9.0, 0.0, 0.0)), "outside");
    }
}
