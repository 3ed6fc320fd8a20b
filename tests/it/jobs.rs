//! The life of jobs in the store and with workers, on both engines (see `place.rs`).

mod callbacks;
mod results;

use crate::place::{Place, endless, new_job, on_both_engines, output, study, submit, until, until_state, work, workers};
use sha2::{Digest, Sha256};
use sqlx::{ConnectOptions, Connection, sqlite::SqliteConnectOptions};
use std::{
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};
use ventricle::{
    jobs::{
        Deletion, Finish, Heartbeat, ListQuery, NewJob, Outcome, Snapshot, State, Store, StoreError, StoreSettings, SubmitError, Submitted,
        Threads, WorkError, WorkerSettings, input, start_workers,
    },
    pipeline::{
        monitor::{Monitor, Stage},
        parameters::Parameters,
    },
};

on_both_engines! {
    a_job_goes_from_queued_to_succeeded_with_its_results,
    the_input_is_kept_when_asked_for,
    a_job_says_whether_its_input_is_kept,
    the_same_key_and_request_is_the_same_job_however_many_race,
    the_queue_is_limited_by_jobs_and_bytes_exactly,
    a_queued_job_is_cancelled_at_once_and_a_finished_one_deleted,
    a_running_job_stops_within_a_second,
    a_heartbeat_tells_of_the_request_to_cancel_and_a_late_success_is_cancelled,
    what_comes_late_from_a_lost_attempt_is_refused,
    an_attempt_that_lost_its_job_before_reading_the_input_is_told_so,
    a_job_whose_input_is_gone_fails_as_damaged,
    a_panic_fails_its_job_without_internal_text_and_the_worker_goes_on,
    a_drain_waits_then_gives_back_uncharged,
    a_computation_that_does_not_stop_is_left_behind_by_the_drain,
    lists_are_newest_first_in_pages_and_filtered,
    waiting_ends_with_a_change_the_time_or_the_job,
    the_rate_is_measured_and_survives_a_restart,
    a_job_has_the_processors_that_others_leave_it,
}

async fn a_job_goes_from_queued_to_succeeded_with_its_results(place: &Place) {
    let store = place.open().await;
    let job = submit(&store).await;
    assert_eq!((job.state, job.queue_position, job.attempt, job.gates_total), (State::Queued, Some(1), 0, 4));
    assert_eq!(submit(&store).await.queue_position, Some(2));
    let (gate, gates) = std::sync::mpsc::channel::<()>();
    let gates = std::sync::Mutex::new(gates);
    let running = workers(
        &store,
        work(move |given, parameters, id, progress| {
            assert_eq!((given, parameters), (&study(), &Parameters::paper()));
            progress.begin(Stage::Measurement, Some(0));
            progress.end(Stage::Measurement, Some(0));
            progress.advance(1, 4);
            gates.lock().unwrap().recv().unwrap();
            Ok(vec![output("report", id.to_string().as_bytes()), output("gates/1/endocardial.glb", &[0; 300_000])])
        }),
    );
    let seen = until(&store, job.id, |job| job.gates_done == 1).await;
    assert_eq!((seen.state, seen.progress, seen.stage.as_deref()), (State::Running, 0.25, Some("measurement")));
    assert!(seen.version > job.version && seen.started_at.is_some() && seen.queue_position.is_none());
    gate.send(()).unwrap();
    let done = until_state(&store, job.id, State::Succeeded).await;
    assert_eq!((done.progress, done.attempt, done.stage, done.gates_done), (1.0, 1, None, 1));
    assert!(done.finished_at >= done.started_at && done.started_at >= Some(done.created_at));
    let blob = store.blob(job.id, "report").await.unwrap().unwrap();
    assert_eq!((blob.data.as_slice(), blob.media_type.as_str()), (job.id.to_string().as_bytes(), "application/json"));
    let large = store.blob(job.id, "gates/1/endocardial.glb").await.unwrap().unwrap();
    assert_eq!((large.data.len(), large.sha256), (300_000, hex::encode(Sha256::digest(&large.data))));
    assert_eq!(store.blob(job.id, "input").await.unwrap(), None, "the input of a finished job is deleted");
    assert_eq!(store.blob(job.id, "surfaces.glb").await.unwrap(), None);
    gate.send(()).unwrap();
    assert!(running.alive());
    running.drain(Duration::from_secs(10)).await;
    assert!(!running.alive());
}

