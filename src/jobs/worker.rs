//! Who works.

use super::{store::Store, work::Work};
use std::time::Duration;

/// Everything about the workers that can be chosen.
#[derive(Clone)]
pub struct WorkerSettings {
    /// Jobs worked on at once.
    pub workers: usize,
    /// Threads of each worker's own pool.
    pub threads_per_worker: usize,
    /// Name of this node in the leases, for people who read the table.
    pub node: String,
    /// How often a lease is renewed.
    pub heartbeat: Duration,
    /// How often progress is written at most.
    pub progress_interval: Duration,
    /// How often a free worker looks for jobs it was not told of.
    pub poll: Duration,
    /// What is done with a job.
    pub work: Work,
}

/// What a drain came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Drained {
    /// Jobs that were running and went back to the queue, uncharged.
    pub given_back: usize,
}

/// The running workers and the reaper of this process. Dropping it stops them without waiting; what they held stays leased until it
/// is reaped or the store is opened again.
#[derive(Debug)]
pub struct Workers {}

/// Starts the workers and the reaper on the current runtime.
pub fn start_workers(store: Store, settings: WorkerSettings) -> std::io::Result<Workers> {
    drop((store, settings));
    todo!()
}

impl Workers {
    /// Claims nothing more, waits for the running jobs at most so long, then stops them and gives them back, uncharged.
    pub async fn drain(&self, timeout: Duration) -> Drained {
        todo!("{timeout:?}")
    }

    /// Whether every worker and the reaper still run.
    pub fn alive(&self) -> bool {
        todo!()
    }
}
