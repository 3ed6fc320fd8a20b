//! Tables and pictures for people: Markdown, SVG sheets and charts, PNG.

pub mod chart;
pub mod markdown;
pub mod raster;
pub mod svg;