async fn a_job_has_the_processors_that_others_leave_it(place: &Place) {
    let store = place.open().await;
    let (tell, told) = std::sync::mpsc::channel();
    let (go, gone) = std::sync::mpsc::channel::<()>();
    let gone = std::sync::Mutex::new(gone);
    let work = work(move |_, _, id, _| {
        tell.send((id, rayon::current_num_threads())).unwrap();
        gone.lock().unwrap().recv().unwrap();
        Ok(Vec::new())
    });
    let told = std::sync::Mutex::new(told);
    let next = || told.lock().unwrap().recv_timeout(Duration::from_secs(20)).unwrap();
    let settings = WorkerSettings { workers: 2, threads: Threads::ByLoad(4), work, ..WorkerSettings::default() };
    let workers = start_workers(store.clone(), settings.clone()).unwrap();
    let alone = submit(&store).await.id;
    assert_eq!(next(), (alone, 4), "nothing else runs or waits");
    let second = submit(&store).await.id;
    assert_eq!(next(), (second, 2), "another one runs");
    go.send(()).unwrap();
    go.send(()).unwrap();
    until_state(&store, alone, State::Succeeded).await;
    until_state(&store, second, State::Succeeded).await;
    workers.drain(Duration::from_secs(10)).await;

    let ids = [submit(&store).await.id, submit(&store).await.id, submit(&store).await.id];
    let workers = start_workers(store.clone(), settings).unwrap();
    let mut begun = [next(), next()];
    begun.sort();
    assert_eq!(begun, [(ids[0], 2), (ids[1], 2)], "the other worker takes what waits");
    go.send(()).unwrap();
    assert_eq!(next(), (ids[2], 2));
    go.send(()).unwrap();
    go.send(()).unwrap();
    until_state(&store, ids[2], State::Succeeded).await;
    workers.drain(Duration::from_secs(10)).await;
}

async fn the_input_is_kept_when_asked_for(place: &Place) {
    let store = Store::open(StoreSettings { keep_input: true, ..place.settings() }).await.unwrap();
    let job = submit(&store).await;
    let _workers = workers(&store, work(|_, _, _, _| Ok(Vec::new())));
    until_state(&store, job.id, State::Succeeded).await;
    let input = store.blob(job.id, "input").await.unwrap().unwrap();
    assert_eq!(ventricle::jobs::input::decode(&input.data).unwrap(), study());
}

async fn a_job_says_whether_its_input_is_kept(place: &Place) {
    for (by_default, said, kept) in [(false, Some(true), true), (true, Some(false), false), (true, None, true), (false, None, false)] {
        let store = Store::open(StoreSettings { keep_input: by_default, ..place.settings() }).await.unwrap();
        let new = NewJob { keep_input: said, ..new_job() };
        let id = store.submit(store.reserve(100).unwrap(), new).await.unwrap().job().id;
        assert_eq!(store.kept_input(id).await.unwrap().unwrap().keep_input, said);
        let claim = store.claim("worker").await.unwrap().unwrap();
        store.finish(&claim, Outcome::Succeeded(Arc::default()), &Snapshot::default()).await.unwrap();
        assert_eq!(store.get(id).await.unwrap().unwrap().input_kept, kept, "{by_default} {said:?}");
        assert_eq!(store.kept_input(id).await.unwrap().is_some(), kept);
        store.close().await;
    }
}

async fn the_same_key_and_request_is_the_same_job_however_many_race(place: &Place) {
    let store = place.open().await;
    let keyed = || NewJob { idempotency_key: Some("key".into()), ..new_job() };
    let racing = (0..8).map(|_| {
        let (store, new) = (store.clone(), keyed());
        tokio::spawn(async move { store.submit(store.reserve(100).unwrap(), new).await.unwrap() })
    });
    let mut answers = Vec::new();
    for answer in racing.collect::<Vec<_>>() {
        answers.push(answer.await.unwrap());
    }
    assert_eq!(answers.iter().filter(|answer| matches!(answer, Submitted::Created(_))).count(), 1);
    assert!(answers.iter().all(|answer| answer.job().id == answers[0].job().id));
    assert_eq!(store.counts().await.unwrap().queued, 1);
    assert_eq!(store.counts().await.unwrap().reserved, 0);

    let other = NewJob { request_hash: [2; 32], ..keyed() };
    let refused = store.submit(store.reserve(100).unwrap(), other).await;
    assert!(matches!(refused, Err(SubmitError::KeyReused)));
    let someone_else = NewJob { owner: "someone else".into(), ..keyed() };
    assert!(matches!(store.submit(store.reserve(100).unwrap(), someone_else).await, Ok(Submitted::Created(_))));
}

