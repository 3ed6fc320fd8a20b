//! Room for bodies with studies: how many are received at once, and how much of the memory they may take. A body that waits for room is not read
//! meanwhile, so that its sender waits too. No owner takes more than half of it, so that none shuts the others out.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError, Weak},
    time::Duration,
};
use tokio::{
    sync::{AcquireError, OwnedSemaphorePermit, Semaphore},
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
    all: Share,
    /// What one owner may take.
    most_of_one: (usize, u32),
    owners: Mutex<HashMap<String, Weak<Share>>>,
    patience: Duration,
}

/// Places and memory of all, or of one owner.
#[derive(Debug)]
struct Share {
    /// Bodies that are received or wait: twice those that may be received.
    line: Arc<Semaphore>,
    places: Arc<Semaphore>,
    blocks: Arc<Semaphore>,
    most_blocks: u32,
}

/// The room of one body, given back when dropped.
#[derive(Debug)]
pub(super) struct Room {
    blocks: OwnedSemaphorePermit,
    _permits: Vec<OwnedSemaphorePermit>,
    /// Kept, as who comes next must find what this one has taken.
    _of_owner: Option<Arc<Share>>,
}

/// There is no room, and was none for a while.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "As many studies are being received, of all or of this owner, as the service takes at once or has memory for. Send the request again in \
     {RETRY_AFTER_S} s."
)]
pub(super) struct UploadsFull;

impl Uploads {
    /// At most so many at once, which together hold at most so many bytes.
    pub(super) fn new(at_once: usize, bytes: u64) -> Self {
        Self::with_patience(at_once, bytes, PATIENCE)
    }

    /// The same with another time to wait.
    pub(super) fn with_patience(at_once: usize, bytes: u64, patience: Duration) -> Self {
        Self(Arc::new(Shared {
            all: Share::new(at_once, blocks(bytes)),
            most_of_one: (at_once.div_ceil(2), blocks(bytes).div_ceil(2)),
            owners: Mutex::default(),
            patience,
        }))
    }

    /// Room for a body of an owner, if there are owners, that holds at most so many bytes, when there is some. What could hold more than all the
    /// memory, or than the owner's half of it, gets all of that.
    pub(super) async fn room(&self, owner: Option<&str>, bytes: u64) -> Result<Room, UploadsFull> {
        let of_owner = owner.map(|owner| self.0.share(owner));
        // The owner's first: who waits for his own takes nothing from others but a place in the line.
        let shares: Vec<&Share> = of_owner.as_deref().into_iter().chain([&self.0.all]).collect();
        let mut permits = Vec::with_capacity(3 * shares.len());
        for share in &shares {
            permits.push(Arc::clone(&share.line).try_acquire_owned().map_err(|_| UploadsFull)?);
        }
        let waiting = async {
            for share in shares {
                permits.push(Arc::clone(&share.places).acquire_owned().await?);
                permits.push(Arc::clone(&share.blocks).acquire_many_owned(blocks(bytes).min(share.most_blocks)).await?);
            }
            Ok::<_, AcquireError>(permits)
        };
        let mut permits = timeout(self.0.patience, waiting).await.ok().and_then(Result::ok).ok_or(UploadsFull)?;
        let blocks = permits.pop().ok_or(UploadsFull)?;
        count(&blocks, 1.0);
        Ok(Room { blocks, _permits: permits, _of_owner: of_owner })
    }
}

impl Shared {
    /// That of an owner, as long as something of it is taken.
    fn share(&self, owner: &str) -> Arc<Share> {
        let mut owners = self.owners.lock().unwrap_or_else(PoisonError::into_inner);
        owners.retain(|_, share| share.strong_count() > 0);
        owners.get(owner).and_then(Weak::upgrade).unwrap_or_else(|| {
            let share = Arc::new(Share::new(self.most_of_one.0, self.most_of_one.1));
            owners.insert(owner.to_owned(), Arc::downgrade(&share));
            share
        })
    }
}

impl Share {
    fn new(at_once: usize, most_blocks: u32) -> Self {
        Self {
            line: Arc::new(Semaphore::new(2 * at_once)),
            places: Arc::new(Semaphore::new(at_once)),
            blocks: Arc::new(Semaphore::new(most_blocks as usize)),
            most_blocks,
        }
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
        let (first, second) = (uploads.room(None, 3 * MIB).await.unwrap(), uploads.room(None, MIB).await.unwrap());
        assert_eq!(uploads.room(None, 1).await.unwrap_err(), UploadsFull);
        drop(second);
        assert_eq!(uploads.room(None, 2 * MIB).await.unwrap_err(), UploadsFull);
        let small = uploads.room(None, MIB).await.unwrap();
        drop((first, small));
        let all = uploads.room(None, 100 * MIB).await.unwrap();
        assert_eq!(all.blocks.num_permits() as u64 * BLOCK_BYTES, 4 * MIB, "more than all is all");
    }

    #[tokio::test]
    async fn who_waits_for_memory_gets_it_when_it_is_given_back() {
        let uploads = Uploads::with_patience(9, 4 * MIB, Duration::from_mins(1));
        let first = uploads.room(None, 3 * MIB).await.unwrap();
        let mut second = Box::pin(uploads.room(None, 2 * MIB));
        assert!(timeout(Duration::from_millis(20), &mut second).await.is_err(), "it waits");
        drop(first);
        second.await.unwrap();
    }

    #[tokio::test]
    async fn places_are_few_and_so_is_the_line_for_them() {
        let uploads = Uploads::with_patience(1, MIB, Duration::from_secs(20));
        let first = uploads.room(None, 1).await.unwrap();
        let mut second = Box::pin(uploads.room(None, 1));
        assert!(timeout(Duration::from_millis(20), &mut second).await.is_err(), "it waits");
        assert_eq!(uploads.room(None, 1).await.unwrap_err(), UploadsFull, "the third is refused at once");
        drop(first);
        second.await.unwrap();
    }

    #[tokio::test]
    async fn one_owner_takes_half_and_leaves_the_line_to_others() {
        let uploads = Uploads::with_patience(4, 4 * MIB, Duration::from_millis(200));
        let (first, second) = (uploads.room(Some("one"), 1).await.unwrap(), uploads.room(Some("one"), 1).await.unwrap());
        let wait = || {
            tokio::spawn({
                let uploads = uploads.clone();
                async move { uploads.room(Some("one"), 1).await.map(drop) }
            })
        };
        let waiting = [wait(), wait(), wait()];
        tokio::time::sleep(Duration::from_millis(50)).await;
        let others = [uploads.room(Some("two"), MIB).await.unwrap(), uploads.room(Some("three"), MIB).await.unwrap()];
        let mut refused = 0;
        for waiting in waiting {
            refused += usize::from(waiting.await.unwrap().is_err());
        }
        assert_eq!(refused, 3, "while what is the owner's is taken");
        drop((first, second, others));
        let large = uploads.room(Some("one"), 3 * MIB).await.unwrap();
        assert_eq!(uploads.room(Some("one"), 1).await.unwrap_err(), UploadsFull, "it has all that is the owner's");
        assert!(uploads.room(Some("two"), MIB).await.is_ok());
        drop(large);
        assert!(uploads.0.owners.lock().unwrap().values().all(|share| share.strong_count() == 0), "nothing of them is left");
    }
}
