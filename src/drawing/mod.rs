//! Tables and pictures for people: Markdown, SVG sheets and charts, PNG, polar maps and shaded surfaces.

pub mod bulls_eye;
pub mod chart;
pub mod markdown;
pub mod marks;
pub mod polar;
pub mod raster;
pub mod scale;
pub mod scene;
pub mod svg;