async fn the_queue_is_limited_by_jobs_and_bytes_exactly(place: &Place) {
    let bytes = ventricle::jobs::input::encode(&study()).unwrap().len() as u64;
    let limits = StoreSettings { max_queued_jobs: 3, max_queued_bytes: 3 * bytes, ..place.settings() };
    let store = Store::open(limits.clone()).await.unwrap();
    submit(&store).await;
    let held = store.reserve(bytes).unwrap();
    assert!(store.reserve(bytes + 1).is_err(), "too many bytes");
    let last = store.reserve(0).unwrap();
    let full = store.reserve(0).unwrap_err();
    assert!((1..=600).contains(&full.retry_after_s), "too many jobs: {full:?}");
    // The place was taken for fewer bytes than the study needs; there is still room.
    store.submit(last, new_job()).await.unwrap();
    drop(held);
    submit(&store).await;
    assert!(store.reserve(0).is_err());
    let counts = store.counts().await.unwrap();
    assert_eq!((counts.queued, counts.queued_bytes, counts.reserved), (3, 3 * bytes, 0));
    store.close().await;

    let store = Store::open(limits).await.unwrap();
    assert!(store.reserve(0).is_err(), "the limits know what was queued before");
    let claim = store.claim("test").await.unwrap().unwrap();
    assert!(store.reserve(bytes).is_ok(), "what runs is not queued");
    assert!(store.give_back(&claim).await.unwrap());
    assert!(store.reserve(0).is_err());
    let place = store.list(ListQuery::default()).await.unwrap().jobs[0].id;
    assert!(matches!(store.delete(place).await.unwrap(), Deletion::Cancelled(_)));
    let mut reservation = store.reserve(0).unwrap();
    assert!(reservation.resize(bytes + 1).is_err());
    reservation.resize(bytes).unwrap();
}

async fn a_queued_job_is_cancelled_at_once_and_a_finished_one_deleted(place: &Place) {
    let store = place.open().await;
    let job = submit(&store).await;
    let Deletion::Cancelled(cancelled) = store.delete(job.id).await.unwrap() else { panic!("not cancelled") };
    assert_eq!((cancelled.state, cancelled.attempt), (State::Cancelled, 0));
    assert!(cancelled.finished_at.is_some() && cancelled.version > job.version);
    assert_eq!(store.blob(job.id, "input").await.unwrap(), None);
    assert_eq!(store.claim("test").await.unwrap(), None);
    assert_eq!(store.delete(job.id).await.unwrap(), Deletion::Deleted);
    assert_eq!(store.get(job.id).await.unwrap(), None);
    assert_eq!(store.delete(job.id).await.unwrap(), Deletion::NotFound);
}

async fn a_running_job_stops_within_a_second(place: &Place) {
    let store = place.open().await;
    let job = submit(&store).await;
    let settings = WorkerSettings { work: endless(), heartbeat: Duration::from_mins(1), ..WorkerSettings::default() };
    let _workers = start_workers(store.clone(), settings).unwrap();
    until_state(&store, job.id, State::Running).await;
    let asked = Instant::now();
    let Deletion::Cancelling(cancelling) = store.delete(job.id).await.unwrap() else { panic!("not cancelling") };
    assert!(cancelling.state == State::Running && cancelling.cancel_requested);
    until_state(&store, job.id, State::Cancelled).await;
    assert!(asked.elapsed() < Duration::from_secs(1), "{:?}", asked.elapsed());
    assert_eq!(store.delete(job.id).await.unwrap(), Deletion::Deleted);
}

async fn a_heartbeat_tells_of_the_request_to_cancel_and_a_late_success_is_cancelled(place: &Place) {
    let store = place.open().await;
    let job = submit(&store).await;
    let claim = store.claim("test").await.unwrap().unwrap();
    assert_eq!(store.heartbeat(&claim, None).await.unwrap(), Heartbeat::Held { cancel: false });
    store.delete(job.id).await.unwrap();
    assert_eq!(store.heartbeat(&claim, None).await.unwrap(), Heartbeat::Held { cancel: true });
    let results = Outcome::Succeeded([output("report", b"{}")].into());
    assert_eq!(store.finish(&claim, results, &Snapshot::default()).await.unwrap(), Finish::Done(State::Cancelled));
    assert_eq!(store.blob(job.id, "report").await.unwrap(), None);
}

