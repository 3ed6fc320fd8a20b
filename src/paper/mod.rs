//! The paper's tables and figures, redone on simulated hearts whose volumes are known, beside what the paper prints.
//!
//! Each table is a file with a `measure` that runs what the table is about and a `markdown` that writes it with the printed numbers
//! ([`printed`]) next to it. Seconds are of the machine that ran it; everything else is the same wherever it runs.

pub mod cycle;
pub mod experiment;
pub mod figures;
pub mod initial_meshes;
pub mod missing;
pub mod models;
pub mod oscillation;
pub mod printed;
pub mod reconstructions;
pub mod threshold;
pub mod volumes;

use crate::{phantom::PhantomError, pipeline::PipelineError};

/// Why a table or figure could not be made.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// The simulated heart is impossible.
    #[error(transparent)]
    Phantom(#[from] PhantomError),
    /// The reconstruction failed where it must not.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A picture could not be encoded.
    #[error("a picture could not be encoded as PNG: {0}")]
    Png(#[from] png::EncodingError),
    /// There is no such table.
    #[error("the paper has tables 1 to 6, not {0}")]
    NoSuchTable(usize),
}

/// The numbers of the paper's tables.
pub const TABLES: std::ops::RangeInclusive<usize> = 1..=6;

/// A table of the paper by its number, measured now, as Markdown.
///
/// Errors: what cannot be simulated, reconstructed or is no table.
pub fn table(number: usize) -> Result<String, PaperError> {
    Ok(match number {
        1 => models::markdown(&models::measure(&models::Steps::PRINTED)?),
        2 => initial_meshes::markdown(&initial_meshes::measure()?),
        3 => reconstructions::markdown(&reconstructions::measure()?),
        4 => volumes::markdown(&volumes::measure()?),
        5 => cycle::markdown(&cycle::measure()?),
        6 => missing::markdown(&missing::measure()?),
        other => return Err(PaperError::NoSuchTable(other)),
    })
}

/// The distances behind figure 5, measured now, as Markdown.
///
/// Errors: what cannot be simulated or reconstructed.
pub fn distances() -> Result<String, PaperError> {
    Ok(oscillation::markdown(&oscillation::measure()?))
}
