//! From a reconstruction to what people read. Pure functions: the same reconstruction gives the same report, timing aside.

mod fits;
#[expect(clippy::module_inception, reason = "the report is what the module is named for; other forms of it are its siblings")]
mod report;
mod wall;

pub use fits::{DistanceTrace, Extremes, FitSummary, GvfSummary, ParticleDistances, SurfaceFits, TriangleSummary};
pub use report::{
    AffectedRegion, AffectedSector, Function, GateReport, GridSummary, MYOCARDIAL_DENSITY_G_PER_ML, Myocardium, QUALITY_LIMITS, Quality,
    QualityLimits, RegionSummary, Remark, Report, SCHEMA, Software, StudySummary, Timing, TimingReport, build,
};
pub use wall::WallSummary;
