//! How much may wait, who has a place, and how fast the queue moves.
//!
//! The counts are kept in memory, exact for a single process: they start from the rows at open and change with every committed
//! change. Where several processes share a database, [`super::Store::submit`] checks the rows again inside its transaction.

use super::error::QueueFull;
use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// Finished jobs the rate is measured over.
const MEASURED_JOBS: usize = 32;
/// Limits of `Retry-After` in s: clients need at least a second, and none should give up hope for longer than ten minutes.
const RETRY_AFTER_S: (f64, f64) = (1.0, 600.0);
/// Assumed duration of a job in s until one was measured (an eight-gate study takes a few).
const ASSUMED_DURATION_S: f64 = 5.0;

/// Jobs and bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Load {
    pub(super) jobs: u64,
    pub(super) bytes: u64,
}

/// The queue of one process.
#[derive(Debug)]
pub(super) struct Queue {
    limit: Load,
    state: Mutex<QueueState>,
}

#[derive(Debug, Default)]
struct QueueState {
    /// Signed: a job may be claimed between its commit and the line that counts it.
    queued_jobs: i64,
    queued_bytes: i64,
    reserved: Load,
    /// Workers of this process.
    workers: usize,
    /// Jobs under way in all processes. While anything waits, every worker has one: then it is the number of workers of all nodes.
    running: u64,
    durations_s: VecDeque<f64>,
}

