//! A database of an earlier version is brought to the present one by opening it, and loses nothing.

use crate::place::{Place, new_job, on_both_engines, output, study};
use sha2::{Digest, Sha256};
use std::time::Duration;
use uuid::Uuid;
use ventricle::{
    jobs::{Backend, Deletion, ListQuery, NewJob, Outcome, Snapshot, State, Store, StoreError, StoreSettings, Submitted, input},
    pipeline::parameters::Parameters,
    report::Summary,
};

on_both_engines! {
    opening_upgrades_and_loses_nothing,
    an_older_program_refuses_what_a_later_one_has_upgraded,
}

const VERSION_1: &str = include_str!("../../src/jobs/schema.sql");
/// When the rows of version 1 were written: in 2026.
const THEN_MS: i64 = 1_790_000_000_000;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().flat_map(|byte| [byte >> 4, byte & 0xf]).filter_map(|nibble| char::from_digit(nibble.into(), 16)).collect()
}

/// Bytes as the engine's SQL has them.
fn literal(place: &Place, bytes: &[u8]) -> String {
    match place.backend {
        Backend::Sqlite { .. } => format!("x'{}'", hex(bytes)),
        Backend::Postgres { .. } => format!("'\\x{}'::bytea", hex(bytes)),
    }
}

/// One job in every state, as version 1 left them; the ids in the order of [`State::ALL`].
async fn write_version_1(place: &Place) -> [Uuid; 5] {
    let bytes = if matches!(place.backend, Backend::Sqlite { .. }) { "BLOB" } else { "BYTEA" };
    let mut statements = vec![VERSION_1.replace("{bytes}", bytes)];
    statements.push("CREATE TABLE schema_version (version BIGINT NOT NULL); INSERT INTO schema_version (version) VALUES (1);".to_owned());
    let parameters = serde_json::to_string(&Parameters::paper()).unwrap();
    let stored = input::encode(&study()).unwrap();
    let ids = State::ALL.map(|_| Uuid::now_v7());
    for (id, state) in ids.into_iter().zip(State::ALL) {
        let lease = match state {
            State::Queued => "0, NULL, NULL",
            State::Running => "1, 'old/worker-1', 1",
            State::Succeeded | State::Failed | State::Cancelled => "1, NULL, NULL",
        };
        let finished = if state.is_final() { (THEN_MS + 3000).to_string() } else { "NULL".to_owned() };
        let started = if state == State::Queued { "NULL".to_owned() } else { (THEN_MS + 1000).to_string() };
        let error = if state == State::Failed { r#"'{"code":"no_border","message":"None."}'"# } else { "NULL" };
        statements.push(format!(
            "INSERT INTO jobs (id, owner, idempotency_key, request_hash, kind, parameters, study_instance_uid, input_bytes, state,
                attempts, lease_owner, lease_until, max_attempts, run_after, gates_total, created_at, started_at, finished_at, error, version)
            VALUES ('{id}', 'someone', 'key-{}', {}, 'reconstruction', '{parameters}', '1.2.3', {}, '{}', {lease}, 3, {THEN_MS}, 4, {THEN_MS},
                {started}, {finished}, {error}, 7);",
            state.name(),
            literal(place, &[1; 32]),
            stored.len(),
            state.name(),
        ));
        let (name, media_type, data) = match state {
            State::Queued | State::Running => ("input", input::MEDIA_TYPE, stored.as_slice()),
            State::Succeeded => ("report", "application/json", b"{\"old\":true}".as_slice()),
            State::Failed | State::Cancelled => continue,
        };
        statements.push(format!(
            "INSERT INTO blobs (job_id, name, media_type, sha256, size, data) VALUES ('{id}', '{name}', '{media_type}', '{}', {}, {});",
            hex(&Sha256::digest(data)),
            data.len(),
            literal(place, data),
        ));
    }
    place.run(statements.concat()).await;
    ids
}

