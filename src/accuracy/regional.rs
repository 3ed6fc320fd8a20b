//! How far each derived quantity (segments, thickness, motion, phase, rates, shape, defects, TID) is from the truth: a family of hearts whose parts
//! contract late, not at all, are thin or take up less, by the preset `clinical`, told nothing but where the anterior wall is.

pub mod criteria;
pub mod exact;
pub mod family;
pub mod score;
pub mod tables;

use super::{AccuracyError, parallel};
use crate::phantom::PhantomError;
use family::Heart;
use score::Run;

/// Runs every heart on some threads; `each` hears of every run as it ends, in no order. The result is in order.
///
/// Errors: a phantom that cannot be made, or no thread.
pub fn run(hearts: &[Heart], threads: usize, each: impl Fn(&Run) + Sync) -> Result<Vec<Run>, AccuracyError> {
    let of = |_: usize, heart: &Heart| {
        let run = score::run(heart)?;
        each(&run);
        Ok::<_, PhantomError>(run)
    };
    Ok(parallel::in_order(hearts, threads, of)?.into_iter().collect::<Result<_, _>>()?)
}
