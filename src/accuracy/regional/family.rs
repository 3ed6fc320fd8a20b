//! The hearts whose parts differ: what each kind draws.

use super::super::{draw::Draw, hearts};
use crate::{
    phantom::{Defect, Phantom, Regional, Shape, Site},
    pipeline::parameters::AnalysisParameters,
};

/// A kind of heart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// All of the wall beats alike.
    Synchronous,
    /// The same, sixteen gates.
    SixteenGates,
    /// A sharp sector of 60° that contracts a quarter of R-R later.
    Late,
    /// A sector that does not contract.
    Akinetic,
    /// A sector with 55-75 % of the wall.
    Thin,
    /// A perfusion defect.
    Defect,
    /// One heart twice, the second time with a larger cavity: stress after rest.
    Pair,
}

impl Kind {
    /// All kinds, as the tables list them.
    pub const ALL: [Self; 7] = [Self::Synchronous, Self::SixteenGates, Self::Late, Self::Akinetic, Self::Thin, Self::Defect, Self::Pair];

    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Synchronous => "synchronous",
            Self::SixteenGates => "16 gates",
            Self::Late => "late sector",
            Self::Akinetic => "akinetic sector",
            Self::Thin => "thin sector",
            Self::Defect => "defect",
            Self::Pair => "pair",
        }
    }

    /// What it is about.
    pub fn about(self) -> &'static str {
        match self {
            Self::Synchronous => "all of the wall beats alike, 8 gates",
            Self::SixteenGates => "the same, 16 gates of half the counts",
            Self::Late => "a sharp sector of 60°, apex to base, a quarter of R-R (90°) later, in turn over each side of the heart",
            Self::Akinetic => "a sector of 80-120°, apex to base, that does not contract; edges of 20°",
            Self::Thin => "a sector of 80-120° with 55-75 % of the wall; edges of 20°",
            Self::Defect => "a perfusion defect of 10-30 % of the wall that takes up 0-20 % of the rest",
            Self::Pair => "a heart twice, at the second time with a cavity of 1.00 to 1.35 times the volume, other noise and place",
        }
    }

    fn studies(self) -> usize {
        match self {
            Self::Synchronous | Self::Pair => 12,
            Self::SixteenGates | Self::Late | Self::Akinetic => 6,
            Self::Thin => 3,
            Self::Defect => 8,
        }
    }
}

/// A study of the family.
#[derive(Debug, Clone)]
pub struct Heart {
    /// Kind and number.
    pub name: String,
    /// Its kind.
    pub kind: Kind,
    /// What is simulated.
    pub phantom: Phantom,
}

impl Heart {
    /// Which side is anterior is told: the phantoms are looked at for what is measured there.
    pub fn analysis(&self) -> AnalysisParameters {
        let anterior = self.phantom.pose.rotation() * glam::DVec3::NEG_Y;
        AnalysisParameters { anterior: Some(anterior.to_array()), ..AnalysisParameters::default() }
    }
}

/// Every study, kind by kind. Both of a pair follow each other.
pub fn hearts() -> Vec<Heart> {
    let of_kind = |(index, kind): (usize, Kind)| {
        (0..kind.studies()).map(move |number| {
            // Beyond the seeds of the published family.
            let seed = 100_000 + 1000 * (index as u64 + 1) + number as u64;
            let mut phantom = heart(kind, number, seed);
            phantom.imaging.noise_seed = Some(seed);
            Heart { name: format!("{} #{}", kind.name(), number + 1), kind, phantom }
        })
    };
    Kind::ALL.into_iter().enumerate().flat_map(of_kind).collect()
}

fn heart(kind: Kind, number: usize, seed: u64) -> Phantom {
    let mut draw = Draw::of(seed);
    match kind {
        Kind::Synchronous => hearts::usual(&mut draw),
        Kind::SixteenGates => hearts::sixteen_gates(&mut draw),
        Kind::Late => {
            let sector = Regional { edge_degrees: 0.0, delay: 0.25, ..Regional::sector(60.0 * number as f64, 60.0) };
            with(hearts::usual(&mut draw), sector)
        }
        Kind::Akinetic => {
            let phantom = hearts::usual(&mut draw);
            let sector = Regional::sector(60.0 * number as f64, draw.between(80.0, 120.0));
            with(phantom, Regional { amplitude: 0.0, ..sector })
        }
        Kind::Thin => {
            let phantom = hearts::usual(&mut draw);
            let sector = Regional::sector(draw.between(0.0, 360.0), draw.between(80.0, 120.0));
            with(phantom, Regional { thickness: draw.between(0.55, 0.75), ..sector })
        }
        Kind::Defect => {
            let mut phantom = hearts::usual(&mut draw);
            let site = [Site::Apical, Site::Anterior, Site::Inferior, Site::Septal, Site::Lateral][number % 5];
            phantom.uptake.defects = vec![Defect { site, extent: draw.between(0.10, 0.30), severity: draw.between(0.8, 1.0) }];
            phantom
        }
        Kind::Pair => {
            // Both of a pair draw the same heart; what differs is drawn after it.
            let mut first = Draw::of(seed - number as u64 % 2);
            let phantom = hearts::usual(&mut first);
            if number.is_multiple_of(2) { phantom } else { larger(phantom, 1.0 + 0.07 * (number / 2) as f64, &mut draw) }
        }
    }
}

fn with(phantom: Phantom, regional: Regional) -> Phantom {
    Phantom { regional: vec![regional], ..phantom }
}

/// The same heart with a larger cavity, elsewhere in the grid.
fn larger(mut phantom: Phantom, ratio: f64, draw: &mut Draw) -> Phantom {
    if let Shape::Ventricle(ventricle) = &mut phantom.shape {
        ventricle.edv_ml *= ratio;
        ventricle.esv_ml *= ratio;
    }
    phantom.pose.offset_mm = [draw.between(-5.0, 5.0), draw.between(-5.0, 5.0), draw.between(-3.0, 3.0)];
    phantom
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom;

    #[test]
    fn every_heart_can_be_made_and_pairs_follow_each_other() {
        let all = hearts();
        assert!((40..=60).contains(&all.len()), "{}", all.len());
        for heart in &all {
            let truth = phantom::truth(&heart.phantom).unwrap();
            assert!(truth.within_grid, "{}", heart.name);
            assert_eq!(heart.kind == Kind::Defect, truth.defect_fraction > 0.0);
        }
        let pairs: Vec<f64> =
            all.iter().filter(|heart| heart.kind == Kind::Pair).map(|heart| phantom::truth(&heart.phantom).unwrap().edv_ml).collect();
        for (index, pair) in pairs.chunks_exact(2).enumerate() {
            assert!((pair[1] / pair[0] - 1.0 - 0.07 * index as f64).abs() < 1e-6, "{pair:?}");
        }
    }
}
