//! Who takes back what lost workers held, counts what waits and deletes what is over. Every node has one; which of them is first does
//! not matter.

use super::store::Store;
use std::time::Duration;
use tokio::time::{MissedTickBehavior, interval};

/// Looks this often in the time of one lease, so that a lost job waits at most a third longer than its lease.
const LOOKS_PER_LEASE: u32 = 3;
/// The shortest time between two looks.
const SHORTEST_PAUSE: Duration = Duration::from_millis(50);

/// Takes back jobs whose lease is over and deletes those whose time is, for ever.
pub(super) async fn run(store: Store) {
    let settings = &store.inner.settings;
    let pause = (settings.lease / LOOKS_PER_LEASE).max(SHORTEST_PAUSE);
    let mut looks = interval(pause);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    // What waits is counted in memory; where other nodes take from it too, the rows are counted as often as they are polled.
    let shared = store.inner.database.is_shared();
    let mut counts = interval(settings.poll.max(SHORTEST_PAUSE));
    counts.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            _ = looks.tick() => {
                reap(&store).await;
                count(&store).await;
                // Half of the time is the others'; what is left over waits for the next look.
                if let Err(error) = store.tidy(pause / 2).await {
                    tracing::warn!(%error, "what is to be kept no longer could not be deleted");
                }
            }
            _ = counts.tick(), if shared => count(&store).await,
        }
    }
}

async fn reap(store: &Store) {
    let reaped = match store.look_at_clock().await {
        Ok(Some(now_ms)) => store.reap_lost(now_ms).await,
        Ok(None) => return,
        Err(error) => Err(error),
    };
    match reaped {
        Ok(reaped) => {
            for job in reaped {
                tracing::warn!(job_id = %job.id, state = job.state.name(), "the worker of a job was lost");
                metrics::counter!("ventricle_jobs_reaped_total", "state" => job.state.name()).increment(1);
            }
        }
        Err(error) => tracing::warn!(%error, "lost jobs could not be looked for"),
    }
}

async fn count(store: &Store) {
    if let Err(error) = store.publish_counts().await {
        tracing::warn!(%error, "the queue could not be counted");
    }
}
