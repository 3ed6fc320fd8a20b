//! The spoiled studies, and the good ones beside them.

use super::super::{draw::Draw, hearts};
use crate::{
    phantom::{Defect, Liver, Phantom, Psf, Site},
    study::Study,
    volume::Grid,
};
use glam::DVec3;
use ndarray::{Array3, Slice};

/// What is wrong with a study.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Nothing: a ventricle as a usual camera sees it.
    Good,
    /// Nothing but what every clinic has, all at once.
    Clinic,
    /// Next to no counts.
    FewCounts,
    /// Beats lost in the last gates.
    LostBeats,
    /// The R wave is not before the first gate.
    Rotated,
    /// Gates in the wrong order.
    Shuffled,
    /// The image ends below the valve plane.
    BaseCut,
    /// The image ends above the tip.
    ApexCut,
    /// The image ends within a side wall.
    SideCut,
    /// Zero outside of a circle through the wall.
    Masked,
    /// Something as bright as the wall or brighter against it.
    HotOrgan,
    /// A defect of a large part of the wall.
    LargeDefect,
    /// A ventricle narrower than the camera resolves.
    Small,
    /// A camera that resolves nothing.
    Blurred,
    /// The patient moved.
    Moved,
}

impl Kind {
    /// All kinds, as the tables list them.
    pub const ALL: [Self; 15] = [
        Self::Good,
        Self::Clinic,
        Self::FewCounts,
        Self::LostBeats,
        Self::Rotated,
        Self::Shuffled,
        Self::BaseCut,
        Self::ApexCut,
        Self::SideCut,
        Self::Masked,
        Self::HotOrgan,
        Self::LargeDefect,
        Self::Small,
        Self::Blurred,
        Self::Moved,
    ];

    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Clinic => "good, clinic",
            Self::FewCounts => "few counts",
            Self::LostBeats => "lost beats",
            Self::Rotated => "gates rotated",
            Self::Shuffled => "gates shuffled",
            Self::BaseCut => "base cut off",
            Self::ApexCut => "apex cut off",
            Self::SideCut => "side cut off",
            Self::Masked => "masked",
            Self::HotOrgan => "hot organ",
            Self::LargeDefect => "large defect",
            Self::Small => "small",
            Self::Blurred => "blurred",
            Self::Moved => "moved",
        }
    }

    /// What it is.
    pub fn about(self) -> &'static str {
        match self {
            Self::Good => "EDV 65-240 ml, as the families `normal` to `growing PSF`",
            Self::Clinic => "the family `clinic`",
            Self::FewCounts => ".4-4 counts in the brightest wall voxel of .05 ml",
            Self::LostBeats => "one to three last gates with .05-.40 of the counts",
            Self::Rotated => "the first gate is two to six of eight gates after the R wave",
            Self::Shuffled => "three pairs of gates exchanged",
            Self::BaseCut => "the last 5-30 % of the ventricle's length beyond the last slice",
            Self::ApexCut => "the first 5-30 % of it before the first slice",
            Self::SideCut => "columns end 2-20 mm inside the epicardium, on either side",
            Self::Masked => "zero outside of a circle from 2 mm outside to 8 mm inside the epicardium's largest radius",
            Self::HotOrgan => "an organ of 1.5-5 times the wall's uptake 0-3 mm under the inferior wall",
            Self::LargeDefect => "40-65 % of the wall takes up nothing to a tenth",
            Self::Small => "EDV 22-42 ml, EF .65-.80",
            Self::Blurred => "a PSF of 20-30 mm",
            Self::Moved => "12-40 mm across or along the axis for 30-50 % of the time",
        }
    }

    /// The flags of which one at least is right for it; empty for good studies.
    pub fn flags(self) -> &'static [&'static str] {
        match self {
            Self::Good | Self::Clinic => &[],
            Self::FewCounts => &["low_counts"],
            Self::LostBeats | Self::Rotated | Self::Shuffled => &["gating"],
            Self::BaseCut => &["truncated", "valve_plane"],
            Self::ApexCut | Self::SideCut | Self::Masked => &["truncated"],
            Self::HotOrgan => &["extracardiac_activity"],
            Self::LargeDefect => &["large_defect"],
            Self::Small => &["small_heart"],
            Self::Blurred => &["small_heart", "psf_at_bound"],
            Self::Moved => &["motion"],
        }
    }

    /// Whether nothing is wrong.
    pub fn is_good(self) -> bool {
        self.flags().is_empty()
    }

    /// Studies of this kind in a half.
    fn studies(self, half: Half) -> usize {
        match (self, half) {
            (Self::Good, _) => 36,
            (Self::Clinic, _) => 16,
            (_, Half::Setting) => 8,
            (_, Half::Published) => 12,
        }
    }
}

