//! Studies side by side.

use rayon::{ThreadPoolBuildError, ThreadPoolBuilder};
use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

/// The value of a function for every item, in order, on some threads, each with a pool of its own: on a shared one, a study that waits for
/// its gates runs pieces of another, and a study's seconds would be those of both.
///
/// Errors: a thread's pool that cannot be made.
pub fn in_order<I: Sync, T: Send>(
    items: &[I],
    threads: usize,
    value: impl Fn(usize, &I) -> T + Sync,
) -> Result<Vec<T>, ThreadPoolBuildError> {
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<(usize, T)>> = Mutex::new(Vec::with_capacity(items.len()));
    let pools = (0..threads.max(1)).map(|_| ThreadPoolBuilder::new().num_threads(1).build()).collect::<Result<Vec<_>, _>>()?;
    thread::scope(|scope| {
        for pool in &pools {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(item) = items.get(index) else { break };
                    let result = pool.install(|| value(index, item));
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_unstable_by_key(|(index, _)| *index);
    Ok(done.into_iter().map(|(_, value)| value).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_comes_back_in_its_place() {
        let items: Vec<usize> = (0..100).collect();
        for threads in [0, 1, 3] {
            let squares = in_order(&items, threads, |index, item| (index, item * item)).unwrap();
            assert!(squares.iter().enumerate().all(|(place, &(index, square))| place == index && square == place * place));
        }
    }
}
