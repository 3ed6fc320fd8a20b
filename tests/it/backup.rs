//! What was backed up while nodes worked goes on where it is restored, with nothing lost that the backup had.

use crate::{
    cluster::Cluster,
    place::{Place, output, submit, until_state, work, workers},
};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Duration,
};
use uuid::Uuid;
use ventricle::jobs::{ListQuery, State, Store, StoreSettings, Workers};

/// A store whose leases are over soon after a restore, though not while a busy machine pauses.
async fn open(place: &Place) -> Store {
    Store::open(StoreSettings { lease: Duration::from_secs(3), ..place.settings() }).await.unwrap()
}

/// Workers that take so long for a job; its report is its id and who made it.
fn slow_workers(store: &Store, maker: &'static str, takes: Duration) -> Workers {
    let report = move |id: Uuid| vec![output("report", format!("{id} {maker}").as_bytes())];
    workers(
        store,
        work(move |_, _, id, _| {
            std::thread::sleep(takes);
            Ok(report(id))
        }),
    )
}

/// The state of every job.
async fn states(store: &Store) -> BTreeMap<Uuid, State> {
    let mut states = BTreeMap::new();
    let mut query = ListQuery { limit: ListQuery::LARGEST_LIMIT, ..ListQuery::default() };
    loop {
        let page = store.list(query.clone()).await.unwrap();
        states.extend(page.jobs.iter().map(|job| (job.id, job.state)));
        let Some(cursor) = page.next_cursor else { return states };
        query.cursor = Some(cursor);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_dump_made_while_nodes_work_goes_on_where_it_is_restored() {
    let Some(cluster) = Cluster::start("backup and restore").map(Arc::new) else { return };
    let place = Place::postgres_database(cluster.url.clone());
    let nodes = [open(&place).await, open(&place).await];
    let working = nodes.each_ref().map(|node| slow_workers(node, "before", Duration::from_millis(50)));
    let mut before = BTreeSet::new();
    for number in 0..30 {
        before.insert(submit(&nodes[number % 2]).await.id);
    }
    until_state(&nodes[0], *before.first().unwrap(), State::Succeeded).await;
    let node = nodes[0].clone();
    let submitting = tokio::spawn(async move {
        let mut after = BTreeSet::new();
        for _ in 0..30 {
            after.insert(submit(&node).await.id);
        }
        after
    });
    let dumped = Arc::clone(&cluster);
    let dump = tokio::task::spawn_blocking(move || dumped.run("pg_dump", &["--format", "custom", &dumped.url], &[])).await.unwrap();
    let after = submitting.await.unwrap();
    drop(working);
    for node in nodes {
        node.close().await;
    }

    cluster.run("psql", &["--quiet", "--command", "CREATE DATABASE restored", &cluster.url], &[]);
    let restored = cluster.url.replace("/postgres", "/restored");
    assert_ne!(restored, cluster.url);
    cluster.run("pg_restore", &["--exit-on-error", "--dbname", &restored], &dump);
    let place = Place::postgres_database(restored);
    let nodes = [open(&place).await, open(&place).await];
    let dumped = states(&nodes[0]).await;
    let known: BTreeSet<Uuid> = dumped.keys().copied().collect();
    assert!(before.is_subset(&known) && known.is_subset(&(&before | &after)), "what was accepted before the dump is in it");
    let count = |wanted: State| dumped.values().filter(|state| **state == wanted).count();
    assert!(count(State::Succeeded) > 0 && count(State::Queued) > 0, "the dump was made in the middle: {dumped:?}");
    let _working = nodes.each_ref().map(|node| slow_workers(node, "after", Duration::ZERO));
    for (id, state) in &dumped {
        let job = until_state(&nodes[1], *id, State::Succeeded).await;
        let report = String::from_utf8(nodes[1].blob(*id, "report").await.unwrap().unwrap().data).unwrap();
        let (maker, attempt) = match state {
            State::Succeeded => ("before", 1),
            State::Running => ("after", 2),
            _ => ("after", 1),
        };
        assert_eq!((report, job.attempt), (format!("{id} {maker}"), attempt), "{state:?} in the dump");
        assert_eq!(nodes[0].blob(*id, "input").await.unwrap(), None);
    }
    assert_eq!(states(&nodes[0]).await.len(), dumped.len());
}