async fn what_comes_late_from_a_lost_attempt_is_refused(place: &Place) {
    // On PostgreSQL a transaction that pauses for longer than a lease is ended: not so short that a busy machine does so.
    let settings = StoreSettings { lease: Duration::from_secs(1), retry_pause: Duration::from_secs(1), ..place.settings() };
    let store = Store::open(settings).await.unwrap();
    let job = submit(&store).await;
    let first = store.claim("first").await.unwrap().unwrap();
    assert_eq!(store.reap().await.unwrap(), [], "the lease still runs");
    tokio::time::sleep(Duration::from_millis(1100)).await;
    let reaped = store.reap().await.unwrap();
    assert_eq!(reaped.iter().map(|job| (job.id, job.state)).collect::<Vec<_>>(), [(job.id, State::Queued)]);
    assert_eq!(store.claim("second").await.unwrap(), None, "a pause comes before the next attempt");
    tokio::time::sleep(Duration::from_millis(1100)).await;
    let second = store.claim("second").await.unwrap().unwrap();
    assert_eq!((first.id, first.attempt, second.id, second.attempt), (job.id, 1, job.id, 2));

    let news = Snapshot { fraction: 0.9, ..Snapshot::default() };
    let results = |data: &[u8]| Outcome::Succeeded([output("report", data)].into());
    assert_eq!(store.heartbeat(&first, Some(&news)).await.unwrap(), Heartbeat::Lost);
    assert_eq!(store.finish(&first, results(b"first"), &news).await.unwrap(), Finish::Lost);
    assert!(!store.give_back(&first).await.unwrap());
    let untouched = store.get(job.id).await.unwrap().unwrap();
    assert_eq!((untouched.state, untouched.progress, untouched.attempt), (State::Running, 0.0, 2));
    assert_eq!(store.finish(&second, results(b"second"), &news).await.unwrap(), Finish::Done(State::Succeeded));
    assert_eq!(store.finish(&second, results(b"again"), &news).await.unwrap(), Finish::Lost, "once is enough");
    assert_eq!(store.blob(job.id, "report").await.unwrap().unwrap().data, b"second");
}

async fn an_attempt_that_lost_its_job_before_reading_the_input_is_told_so(place: &Place) {
    let store = Store::open(StoreSettings { lease: Duration::from_secs(1), ..place.settings() }).await.unwrap();
    let job = submit(&store).await;
    let first = store.claim("first").await.unwrap().unwrap();
    assert_eq!(input::decode(&store.input(&first).await.unwrap().unwrap()).unwrap(), study());
    tokio::time::sleep(Duration::from_millis(1100)).await;
    store.reap().await.unwrap();
    assert_eq!(store.input(&first).await.unwrap(), None, "queued again");
    let second = store.claim("second").await.unwrap().unwrap();
    assert_eq!((second.id, second.attempt), (job.id, 2));
    assert_eq!(store.input(&first).await.unwrap(), None, "the input is there, but somebody else's");
    assert_eq!(input::decode(&store.input(&second).await.unwrap().unwrap()).unwrap(), study());
    store.finish(&second, Outcome::Succeeded([].into()), &Snapshot::default()).await.unwrap();
    assert_eq!(store.blob(job.id, "input").await.unwrap(), None);
    assert_eq!(store.input(&first).await.unwrap(), None, "finished, and its input deleted");
    assert_eq!(store.input(&second).await.unwrap(), None);
    assert_eq!(store.delete(job.id).await.unwrap(), Deletion::Deleted);
    assert_eq!(store.input(&first).await.unwrap(), None, "deleted");
}

