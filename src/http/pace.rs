//! How fast a body must come: it makes no pause longer than one time, and is there within another. Who sends nothing, or next to nothing, holds no
//! place for long.

use super::body::BodyError;
use axum::body::Bytes;
use futures_util::{Stream, StreamExt};
use std::{
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll},
    time::Duration,
};
use tokio::time::{Instant, Sleep, sleep_until};

/// How fast.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    /// Longest time without a byte.
    pub pause: Duration,
    /// Time for the whole.
    pub time: Duration,
    /// Each so many bytes that came give it that time once more.
    pub longer_by_bytes: u64,
}

impl Pace {
    /// The time of a body of which so many bytes came.
    fn time_of(self, received: u64) -> Duration {
        self.time.saturating_add(self.time.mul_f64(received as f64 / self.longer_by_bytes.max(1) as f64))
    }
}

/// Time that the service took for itself while a body was under way, which is not its sender's. Clones share it.
#[derive(Debug, Clone, Default)]
pub(super) struct OwnTime(Arc<AtomicU64>);

impl OwnTime {
    /// So much more.
    pub(super) fn add(&self, time: Duration) {
        self.0.fetch_add(time.as_millis() as u64, Ordering::Relaxed);
    }

    fn get(&self) -> Duration {
        Duration::from_millis(self.0.load(Ordering::Relaxed))
    }
}

/// The chunks of a body, until it is too slow.
pub(super) struct Paced<S> {
    chunks: S,
    pace: Pace,
    own_time: OwnTime,
    began: Instant,
    received: u64,
    /// When the pause is too long that goes on now.
    pause_ends: Option<Instant>,
    timer: Pin<Box<Sleep>>,
}

impl<S> Paced<S> {
    /// From now on.
    pub(super) fn new(chunks: S, pace: Pace, own_time: OwnTime) -> Self {
        let began = Instant::now();
        Self { chunks, pace, own_time, began, received: 0, pause_ends: None, timer: Box::pin(sleep_until(began)) }
    }
}

impl<S: Stream<Item = Result<Bytes, axum::Error>> + Unpin> Stream for Paced<S> {
    type Item = Result<Bytes, BodyError>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let this = &mut *self;
        // What is there came in time, however late it is asked for.
        if let Poll::Ready(next) = this.chunks.poll_next_unpin(context) {
            this.pause_ends = None;
            return Poll::Ready(next.map(|chunk| {
                let chunk = chunk.map_err(|error| BodyError::from_stream(&error))?;
                this.received += chunk.len() as u64;
                Ok(chunk)
            }));
        }
        loop {
            let now = Instant::now();
            let pause_ends = *this.pause_ends.get_or_insert(now + this.pace.pause);
            let allowed = this.pace.time_of(this.received);
            let ends = this.began + allowed + this.own_time.get();
            if now >= ends {
                return Poll::Ready(Some(Err(BodyError::TooSlow { seconds: allowed.as_secs(), received: this.received })));
            }
            if now >= pause_ends {
                return Poll::Ready(Some(Err(BodyError::Stalled { seconds: this.pace.pause.as_secs() })));
            }
            this.timer.as_mut().reset(ends.min(pause_ends));
            std::task::ready!(this.timer.as_mut().poll(context));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::stream;
    use std::convert::Infallible;

    const PACE: Pace = Pace { pause: Duration::from_millis(300), time: Duration::from_millis(600), longer_by_bytes: 100 };

    /// Chunks of so many bytes, each so long after the one before, and then nothing more. They come before the pause that ends with them does,
    /// however slow the machine is: what is there is asked for first.
    fn chunks(every_ms: u64, bytes: usize, count: usize) -> impl Stream<Item = Result<Bytes, axum::Error>> + Unpin {
        let chunks = stream::iter(0..count).then(move |_| async move {
            tokio::time::sleep(Duration::from_millis(every_ms)).await;
            Ok::<_, Infallible>(Bytes::from(vec![0; bytes]))
        });
        Box::pin(chunks.map(|chunk| chunk.map_err(axum::Error::new)).chain(stream::pending()))
    }

    /// Bytes that came, and how it ended.
    async fn end(mut paced: Paced<impl Stream<Item = Result<Bytes, axum::Error>> + Unpin>) -> (u64, BodyError) {
        loop {
            if let Err(error) = paced.next().await.unwrap() {
                return (paced.received, error);
            }
        }
    }

    #[tokio::test]
    async fn a_pause_ends_it() {
        let slow = Paced::new(chunks(100, 100, 4), PACE, OwnTime::default());
        assert_eq!(end(slow).await, (400, BodyError::Stalled { seconds: 0 }));
        let silent = Paced::new(chunks(0, 0, 0), PACE, OwnTime::default());
        assert_eq!(end(silent).await, (0, BodyError::Stalled { seconds: 0 }));
    }

    #[tokio::test]
    async fn bytes_give_it_more_time_and_drops_do_not() {
        let drops = Paced::new(chunks(100, 1, 1000), PACE, OwnTime::default());
        let (received, error) = end(drops).await;
        assert!(matches!(error, BodyError::TooSlow { .. }) && (1..=6).contains(&received), "{received} {error}");
        // Over twice as fast as it must be, for three times the time.
        let steady = Paced::new(chunks(100, 50, 18), PACE, OwnTime::default());
        assert_eq!(end(steady).await, (900, BodyError::Stalled { seconds: 0 }));
    }

    #[tokio::test]
    async fn the_time_of_the_service_is_not_the_senders() {
        let own_time = OwnTime::default();
        own_time.add(Duration::from_secs(1));
        let began = Instant::now();
        assert!(matches!(end(Paced::new(chunks(100, 0, 1000), PACE, own_time)).await.1, BodyError::TooSlow { .. }));
        assert!(began.elapsed() >= Duration::from_millis(1600));
        // A pause in asking is none in sending.
        let mut late = Paced::new(chunks(50, 7, 2), PACE, OwnTime::default());
        assert_eq!(late.next().await.unwrap().unwrap().len(), 7);
        assert!(futures_util::poll!(late.next()).is_pending());
        tokio::time::sleep(2 * PACE.time).await;
        assert_eq!(late.next().await.unwrap().unwrap().len(), 7);
    }
}
