//! DICOM instances that wait for the rest of their study: in the store, and put together by one node or two. On both engines (see `place.rs`).

use crate::{
    parted::{self, GATES},
    place::{Place, new_job, on_both_engines},
};
use dicom_dictionary_std::tags;
use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use uuid::Uuid;
use ventricle::{
    access::Access,
    assembly::{Assembler, Parsers, Received, Settings, Way},
    intake,
    jobs::{
        Backend, Deletion, Filed, JobError, ListQuery, Members, NewInstance, NewJob, Outcome, Series, Snapshot, State, Store, StoreError,
        StoreSettings, SubmitError, Submitted,
    },
};

on_both_engines! {
    parts_are_filed_once_and_another_of_the_same_uid_is_a_conflict,
    each_owner_has_instances_of_its_own,
    series_are_quiet_when_none_came_for_so_long_longest_waiting_first,
    what_waits_is_bounded_and_filed_whole_or_not_at_all,
    the_same_parts_fail_once_and_are_tried_again_with_more,
    excerpts_go_when_a_job_has_all_or_with_the_job_that_keeps_them,
    what_still_waits_outlives_the_job_of_the_rest,
    parts_that_come_again_after_a_later_job_was_deleted_are_the_earlier_jobs,
    parts_that_another_took_meanwhile_make_no_second_job,
    parts_that_were_deleted_meanwhile_make_no_job,
    nodes_that_complete_a_series_at_once_make_one_job,
    nodes_that_find_a_series_quiet_at_once_make_one_job,
    a_series_that_cannot_be_read_holds_up_no_other,
}

const SOON: Duration = Duration::from_secs(20);
const NEVER: Duration = Duration::from_hours(1);

/// The owner of every job that `place::new_job` makes.
const OWNER: &str = "someone";

fn series_of(owner: &str, number: usize) -> Series {
    Series { owner: owner.to_owned(), study_uid: "1.2.3".to_owned(), series_uid: format!("1.2.3.{number}") }
}

/// The first series of the usual owner.
fn series() -> Series {
    series_of(OWNER, 1)
}

/// A part that says what its content says.
fn part_of(series: Series, uid: &str, data: &[u8]) -> NewInstance {
    let said = String::from_utf8(data.to_vec()).unwrap();
    NewInstance::new(series, "1.2.840.10008.5.1.4.1.1.20".to_owned(), uid.to_owned(), "{}".to_owned(), said, data.to_vec())
}

/// Files parts of the first series, each with its UID as its content.
async fn file(store: &Store, uids: &[&str]) -> Vec<Filed> {
    store.file(uids.iter().map(|uid| part_of(series(), uid, uid.as_bytes())).collect()).await.unwrap()
}

fn members(uids: &[&str], keep: bool) -> Members {
    Members::Filed { instance_uids: names(uids), keep }
}

fn names(uids: &[&str]) -> Vec<String> {
    uids.iter().map(|&uid| uid.to_owned()).collect()
}

async fn try_assembled(store: &Store, key: &str, uids: &[&str], keep: bool) -> Result<Submitted, SubmitError> {
    let new = NewJob { idempotency_key: Some(key.to_owned()), ..new_job() };
    store.submit_assembled(store.reserve(0).unwrap(), new, members(uids, keep)).await
}

/// A new job of these parts.
async fn assembled(store: &Store, key: &str, uids: &[&str], keep: bool) -> Uuid {
    let submitted = try_assembled(store, key, uids, keep).await.unwrap();
    assert!(matches!(submitted, Submitted::Created(_)), "{submitted:?}");
    submitted.job().id
}

/// Tries to make these parts of the first series a failed job.
async fn failed(store: &Store, key: &str, uids: &[&str]) -> Result<Option<Uuid>, SubmitError> {
    let error = JobError { code: "inconsistent_frames".into(), message: "Slice 3 of gate 2 is missing.".into() };
    let job = store.fail_assembly(&series(), (key, new_job().request_hash), names(uids), &error, None).await?;
    Ok(job.map(|job| {
        assert_eq!((job.state, job.error.as_ref(), job.study_instance_uid.as_deref()), (State::Failed, Some(&error), Some("1.2.3")));
        job.id
    }))
}

/// Cancels a job that waits and deletes it, or deletes it.
async fn delete(store: &Store, job: Uuid) {
    if !matches!(store.delete(job).await.unwrap(), Deletion::Deleted) {
        assert_eq!(store.delete(job).await.unwrap(), Deletion::Deleted);
    }
}

