//! How long finished jobs are kept, and that their room comes back.

use crate::place::{Place, new_job, on_both_engines, output, submit, until_state, work, workers};
use sqlx::{ConnectOptions, Connection, Row, sqlite::SqliteConnectOptions};
use std::time::{Duration, Instant};
use uuid::Uuid;
use ventricle::jobs::{Deletion, Job, NewJob, Outcome, Snapshot, State, Store, StoreSettings, SubmitError, Submitted};

on_both_engines! {
    the_time_begins_with_the_end_and_is_the_jobs_own_or_the_configured,
    what_is_over_is_deleted_in_steps_the_longest_over_first,
    the_reaper_deletes_with_all_data_and_whoever_waits_is_told,
    a_study_that_can_never_wait_is_not_sent_away_to_come_back,
}

const HOUR: Duration = Duration::from_hours(1);
const MOMENT: Duration = Duration::from_millis(1);

async fn open(place: &Place, retention: Option<Duration>) -> Store {
    Store::open(StoreSettings { retention, ..place.settings() }).await.unwrap()
}

async fn submit_kept(store: &Store, retention: Duration) -> Job {
    let new = NewJob { retention: Some(retention), ..new_job() };
    store.submit(store.reserve(100).unwrap(), new).await.unwrap().job().clone()
}

fn kept_s(job: &Job) -> Option<f64> {
    job.expires_at.map(|end| end.duration_since(job.finished_at.unwrap()).as_secs_f64())
}

/// The job with this id, ended with these results.
async fn end(store: &Store, id: Uuid, outcome: Outcome) -> Job {
    let claim = store.claim("test").await.unwrap().unwrap();
    assert_eq!(claim.id, id);
    store.finish(&claim, outcome, &Snapshot::default()).await.unwrap();
    store.get(id).await.unwrap().unwrap()
}

async fn the_time_begins_with_the_end_and_is_the_jobs_own_or_the_configured(place: &Place) {
    let store = open(place, Some(2 * HOUR)).await;
    let (usual, own) = (submit(&store).await, submit_kept(&store, HOUR).await);
    let (cancelled, failed) = (submit(&store).await, submit_kept(&store, Duration::MAX).await);
    assert!([&usual, &own, &cancelled].iter().all(|job| job.expires_at.is_none()));
    let results = || Outcome::Succeeded([output("report", b"{}")].into());
    assert_eq!(kept_s(&end(&store, usual.id, results()).await), Some(7200.0));
    assert_eq!(kept_s(&end(&store, own.id, results()).await), Some(3600.0));
    let Deletion::Cancelled(cancelled) = store.delete(cancelled.id).await.unwrap() else { panic!("not cancelled") };
    assert_eq!(kept_s(&cancelled), Some(7200.0));
    let error = ventricle::jobs::JobError { code: "no_border".into(), message: "None.".into() };
    let longest = kept_s(&end(&store, failed.id, Outcome::Failed(error)).await).unwrap();
    assert!(longest > 999.0 * 365.0 * 86400.0, "a time beyond all dates is a date still: {longest} s");
    assert!(store.expire().await.unwrap().is_empty(), "none is over");
    store.close().await;

    let store = open(place, None).await;
    let kept = submit(&store).await;
    assert_eq!(end(&store, kept.id, results()).await.expires_at, None, "until someone deletes it");
    assert!(store.expire().await.unwrap().is_empty());
    assert_eq!(kept_s(&store.get(usual.id).await.unwrap().unwrap()), Some(7200.0), "what was promised stays");
}

async fn what_is_over_is_deleted_in_steps_the_longest_over_first(place: &Place) {
    let store = open(place, Some(MOMENT)).await;
    let mut over = Vec::new();
    for _ in 0..23 {
        let id = submit(&store).await.id;
        assert!(matches!(store.delete(id).await.unwrap(), Deletion::Cancelled(_)));
        over.push(id);
    }
    let (kept, waiting) = (submit_kept(&store, HOUR).await.id, submit(&store).await.id);
    store.delete(kept).await.unwrap();
    tokio::time::sleep(Duration::from_millis(5)).await;
    let mut deleted = Vec::new();
    for expected in [10, 10, 3, 0] {
        let mut step = store.expire().await.unwrap();
        assert_eq!(step.len(), expected);
        step.sort();
        deleted.extend(step);
    }
    assert_eq!(deleted, over);
    assert_eq!(store.get(kept).await.unwrap().unwrap().state, State::Cancelled);
    assert_eq!(store.get(waiting).await.unwrap().unwrap().state, State::Queued);
}

