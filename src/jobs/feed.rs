//! What everyone is told who listens to all jobs of the service.
//!
//! One task of a process reads each changed job once and tells all listeners, however many there are. It learns of changes as waiting callers
//! do: from this process at once, from other nodes by what they tell (`listen.rs`), and, where a database is shared, by a look at the jobs that
//! are not finished while somebody listens. Whoever falls behind is told that something was missed and reads the list again.

use super::{
    database::values,
    error::StoreError,
    job::Job,
    store::{Inner, Store, parse_id},
    watch::Change,
};
use std::{
    collections::HashMap,
    sync::{Arc, Weak},
};
use tokio::{
    sync::broadcast::{self, error::RecvError},
    time::{MissedTickBehavior, interval},
};
use uuid::Uuid;

/// News that a listener may be behind.
const BACKLOG: usize = 256;

/// What a listener is told.
#[derive(Debug, Clone)]
pub enum News {
    /// A job is new or has changed.
    Changed(Arc<Job>),
    /// A job and its data are gone.
    Deleted {
        /// Which.
        id: Uuid,
        /// Whose it was, where that is still known.
        owner: Option<Arc<str>>,
    },
    /// Changes may have been missed: the list is to be read again.
    Missed,
}

impl Store {
    /// What happens to any job from now on. Must be called on a runtime of tokio.
    pub fn news(&self) -> broadcast::Receiver<News> {
        let start = || {
            let (sender, _) = broadcast::channel(BACKLOG);
            let changes = self.inner.watchers.watch_all();
            tokio::spawn(run(Arc::downgrade(&self.inner), changes, sender.clone()));
            sender
        };
        self.inner.feed.get_or_init(start).subscribe()
    }

    /// The jobs that are not finished, and those that are newer than all of the look before, with their versions.
    async fn look(&self, before: Option<&Look>) -> Result<Look, StoreError> {
        let sql = "SELECT id, version, owner FROM jobs WHERE state IN ('queued', 'running') OR id > $1";
        let newest = match before {
            Some(look) => look.newest,
            None => match self.inner.database.fetch_one("SELECT MAX(id) FROM jobs", vec![]).await?.map(|row| row.get(0)).transpose()? {
                Some(Some(id)) => parse_id(&Option::<String>::unwrap_or_default(id))?,
                _ => Uuid::nil(),
            },
        };
        let rows = self.inner.database.fetch(sql, values![newest]).await?;
        let versions = rows.iter().map(|row| {
            let owner: Arc<str> = row.get::<String>(2)?.into();
            Ok((parse_id(&row.get::<String>(0)?)?, (row.get(1)?, owner)))
        });
        let versions = versions.collect::<Result<HashMap<_, _>, StoreError>>()?;
        Ok(Look { newest: versions.keys().copied().fold(newest, Ord::max), versions })
    }
}

/// The rows as they were when they were looked at.
struct Look {
    /// Of jobs that were not finished: versions and owners.
    versions: HashMap<Uuid, (i64, Arc<str>)>,
    newest: Uuid,
}

impl Look {
    /// Notes what listeners are told of a job; returns whether they were told before.
    fn told(&mut self, job: &Job) -> bool {
        if job.state.is_final() {
            self.versions.remove(&job.id);
            return false;
        }
        self.versions.insert(job.id, (job.version, job.owner.as_str().into())).is_some_and(|(version, _)| version == job.version)
    }
}

/// Tells listeners while the store lives.
async fn run(store: Weak<Inner>, mut changes: broadcast::Receiver<Option<Change>>, listeners: broadcast::Sender<News>) {
    let Some((shared, poll)) = store.upgrade().map(|inner| (inner.database.is_shared(), inner.settings.poll)) else { return };
    let mut looks = interval(poll);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut known: Option<Look> = None;
    loop {
        let changed = tokio::select! {
            change = changes.recv() => match change {
                Ok(Some(change)) => Some(vec![change]),
                Ok(None) | Err(RecvError::Lagged(_)) => None,
                Err(RecvError::Closed) => return,
            },
            _ = looks.tick(), if shared => Some(vec![]),
        };
        let Some(store) = store.upgrade().map(|inner| Store { inner }) else { return };
        if listeners.receiver_count() == 0 {
            // Who begins to listen reads the list himself.
            known = None;
            continue;
        }
        let news = match changed {
            None => vec![News::Missed],
            Some(changed) if changed.is_empty() => match found(&store, &mut known).await {
                Some(changed) => read(&store, changed, &mut known).await,
                None => vec![News::Missed],
            },
            Some(changed) => read(&store, changed, &mut known).await,
        };
        for one in news {
            // The last listener may just have left.
            drop(listeners.send(one));
        }
    }
}

/// The jobs as they now are, but for those that were told already.
async fn read(store: &Store, changed: Vec<Change>, known: &mut Option<Look>) -> Vec<News> {
    let mut news = Vec::with_capacity(changed.len());
    for Change { id, owner } in changed {
        match store.get(id).await {
            Ok(Some(job)) => {
                if !known.as_mut().is_some_and(|known| known.told(&job)) {
                    news.push(News::Changed(Arc::new(job)));
                }
            }
            Ok(None) => news.push(News::Deleted { id, owner }),
            Err(error) => {
                tracing::debug!(%error, "a changed job could not be read for those who listen");
                news.push(News::Missed);
            }
        }
    }
    news
}

/// The jobs that are new, have changed or are finished since the rows were last looked at, and the rows as they now are; `None` if they were not: what
/// changed since somebody began to listen cannot be told from what had before.
async fn found(store: &Store, known: &mut Option<Look>) -> Option<Vec<Change>> {
    let now = match store.look(known.as_ref()).await {
        Ok(now) => now,
        Err(error) => {
            tracing::debug!(%error, "changes of other nodes could not be looked for");
            return Some(vec![]);
        }
    };
    let Some(before) = known.take() else {
        *known = Some(now);
        return None;
    };
    let new = now.versions.iter().filter(|(id, (version, _))| before.versions.get(id).is_none_or(|(before, _)| before != version));
    let finished = before.versions.iter().filter(|(id, _)| !now.versions.contains_key(id));
    let changed = new.chain(finished).map(|(id, (_, owner))| Change { id: *id, owner: Some(Arc::clone(owner)) }).collect();
    // What is read now is compared with what was told, not with what was just seen.
    *known = Some(Look { versions: before.versions, newest: now.newest });
    Some(changed)
}
