//! One thread that owns a rayon pool, of as many threads as its job is to have. A pool shared between jobs would let one job's threads pick up
//! another's work while they wait, inside its stack and its time.
//!
//! The pool of one thread is there from the start; a larger one is made for its job and ends with it (0.1 ms a thread): kept, they would be the
//! square of the processors.

use super::priority;
use crate::pipeline;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::{
    any::Any,
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::mpsc::{self, RecvTimeoutError},
    thread,
    time::Duration,
};
use tokio::sync::oneshot;

/// Without a task for so long, memory is given back: a little sooner than the process gives to the system what is free in it.
const KEEPS: Duration = Duration::from_secs(20);

type Task = Box<dyn FnOnce() + Send>;

/// Runs one task after another inside its own pool, at a lower priority. Dropping it ends the thread after the task at hand.
#[derive(Debug)]
pub(super) struct ComputeThread {
    tasks: mpsc::Sender<(usize, Task)>,
}

impl ComputeThread {
    /// A thread of this name; those of its pools have numbers after it.
    pub(super) fn start(name: &str) -> io::Result<Self> {
        let (tasks, received) = mpsc::channel::<(usize, Task)>();
        let (started, starts) = mpsc::channel();
        let pool_name = name.to_owned();
        thread::Builder::new().name(name.to_owned()).spawn(move || {
            // Before the pools are made: their threads inherit it.
            priority::lower(priority::RECONSTRUCTING);
            let single = match pool(&pool_name, 1) {
                Ok(pool) => pool,
                Err(error) => return drop(started.send(Err(error))),
            };
            drop(started.send(Ok(())));
            while let Some((threads, task)) = next(&received, &single) {
                match (threads > 1).then(|| pool(&pool_name, threads)) {
                    Some(Ok(pool)) => pool.install(task),
                    None => single.install(task),
                    Some(Err(error)) => {
                        tracing::warn!(%error, threads, "the system gave no threads: this job is computed on one");
                        single.install(task);
                    }
                }
            }
        })?;
        starts.recv().map_err(io::Error::other)?.map_err(io::Error::other)?;
        Ok(Self { tasks })
    }

    /// Runs a task on so many threads; a panic in it comes back as its message.
    pub(super) fn run<T: Send + 'static>(
        &self,
        threads: usize,
        task: impl FnOnce() -> T + Send + 'static,
    ) -> oneshot::Receiver<Result<T, String>> {
        let (answer, answered) = oneshot::channel();
        let task = Box::new(move || {
            let result = catch_unwind(AssertUnwindSafe(task)).map_err(|panic| message(&*panic));
            // Nobody waits for the answer any more when the worker was stopped.
            drop(answer.send(result));
        });
        // Should the thread be gone, the answer's sender goes with the task and the receiver says so.
        drop(self.tasks.send((threads, task)));
        answered
    }
}

/// Waits for the next task. When there has been none for a while, the pool gives back the memory that its thread keeps between studies.
fn next(received: &mpsc::Receiver<(usize, Task)>, single: &ThreadPool) -> Option<(usize, Task)> {
    match received.recv_timeout(KEEPS) {
        Ok(next) => Some(next),
        Err(RecvTimeoutError::Timeout) => {
            single.broadcast(|_| pipeline::forget());
            received.recv().ok()
        }
        Err(RecvTimeoutError::Disconnected) => None,
    }
}

fn pool(name: &str, threads: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    let name = name.to_owned();
    ThreadPoolBuilder::new().num_threads(threads).thread_name(move |index| format!("{name}-{index}")).build()
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned()).or_else(|| panic.downcast_ref::<String>().cloned());
    format!("panic: {}", text.unwrap_or_else(|| "without a message".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn tasks_run_in_their_own_pool_and_survive_a_panic() {
        let thread = ComputeThread::start("compute-test").expect("starts");
        let panicked = thread.run(3, || -> u32 { panic!("number {}", 7) }).await.expect("answers");
        assert_eq!(panicked, Err("panic: number 7".to_owned()));
        for threads in [3, 1, 2, 1] {
            assert_eq!(thread.run(threads, rayon::current_num_threads).await.expect("answers"), Ok(threads));
        }
    }

    #[cfg(target_os = "linux")]
    #[tokio::test]
    async fn all_its_threads_stand_back_behind_those_that_answer() {
        use super::super::priority::tests::nice;
        let lowered = (nice() + priority::RECONSTRUCTING).min(19);
        let thread = ComputeThread::start("compute-nice").expect("starts");
        for threads in [1, 3] {
            let each = thread.run(threads, || rayon::broadcast(|_| nice())).await.expect("answers");
            assert_eq!(each, Ok(vec![lowered; threads]));
        }
        assert_eq!(nice() + priority::RECONSTRUCTING, lowered, "this thread stays as it was");
    }
}
