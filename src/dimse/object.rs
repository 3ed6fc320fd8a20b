//! An object as it arrives: a Part-10 file that grows, within a limit of its own and one for all of them.

use super::{command::Command, negotiate::Context};
use dicom_object::FileMetaTableBuilder;
use std::{sync::Arc, time::Duration};
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore},
    time::timeout,
};

/// What every association may hold without asking: several times a gated study of 64 x 64 x 24 voxels.
const SMALL_BYTES: usize = 8 << 20;
/// Larger objects that are held at once. One that has the permit can be finished: nobody holds a part and waits for another.
const LARGE_AT_ONCE: usize = 2;
/// How long a large object waits for its permit.
const LARGE_TIME: Duration = Duration::from_secs(30);

/// The memory of the objects of all associations: each its small share, and as many large ones as [`LARGE_AT_ONCE`].
#[derive(Debug, Clone)]
pub(super) struct Memory {
    most_bytes: usize,
    large: Arc<Semaphore>,
    patience: Duration,
}

impl Memory {
    /// For objects of at most so many bytes.
    pub(super) fn new(most_bytes: usize) -> Self {
        Self { most_bytes, large: Arc::new(Semaphore::new(LARGE_AT_ONCE)), patience: LARGE_TIME }
    }
}

/// Why an object is not taken further.
#[derive(Debug, thiserror::Error)]
pub(super) enum NoRoom {
    /// It is larger than any may be.
    #[error("The object exceeds {0} MiB, the most accepted here.")]
    TooLarge(usize),
    /// Others are held.
    #[error("Other large objects are being received. Try again later.")]
    Busy,
}

/// A file that grows.
pub(super) struct Object {
    memory: Memory,
    file: Vec<u8>,
    permit: Option<OwnedSemaphorePermit>,
}

/// A whole file, with its claim on memory.
pub(super) struct Received {
    file: Vec<u8>,
    _permit: Option<OwnedSemaphorePermit>,
}

impl AsRef<[u8]> for Received {
    fn as_ref(&self) -> &[u8] {
        &self.file
    }
}

impl Object {
    /// Begins a file: its meta information is what the association says of the data set. `None` if that cannot be written.
    pub(super) fn new(memory: &Memory, command: &Command, context: &Context) -> Option<Self> {
        let meta = FileMetaTableBuilder::new()
            .media_storage_sop_class_uid(&command.class_uid)
            .media_storage_sop_instance_uid(&command.instance_uid)
            .transfer_syntax(&context.transfer_syntax)
            .build()
            .ok()?;
        let mut file = vec![0; 128];
        file.extend_from_slice(b"DICM");
        meta.write(&mut file).ok()?;
        Some(Self { memory: memory.clone(), file, permit: None })
    }

    /// Adds a part of the data set.
    pub(super) async fn add(&mut self, data: &[u8]) -> Result<(), NoRoom> {
        let bytes = self.file.len() + data.len();
        if bytes > self.memory.most_bytes {
            return Err(NoRoom::TooLarge(self.memory.most_bytes >> 20));
        }
        if bytes > SMALL_BYTES && self.permit.is_none() {
            let permit = timeout(self.memory.patience, Arc::clone(&self.memory.large).acquire_owned()).await;
            self.permit = Some(permit.ok().and_then(Result::ok).ok_or(NoRoom::Busy)?);
        }
        self.file.extend_from_slice(data);
        Ok(())
    }

    /// The whole file.
    pub(super) fn whole(self) -> Received {
        Received { file: self.file, _permit: self.permit }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(memory: &Memory) -> Object {
        let command =
            Command { class_uid: "1.2.840.10008.5.1.4.1.1.20".to_owned(), instance_uid: "1.2.3".to_owned(), ..Command::default() };
        let context = Context { id: 1, class_uid: command.class_uid.clone(), transfer_syntax: "1.2.840.10008.1.2.1".to_owned() };
        Object::new(memory, &command, &context).unwrap()
    }

    #[tokio::test]
    async fn small_objects_never_wait_and_large_ones_are_few() {
        let memory = Memory { patience: Duration::from_millis(20), ..Memory::new(16 << 20) };
        let chunk = vec![0; SMALL_BYTES];
        let mut large: Vec<Object> = (0..LARGE_AT_ONCE).map(|_| object(&memory)).collect();
        for object in &mut large {
            object.add(&chunk).await.unwrap();
        }
        let mut late = object(&memory);
        assert!(matches!(late.add(&chunk).await, Err(NoRoom::Busy)));
        object(&memory).add(&chunk[..SMALL_BYTES / 2]).await.unwrap();
        let received = large.pop().unwrap().whole();
        assert!(matches!(late.add(&chunk).await, Err(NoRoom::Busy)), "a received object counts until it is stored");
        drop(received);
        late.add(&chunk).await.unwrap();
        assert!(matches!(late.add(&chunk).await, Err(NoRoom::TooLarge(16))));
    }
}