/// The parts of the first series whose excerpts are there, each with its job.
async fn kept(store: &Store) -> Vec<(String, Option<Uuid>)> {
    store.series(&series()).await.unwrap().into_iter().map(|part| (part.instance_uid, part.job)).collect()
}

fn with_job(uids: &[&str], job: Option<Uuid>) -> Vec<(String, Option<Uuid>)> {
    uids.iter().map(|&uid| (uid.to_owned(), job)).collect()
}

async fn waiting(store: &Store) -> Vec<Series> {
    let mut all = store.quiet_series(Duration::ZERO, 0).await.unwrap();
    all.extend(store.quiet_series(Duration::ZERO, all.len()).await.unwrap());
    all
}

async fn jobs(store: &Store) -> Vec<Uuid> {
    store.list(ListQuery::default()).await.unwrap().jobs.into_iter().map(|job| job.id).collect()
}

async fn parts_are_filed_once_and_another_of_the_same_uid_is_a_conflict(place: &Place) {
    let store = place.open().await;
    assert_eq!(file(&store, &["1.1", "1.2"]).await, [Filed::New, Filed::New]);
    let changed = part_of(series(), "1.2", b"another image");
    let elsewhere = part_of(series_of(OWNER, 2), "1.1", b"1.1");
    let filed = store.file(vec![part_of(series(), "1.1", b"1.1"), changed, elsewhere, part_of(series(), "1.3", b"1.3")]).await.unwrap();
    assert_eq!(filed, [Filed::Known, Filed::Conflict, Filed::Known, Filed::New]);
    // The same in another encoding; the first one stays.
    let encoded = NewInstance { data: b"1.1, encoded".to_vec(), sha256: "of it".to_owned(), ..part_of(series(), "1.1", b"1.1") };
    assert_eq!(store.file(vec![encoded]).await.unwrap(), [Filed::Known]);
    assert_eq!(store.excerpt(OWNER, "1.1").await.unwrap().as_deref(), Some(b"1.1".as_slice()));
    // Twice in one request.
    assert_eq!(file(&store, &["1.4", "1.4"]).await, [Filed::New, Filed::Known]);
    assert_eq!(kept(&store).await, with_job(&["1.1", "1.2", "1.3", "1.4"], None));
    assert_eq!(store.excerpt(OWNER, "1.2").await.unwrap().as_deref(), Some(b"1.2".as_slice()), "the first one stays");
    assert_eq!(waiting(&store).await, [series()]);

    // On disk, with what says which part each is.
    store.close().await;
    // One of version 4, which kept no identity.
    place.run("UPDATE instances SET identity = NULL WHERE sop_instance_uid = '1.1'".to_owned()).await;
    let store = place.open().await;
    let filed = store.file(vec![part_of(series(), "1.1", b"1.1"), part_of(series(), "1.1", b"another")]).await.unwrap();
    assert_eq!(filed, [Filed::Known, Filed::Conflict]);
    let parts = store.series(&series()).await.unwrap();
    assert!(parts.iter().all(|part| (part.holds.as_str(), part.size, part.sha256.len()) == ("{}", 3, 64)), "{parts:?}");
    // What a job has taken is known still, and another of its UID a conflict.
    let job = assembled(&store, "a", &["1.1", "1.2"], false).await;
    assert_eq!(kept(&store).await, with_job(&["1.3", "1.4"], None));
    assert_eq!(store.excerpt(OWNER, "1.1").await.unwrap(), None, "the job has the study");
    let filed = store.file(vec![part_of(series(), "1.1", b"1.1"), part_of(series(), "1.2", b"other")]).await.unwrap();
    assert_eq!(filed, [Filed::Known, Filed::Conflict]);
    assert_eq!(jobs(&store).await, [job]);
}

