//! On how many threads a job is computed.
//!
//! A study alone is done soonest on all processors; of many, most are done in a time if each has one processor, since nothing computes
//! perfectly in parallel. A job keeps the threads that it began with: what arrives meanwhile makes them share the processors for the rest of it, which
//! is a second or less, while a pool that shrinks would have to take threads away in the middle of waiting for each other.

/// Who decides on how many threads a job is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Threads {
    /// Always so many.
    Fixed(usize),
    /// So many processors, shared by the jobs that are there when one begins.
    ByLoad(usize),
}

impl Threads {
    /// Threads of a job that begins, where so many run (itself too), so many more may be begun, and so many can run at once.
    pub fn of_job(self, running: usize, waiting: usize, workers: usize) -> usize {
        match self {
            Self::Fixed(threads) => threads.max(1),
            // Rounded up: a processor too few is idle, a thread too many shares.
            Self::ByLoad(processors) => processors.div_ceil(running.saturating_add(waiting).min(workers).max(1)).max(1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_alone_has_all_processors_and_one_of_many_a_single_one() {
        let eight = |running, waiting| Threads::ByLoad(8).of_job(running, waiting, 8);
        assert_eq!([eight(1, 0), eight(1, 1), eight(2, 0), eight(2, 1), eight(4, 0), eight(5, 2), eight(8, 0)], [8, 4, 4, 3, 2, 2, 1]);
        assert_eq!((eight(1, 1000), eight(8, 1000)), (1, 1));
    }

    #[test]
    fn fewer_workers_than_processors_share_all_of_them() {
        assert_eq!(Threads::ByLoad(8).of_job(1, 1000, 2), 4, "the second worker takes the other half");
        assert_eq!(Threads::ByLoad(8).of_job(1, 1000, 1), 8);
        assert_eq!(Threads::ByLoad(2).of_job(5, 0, 16), 1, "more workers than processors");
    }

    #[test]
    fn what_is_asked_for_is_had_whatever_waits() {
        assert_eq!((Threads::Fixed(3).of_job(1, 0, 1), Threads::Fixed(3).of_job(9, 99, 9), Threads::Fixed(0).of_job(1, 0, 1)), (3, 3, 1));
    }
}
