//! How far the presets are from the truth: a fixed family of simulated hearts whose volumes and surfaces are known exactly, and real studies
//! with labels.
//!
//! Everything comes out the same wherever it runs, seconds apart. A study that fails is counted as a failure beside every number.

pub mod ablation;
pub mod bland_altman;
pub mod criteria;
pub mod distance;
mod draw;
pub mod family;
mod hearts;
pub mod line;
pub mod parallel;
pub mod pictures;
pub mod published;
pub mod real;
pub mod regional;
pub mod score;
pub mod spoiled;
pub mod statistics;
pub mod tables;

use crate::phantom::PhantomError;

/// Why the accuracy could not be measured. Studies that fail are no error: they are counted.
#[derive(Debug, thiserror::Error)]
pub enum AccuracyError {
    /// A simulated heart is impossible.
    #[error(transparent)]
    Phantom(#[from] PhantomError),
    /// A thread could not be had.
    #[error("a thread could not be started: {0}")]
    Thread(#[from] rayon::ThreadPoolBuildError),
}

/// Runs every member by every method on some threads; `each` hears of every run as it ends, in no order. The result is in order.
///
/// Errors: a phantom that cannot be made, or no thread.
pub fn run(
    members: &[family::Member],
    methods: &[score::Method],
    threads: usize,
    each: impl Fn(&score::Run) + Sync,
) -> Result<Vec<score::Run>, AccuracyError> {
    let of = |_: usize, member: &family::Member| {
        let runs = score::run(member, methods)?;
        runs.iter().for_each(&each);
        Ok::<_, PhantomError>(runs)
    };
    let runs = parallel::in_order(members, threads, of)?.into_iter().collect::<Result<Vec<_>, _>>()?;
    Ok(runs.into_iter().flatten().collect())
}
