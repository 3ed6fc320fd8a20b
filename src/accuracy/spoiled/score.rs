//! One study: how wrong its result is, and which flags it carries.

use super::{
    super::{distance, score::Values},
    family::{Kind, Spoiled},
};
use crate::{
    analysis,
    phantom::{self, ExactSurfaces, PhantomError, Simulation},
    pipeline::{self, Reconstruction, monitor::Silent, parameters::Parameters},
    report::{self, Quality, Timing},
};

/// From which on a result is bad: the error of the ejection fraction in points, of the end-diastolic volume in percent, and the mean distance of
/// either surface in mm. Set before anything was measured: 10 points and 15 % are what two readings of one patient differ by at the most
/// (`docs/accuracy.md`), 3 mm about half a
/// clinical voxel.
pub const BAD: [f64; 3] = [10.0, 15.0, 3.0];

/// What came of a study.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// The study's name.
    pub name: String,
    /// What is wrong with it.
    pub kind: Kind,
    /// Errors and flags, or the code of the refusal.
    pub outcome: Result<Judged, String>,
}

/// A result and what was said of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// Errors as [`BAD`] has them; the last is that of the worse surface.
    pub errors: [f64; 3],
    /// Flags, score and what they come from.
    pub quality: Quality,
}

impl Judged {
    /// Whether an error is beyond its bound.
    pub fn is_bad(&self) -> bool {
        self.errors.iter().zip(BAD).any(|(error, bound)| error.abs() > bound)
    }
}

impl Run {
    /// Whether the result is bad; a refusal gives none.
    pub fn is_bad(&self) -> bool {
        self.outcome.as_ref().is_ok_and(Judged::is_bad)
    }

    /// Whether a reader is told: by a flag or by a refusal.
    pub fn is_told(&self) -> bool {
        self.outcome.as_ref().map_or(true, |judged| !judged.quality.flags.is_empty())
    }

    /// Whether a flag is there that is right for what is wrong, or a refusal.
    pub fn is_named(&self) -> bool {
        let right = |flag: &String| self.kind.flags().contains(&flag.as_str());
        self.outcome.as_ref().map_or(true, |judged| judged.quality.flags.iter().any(right))
    }
}

/// Simulates, spoils, reconstructs and compares.
///
/// Errors: a phantom that cannot be made.
pub fn run(spoiled: &Spoiled) -> Result<Run, PhantomError> {
    let Simulation { study, truth } = phantom::simulate(&spoiled.phantom)?;
    let study = spoiled.damage.done_to(&study);
    let outcome =
        pipeline::reconstruct(&study, &Parameters::clinical(), &Silent).map_err(|error| error.code().to_owned()).and_then(|found| {
            let of = |volume: fn(&phantom::GateTruth) -> f64| truth.gates.iter().map(volume).collect::<Vec<f64>>();
            let truth = Values::of_cycle(&of(|gate| gate.endocardial_ml), &of(|gate| gate.epicardial_ml));
            let (Some(values), Some(truth)) = (Values::of(&found), truth) else { return Err("no_volumes".to_owned()) };
            let analysis = analysis::analyse(&study, &found);
            let report = report::build(&spoiled.name, &study, &found, &analysis, &Timing::default());
            Ok(Judged {
                errors: [values.ef_percent - truth.ef_percent, 100.0 * (values.edv_ml / truth.edv_ml - 1.0), distance_mm(spoiled, &found)],
                quality: report.quality,
            })
        });
    Ok(Run { name: spoiled.name.clone(), kind: spoiled.kind, outcome })
}

/// The larger of both surfaces' mean distances over the gates in mm; infinite where it cannot be measured.
fn distance_mm(spoiled: &Spoiled, found: &Reconstruction) -> f64 {
    let offset_mm = spoiled.damage.offset_mm(&spoiled.phantom.imaging.grid);
    let exact = |place: usize| {
        let exact = spoiled.phantom.exact_surfaces(spoiled.damage.gate_at(place))?;
        let [endocardial, epicardial] = [&exact.endocardial, &exact.epicardial].map(|mesh| mesh.map(|point| point + offset_mm));
        Some(ExactSurfaces { endocardial, epicardial, ..exact })
    };
    let mean = distance::over_the_cycle(found, exact);
    mean.map_or(f64::INFINITY, |mean| mean.endocardial.closed_mm.max(mean.epicardial.closed_mm))
}