/// Which half of the studies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Half {
    /// Those that the limits were set by.
    Setting,
    /// Those that are published.
    Published,
}

/// One study.
#[derive(Debug, Clone)]
pub struct Spoiled {
    /// Kind and number.
    pub name: String,
    /// What is wrong with it.
    pub kind: Kind,
    /// What is simulated.
    pub phantom: Phantom,
    /// What is done to the images then.
    pub damage: Damage,
}

/// What is done to simulated images.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Damage {
    /// Counts of the last gates against what they were, from the first of these on.
    pub last_gates: Vec<f64>,
    /// The simulated gate that stands at each place, where not in order.
    pub order: Option<Vec<usize>>,
    /// Voxels that are left along slices, rows and columns, `[from, to)`.
    pub kept: Option<[[usize; 2]; 3]>,
    /// How many voxels, along slices, rows, columns, the patient moves, and for which part of the time.
    pub moved: Option<([isize; 3], f64)>,
}

/// Every study of a half.
pub fn studies(half: Half) -> Vec<Spoiled> {
    let first = if half == Half::Setting { 500_000 } else { 700_000 };
    let of_kind = |(index, kind): (usize, Kind)| {
        (0..kind.studies(half)).map(move |number| {
            let seed = first + 1000 * index as u64 + number as u64;
            let mut draw = Draw::of(seed);
            let (mut phantom, damage) = make(kind, number, &mut draw);
            phantom.imaging.noise_seed = Some(seed);
            Spoiled { name: format!("{} #{}", kind.name(), number + 1), kind, phantom, damage }
        })
    };
    Kind::ALL.into_iter().enumerate().flat_map(of_kind).collect()
}

/// One of the families without anything that a flag is for.
fn usual(number: usize, draw: &mut Draw) -> Phantom {
    match number % 9 {
        0 => hearts::seen(hearts::normal(draw), draw),
        1 => hearts::seen(hearts::dilated(draw), draw),
        2 => hearts::base_tilted(draw),
        3 => hearts::uneven(draw),
        4 => hearts::right_ventricle(draw),
        5 => hearts::displaced(draw),
        6 => hearts::on_grid(draw, hearts::ISOTROPIC_6_4),
        7 => hearts::liver(draw, 10.0),
        _ => hearts::tailed(draw),
    }
}

fn make(kind: Kind, number: usize, draw: &mut Draw) -> (Phantom, Damage) {
    let none = Damage::default();
    match kind {
        Kind::Good => (usual(number, draw), none),
        Kind::Clinic => (hearts::clinic(draw), none),
        Kind::FewCounts => {
            let mut phantom = hearts::usual(draw);
            phantom.imaging.counts = draw.log_between(0.4, 4.0);
            (phantom, none)
        }
        Kind::LostBeats => {
            let last_gates = (0..=number % 3).map(|_| draw.between(0.05, 0.40)).collect();
            (hearts::usual(draw), Damage { last_gates, ..none })
        }
        Kind::Rotated => {
            let phantom = hearts::usual(draw);
            let (gates, by) = (phantom.imaging.gates, 2 + number % 5);
            (phantom, Damage { order: Some((0..gates).map(|gate| (gate + by) % gates).collect()), ..none })
        }
        Kind::Shuffled => {
            let phantom = hearts::usual(draw);
            let mut order: Vec<usize> = (0..phantom.imaging.gates).collect();
            let mut any = || (draw.between(0.0, order.len() as f64) as usize).min(7);
            let pairs: Vec<(usize, usize)> = (0..3).map(|_| (any(), any())).collect();
            for (one, other) in pairs {
                order.swap(one, other);
            }
            // Three exchanges may undo each other.
            if order.is_sorted() {
                order.swap(1, 5);
            }
            (phantom, Damage { order: Some(order), ..none })
        }
        Kind::BaseCut | Kind::ApexCut | Kind::SideCut => cut(kind, number, draw),
        Kind::Masked => {
            let mut phantom = hearts::usual(draw);
            phantom.pose.offset_mm = [draw.between(-2.0, 2.0), draw.between(-2.0, 2.0), 0.0];
            let widest_mm = phantom.shape.surfaces(0.0).map_or(0.0, |surfaces| surfaces.epicardium.widest_radius_mm());
            phantom.imaging.field_of_view_mm = Some(widest_mm - draw.between(-2.0, 8.0));
            (phantom, none)
        }
        Kind::HotOrgan => {
            let mut phantom = hearts::usual(draw);
            phantom.uptake.liver = Some(Liver { gap_mm: draw.between(0.0, 3.0), uptake: draw.between(1.5, 5.0) });
            (phantom, none)
        }
        Kind::LargeDefect => {
            let mut phantom = hearts::usual(draw);
            let site = [Site::Apical, Site::Anterior, Site::Inferior, Site::Septal, Site::Lateral][number % 5];
            phantom.uptake.defects = vec![Defect { site, extent: draw.between(0.40, 0.65), severity: draw.between(0.9, 1.0) }];
            (phantom, none)
        }
        Kind::Small => {
            let (edv_ml, ejection) = (draw.between(22.0, 42.0), draw.between(0.65, 0.80));
            (hearts::seen(hearts::ventricle(edv_ml, ejection, (1.5, 1.8), draw), draw), none)
        }
        Kind::Blurred => {
            let mut phantom = hearts::usual(draw);
            phantom.imaging.psf = Psf::gaussian(draw.between(20.0, 30.0));
            (phantom, none)
        }
        Kind::Moved => {
            let phantom = hearts::usual(draw);
            let (by_mm, part) = (draw.sign() * draw.between(12.0, 40.0), draw.between(0.3, 0.5));
            let axis = number % 3;
            let mut voxels = [0; 3];
            voxels[axis] = (by_mm / phantom.imaging.grid.spacing_mm[axis]).round() as isize;
            (phantom, Damage { moved: Some((voxels, part)), ..none })
        }
    }
}

