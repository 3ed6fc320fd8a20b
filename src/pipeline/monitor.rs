//! How a reconstruction tells what it does and is told to stop. The pipeline reads no clock: whoever implements [`Monitor`] may.

use super::PipelineError;
use serde::{Deserialize, Serialize};

/// What is being computed for one gate, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Finding the ventricle in any orientation (once a study; clinical preset).
    Localisation,
    /// Finding the useful slices, the centre and the filtering circle (once a study).
    Region,
    /// The gradient of the counts that edges are found in, by Canny's operator or the plain one.
    Edges,
    /// Telling endocardial from epicardial edges.
    Borders,
    /// The gradient vector flow of both borders.
    GradientVectorFlow,
    /// The evolution of both deformable meshes.
    Deformation,
    /// Surfaces at the gradient's extrema along rays across the wall (clinical preset).
    Rays,
    /// Fitting the model of the camera to all gates at once (clinical preset).
    ModelFit,
    /// Putting the wall between both surfaces in order.
    Wall,
    /// Volumes, distances, checks.
    Measurement,
}

impl Stage {
    /// All stages in the order they run.
    pub const ALL: [Self; 10] = [
        Self::Localisation,
        Self::Region,
        Self::Edges,
        Self::Borders,
        Self::GradientVectorFlow,
        Self::Deformation,
        Self::Rays,
        Self::ModelFit,
        Self::Wall,
        Self::Measurement,
    ];

    /// The name used in JSON, metrics and logs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Localisation => "localisation",
            Self::Region => "region",
            Self::Edges => "edges",
            Self::Borders => "borders",
            Self::GradientVectorFlow => "gradient_vector_flow",
            Self::Deformation => "deformation",
            Self::Rays => "rays",
            Self::ModelFit => "model_fit",
            Self::Wall => "wall",
            Self::Measurement => "measurement",
        }
    }
}

/// Receives progress from, and may cancel, a running reconstruction. Called from several threads at once.
pub trait Monitor: Sync {
    /// A stage begins, for a gate (from 0) or for the whole study.
    fn begin(&self, _stage: Stage, _gate: Option<usize>) {}
    /// A stage ended, for a gate (from 0) or for the whole study.
    fn end(&self, _stage: Stage, _gate: Option<usize>) {}
    /// `done` of `total` units of work are finished; `done` grows, but calls of different threads may arrive out of order.
    fn advance(&self, _done: usize, _total: usize) {}
    /// Whether the reconstruction should stop. Asked at every stage and inside every long loop; must be cheap.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// A monitor that listens to nothing and never cancels.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Monitor for Silent {}

/// `Err(Cancelled)` if the monitor says so: for use with `?` inside loops.
pub(super) fn check(monitor: &dyn Monitor) -> Result<(), PipelineError> {
    if monitor.is_cancelled() { Err(PipelineError::Cancelled) } else { Ok(()) }
}
