//! Who waits for a change of which job. A hint only: changes that nobody told of are found by polling.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};
use tokio::sync::{broadcast, watch};
use uuid::Uuid;

/// Changes that who watches all jobs may be behind.
const BACKLOG: usize = 1024;

/// The waiting callers of one process.
#[derive(Debug)]
pub(super) struct Watchers {
    by_job: Mutex<HashMap<Uuid, watch::Sender<()>>>,
    all: broadcast::Sender<Option<Change>>,
}

/// A job that has changed.
#[derive(Debug, Clone)]
pub(super) struct Change {
    pub(super) id: Uuid,
    /// Whose it is, where that is known without the row, which may be gone.
    pub(super) owner: Option<Arc<str>>,
}

impl Default for Watchers {
    fn default() -> Self {
        Self { by_job: Mutex::default(), all: broadcast::channel(BACKLOG).0 }
    }
}

/// One waiting caller.
pub(super) struct Watcher<'a> {
    watchers: &'a Watchers,
    id: Uuid,
    receiver: Option<watch::Receiver<()>>,
}

impl Watchers {
    fn by_job(&self) -> MutexGuard<'_, HashMap<Uuid, watch::Sender<()>>> {
        self.by_job.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sees every change announced from now on.
    pub(super) fn watch(&self, id: Uuid) -> Watcher<'_> {
        let receiver = self.by_job().entry(id).or_insert_with(|| watch::channel(()).0).subscribe();
        Watcher { watchers: self, id, receiver: Some(receiver) }
    }

    /// Sees which jobs change from now on; `None`: any may have.
    pub(super) fn watch_all(&self) -> broadcast::Receiver<Option<Change>> {
        self.all.subscribe()
    }

    /// Any job may have changed.
    pub(super) fn announce_all(&self) {
        // Nobody may be watching all jobs.
        drop(self.all.send(None));
        for sender in self.by_job().values() {
            sender.send_replace(());
        }
    }

    /// The job has changed.
    pub(super) fn announce(&self, id: Uuid) {
        self.tell(Change { id, owner: None });
    }

    /// The job of this owner has changed, or is gone.
    pub(super) fn announce_of(&self, id: Uuid, owner: &str) {
        self.tell(Change { id, owner: Some(owner.into()) });
    }

    fn tell(&self, change: Change) {
        let id = change.id;
        // Nobody may be watching all jobs.
        drop(self.all.send(Some(change)));
        if let Some(sender) = self.by_job().get(&id) {
            sender.send_replace(());
        }
    }
}

impl Watcher<'_> {
    /// Waits for the next change not yet waited for.
    pub(super) async fn changed(&mut self) {
        if let Some(receiver) = &mut self.receiver
            && receiver.changed().await.is_ok()
        {
            return;
        }
        // The sender lives while a watcher does; should it not, polling goes on.
        std::future::pending::<()>().await;
    }
}

impl Drop for Watcher<'_> {
    fn drop(&mut self) {
        let mut by_job = self.watchers.by_job();
        drop(self.receiver.take());
        if by_job.get(&self.id).is_some_and(|sender| sender.receiver_count() == 0) {
            by_job.remove(&self.id);
        }
    }
}
