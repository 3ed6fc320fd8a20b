//! From a reconstruction to what people read. Pure functions: the same reconstruction gives the same report, timing aside.

mod body;
mod comparison;
mod cycle;
mod fits;
mod model;
pub mod polar;
mod pose;
mod quality;
mod regional;
#[expect(clippy::module_inception, reason = "the report is what the module is named for; other forms of it are its siblings")]
mod report;
mod schema;
mod slices;
mod summary;
mod uncertainty;
mod wall;
mod wall_function;

pub use crate::analysis::RotationSource;
pub use body::{BodySource, BodySummary};
pub use comparison::{COMPARISON_SCHEMA, Comparison, ComparisonError, Difference, RegionalDifferences, compare};
pub use cycle::{CyclePoint, CycleSummary, Harmonic};
pub use fits::{DistanceTrace, Extremes, FitSummary, GvfSummary, ParticleDistances, SurfaceFits, TriangleSummary};
pub use model::{GateModel, ModelSummary, PsfSummary, RefereeSummary, ResidualSummary};
pub use polar::{PolarMap, PolarMaps, Quantity};
pub use pose::{PatientPose, PoseConfidenceSummary, PoseSummary};
pub use quality::{QUALITY_LIMITS, Quality, QualityLimits};
pub use regional::{RegionalSummary, RegionalValues, Rotation, SegmentReport, TerritoryReport};
pub use report::{
    AffectedRegion, AffectedSector, Function, GateReport, GridSummary, MYOCARDIAL_DENSITY_G_PER_ML, Myocardium, RegionSummary, Remark,
    Report, SCHEMA, Software, StudySummary, Timing, TimingReport, build,
};
pub use schema::PublishedSchema;
pub use slices::{PlaneName, Slices};
pub use summary::Summary;
pub use uncertainty::{ErrorSummary, HALF_WIDTH_95, UncertaintySummary};
pub use wall::WallSummary;
pub use wall_function::{PerfusionSummary, PhaseSummary, ShapeReport, ShapeSummary};
