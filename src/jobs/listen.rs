//! Who hears of the changes that other nodes make, on PostgreSQL.
//!
//! Every statement that changes a job tells so by `NOTIFY` in its own transaction (the fragment `{notify}`): `queued`, `changed` or `cancel`,
//! the job's id and its owner. Each store listens on one connection of its own. What is heard is a hint that shortens waiting, never the only way to
//! learn something: free workers and waiting callers look by themselves, and a heartbeat returns the wish to cancel. So nothing is lost when
//! the connection is, or when something between (a pooler) does not carry notifications.

use super::{
    backoff::Backoff,
    database::CHANNEL,
    store::{Inner, Store},
};
use sqlx::{AssertSqlSafe, Executor as _, Row as _, postgres::PgListener};
use std::{io, sync::Weak, time::Duration};
use tokio::time::timeout;
use uuid::Uuid;

/// After so long without a word the connection is tried: one whose other end vanished without a sign would be silent for ever.
const SILENCE: Duration = Duration::from_secs(30);
/// How long that trial may take.
const ANSWER_TIME: Duration = Duration::from_secs(5);

/// Listens while the store lives.
pub(super) async fn run(store: Weak<Inner>, url: String) {
    let connected = metrics::gauge!("ventricle_listener_connected");
    let mut backoff = Backoff::default();
    while store.strong_count() > 0 {
        match connect(&url).await {
            Ok(mut listener) => {
                backoff = Backoff::default();
                connected.set(1.0);
                look_again(&store);
                let why = hear(&store, &mut listener).await;
                connected.set(0.0);
                tracing::warn!(error = %why, "the connection on which other nodes are heard was lost; polling goes on meanwhile");
            }
            Err(error) => tracing::warn!(%error, "other nodes cannot be heard yet; polling goes on meanwhile"),
        }
        backoff.pause().await;
    }
}

async fn connect(url: &str) -> Result<PgListener, sqlx::Error> {
    let mut listener = PgListener::connect(url).await?;
    // There is something to be done after a connection was lost, so it is to be told.
    listener.eager_reconnect(false);
    // In the simple protocol, without a named statement, as everything (see `database.rs`).
    let row = sqlx::raw_sql(AssertSqlSafe(format!("SELECT {CHANNEL}"))).fetch_one(&mut listener).await?;
    listener.listen(row.try_get(0)?).await?;
    Ok(listener)
}

/// Acts on what is told until the connection is lost; returns why.
async fn hear(store: &Weak<Inner>, listener: &mut PgListener) -> sqlx::Error {
    loop {
        match timeout(SILENCE, listener.try_recv()).await {
            Ok(Ok(Some(news))) => act(store, news.payload()),
            Ok(Ok(None)) => return io::Error::from(io::ErrorKind::ConnectionAborted).into(),
            Ok(Err(error)) => return error,
            Err(_) => match timeout(ANSWER_TIME, listener.execute("SELECT 1")).await {
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return error,
                Err(_) => return io::Error::from(io::ErrorKind::TimedOut).into(),
            },
        }
    }
}

/// What was told while nobody listened is unknown: everyone who waits looks for himself.
fn look_again(store: &Weak<Inner>) {
    let Some(inner) = store.upgrade() else { return };
    inner.watchers.announce_all();
    inner.work_ready.notify_one();
}

fn act(store: &Weak<Inner>, news: &str) {
    let Some(store) = store.upgrade().map(|inner| Store { inner }) else { return };
    let Some((kind, id, owner)) = read(news) else {
        tracing::debug!("something was told that is not understood");
        return;
    };
    match kind {
        "queued" => store.inner.work_ready.notify_one(),
        "cancel" => {
            if let Some(progress) = store.running().get(&id) {
                progress.cancel();
            }
        }
        // What a later version may tell is at least a change.
        _ => {}
    }
    store.inner.watchers.announce_of(id, owner);
}

/// The kind of change, the job, and whose it is.
fn read(news: &str) -> Option<(&str, Uuid, &str)> {
    let (kind, rest) = news.split_once(' ')?;
    let (id, owner) = rest.split_once(' ')?;
    Some((kind, Uuid::parse_str(id).ok()?, owner))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn news_are_a_kind_a_job_and_its_owner() {
        let id = Uuid::now_v7();
        assert_eq!(read(&format!("queued {id} St Mary's")), Some(("queued", id, "St Mary's")));
        assert_eq!(read("queued"), None);
        assert_eq!(read("queued 7 anonymous"), None);
    }
}