/// Cuts the image within the ventricle, from its exact place at end diastole.
fn cut(kind: Kind, number: usize, draw: &mut Draw) -> (Phantom, Damage) {
    let phantom = hearts::usual(draw);
    let grid = &phantom.imaging.grid;
    let mut kept = grid.shape.map(|voxels| [0, voxels]);
    if let Some(exact) = phantom.exact_surfaces(0) {
        let along = |axis: usize| {
            let places = exact.epicardial.positions.iter().map(|position| position[2 - axis]);
            places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), mm| (low.min(mm), high.max(mm)))
        };
        let voxel = |axis: usize, mm: f64| ((mm / grid.spacing_mm[axis]).round().max(0.0) as usize).min(grid.shape[axis]);
        if kind == Kind::SideCut {
            let (low, high) = along(2);
            let inside_mm = draw.between(2.0, 20.0);
            if number.is_multiple_of(2) {
                kept[2][1] = voxel(2, high - inside_mm);
            } else {
                kept[2][0] = voxel(2, low + inside_mm);
            }
        } else {
            let (low, high) = along(0);
            let part = draw.between(0.05, 0.30) * (high - low);
            if kind == Kind::BaseCut { kept[0][1] = voxel(0, high - part) } else { kept[0][0] = voxel(0, low + part) }
        }
    }
    (phantom, Damage { kept: Some(kept), ..Damage::default() })
}

impl Damage {
    /// The simulated gate that stands at a place.
    pub fn gate_at(&self, place: usize) -> usize {
        self.order.as_ref().map_or(place, |order| order[place])
    }

    /// What is to be added to a point of the simulated grid to have it in the damaged study's, in mm.
    pub fn offset_mm(&self, grid: &Grid) -> DVec3 {
        let Some(kept) = &self.kept else { return DVec3::ZERO };
        let mm = |axis: usize| -(kept[axis][0] as f64) * grid.spacing_mm[axis];
        DVec3::new(mm(2), mm(1), mm(0))
    }

    /// The study so damaged.
    pub fn done_to(&self, study: &Study) -> Study {
        let mut damaged = study.clone();
        if self.order.is_some() {
            damaged.gates = (0..study.gates.len()).map(|place| study.gates[self.gate_at(place)].clone()).collect();
        }
        let whole = damaged.gates.len().saturating_sub(self.last_gates.len());
        for (gate, part) in damaged.gates[whole..].iter_mut().zip(&self.last_gates) {
            gate.volume.counts.mapv_inplace(|count| (f64::from(count) * part).round() as f32);
        }
        if let Some((by, part)) = self.moved {
            for gate in &mut damaged.gates {
                gate.volume.counts = doubled(&gate.volume.counts, by, part);
            }
        }
        if let Some(kept) = &self.kept {
            let shape = kept.map(|[from, to]| to - from);
            damaged.grid.shape = shape;
            for gate in &mut damaged.gates {
                let counts = gate.volume.counts.slice_each_axis(|of| {
                    let [from, to] = kept[of.axis.index()];
                    Slice::from(from..to)
                });
                gate.volume.counts = counts.as_standard_layout().into_owned();
                gate.volume.grid.shape = shape;
            }
            if let Some(orientation) = &mut damaged.orientation {
                orientation.origin_mm = study.orientation.map_or(DVec3::ZERO, |whole| whole.patient_mm(-self.offset_mm(&study.grid)));
            }
        }
        damaged
    }
}