async fn a_job_whose_input_is_gone_fails_as_damaged(place: &Place) {
    let store = place.open().await;
    let (held, worked_on, whole) = (submit(&store).await, submit(&store).await, submit(&store).await);
    store.close().await;
    place.run(format!("DELETE FROM blobs WHERE job_id IN ('{}', '{}')", held.id, worked_on.id)).await;
    let store = place.open().await;
    let claim = store.claim("someone").await.unwrap().unwrap();
    assert_eq!(claim.id, held.id);
    let damaged = store.input(&claim).await.unwrap_err();
    assert!(matches!(damaged, StoreError::Damaged { .. }), "{damaged}");
    let _workers = workers(&store, work(|_, _, _, _| Ok(Vec::new())));
    until_state(&store, whole.id, State::Succeeded).await;
    let failed = store.get(worked_on.id).await.unwrap().unwrap();
    assert_eq!((failed.state, failed.error.unwrap().code.as_str()), (State::Failed, "internal_error"));
}

#[tokio::test]
async fn a_job_that_loses_every_worker_fails_and_the_next_one_runs() {
    let place = Place::sqlite();
    let mut poison = None;
    for attempt in 1..=3 {
        let store = place.open().await;
        let id = match poison {
            Some(id) => id,
            None => submit(&store).await.id,
        };
        poison = Some(id);
        assert_eq!(store.get(id).await.unwrap().unwrap().state, State::Queued, "before attempt {attempt}");
        let claim = store.claim("dies").await.unwrap().unwrap();
        assert_eq!((claim.id, claim.attempt), (id, attempt));
        store.close().await;
    }
    let store = place.open().await;
    let failed = store.get(poison.unwrap()).await.unwrap().unwrap();
    assert_eq!((failed.state, failed.attempt), (State::Failed, 3));
    assert_eq!(failed.error.unwrap().code, "worker_lost");
    assert_eq!(store.blob(failed.id, "input").await.unwrap(), None);
    let next = submit(&store).await;
    let _workers = workers(&store, work(|_, _, _, _| Ok(Vec::new())));
    until_state(&store, next.id, State::Succeeded).await;
}

#[tokio::test]
async fn a_lost_job_lets_others_go_first() {
    let place = Place::sqlite();
    let store = place.open().await;
    let lost = submit(&store).await.id;
    assert_eq!(store.claim("dies").await.unwrap().unwrap().id, lost);
    store.close().await;
    let store = Store::open(StoreSettings { retry_pause: Duration::from_hours(1), ..place.settings() }).await.unwrap();
    let other = submit(&store).await.id;
    assert_eq!(store.claim("lives").await.unwrap().unwrap().id, other);
    assert_eq!(store.claim("lives").await.unwrap(), None, "its time has not come");
}

#[tokio::test]
async fn a_restart_continues_what_was_running() {
    let place = Place::sqlite();
    let store = place.open().await;
    let jobs = [submit(&store).await.id, submit(&store).await.id, submit(&store).await.id];
    let killed = workers(&store, endless());
    until_state(&store, jobs[0], State::Running).await;
    // Without a drain, as a crash would have it; only the lock must be let go.
    drop(killed);
    drop(store);

    let store = place.open().await;
    let job = store.get(jobs[0]).await.unwrap().unwrap();
    assert_eq!((job.state, job.attempt, job.queue_position), (State::Queued, 1, Some(1)));
    let runs = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&runs);
    let _workers = workers(
        &store,
        work(move |_, _, _, _| {
            counted.fetch_add(1, Ordering::Relaxed);
            Ok(vec![output("report", b"{}")])
        }),
    );
    for id in jobs {
        let done = until_state(&store, id, State::Succeeded).await;
        assert_eq!(done.attempt, if id == jobs[0] { 2 } else { 1 });
        assert!(store.blob(id, "report").await.unwrap().is_some());
    }
    assert_eq!(runs.load(Ordering::Relaxed), 3);
}

async fn a_panic_fails_its_job_without_internal_text_and_the_worker_goes_on(place: &Place) {
    let store = place.open().await;
    let (bad, good, hopeless) = (submit(&store).await.id, submit(&store).await.id, submit(&store).await.id);
    let _workers = workers(
        &store,
        work(move |_, _, id, _| match id {
            id if id == bad => panic!("secret detail"),
            id if id == hopeless => Err(WorkError::Failed { code: "no_border", message: "Gate 2 has no border.".into() }),
            _ => Ok(Vec::new()),
        }),
    );
    let failed = until_state(&store, bad, State::Failed).await;
    let error = failed.error.unwrap();
    assert_eq!((error.code.as_str(), failed.attempt), ("internal_error", 1));
    assert!(!error.message.contains("secret"), "{}", error.message);
    until_state(&store, good, State::Succeeded).await;
    let error = until_state(&store, hopeless, State::Failed).await.error.unwrap();
    assert_eq!((error.code.as_str(), error.message.as_str()), ("no_border", "Gate 2 has no border."));
}

