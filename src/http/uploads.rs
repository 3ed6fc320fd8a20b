//! Room for bodies with studies: how many are received at once, and how much of the memory they may take. A body that waits for room is not read
//! meanwhile, so that its sender waits too.

use std::{sync::Arc, time::Duration};
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore, TryAcquireError},
    time::timeout,
};

/// What memory is counted in.
const BLOCK_BYTES: u64 = 1 << 10;
/// Seconds after which there may be room.
pub(super) const RETRY_AFTER_S: u64 = 5;
/// How long a body waits for room, if nothing else is said.
const PATIENCE: Duration = Duration::from_secs(10);

/// Room for bodies. Clones share it.
#[derive(Debug, Clone)]
pub(super) struct Uploads(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    /// Bodies that are received or wait: twice those that may be received.
    line: Arc<Semaphore>,
    places: Arc<Semaphore>,
    blocks: Arc<Semaphore>,
    most_blocks: u32,
    patience: Duration,
}

/// The room of one body, given back when dropped.
#[derive(Debug)]
pub(super) struct Room {
    _line: OwnedSemaphorePermit,
    _place: OwnedSemaphorePermit,
    blocks: OwnedSemaphorePermit,
}

/// There is no room, and was none for a while.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("As many studies are being received as the service takes at once, or has memory for. Send the request again in {RETRY_AFTER_S} s.")]
pub(super) struct UploadsFull;

impl Uploads {
    /// At most so many at once, which together hold at most so many bytes.
    pub(super) fn new(at_once: usize, bytes: u64) -> Self {
        Self::with_patience(at_once, bytes, PATIENCE)
    }

    /// The same with another time to wait.
    pub(super) fn with_patience(at_once: usize, bytes: u64, patience: Duration) -> Self {
        let most_blocks = blocks(bytes);
        Self(Arc::new(Shared {
            line: Arc::new(Semaphore::new(2 * at_once)),
            places: Arc::new(Semaphore::new(at_once)),
            blocks: Arc::new(Semaphore::new(most_blocks as usize)),
            most_blocks,
            patience,
        }))
    }

    /// Room for a body that holds at most so many bytes, when there is some. What could hold more than all the memory gets all of it.
    pub(super) async fn room(&self, bytes: u64) -> Result<Room, UploadsFull> {
        let shared = &self.0;
        let line = Arc::clone(&shared.line).try_acquire_owned().map_err(|_: TryAcquireError| UploadsFull)?;
        let wanted = blocks(bytes).min(shared.most_blocks);
        let waited = timeout(shared.patience, async {
            let place = Arc::clone(&shared.places).acquire_owned().await?;
            let blocks = Arc::clone(&shared.blocks).acquire_many_owned(wanted).await?;
            Ok::<_, tokio::sync::AcquireError>((place, blocks))
        });
        let (place, blocks) = waited.await.ok().and_then(Result::ok).ok_or(UploadsFull)?;
        count(&blocks, 1.0);
        Ok(Room { _line: line, _place: place, blocks })
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        count(&self.blocks, -1.0);
    }
}

fn count(blocks: &OwnedSemaphorePermit, sign: f64) {
    metrics::gauge!("ventricle_upload_reserved_bytes").increment(sign * (blocks.num_permits() as u64 * BLOCK_BYTES) as f64);
}

/// Bytes as blocks, the last one whole.
fn blocks(bytes: u64) -> u32 {
    u32::try_from(bytes.div_ceil(BLOCK_BYTES)).unwrap_or(u32::MAX).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1 << 20;

    #[tokio::test]
    async fn memory_is_shared_out_and_given_back() {
        let uploads = Uploads::with_patience(9, 4 * MIB, Duration::from_millis(50));
        let (first, second) = (uploads.room(3 * MIB).await.unwrap(), uploads.room(MIB).await.unwrap());
        assert_eq!(uploads.room(1).await.unwrap_err(), UploadsFull);
        drop(second);
        assert_eq!(uploads.room(2 * MIB).await.unwrap_err(), UploadsFull);
        let small = uploads.room(MIB).await.unwrap();
        let waiting = tokio::spawn({
            let uploads = Uploads(Arc::new(Shared {
                line: Arc::clone(&uploads.0.line),
                places: Arc::clone(&uploads.0.places),
                blocks: Arc::clone(&uploads.0.blocks),
                most_blocks: uploads.0.most_blocks,
                patience: Duration::from_mins(1),
            }));
            async move { uploads.room(100 * MIB).await }
        });
        drop((first, small));
        let all = waiting.await.unwrap().unwrap();
        assert_eq!(all.blocks.num_permits() as u64 * BLOCK_BYTES, 4 * MIB, "more than all is all");
    }

    #[tokio::test]
    async fn places_are_few_and_so_is_the_line_for_them() {
        let uploads = Uploads::with_patience(1, MIB, Duration::from_secs(20));
        let first = uploads.room(1).await.unwrap();
        let mut second = Box::pin(uploads.room(1));
        assert!(timeout(Duration::from_millis(20), &mut second).await.is_err(), "it waits");
        assert_eq!(uploads.room(1).await.unwrap_err(), UploadsFull, "the third is refused at once");
        drop(first);
        second.await.unwrap();
    }
}