impl Queue {
    pub(super) fn new(limit: Load, queued: Load, durations_s: impl IntoIterator<Item = f64>) -> Self {
        let durations_s = durations_s.into_iter().take(MEASURED_JOBS).collect();
        let mut state = QueueState { durations_s, workers: 1, ..QueueState::default() };
        state.enter(queued);
        Self { limit, state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, QueueState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for a job of so many bytes.
    pub(super) fn reserve(self: &Arc<Self>, bytes: u64) -> Result<Reservation, QueueFull> {
        let mut state = self.state();
        if !state.fits(self.limit, Load { jobs: 1, bytes }) {
            return Err(QueueFull { retry_after_s: state.retry_after_s() });
        }
        state.reserved.jobs += 1;
        state.reserved.bytes += bytes;
        Ok(Reservation { queue: Arc::clone(self), bytes, queued: None })
    }

    pub(super) fn full(&self) -> QueueFull {
        QueueFull { retry_after_s: self.state().retry_after_s() }
    }

    /// Whether so much may be queued.
    pub(super) fn within_limit(&self, load: Load) -> bool {
        load.jobs <= self.limit.jobs && load.bytes <= self.limit.bytes
    }

    pub(super) fn limit(&self) -> Load {
        self.limit
    }

    pub(super) fn reserved(&self) -> Load {
        self.state().reserved
    }

    /// Jobs were put back into the queue.
    pub(super) fn entered(&self, load: Load) {
        self.state().enter(load);
    }

    /// A job left the queue.
    pub(super) fn left(&self, bytes: u64) {
        let mut state = self.state();
        state.queued_jobs -= 1;
        state.queued_bytes -= bytes as i64;
        state.publish();
    }

    /// The rows were counted: other processes change them too.
    pub(super) fn counted(&self, queued: Load) {
        let mut state = self.state();
        (state.queued_jobs, state.queued_bytes) = (0, 0);
        state.enter(queued);
    }

    /// So many workers of this process take from the queue.
    pub(super) fn served_by(&self, workers: usize) {
        self.state().workers = workers.max(1);
    }

    /// So many jobs are under way in all processes.
    pub(super) fn served_in_all(&self, running: u64) {
        self.state().running = running;
    }

    /// The jobs that all processes finished last took so long, latest first.
    pub(super) fn measured_in_all(&self, durations_s: Vec<f64>) {
        self.state().durations_s = durations_s.into_iter().take(MEASURED_JOBS).collect();
    }

    /// A job took so long.
    pub(super) fn measured(&self, duration_s: f64) {
        let mut state = self.state();
        state.durations_s.push_front(duration_s);
        state.durations_s.truncate(MEASURED_JOBS);
    }

    /// Estimated time in s until the job at this place (from 1) is finished.
    pub(super) fn eta_queued_s(&self, position: u64) -> Option<f64> {
        let state = self.state();
        let mean_s = state.mean_duration_s()?;
        Some((position as f64 / state.servers()).ceil() * mean_s)
    }

    /// Estimated time in s until a job is finished that has run for so long and come so far (0 to 1).
    pub(super) fn eta_running_s(&self, elapsed_s: f64, progress: f64) -> Option<f64> {
        if progress > 0.05 {
            return Some((elapsed_s * (1.0 - progress) / progress).max(0.0));
        }
        Some((self.state().mean_duration_s()? - elapsed_s).max(0.0))
    }
}

impl QueueState {
    fn queued(&self) -> Load {
        Load { jobs: self.queued_jobs.max(0) as u64, bytes: self.queued_bytes.max(0) as u64 }
    }

    fn enter(&mut self, load: Load) {
        self.queued_jobs += load.jobs as i64;
        self.queued_bytes += load.bytes as i64;
        self.publish();
    }

    fn fits(&self, limit: Load, load: Load) -> bool {
        let queued = self.queued();
        let jobs = queued.jobs.saturating_add(self.reserved.jobs).saturating_add(load.jobs);
        let bytes = queued.bytes.saturating_add(self.reserved.bytes).saturating_add(load.bytes);
        jobs <= limit.jobs && bytes <= limit.bytes
    }

    /// Workers that take from the queue, on all nodes as far as they are known to be busy.
    fn servers(&self) -> f64 {
        (self.workers.max(1) as f64).max(self.running as f64)
    }

    fn mean_duration_s(&self) -> Option<f64> {
        let measured = self.durations_s.len();
        (measured > 0).then(|| self.durations_s.iter().sum::<f64>() / measured as f64)
    }

    /// When all that waits now has been taken by a worker. Not when the next one has: of all who are refused meanwhile only one would find room.
    fn retry_after_s(&self) -> u64 {
        let mean_s = self.mean_duration_s().unwrap_or(ASSUMED_DURATION_S);
        let drained_s = mean_s / self.servers() * self.queued_jobs.max(1) as f64;
        drained_s.clamp(RETRY_AFTER_S.0, RETRY_AFTER_S.1).ceil() as u64
    }

    fn publish(&self) {
        metrics::gauge!("ventricle_queue_jobs").set(self.queued().jobs as f64);
        metrics::gauge!("ventricle_queue_bytes").set(self.queued().bytes as f64);
    }
}

/// A place in the queue, held while a body is read and parsed; dropping it frees the place.
#[derive(Debug)]
pub struct Reservation {
    queue: Arc<Queue>,
    bytes: u64,
    /// Bytes of the job that took the place, once it is committed.
    queued: Option<u64>,
}

impl Reservation {
    /// Bytes this place holds.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Changes the bytes this place holds, when more is known about the body. The place is kept as it was if they do not fit.
    pub fn resize(&mut self, bytes: u64) -> Result<(), QueueFull> {
        let mut state = self.queue.state();
        let held = state.reserved.bytes;
        state.reserved.bytes = held.saturating_sub(self.bytes);
        if bytes > self.bytes && !state.fits(self.queue.limit, Load { jobs: 0, bytes }) {
            state.reserved.bytes = held;
            return Err(QueueFull { retry_after_s: state.retry_after_s() });
        }
        state.reserved.bytes = state.reserved.bytes.saturating_add(bytes);
        drop(state);
        self.bytes = bytes;
        Ok(())
    }

    /// The job is committed with so many bytes of input: the place becomes a queued job in one step.
    pub(super) fn into_queued(mut self, bytes: u64) {
        self.queued = Some(bytes);
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut state = self.queue.state();
        state.reserved.jobs = state.reserved.jobs.saturating_sub(1);
        state.reserved.bytes = state.reserved.bytes.saturating_sub(self.bytes);
        if let Some(bytes) = self.queued {
            state.enter(Load { jobs: 1, bytes });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn queue(jobs: u64, bytes: u64) -> Arc<Queue> {
        Arc::new(Queue::new(Load { jobs, bytes }, Load::default(), []))
    }

    #[test]
    fn places_are_limited_by_count_and_bytes_and_freed_by_drop() {
        let queue = queue(2, 100);
        let first = queue.reserve(60).expect("the first fits");
        assert!(queue.reserve(41).is_err(), "bytes are limited");
        let second = queue.reserve(40).expect("exactly full");
        assert!(queue.reserve(0).is_err(), "jobs are limited");
        drop(first);
        drop(second);
        assert_eq!(queue.reserved(), Load::default());
        queue.entered(Load { jobs: 1, bytes: 100 });
        assert!(queue.reserve(1).is_err(), "queued bytes count");
        queue.left(100);
        assert!(queue.reserve(100).is_ok());
    }

    #[test]
    fn a_place_that_cannot_grow_stays_as_it_was() {
        let queue = queue(2, 100);
        let mut place = queue.reserve(60).expect("fits");
        assert!(place.resize(101).is_err());
        assert_eq!((place.bytes(), queue.reserved().bytes), (60, 60));
        place.resize(100).expect("fits");
        assert_eq!(queue.reserved().bytes, 100);
        place.resize(10).expect("shrinking always fits");
        assert_eq!(queue.reserved().bytes, 10);
    }

    #[test]
    fn the_rate_is_that_of_all_nodes() {
        let queue = queue(12, u64::MAX);
        queue.served_by(2);
        queue.entered(Load { jobs: 12, bytes: 12 });
        queue.measured(9.0);
        queue.measured_in_all(vec![2.0, 4.0]);
        queue.served_in_all(6);
        assert_eq!(queue.full().retry_after_s, 6, "mean 3 s x 12 jobs / 6 busy workers");
        assert_eq!(queue.eta_queued_s(7), Some(6.0));
        queue.served_in_all(1);
        assert_eq!(queue.full().retry_after_s, 18, "this node's own two workers are there, busy or not");
    }

    #[test]
    fn retry_after_follows_the_measured_rate_within_its_limits() {
        let queue = queue(10, u64::MAX);
        queue.served_by(2);
        queue.entered(Load { jobs: 10, bytes: 10 });
        queue.measured(2.0);
        queue.measured(4.0);
        assert_eq!(queue.full().retry_after_s, 15, "mean 3 s x 10 jobs / 2 workers");
        assert_eq!(queue.eta_queued_s(3), Some(6.0));
        queue.counted(Load { jobs: 10, bytes: 10 });
        queue.served_in_all(6);
        assert_eq!(queue.full().retry_after_s, 5, "six workers hold a job, four of them in other processes");
        assert_eq!(queue.eta_queued_s(7), Some(6.0));
        queue.counted(Load { jobs: 10, bytes: 10 });
        queue.served_in_all(1);
        assert_eq!(queue.full().retry_after_s, 15, "this process has two, busy or not");
        queue.measured(1e9);
        assert_eq!(queue.full().retry_after_s, 600);
        for _ in 0..MEASURED_JOBS {
            queue.measured(0.001);
        }
        assert_eq!(queue.full().retry_after_s, 1);
    }
}