async fn opening_upgrades_and_loses_nothing(place: &Place) {
    let ids = write_version_1(place).await;
    let settings = StoreSettings { retention: Some(Duration::from_mins(1)), ..place.settings() };
    let store = Store::open(settings.clone()).await.unwrap();
    // SQLite takes back what ran as it opens, PostgreSQL when the lease is over, as this one is.
    store.reap().await.unwrap();
    let jobs = store.list(ListQuery::default()).await.unwrap().jobs;
    let mut states: Vec<_> = jobs.iter().map(|job| (job.id, job.state, job.attempt)).collect();
    states.reverse();
    let [queued, running, succeeded, failed, cancelled] = ids;
    assert_eq!(
        states,
        [
            (queued, State::Queued, 0),
            (running, State::Queued, 1),
            (succeeded, State::Succeeded, 1),
            (failed, State::Failed, 1),
            (cancelled, State::Cancelled, 1),
        ]
    );
    assert!(jobs.iter().all(|job| job.study_instance_uid.as_deref() == Some("1.2.3") && job.created_at.as_millisecond() == THEN_MS));
    assert!(jobs.iter().all(|job| job.expires_at.is_none()), "no time was set for them");
    assert!(jobs.iter().all(|job| job.summary.is_none() && job.input_kept == (job.state == State::Queued)), "{jobs:?}");
    assert!(store.expire().await.unwrap().is_empty());
    assert_eq!(store.blob(succeeded, "report").await.unwrap().unwrap().data, b"{\"old\":true}");
    assert_eq!(store.get(failed).await.unwrap().unwrap().error.unwrap().code, "no_border");
    assert_eq!(store.counts().await.unwrap().queued, 2);

    let repeated = NewJob { idempotency_key: Some("key-succeeded".into()), ..new_job() };
    let repeated = store.submit(store.reserve(100).unwrap(), repeated).await.unwrap();
    assert!(matches!(&repeated, Submitted::Existing(job) if job.id == succeeded), "{repeated:?}");
    let claim = store.claim("new").await.unwrap().unwrap();
    assert_eq!(claim.id, queued);
    assert_eq!(input::decode(&store.input(&claim).await.unwrap().unwrap()).unwrap(), study());
    assert_eq!(serde_json::from_str::<Parameters>(&claim.parameters).unwrap(), Parameters::paper());
    let summary = Summary { edv_ml: None, esv_ml: None, ef_percent: None, mass_g: 120.5, quality_score: 0.75, flags: vec!["odd".into()] };
    let outputs = [output("report", b"{}"), output("summary", &serde_json::to_vec(&summary).unwrap())];
    store.finish(&claim, Outcome::Succeeded(outputs.into()), &Snapshot::default()).await.unwrap();
    let done = store.get(queued).await.unwrap().unwrap();
    assert_eq!((done.summary, done.input_kept), (Some(summary), false), "the operator's setting decides of what was stored before");
    assert_eq!(store.blob(queued, "summary").await.unwrap(), None, "it is a part of the job");
    assert_eq!(done.expires_at.unwrap().duration_since(done.finished_at.unwrap()).as_secs(), 60);
    assert_eq!(store.delete(cancelled).await.unwrap(), Deletion::Deleted);
    store.close().await;

    let store = Store::open(settings).await.unwrap();
    assert_eq!(store.list(ListQuery::default()).await.unwrap().jobs.len(), 4, "opened again, nothing is done again");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nodes_that_open_at_once_upgrade_once() {
    for version in [0, 1] {
        let Some(place) = Place::postgres().await else { return };
        if version == 1 {
            write_version_1(&place).await;
        }
        // A step that was done twice would fail: its tables and columns are there already.
        let opening: Vec<_> = (0..4).map(|_| tokio::spawn(Store::open(place.settings()))).collect();
        for node in opening {
            let store = node.await.unwrap().unwrap_or_else(|error| panic!("from version {version}: {error}"));
            assert_eq!(store.list(ListQuery::default()).await.unwrap().jobs.len(), 5 * version);
            store.close().await;
        }
    }
}

async fn an_older_program_refuses_what_a_later_one_has_upgraded(place: &Place) {
    place.open().await.close().await;
    place.run("UPDATE schema_version SET version = version + 1".to_owned()).await;
    let refused = Store::open(place.settings()).await.unwrap_err();
    assert!(matches!(refused, StoreError::SchemaTooNew { found, known } if found == known + 1), "{refused}");
}