async fn a_drain_waits_then_gives_back_uncharged(place: &Place) {
    let store = place.open().await;
    let (long, waiting) = (submit(&store).await.id, submit(&store).await.id);
    for round in 1..=5 {
        let draining = workers(&store, endless());
        until_state(&store, long, State::Running).await;
        assert_eq!(draining.drain(Duration::from_millis(20)).await.given_back, 1);
        let job = store.get(long).await.unwrap().unwrap();
        assert_eq!((job.state, job.attempt, job.queue_position), (State::Queued, round, Some(1)), "never worker_lost");
    }
    assert_eq!(store.get(waiting).await.unwrap().unwrap().attempt, 0);

    let short = workers(
        &store,
        work(|_, _, _, _| {
            std::thread::sleep(Duration::from_millis(200));
            Ok(Vec::new())
        }),
    );
    until_state(&store, long, State::Running).await;
    assert_eq!(short.drain(Duration::from_secs(10)).await.given_back, 0);
    assert_eq!(store.get(long).await.unwrap().unwrap().state, State::Succeeded);
    assert_eq!(store.get(waiting).await.unwrap().unwrap().state, State::Queued, "nothing is claimed while draining");
}

async fn a_computation_that_does_not_stop_is_left_behind_by_the_drain(place: &Place) {
    let store = place.open().await;
    let job = submit(&store).await;
    let deaf = workers(
        &store,
        work(|_, _, _, _| {
            std::thread::sleep(Duration::from_secs(4));
            Ok(vec![output("report", b"{}")])
        }),
    );
    until_state(&store, job.id, State::Running).await;
    let began = Instant::now();
    assert_eq!(deaf.drain(Duration::from_millis(20)).await.given_back, 1);
    assert!(began.elapsed() < Duration::from_secs(3), "{:?}", began.elapsed());
    assert_eq!(store.get(job.id).await.unwrap().unwrap().state, State::Queued);
}

#[tokio::test]
async fn a_directory_that_cannot_be_used_is_named() {
    let place = Place::sqlite();
    std::fs::create_dir_all(&place.directory).unwrap();
    std::fs::write(place.directory.join("ventricle.sqlite"), "no database ".repeat(500)).unwrap();
    let refused = Store::open(place.settings()).await.unwrap_err();
    assert!(
        matches!(refused, StoreError::Directory { .. }) && refused.to_string().contains(place.directory.to_str().unwrap()),
        "{refused}"
    );
}

#[tokio::test]
async fn a_directory_serves_one_store() {
    let place = Place::sqlite();
    let store = place.open().await;
    let second = StoreSettings { directory_wait: Duration::from_millis(200), ..place.settings() };
    let refused = Store::open(second.clone()).await.unwrap_err();
    assert!(matches!(refused, StoreError::DirectoryInUse { .. }), "{refused}");
    assert!(refused.to_string().contains("in use by another process"), "{refused}");
    submit(&store).await;
    store.ping().await.unwrap();
    store.close().await;
    assert!(store.ping().await.is_err());
    let store = Store::open(second).await.unwrap();
    assert_eq!(store.counts().await.unwrap().queued, 1);
}

#[tokio::test]
async fn damaged_data_and_a_later_schema_are_noticed() {
    let place = Place::sqlite();
    let store = place.open().await;
    let job = submit(&store).await;
    let claim = store.claim("test").await.unwrap().unwrap();
    let results = Outcome::Succeeded([output("report", b"{}"), output("surfaces.glb", b"glTF")].into());
    store.finish(&claim, results, &Snapshot::default()).await.unwrap();
    store.close().await;
    tamper(&place, "UPDATE blobs SET data = x'7b7c' WHERE name = 'report'").await;
    let store = place.open().await;
    let damaged = store.blob(job.id, "report").await.unwrap_err();
    assert!(matches!(damaged, StoreError::Damaged { .. }), "{damaged}");
    assert_eq!(store.blob(job.id, "surfaces.glb").await.unwrap().unwrap().data, b"glTF");
    store.close().await;
    tamper(&place, "UPDATE schema_version SET version = 99").await;
    let later = Store::open(place.settings()).await.unwrap_err();
    assert!(matches!(later, StoreError::SchemaTooNew { found: 99, .. }), "{later}");
}

