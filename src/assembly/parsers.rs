//! Who parses, on threads that may take their time, and how many at once.

use crate::jobs::priority;
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
    thread,
};
use tokio::sync::{Semaphore, oneshot};

/// Stack of a thread that parses: four times the usual, for the deepest nesting the limits allow.
const STACK_BYTES: usize = 8 << 20;

/// A number of threads that parse. Clones share it.
#[derive(Debug, Clone)]
pub struct Parsers(Arc<Semaphore>);

/// Why nothing was parsed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotParsed {
    /// Nobody parses any more.
    Closed,
    /// The parser panicked, or the system had no thread for it; the log has it.
    Panicked,
}

impl Parsers {
    /// So many at once.
    pub fn new(at_once: usize) -> Self {
        Self(Arc::new(Semaphore::new(at_once)))
    }

    /// Runs a parser when it is its turn, on a thread of its own: its priority is lowered, which a thread that others use could not undo.
    pub async fn run<T: Send + 'static>(&self, parser: impl FnOnce() -> T + Send + 'static) -> Result<T, NotParsed> {
        let permit = Arc::clone(&self.0).acquire_owned().await.map_err(|_| NotParsed::Closed)?;
        let (answer, answered) = oneshot::channel();
        let started = thread::Builder::new().name("parser".to_owned()).stack_size(STACK_BYTES).spawn(move || {
            let _permit = permit; // held to the end even if the caller goes away
            priority::lower(priority::PARSING);
            if let Ok(parsed) = catch_unwind(AssertUnwindSafe(parser)) {
                drop(answer.send(parsed));
            }
        });
        if let Err(error) = started {
            tracing::error!(%error, "the system had no thread to parse on");
            return Err(NotParsed::Panicked);
        }
        answered.await.map_err(|_| {
            // What it said is on standard error.
            tracing::error!("a parser panicked");
            NotParsed::Panicked
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[tokio::test]
    async fn no_more_than_so_many_parse_at_once_and_a_panic_is_its_own_alone() {
        let parsers = Parsers::new(2);
        let (now, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let parsing = (0..8).map(|number| {
            let (parsers, now, most) = (parsers.clone(), Arc::clone(&now), Arc::clone(&most));
            tokio::spawn(async move {
                let parser = move || {
                    most.fetch_max(now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                    thread::sleep(std::time::Duration::from_millis(5));
                    now.fetch_sub(1, Ordering::SeqCst);
                    assert_ne!(number, 3, "the third panics");
                    number
                };
                parsers.run(parser).await
            })
        });
        let mut parsed = Vec::new();
        for one in parsing.collect::<Vec<_>>() {
            parsed.push(one.await.unwrap());
        }
        assert_eq!(parsed[3], Err(NotParsed::Panicked));
        assert_eq!(parsed.into_iter().flatten().sum::<usize>(), 25);
        assert_eq!(most.load(Ordering::SeqCst), 2);
    }
}
