//! From a reconstruction to what people read. Pure functions: the same reconstruction gives the same report, timing aside.

mod report;

pub use report::{
    FitSummary, Function, GateReport, GridSummary, GvfSummary, MYOCARDIAL_DENSITY_G_PER_ML, Myocardium, QUALITY_LIMITS, Quality,
    QualityLimits, RegionSummary, Remark, Report, SCHEMA, Software, StudySummary, SurfaceFits, Timing, TimingReport, build,
};
