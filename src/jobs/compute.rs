//! One thread that owns one rayon pool. A pool shared between jobs would let one job's threads pick up another's work while they wait,
//! inside its stack and its time.

use rayon::ThreadPoolBuilder;
use std::{
    any::Any,
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::mpsc,
    thread,
};
use tokio::sync::oneshot;

type Task = Box<dyn FnOnce() + Send>;

/// Runs one task after another inside its own pool. Dropping it ends the thread after the task at hand.
#[derive(Debug)]
pub(super) struct ComputeThread {
    tasks: mpsc::Sender<Task>,
}

impl ComputeThread {
    /// A thread of this name with a pool of so many threads.
    pub(super) fn start(name: &str, threads: usize) -> io::Result<Self> {
        let pool_name = name.to_owned();
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(move |index| format!("{pool_name}-{index}"))
            .build()
            .map_err(io::Error::other)?;
        let (tasks, received) = mpsc::channel::<Task>();
        thread::Builder::new().name(name.to_owned()).spawn(move || {
            while let Ok(task) = received.recv() {
                pool.install(task);
            }
        })?;
        Ok(Self { tasks })
    }

    /// Runs a task; a panic in it comes back as its message.
    pub(super) fn run<T: Send + 'static>(&self, task: impl FnOnce() -> T + Send + 'static) -> oneshot::Receiver<Result<T, String>> {
        let (answer, answered) = oneshot::channel();
        let task = Box::new(move || {
            let result = catch_unwind(AssertUnwindSafe(task)).map_err(|panic| message(&*panic));
            // Nobody waits for the answer any more when the worker was stopped.
            drop(answer.send(result));
        });
        // Should the thread be gone, the answer's sender goes with the task and the receiver says so.
        drop(self.tasks.send(task));
        answered
    }
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
        let thread = ComputeThread::start("compute-test", 3).expect("starts");
        let panicked = thread.run(|| -> u32 { panic!("number {}", 7) }).await.expect("answers");
        assert_eq!(panicked, Err("panic: number 7".to_owned()));
        let threads = thread.run(rayon::current_num_threads).await.expect("answers");
        assert_eq!(threads, Ok(3));
    }
}
