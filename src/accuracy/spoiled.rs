//! How well the quality flags tell a bad result from a good one: simulated studies spoiled in a known way beside studies that are not, by the preset
//! `clinical`, told nothing.
//!
//! One half of the studies set the limits of the flags ([`crate::report::QualityLimits`]); the other half, of other seeds, is what is published.

pub mod family;
pub mod score;
pub mod tables;

use super::{AccuracyError, parallel};
use crate::phantom::PhantomError;
use family::Spoiled;
use score::Run;

/// Runs every study on some threads; `each` hears of every run as it ends, in no order. The result is in order.
///
/// Errors: a phantom that cannot be made, or no thread.
pub fn run(studies: &[Spoiled], threads: usize, each: impl Fn(&Run) + Sync) -> Result<Vec<Run>, AccuracyError> {
    let of = |_: usize, study: &Spoiled| {
        let run = score::run(study)?;
        each(&run);
        Ok::<_, PhantomError>(run)
    };
    Ok(parallel::in_order(studies, threads, of)?.into_iter().collect::<Result<_, _>>()?)
}