async fn each_owner_has_instances_of_its_own(place: &Place) {
    let store = place.open().await;
    let (ours, theirs) = (series(), series_of("another", 1));
    assert_eq!(file(&store, &["1.1"]).await, [Filed::New]);
    assert_eq!(store.file(vec![part_of(theirs.clone(), "1.1", b"theirs")]).await.unwrap(), [Filed::New]);
    assert_eq!(store.excerpt("another", "1.1").await.unwrap().as_deref(), Some(b"theirs".as_slice()));
    assert_eq!(store.excerpt(OWNER, "1.1").await.unwrap().as_deref(), Some(b"1.1".as_slice()));
    assert_eq!(store.excerpt("nobody", "1.1").await.unwrap(), None);
    let job = assembled(&store, "a", &["1.1"], false).await;
    assert_eq!(store.series(&ours).await.unwrap(), []);
    assert_eq!(waiting(&store).await, std::slice::from_ref(&theirs), "the same UIDs, and nothing of them was taken");
    delete(&store, job).await;
    assert_eq!(store.series(&theirs).await.unwrap().len(), 1);

    // An instance that is a study of its own is the owner's too.
    let whole = |owner: &str| {
        let new = NewJob { owner: owner.to_owned(), ..new_job() };
        let instance = part_of(series_of(owner, 2), "1.9", b"whole");
        (new, Members::Whole(instance))
    };
    let submit = async |(new, members)| store.submit_assembled(store.reserve(0).unwrap(), new, members).await.unwrap();
    let (first, second, again) = (submit(whole(OWNER)).await, submit(whole("another")).await, submit(whole(OWNER)).await);
    assert!(matches!((&first, &second), (Submitted::Created(_), Submitted::Created(_))));
    assert_eq!(again, Submitted::Existing(first.job().clone()));
}

async fn series_are_quiet_when_none_came_for_so_long_longest_waiting_first(place: &Place) {
    let store = place.open().await;
    let [first, second] = [1, 2].map(|number| series_of(OWNER, number));
    let quiet = Duration::from_secs(2);
    assert_eq!(waiting(&store).await, []);
    store.file(vec![part_of(first.clone(), "1.1", b"1")]).await.unwrap();
    tokio::time::sleep(quiet + Duration::from_millis(50)).await;
    store.file(vec![part_of(second.clone(), "2.1", b"1")]).await.unwrap();
    assert_eq!(store.quiet_series(quiet, 0).await.unwrap(), std::slice::from_ref(&first));
    assert_eq!(waiting(&store).await, [first.clone(), second.clone()]);
    tokio::time::sleep(Duration::from_millis(20)).await;
    // More of the first: its time begins again. The same once more is nothing new.
    store.file(vec![part_of(first.clone(), "1.2", b"1")]).await.unwrap();
    assert_eq!(store.quiet_series(quiet, 0).await.unwrap(), []);
    tokio::time::sleep(Duration::from_millis(20)).await;
    store.file(vec![part_of(second.clone(), "2.1", b"1")]).await.unwrap();
    assert_eq!(waiting(&store).await, [second.clone(), first.clone()]);
    // What a job has, waits no more.
    assembled(&store, "a", &["2.1"], true).await;
    assert_eq!(waiting(&store).await, [first]);
    // A few at a time.
    let many = (10..40).map(|number| part_of(series_of(OWNER, number), &format!("3.{number}"), b"1")).collect();
    store.file(many).await.unwrap();
    assert_eq!(store.quiet_series(Duration::ZERO, 0).await.unwrap().len(), 16);
}

async fn what_waits_is_bounded_and_filed_whole_or_not_at_all(place: &Place) {
    let store = Store::open(StoreSettings { max_queued_bytes: 10_000, ..place.settings() }).await.unwrap();
    let part = |uid: &str, bytes: usize| part_of(series(), uid, &vec![7; bytes]);
    store.file(vec![part("1.1", 6000)]).await.unwrap();
    let refused = store.file(vec![part("1.2", 3000), part("1.3", 2000)]).await.unwrap_err();
    assert!(matches!(refused, SubmitError::QueueFull(_)), "{refused}");
    assert_eq!(kept(&store).await, with_job(&["1.1"], None), "neither of them");
    // To the last byte; what is known takes none.
    store.file(vec![part("1.2", 3000), part("1.4", 1000)]).await.unwrap();
    assert_eq!(store.file(vec![part("1.1", 6000)]).await.unwrap(), [Filed::Known]);
    assert!(store.file(vec![part("1.5", 1)]).await.is_err());
    // A job makes room again.
    assembled(&store, "a", &["1.1"], false).await;
    assert_eq!(store.file(vec![part("1.5", 6000)]).await.unwrap(), [Filed::New]);
    assert!(store.file(vec![part("1.6", 1)]).await.is_err());
}

