//! Who parses, on threads that may take their time, and how many at once.

use std::sync::Arc;
use tokio::sync::Semaphore;

/// A number of threads that parse. Clones share it.
#[derive(Debug, Clone)]
pub struct Parsers(Arc<Semaphore>);

/// Why nothing was parsed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotParsed {
    /// Nobody parses any more.
    Closed,
    /// The parser panicked; the log has it.
    Panicked,
}

impl Parsers {
    /// So many at once.
    pub fn new(at_once: usize) -> Self {
        Self(Arc::new(Semaphore::new(at_once)))
    }

    /// Runs a parser when it is its turn.
    pub async fn run<T: Send + 'static>(&self, parser: impl FnOnce() -> T + Send + 'static) -> Result<T, NotParsed> {
        let permit = Arc::clone(&self.0).acquire_owned().await.map_err(|_| NotParsed::Closed)?;
        let parsed = tokio::task::spawn_blocking(move || {
            let _permit = permit; // held to the end even if the caller goes away
            parser()
        });
        parsed.await.map_err(|panic| {
            tracing::error!(%panic, "a parser panicked");
            NotParsed::Panicked
        })
    }
}
