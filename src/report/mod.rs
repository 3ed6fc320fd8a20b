//! From a reconstruction to what people read. Pure functions: the same reconstruction gives the same report, timing aside.

#[expect(clippy::module_inception, reason = "the report is what the module is named for; other forms of it are its siblings")]
mod report;

pub use report::{
    FitSummary, Function, GateReport, GridSummary, GvfSummary, MYOCARDIAL_DENSITY_G_PER_ML, Myocardium, QUALITY_LIMITS, Quality,
    QualityLimits, RegionSummary, Remark, Report, SCHEMA, Software, StudySummary, SurfaceFits, Timing, TimingReport, build,
};