async fn the_same_parts_fail_once_and_are_tried_again_with_more(place: &Place) {
    let store = place.open().await;
    file(&store, &["1.1", "1.2"]).await;
    let first = failed(&store, "a", &["1.1", "1.2"]).await.unwrap().expect("a job");
    assert_eq!(kept(&store).await, with_job(&["1.1", "1.2"], Some(first)), "for when more comes");
    assert_eq!(waiting(&store).await, []);
    assert_eq!(failed(&store, "a", &["1.1", "1.2"]).await.unwrap(), None);
    assert_eq!(file(&store, &["1.1"]).await, [Filed::Known]);
    assert_eq!((jobs(&store).await, store.counts().await.unwrap().queued), (vec![first], 0));
    assert!(store.claim("worker").await.unwrap().is_none(), "it is not worked on");

    assert_eq!(file(&store, &["1.3"]).await, [Filed::New]);
    assert_eq!(waiting(&store).await, [series()]);
    let all = [with_job(&["1.1", "1.2"], Some(first)), with_job(&["1.3"], None)].concat();
    assert_eq!(kept(&store).await, all);
    let second = failed(&store, "b", &["1.1", "1.2", "1.3"]).await.unwrap().expect("another job");
    assert_eq!(kept(&store).await, with_job(&["1.1", "1.2", "1.3"], Some(second)));
    file(&store, &["1.4"]).await;
    let third = assembled(&store, "c", &["1.1", "1.2", "1.3", "1.4"], false).await;
    assert_eq!(kept(&store).await, []);
    // The instances are the last job's: the failed ones may go.
    delete(&store, first).await;
    delete(&store, second).await;
    assert_eq!(file(&store, &["1.1", "1.4"]).await, [Filed::Known, Filed::Known]);
    assert_eq!(jobs(&store).await, [third]);
}

async fn excerpts_go_when_a_job_has_all_or_with_the_job_that_keeps_them(place: &Place) {
    let store = Store::open(StoreSettings { retention: Some(Duration::from_millis(1)), ..place.settings() }).await.unwrap();
    for keep in [false, true] {
        file(&store, &["1.1", "1.2"]).await;
        let job = assembled(&store, "a", &["1.1", "1.2"], keep).await;
        assert_eq!(kept(&store).await, if keep { with_job(&["1.1", "1.2"], Some(job)) } else { vec![] });
        // By a client, in two steps: cancelled, it is still there.
        assert!(matches!(store.delete(job).await.unwrap(), Deletion::Cancelled(_)));
        assert_eq!(file(&store, &["1.1"]).await, [Filed::Known]);
        assert_eq!(store.delete(job).await.unwrap(), Deletion::Deleted);
        assert_eq!(file(&store, &["1.1"]).await, [Filed::New], "as if it had never come");

        // By its time, when it has succeeded.
        file(&store, &["1.2"]).await;
        let job = assembled(&store, "a", &["1.1", "1.2"], keep).await;
        let claim = store.claim("worker").await.unwrap().unwrap();
        store.finish(&claim, Outcome::Succeeded([].into()), &Snapshot::default()).await.unwrap();
        assert_eq!(store.excerpt(OWNER, "1.2").await.unwrap().is_some(), keep);
        tokio::time::sleep(Duration::from_millis(5)).await;
        assert_eq!(store.expire().await.unwrap(), [job]);
        assert_eq!((kept(&store).await, store.excerpt(OWNER, "1.2").await.unwrap()), (vec![], None));
    }
    // And when it failed before it began.
    file(&store, &["1.1", "1.2"]).await;
    let job = failed(&store, "b", &["1.1", "1.2"]).await.unwrap().unwrap();
    tokio::time::sleep(Duration::from_millis(5)).await;
    assert_eq!(store.expire().await.unwrap(), [job]);
    assert_eq!(file(&store, &["1.1", "1.2"]).await, [Filed::New, Filed::New]);
}

async fn what_still_waits_outlives_the_job_of_the_rest(place: &Place) {
    let store = place.open().await;
    file(&store, &["1.1", "1.2"]).await;
    let first = assembled(&store, "a", &["1.1", "1.2"], true).await;
    file(&store, &["1.3"]).await;
    delete(&store, first).await;
    assert_eq!((kept(&store).await, waiting(&store).await), (with_job(&["1.3"], None), vec![series()]));
    // It ends in a job of its own; the others are as new.
    let alone = failed(&store, "b", &["1.3"]).await.unwrap().unwrap();
    assert_eq!(file(&store, &["1.1", "1.2"]).await, [Filed::New, Filed::New]);
    assert_eq!(kept(&store).await, [with_job(&["1.1", "1.2"], None), with_job(&["1.3"], Some(alone))].concat());
}

