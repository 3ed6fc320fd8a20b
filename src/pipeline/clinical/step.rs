//! Steps of a fit.

use super::system::System;

/// Changes of the parameters of all gates, and of the shared ones.
#[derive(Debug, Clone)]
pub(super) struct Step {
    pub(super) gates: Vec<Vec<f64>>,
    pub(super) shared: Vec<f64>,
}

impl Step {
    /// `each(own, of the others…)` for every parameter.
    fn with<const N: usize>(&self, others: [&Self; N], each: impl Fn(f64, [f64; N]) -> f64) -> Self {
        let line = |own: &[f64], others: [&[f64]; N]| -> Vec<f64> {
            own.iter().enumerate().map(|(i, value)| each(*value, others.map(|other| other[i]))).collect()
        };
        Self {
            gates: self.gates.iter().enumerate().map(|(g, gate)| line(gate, others.map(|other| other.gates[g].as_slice()))).collect(),
            shared: line(&self.shared, others.map(|other| other.shared.as_slice())),
        }
    }

    fn values(&self) -> impl Iterator<Item = f64> + '_ {
        self.gates.iter().flatten().chain(&self.shared).copied()
    }
}

/// A step that was made: the system's own, and what was made of it.
pub(super) struct Moved {
    pub(super) own: Step,
    pub(super) step: Step,
}

/// Most of the way from one result to the next that is gone again.
const FARTHEST: f64 = 4.0;

/// A step that takes the last one's success into account: where steps shrink slowly and keep their direction, as along the valley in which
/// wall activity and thickness give the same counts, it is longer (Anderson's mixing of depth 1, weighed by the system's diagonal).
pub(super) fn accelerated(last: &Moved, own: &Step, system: &System) -> Step {
    let diagonal = system.diagonal();
    let (mut across, mut along) = (0.0, 0.0);
    for ((now, before), weight) in own.values().zip(last.own.values()).zip(diagonal.values()) {
        across += weight * now * (now - before);
        along += weight * (now - before) * (now - before);
    }
    let by = (across / along.max(f64::MIN_POSITIVE)).clamp(-FARTHEST, 0.5);
    own.with([&last.step, &last.own], |now, [made, before]| now - by * (made + now - before))
}