/// Changes the database behind the store's back.
async fn tamper(place: &Place, sql: &'static str) {
    let options = SqliteConnectOptions::new().filename(place.directory.join("ventricle.sqlite"));
    let mut connection = options.connect().await.unwrap();
    assert!(sqlx::raw_sql(sql).execute(&mut connection).await.unwrap().rows_affected() > 0);
    connection.close().await.unwrap();
}

async fn lists_are_newest_first_in_pages_and_filtered(place: &Place) {
    let store = place.open().await;
    let mut ids = Vec::new();
    for number in 0..7 {
        let mut new = new_job();
        new.study.acquisition.study_instance_uid = Some(format!("1.2.{}", number % 2));
        ids.push(store.submit(store.reserve(100).unwrap(), new).await.unwrap().job().id);
    }
    ids.reverse();
    let (mut seen, mut cursor) = (Vec::new(), None);
    for pages in 1.. {
        let page = store.list(ListQuery { limit: 3, cursor, ..ListQuery::default() }).await.unwrap();
        seen.extend(page.jobs.iter().map(|job| job.id));
        cursor = page.next_cursor;
        if cursor.is_none() {
            assert_eq!(pages, 3);
            break;
        }
    }
    assert_eq!(seen, ids);
    let odd = ListQuery { study_instance_uid: Some("1.2.1".into()), ..ListQuery::default() };
    let page = store.list(odd.clone()).await.unwrap();
    assert_eq!((page.jobs.len(), page.next_cursor), (3, None));
    assert!(page.jobs.iter().all(|job| job.study_instance_uid.as_deref() == Some("1.2.1")));
    store.delete(ids[1]).await.unwrap();
    let cancelled = store.list(ListQuery { state: Some(State::Cancelled), ..odd }).await.unwrap().jobs;
    assert_eq!(cancelled.iter().map(|job| job.id).collect::<Vec<_>>(), [ids[1]]);
}

async fn waiting_ends_with_a_change_the_time_or_the_job(place: &Place) {
    let store = Store::open(StoreSettings { poll: Duration::from_mins(1), ..place.settings() }).await.unwrap();
    let job = submit(&store).await;
    let began = Instant::now();
    let same = store.wait_for_change(job.id, job.version, Duration::from_millis(100)).await.unwrap().unwrap();
    assert!(same.version == job.version && began.elapsed() >= Duration::from_millis(100));
    let (claim, changed) = tokio::join!(store.claim("test"), store.wait_for_change(job.id, job.version, Duration::from_secs(20)));
    let changed = changed.unwrap().unwrap();
    assert_eq!(changed.state, State::Running);
    let claim = claim.unwrap().unwrap();
    let wait = store.wait_for_change(job.id, changed.version, Duration::from_secs(20));
    let failed = async {
        let error = ventricle::jobs::JobError { code: "no_border".into(), message: "None.".into() };
        store.finish(&claim, Outcome::Failed(error), &Snapshot::default()).await
    };
    let (ended, _) = tokio::join!(wait, failed);
    let ended = ended.unwrap().unwrap();
    assert_eq!(ended.state, State::Failed);
    store.wait_for_change(job.id, ended.version, Duration::from_secs(20)).await.unwrap().unwrap();
    store.delete(job.id).await.unwrap();
    assert_eq!(store.wait_for_change(job.id, ended.version, Duration::from_secs(20)).await.unwrap(), None);
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
}

async fn the_rate_is_measured_and_survives_a_restart(place: &Place) {
    let store = place.open().await;
    let job = submit(&store).await;
    assert_eq!(job.eta_seconds, None, "nothing was measured yet");
    let measuring = workers(
        &store,
        work(|_, _, _, _| {
            std::thread::sleep(Duration::from_millis(150));
            Ok(Vec::new())
        }),
    );
    until_state(&store, job.id, State::Succeeded).await;
    measuring.drain(Duration::from_secs(5)).await;
    store.close().await;
    let store = place.open().await;
    let (first, second) = (submit(&store).await, submit(&store).await);
    let (first_s, second_s) = (first.eta_seconds.unwrap(), second.eta_seconds.unwrap());
    assert!((0.1..2.0).contains(&first_s) && (second_s - 2.0 * first_s).abs() < 1e-9, "{first_s} {second_s}");
}