async fn parts_that_come_again_after_a_later_job_was_deleted_are_the_earlier_jobs(place: &Place) {
    let store = place.open().await;
    // They make a study now and then, or do not, or did not and do: by another version of the program.
    for (failed_first, fails_again) in [(false, false), (true, true), (true, false)] {
        let key = format!("the first two, failing: {failed_first} {fails_again}");
        let make = async |fails: bool| {
            if fails {
                failed(&store, &key, &["1.1", "1.2"]).await.unwrap().unwrap_or_default()
            } else {
                try_assembled(&store, &key, &["1.1", "1.2"], true).await.unwrap().job().id
            }
        };
        file(&store, &["1.1", "1.2"]).await;
        let first = make(failed_first).await;
        file(&store, &["1.3"]).await;
        let all = assembled(&store, "all", &["1.1", "1.2", "1.3"], false).await;
        delete(&store, all).await;
        assert_eq!(file(&store, &["1.1", "1.2"]).await, [Filed::New, Filed::New]);
        assert_eq!(waiting(&store).await, [series()]);
        // The job that was made of the same two before is theirs: they wait no more.
        assert_eq!(make(fails_again).await, if fails_again { Uuid::nil() } else { first });
        assert_eq!(waiting(&store).await, []);
        assert_eq!((kept(&store).await, jobs(&store).await), (with_job(&["1.1", "1.2"], Some(first)), vec![first]));
        delete(&store, first).await;
    }
}

async fn parts_that_another_took_meanwhile_make_no_second_job(place: &Place) {
    let store = place.open().await;
    file(&store, &["1.1", "1.2", "1.3"]).await;
    let job = assembled(&store, "all", &["1.1", "1.2", "1.3"], false).await;
    // Whoever read the first two before the third came is late.
    let late = try_assembled(&store, "two", &["1.1", "1.2"], true).await.unwrap();
    assert!(matches!(&late, Submitted::Existing(existing) if existing.id == job), "{late:?}");
    assert_eq!(failed(&store, "two", &["1.1", "1.2"]).await.unwrap(), None);
    assert_eq!((jobs(&store).await, store.counts().await.unwrap().reserved), (vec![job], 0));
    delete(&store, job).await;
    assert_eq!(file(&store, &["1.1", "1.2", "1.3"]).await, [Filed::New; 3], "all of them were its own");
}

async fn parts_that_were_deleted_meanwhile_make_no_job(place: &Place) {
    let store = place.open().await;
    for order in [["1.1", "1.2", "1.3"], ["1.3", "1.1", "1.2"]] {
        file(&store, &["1.1", "1.2"]).await;
        let first = assembled(&store, "a", &["1.1", "1.2"], true).await;
        file(&store, &["1.3"]).await;
        // All three are read; then the job of two of them is deleted.
        delete(&store, first).await;
        let refused = try_assembled(&store, "b", &order, false).await.unwrap_err();
        assert!(matches!(refused, SubmitError::InstancesGone), "{refused}");
        let refused = failed(&store, "c", &order).await.unwrap_err();
        assert!(matches!(refused, SubmitError::InstancesGone), "{refused}");
        let counts = store.counts().await.unwrap();
        assert_eq!((jobs(&store).await, counts.queued, counts.reserved), (vec![], 0, 0), "nothing of it stays");
        assert_eq!(kept(&store).await, with_job(&["1.3"], None));
    }
}

/// Two nodes on one database; on SQLite two that share the store, as only one process can have it.
async fn two_nodes(place: &Place) -> [Store; 2] {
    let store = place.open().await;
    let other = if matches!(place.backend, Backend::Sqlite { .. }) { store.clone() } else { place.open().await };
    [store, other]
}

fn assembler(store: &Store, quiet: Duration) -> Assembler {
    let settings = Settings { limits: intake::Limits::default(), quiet, keep_subject: false, callback_url: None };
    Assembler::new(store.clone(), settings, Parsers::new(2), Arc::new(Access::open()))
}