async fn the_reaper_deletes_with_all_data_and_whoever_waits_is_told(place: &Place) {
    let settings = StoreSettings { retention: Some(MOMENT), lease: Duration::from_millis(150), keep_input: true, ..place.settings() };
    let store = Store::open(settings).await.unwrap();
    let keyed = || NewJob { idempotency_key: Some("key".into()), ..new_job() };
    let submitted = store.submit(store.reserve(100).unwrap(), keyed()).await.unwrap();
    let (id, version) = (submitted.job().id, submitted.job().version);
    let kept = submit_kept(&store, HOUR).await.id;
    let follower = tokio::spawn({
        let store = store.clone();
        async move {
            let mut version = version;
            while let Some(job) = store.wait_for_change(id, version, Duration::from_secs(20)).await.unwrap() {
                version = job.version;
                tokio::time::sleep(MOMENT).await;
            }
        }
    });
    let _workers = workers(&store, work(|_, _, _, _| Ok(vec![output("report", b"{}")])));
    tokio::time::timeout(Duration::from_secs(20), follower).await.expect("the job is never gone").unwrap();
    assert_eq!(store.get(id).await.unwrap(), None);
    for name in ["report", "input"] {
        assert_eq!(store.blob(id, name).await.unwrap(), None, "{name}");
    }
    assert_eq!(store.delete(id).await.unwrap(), Deletion::NotFound);
    until_state(&store, kept, State::Succeeded).await;
    assert!(store.blob(kept, "report").await.unwrap().is_some());

    let again = store.submit(store.reserve(100).unwrap(), keyed()).await.unwrap();
    assert!(matches!(&again, Submitted::Created(job) if job.id != id), "the key is free again: {again:?}");
}

/// The size of the database file in MiB.
fn file_mib(place: &Place) -> f64 {
    std::fs::metadata(place.directory.join("ventricle.sqlite")).unwrap().len() as f64 / f64::from(1 << 20)
}

#[tokio::test]
async fn the_file_shrinks_in_short_steps_when_results_expire() {
    let place = &Place::sqlite();
    let store = open(place, Some(MOMENT)).await;
    let large: Vec<_> = (0..48).map(|number| output(&format!("gates/{number}/wall.vtu"), &vec![number; 1 << 20])).collect();
    let mut over = Vec::new();
    for part in [&large[..24], &large[24..]] {
        let id = submit(&store).await.id;
        end(&store, id, Outcome::Succeeded(part.into())).await;
        over.push(id);
    }
    // Written after what goes: its pages are moved.
    let kept = submit_kept(&store, HOUR).await.id;
    end(&store, kept, Outcome::Succeeded([output("report", &vec![7; 3 << 20])].into())).await;
    assert!(!store.shrink().await.unwrap(), "there is nothing to give back");
    assert!(file_mib(place) > 48.0, "{} MiB", file_mib(place));
    tokio::time::sleep(Duration::from_millis(5)).await;
    let mut expired = store.expire().await.unwrap();
    expired.sort();
    assert_eq!(expired, over);
    let (mut steps, mut longest) = (1, Duration::ZERO);
    loop {
        let began = Instant::now();
        let more = store.shrink().await.unwrap();
        longest = longest.max(began.elapsed());
        if !more {
            break;
        }
        steps += 1;
    }
    // 48 MiB were freed, 16 stay free, one goes with each step.
    assert!((30..=34).contains(&steps), "{steps} steps");
    assert!(longest < Duration::from_secs(1), "{longest:?}");
    assert!((18.0..22.0).contains(&file_mib(place)), "{} MiB", file_mib(place));
    assert_eq!(store.blob(kept, "report").await.unwrap().unwrap().data, vec![7; 3 << 20]);
    assert!(!store.shrink().await.unwrap());
    store.close().await;

    let mut connection = SqliteConnectOptions::new().filename(place.directory.join("ventricle.sqlite")).connect().await.unwrap();
    let check = sqlx::query("PRAGMA integrity_check").fetch_one(&mut connection).await.unwrap();
    assert_eq!(check.get::<String, _>(0), "ok");
    connection.close().await.unwrap();
}

async fn a_study_that_can_never_wait_is_not_sent_away_to_come_back(place: &Place) {
    let store = Store::open(StoreSettings { max_queued_bytes: 100, ..place.settings() }).await.unwrap();
    let refused = store.submit(store.reserve(0).unwrap(), new_job()).await.unwrap_err();
    assert!(matches!(refused, SubmitError::TooLarge { limit: 100, .. }), "{refused}");
    assert_eq!(store.counts().await.unwrap().reserved, 0);
}