/// An image and the same moved, each for its part of the time. What moves in repeats the edge.
fn doubled(counts: &Array3<f32>, by: [isize; 3], part: f64) -> Array3<f32> {
    let (nz, ny, nx) = counts.dim();
    let from = |index: usize, by: isize, extent: usize| (index as isize - by).clamp(0, extent as isize - 1) as usize;
    Array3::from_shape_fn(counts.dim(), |(z, y, x)| {
        let other = counts[[from(z, by[0], nz), from(y, by[1], ny), from(x, by[2], nx)]];
        ((1.0 - part) * f64::from(counts[[z, y, x]]) + part * f64::from(other)) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        phantom,
        study::{Acquisition, Format, Gate},
        volume::Volume,
    };
    use std::collections::BTreeSet;

    #[test]
    fn what_is_published_is_large_and_shares_no_seed_with_what_set_the_limits() {
        let (setting, published) = (studies(Half::Setting), studies(Half::Published));
        assert!(published.len() >= 200, "{}", published.len());
        let seeds: BTreeSet<_> = setting.iter().chain(&published).map(|study| study.phantom.imaging.noise_seed).collect();
        assert_eq!(seeds.len(), setting.len() + published.len());
        for study in &published {
            assert!(phantom::truth(&study.phantom).is_ok(), "{}", study.name);
            assert!(study.damage == Damage::default() || !study.kind.is_good(), "{}", study.name);
        }
    }

    fn ramp() -> Study {
        let grid = Grid { shape: [3, 2, 4], spacing_mm: [5.0, 4.0, 4.0] };
        let gate = |gate: usize| {
            let counts = Array3::from_shape_fn(grid.shape, |(z, y, x)| (1000 * gate + 100 * z + 10 * y + x) as f32);
            Gate { volume: Volume { grid, counts }, duration_ms: None }
        };
        let gates = (1..=4).map(gate).collect();
        Study { grid, gates, orientation: None, acquisition: Acquisition::unknown(Format::Phantom), warnings: Vec::new() }
    }

    #[test]
    fn gates_change_places_and_the_last_lose_counts() {
        let done = Damage { order: Some(vec![2, 3, 0, 1]), last_gates: vec![0.5], ..Damage::default() }.done_to(&ramp());
        let firsts: Vec<f32> = done.gates.iter().map(|gate| gate.volume.counts[[0, 0, 0]]).collect();
        assert!(firsts.iter().zip([3000.0, 4000.0, 1000.0, 1000.0]).all(|(found, expected)| (found - expected).abs() < 1e-3), "{firsts:?}");
    }

    #[test]
    fn what_is_cut_keeps_its_place() {
        let damage = Damage { kept: Some([[1, 3], [0, 2], [1, 4]]), ..Damage::default() };
        let (whole, done) = (ramp(), damage.done_to(&ramp()));
        assert_eq!((done.grid.shape, done.gates[0].volume.counts.dim()), ([2, 2, 3], (2, 2, 3)));
        let offset_mm = damage.offset_mm(&whole.grid);
        assert_eq!(offset_mm, DVec3::new(-4.0, 0.0, -5.0));
        let voxel = whole.grid.voxel_at(done.grid.position_mm([0, 1, 2]) - offset_mm).unwrap();
        assert!((whole.gates[0].volume.counts[voxel] - done.gates[0].volume.counts[[0, 1, 2]]).abs() < 1e-6);
    }

    #[test]
    fn who_moved_is_in_both_places() {
        let done = Damage { moved: Some(([0, 0, 2], 0.25)), ..Damage::default() }.done_to(&ramp());
        let counts = &done.gates[0].volume.counts;
        assert!((counts[[0, 0, 3]] - (0.75 * 1003.0 + 0.25 * 1001.0)).abs() < 1e-3);
        assert!((counts[[0, 0, 0]] - 1000.0).abs() < 1e-3, "the edge is repeated");
    }
}