async fn receive(assembler: &Assembler, files: &[Vec<u8>]) -> Received {
    let mut reception = assembler.reception((OWNER, None), Way::Stow, None);
    for file in files {
        reception.take(file.clone()).await;
    }
    let received = reception.end().await;
    assert!(received.outcomes.iter().all(|outcome| outcome.result.is_ok()), "{received:?}");
    received
}

/// The jobs once there are any.
async fn jobs_soon(store: &Store) -> Vec<Uuid> {
    let start = Instant::now();
    loop {
        let jobs = jobs(store).await;
        if !jobs.is_empty() {
            return jobs;
        }
        assert!(start.elapsed() < SOON, "no job");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn nodes_that_complete_a_series_at_once_make_one_job(place: &Place) {
    let nodes = two_nodes(place).await;
    let [one, other] = [&nodes[0], &nodes[1]].map(|store| assembler(store, NEVER));
    for seed in 1..5 {
        let gates = parted::gates(&parted::whole(seed));
        // Each gets half of it, or each all of it, as a PACS that sends again to the other.
        let (first, second) = if seed % 2 == 0 { (&gates[..GATES / 2], &gates[GATES / 2..]) } else { (&gates[..], &gates[..]) };
        let (first, second) = tokio::join!(receive(&one, first), receive(&other, second));
        let mut told: Vec<Uuid> = first.jobs.into_iter().chain(second.jobs).collect();
        told.dedup();
        let made = jobs(&nodes[0]).await;
        assert_eq!((made.len(), told.len()), (seed as usize, 1), "{told:?}");
        assert_eq!(made[0], told[0]);
        assert_eq!(nodes[0].get(told[0]).await.unwrap().unwrap().gates_total, GATES as u64);
        assert_eq!(waiting(&nodes[0]).await, []);
    }
}

async fn nodes_that_find_a_series_quiet_at_once_make_one_job(place: &Place) {
    let nodes = two_nodes(place).await;
    let assemblers = [&nodes[0], &nodes[1]].map(|store| assembler(store, Duration::from_millis(300)));
    let _watches = [assemblers[0].watch(None), assemblers[1].watch(None)];
    let mut expected = 0;
    // Gates that do not say how many they are make a study; slices of which one is missing make none.
    let whole = parted::whole(1);
    let gates: Vec<_> = parted::gates(&whole).iter().map(|file| parted::without(file, &[tags::NUMBER_OF_TIME_SLOTS])).collect();
    let slices = parted::slices(&parted::whole(2)).split_off(1);
    for (files, state) in [(gates, State::Queued), (slices, State::Failed)] {
        expected += 1;
        receive(&assemblers[0], &files).await;
        let start = Instant::now();
        while jobs(&nodes[0]).await.len() < expected {
            assert!(start.elapsed() < SOON, "no job of {} files", files.len());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
        let made = jobs(&nodes[0]).await;
        assert_eq!(made.len(), expected);
        assert_eq!(nodes[0].get(made[0]).await.unwrap().unwrap().state, state);
        assert_eq!(waiting(&nodes[0]).await, []);
    }
}

async fn a_series_that_cannot_be_read_holds_up_no_other(place: &Place) {
    let store = place.open().await;
    let filing = assembler(&store, NEVER);
    let part = |seed| parted::gates(&parted::whole(seed)).split_off(1);
    // More than are looked at together.
    let damaged: Vec<_> = (1..=17).map(|seed| part(seed).swap_remove(0)).collect();
    receive(&filing, &damaged).await;
    tokio::time::sleep(Duration::from_millis(20)).await;
    receive(&filing, &part(18)).await;
    let mut first = waiting(&store).await;
    let second = first.pop().unwrap();
    assert_eq!(first.len(), 17);
    store.close().await;
    let uid = parted::text_of(&damaged[0], tags::SOP_INSTANCE_UID);
    let last = second.study_uid.as_str();
    place.run(format!("UPDATE instances SET sha256 = 'other' WHERE study_instance_uid <> '{last}'")).await;
    let store = place.open().await;
    assert!(matches!(store.excerpt(OWNER, &uid).await.unwrap_err(), StoreError::Damaged { .. }));
    let _watch = assembler(&store, Duration::from_millis(50)).watch(None);
    let [job] = jobs_soon(&store).await.try_into().unwrap();
    assert_eq!(store.get(job).await.unwrap().unwrap().study_instance_uid.as_deref(), Some(second.study_uid.as_str()));
    assert_eq!(waiting(&store).await, first, "they stay for who repairs them");
}
