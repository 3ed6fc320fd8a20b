//! Several nodes on one PostgreSQL: stores in this process, services in processes of their own, and a database that crashes.

use crate::{
    cluster::{Cluster, listeners},
    place::{Place, endless, new_job, on_postgres, output, study, submit, until, until_state, work, workers},
    served::{Directory, Served},
};
use sqlx::{AssertSqlSafe, PgConnection};
use std::{
    sync::{Arc, Mutex, mpsc},
    time::{Duration, Instant},
};
use uuid::Uuid;
use ventricle::{
    jobs::{
        Deletion, Finish, Heartbeat, News, Outcome, Snapshot, State, Store, StoreSettings, SubmitError, Submitted, Threads, Work,
        WorkerSettings, Workers, start_workers,
    },
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    pipeline::monitor::{Monitor, Stage},
};

on_postgres! {
    many_nodes_start_at_once_on_an_empty_database,
    what_one_node_does_the_others_hear,
    without_notifications_polling_is_enough,
    who_listens_to_all_jobs_hears_of_those_of_other_nodes,
    who_begins_to_listen_misses_no_job_of_another_node_without_knowing,
    a_job_is_cancelled_from_another_node_nearly_at_once,
    a_listener_that_was_cut_off_comes_back_and_looks_again,
    limits_hold_however_many_submit_on_two_nodes,
    the_rate_is_that_of_all_nodes,
    a_namesake_of_a_lost_worker_cannot_be_mistaken_for_it,
    a_process_paused_beyond_its_lease_changes_nothing,
}

/// Longer than any test lasts: what happens in one was heard, not looked for.
const NEVER: Duration = Duration::from_mins(10);
/// What is heard is heard sooner than this, on a machine that does other things too.
const SOON: Duration = Duration::from_secs(15);

/// A store that learns of others' changes by hearing only.
async fn hearing(place: &Place) -> Store {
    Store::open(StoreSettings { poll: NEVER, ..place.settings() }).await.unwrap()
}

/// Workers that learn of others' changes by hearing only.
fn hearing_workers(store: &Store, work: Work) -> Workers {
    let settings = WorkerSettings { threads: Threads::Fixed(1), heartbeat: NEVER, poll: NEVER, work, ..WorkerSettings::default() };
    start_workers(store.clone(), settings).unwrap()
}

async fn many_nodes_start_at_once_on_an_empty_database(place: &Place) {
    let starting: Vec<_> = (0..6)
        .map(|_| {
            let settings = place.settings();
            tokio::spawn(async move { Store::open(settings).await.unwrap() })
        })
        .collect();
    let mut stores = Vec::new();
    for store in starting {
        stores.push(store.await.unwrap());
    }
    let job = submit(&stores[0]).await;
    assert_eq!(stores[5].get(job.id).await.unwrap().unwrap().id, job.id);
}

async fn what_one_node_does_the_others_hear(place: &Place) {
    let (asked, working) = (hearing(place).await, hearing(place).await);
    let (gate, gates) = mpsc::channel::<()>();
    let gates = Mutex::new(gates);
    let _workers = hearing_workers(
        &working,
        work(move |_, _, _, progress| {
            progress.begin(Stage::Measurement, Some(0));
            progress.advance(2, 4);
            gates.lock().unwrap().recv().unwrap();
            Ok(vec![output("report", b"{}")])
        }),
    );
    let began = Instant::now();
    let job = submit(&asked).await;
    let mut version = job.version;
    let mut seen = Vec::new();
    loop {
        let job = asked.wait_for_change(job.id, version, SOON).await.unwrap().unwrap();
        seen.push((job.state, job.gates_done));
        if job.gates_done == 2 && job.state == State::Running {
            gate.send(()).unwrap();
        }
        if job.state.is_final() {
            break;
        }
        assert!(job.version > version);
        version = job.version;
    }
    assert_eq!(*seen.last().unwrap(), (State::Succeeded, 2), "{seen:?}");
    assert!(seen.contains(&(State::Running, 2)), "progress is seen from another node: {seen:?}");
    assert!(began.elapsed() < SOON, "{:?}", began.elapsed());
}

async fn without_notifications_polling_is_enough(place: &Place) {
    let settings = StoreSettings { listen: false, poll: Duration::from_millis(100), ..place.settings() };
    let (asked, working) = (Store::open(settings.clone()).await.unwrap(), Store::open(settings).await.unwrap());
    let heartbeat = Duration::from_millis(500);
    let running = WorkerSettings { work: endless(), heartbeat, poll: Duration::from_millis(100), ..WorkerSettings::default() };
    let _workers = start_workers(working.clone(), running).unwrap();
    let job = submit(&asked).await;
    until_state(&asked, job.id, State::Running).await;
    let began = Instant::now();
    assert!(matches!(asked.delete(job.id).await.unwrap(), Deletion::Cancelling(_)));
    until_state(&asked, job.id, State::Cancelled).await;
    // A heartbeat, a poll, and what a busy machine adds.
    assert!(began.elapsed() < heartbeat + Duration::from_secs(2), "{:?}", began.elapsed());
}

/// Reads news until one is as wanted.
async fn told(news: &mut tokio::sync::broadcast::Receiver<News>, wanted: impl Fn(&News) -> bool) {
    let read = async { while !wanted(&news.recv().await.unwrap()) {} };
    tokio::time::timeout(SOON, read).await.expect("it is not told");
}

async fn who_listens_to_all_jobs_hears_of_those_of_other_nodes(place: &Place) {
    let other = place.open().await;
    let before = submit(&other).await;
    // By hearing only, and by looking only.
    let deaf = StoreSettings { poll: Duration::from_millis(50), listen: false, ..place.settings() };
    for (listener, hears) in [(hearing(place).await, true), (Store::open(deaf).await.unwrap(), false)] {
        let mut news = listener.news();
        // The first look is what later ones are compared with, and whoever hears must have begun to.
        tokio::time::sleep(Duration::from_secs(3)).await;
        let new = submit(&other).await;
        told(&mut news, |one| matches!(one, News::Changed(job) if job.id == new.id)).await;
        assert!(matches!(other.delete(new.id).await.unwrap(), Deletion::Cancelled(_)));
        told(&mut news, |one| matches!(one, News::Changed(job) if job.id == new.id && job.state == State::Cancelled)).await;
        other.delete(new.id).await.unwrap();
        if hears {
            told(&mut news, |one| matches!(one, News::Deleted { id, owner } if *id == new.id && owner.as_deref() == Some("someone"))).await;
        }
        listener.close().await;
    }
    assert_eq!(other.get(before.id).await.unwrap().unwrap().state, State::Queued);
}

async fn who_begins_to_listen_misses_no_job_of_another_node_without_knowing(place: &Place) {
    let other = place.open().await;
    let poll = Duration::from_millis(300);
    let listener = Store::open(StoreSettings { poll, listen: false, ..place.settings() }).await.unwrap();
    // Until nobody listens any more and that was noticed: then there is nothing to compare a look with.
    drop(listener.news());
    tokio::time::sleep(2 * poll).await;
    let mut news = listener.news();
    let new = submit(&other).await;
    told(&mut news, |one| matches!(one, News::Missed)).await;
    // Once: what happens from now on is told by itself.
    assert!(matches!(other.delete(new.id).await.unwrap(), Deletion::Cancelled(_)));
    told(&mut news, |one| {
        assert!(!matches!(one, News::Missed));
        matches!(one, News::Changed(job) if job.id == new.id && job.state == State::Cancelled)
    })
    .await;
    listener.close().await;
}

async fn a_job_is_cancelled_from_another_node_nearly_at_once(place: &Place) {
    let (asked, working) = (hearing(place).await, hearing(place).await);
    let _workers = hearing_workers(&working, endless());
    let job = submit(&asked).await;
    let running = asked.wait_for_change(job.id, job.version, SOON).await.unwrap().unwrap();
    assert_eq!(running.state, State::Running);
    let began = Instant::now();
    let Deletion::Cancelling(cancelling) = asked.delete(job.id).await.unwrap() else { panic!("not cancelling") };
    let ended = asked.wait_for_change(job.id, cancelling.version, SOON).await.unwrap().unwrap();
    assert_eq!(ended.state, State::Cancelled);
    assert!(began.elapsed() < Duration::from_secs(1), "{:?}", began.elapsed());
}

/// So many listeners, none of them one of these.
async fn until_listening(connection: &mut PgConnection, count: usize, gone: &[i32]) -> Vec<i32> {
    let deadline = Instant::now() + SOON;
    loop {
        let found = listeners(connection).await;
        if found.len() == count && found.iter().all(|pid| !gone.contains(pid)) {
            return found;
        }
        assert!(Instant::now() < deadline, "{found:?} listen");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn a_listener_that_was_cut_off_comes_back_and_looks_again(place: &Place) {
    let (asked, working) = (hearing(place).await, hearing(place).await);
    let mut connection = place.connect().await;
    let first = until_listening(&mut connection, 2, &[]).await;
    let _workers = hearing_workers(&working, work(|_, _, _, _| Ok(Vec::new())));
    let job = submit(&asked).await;
    until_state(&asked, job.id, State::Succeeded).await;
    // Until the worker has looked for the next job and found none.
    tokio::time::sleep(Duration::from_millis(500)).await;

    // As if it had been queued while the connections were down.
    let untold = Uuid::now_v7();
    insert_untold(&mut connection, job.id, untold).await;
    let waiting = {
        let asked = asked.clone();
        tokio::spawn(async move { asked.wait_for_change(untold, 1, NEVER).await.unwrap().unwrap() })
    };
    tokio::time::sleep(Duration::from_millis(500)).await;
    assert!(!waiting.is_finished(), "nobody was told");
    for pid in &first {
        assert!(sqlx::query_scalar::<_, bool>("SELECT pg_terminate_backend($1)").bind(pid).fetch_one(&mut connection).await.unwrap());
    }
    let second = until_listening(&mut connection, 2, &first).await;
    let found = tokio::time::timeout(SOON, waiting).await.expect("the watcher looked again").unwrap();
    assert_ne!(found.state, State::Queued, "a free worker looked again");
    // And they hear as before.
    let began = Instant::now();
    let job = submit(&asked).await;
    until_state(&asked, job.id, State::Succeeded).await;
    assert!(began.elapsed() < SOON, "{:?}", began.elapsed());
    assert_eq!(listeners(&mut connection).await, second);
}

/// A queued copy of a job that nobody is told of.
async fn insert_untold(connection: &mut PgConnection, original: Uuid, id: Uuid) {
    let columns = "owner, request_hash, kind, parameters, input_bytes, max_attempts, run_after, gates_total, created_at";
    let sql = format!("INSERT INTO jobs (id, state, {columns}) SELECT $1, 'queued', {columns} FROM jobs WHERE id = $2");
    let inserted = sqlx::query(AssertSqlSafe(sql)).bind(id.to_string()).bind(original.to_string()).execute(&mut *connection).await.unwrap();
    assert_eq!(inserted.rows_affected(), 1);
}

async fn limits_hold_however_many_submit_on_two_nodes(place: &Place) {
    let bytes = ventricle::jobs::input::encode(&study()).unwrap().len() as u64;
    // First the number of jobs is what limits, then, with half a job's room left over, their bytes.
    for (max_queued_jobs, max_queued_bytes, expected) in [(6, 100 * bytes, 6), (100, 10 * bytes + bytes / 2, 4)] {
        let limits = StoreSettings { max_queued_jobs, max_queued_bytes, ..place.settings() };
        let stores = [Store::open(limits.clone()).await.unwrap(), Store::open(limits).await.unwrap()];
        let racing: Vec<_> = (0..40)
            .map(|number| {
                let store = stores[number % 2].clone();
                tokio::spawn(async move {
                    let Ok(place) = store.reserve(bytes) else { return false };
                    match store.submit(place, new_job()).await {
                        Ok(Submitted::Created(_)) => true,
                        Err(SubmitError::QueueFull(full)) => {
                            assert!((1..=600).contains(&full.retry_after_s));
                            false
                        }
                        other => panic!("{other:?}"),
                    }
                })
            })
            .collect();
        let mut accepted = 0;
        for answer in racing {
            accepted += i32::from(answer.await.unwrap());
        }
        assert_eq!(accepted, expected);
        let counts = stores[0].counts().await.unwrap();
        assert!(counts.queued <= max_queued_jobs && counts.queued_bytes <= max_queued_bytes, "{counts:?}");
    }
}

async fn the_rate_is_that_of_all_nodes(place: &Place) {
    let limits = StoreSettings { max_queued_jobs: 8, ..place.settings() };
    let (asked, working) = (Store::open(limits).await.unwrap(), place.open().await);
    let measured = submit(&asked).await;
    let claim = working.claim("someone").await.unwrap().unwrap();
    working.finish(&claim, Outcome::Succeeded([].into()), &Snapshot::default()).await.unwrap();
    let slow = "UPDATE jobs SET started_at = finished_at - 8000 WHERE id = $1";
    sqlx::query(slow).bind(measured.id.to_string()).execute(&mut place.connect().await).await.unwrap();

    let settings = |workers| WorkerSettings { workers, threads: Threads::Fixed(1), work: endless(), ..WorkerSettings::default() };
    let _one = start_workers(asked.clone(), settings(1)).unwrap();
    let _three = start_workers(working.clone(), settings(3)).unwrap();
    for _ in 0..4 {
        let job = submit(&asked).await;
        until_state(&asked, job.id, State::Running).await;
    }
    // What the other node took is counted every second, or now.
    asked.publish_counts().await.unwrap();
    let mut last = None;
    for _ in 0..8 {
        last = Some(submit(&asked).await.id);
    }
    let last = asked.get(last.unwrap()).await.unwrap().unwrap();
    assert_eq!((last.queue_position, last.eta_seconds), (Some(8), Some(16.0)), "8 jobs of 8 s, 4 workers on two nodes");
    assert_eq!(asked.reserve(0).unwrap_err().retry_after_s, 16);
}

async fn a_namesake_of_a_lost_worker_cannot_be_mistaken_for_it(place: &Place) {
    let lease = Duration::from_millis(200);
    let settings = StoreSettings { lease, ..place.settings() };
    let (before, after) = (Store::open(settings).await.unwrap(), place.open().await);
    let job = submit(&before).await;
    let lost = before.claim("node/worker-1").await.unwrap().unwrap();
    let deadline = Instant::now() + SOON;
    let mut held = None;
    while held.is_none() {
        assert!(Instant::now() < deadline, "the job is not taken back");
        tokio::time::sleep(Duration::from_millis(50)).await;
        after.reap().await.unwrap();
        held = after.claim("node/worker-1").await.unwrap();
    }
    let held = held.unwrap();
    assert_eq!((held.id, lost.attempt, held.attempt), (job.id, 1, 2));
    let results = |data: &[u8]| Outcome::Succeeded([output("report", data)].into());
    let news = Snapshot { fraction: 0.9, ..Snapshot::default() };
    assert_eq!(before.heartbeat(&lost, Some(&news)).await.unwrap(), Heartbeat::Lost);
    assert_eq!(before.finish(&lost, results(b"late"), &news).await.unwrap(), Finish::Lost);
    assert!(!before.give_back(&lost).await.unwrap());
    assert_eq!(after.heartbeat(&held, None).await.unwrap(), Heartbeat::Held { cancel: false });
    assert_eq!(after.finish(&held, results(b"right"), &news).await.unwrap(), Finish::Done(State::Succeeded));
    assert_eq!(before.blob(job.id, "report").await.unwrap().unwrap().data, b"right");
}

/// A study that takes one thread of an unoptimised build some seconds.
fn slow_study() -> Vec<u8> {
    let imaging = Imaging { gates: 8, ..Imaging::default() };
    let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
    phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap()
}

async fn a_process_paused_beyond_its_lease_changes_nothing(place: &Place) {
    let url = place.url().to_owned();
    tokio::task::spawn_blocking(move || pause_and_go_on(&url)).await.unwrap();
}

fn pause_and_go_on(url: &str) {
    let data = Directory::new("paused");
    let start = |node: &str| {
        let flags = ["--database-url", url, "--node", node, "--lease-seconds", "2", "--threads-per-worker", "1"];
        Served::start(&data.0, &flags)
    };
    let paused = start("paused");
    let body = slow_study();
    let accepted = paused.post_keyed("once", "application/dicom", &body);
    assert_eq!(accepted.status, 202, "{}", String::from_utf8_lossy(&accepted.body));
    let id = accepted.json()["id"].as_str().unwrap().to_owned();
    let path = format!("/v1/reconstructions/{id}");
    let began = Instant::now();
    while paused.get(&path).json()["state"] == "queued" {
        assert!(began.elapsed() < SOON, "nobody works");
    }
    paused.signal("STOP");

    let other = start("other");
    let job = other.get(&path).json();
    assert_eq!((&job["state"], &job["attempt"]), (&"running".into(), &1.into()), "paused in the middle: {job}");
    let again = other.post_keyed("once", "application/dicom", &body);
    assert_eq!(again.json()["id"], id.as_str(), "the key is known on every node");
    // Events of a job that runs elsewhere, is lost there and continues here, to the end.
    let events = String::from_utf8(other.get(&format!("{path}/events")).body).unwrap();
    let told: Vec<serde_json::Value> =
        events.lines().filter_map(|line| line.strip_prefix("data:")).map(|data| serde_json::from_str(data.trim()).unwrap()).collect();
    assert!(told.len() > 2, "{events}");
    assert_eq!((&told[0]["attempt"], &told[told.len() - 1]["state"]), (&1.into(), &"succeeded".into()));
    let done = other.finished(&id, Duration::from_mins(1));
    assert_eq!((&done["state"], &done["attempt"]), (&"succeeded".into(), &2.into()), "{done}");
    let report = other.get(&format!("{path}/report")).body;

    paused.signal("CONT");
    let began = Instant::now();
    while !String::from_utf8(paused.get("/metrics").body).unwrap().contains("ventricle_leases_lost_total 1") {
        assert!(began.elapsed() < Duration::from_mins(1), "the paused node never noticed");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(paused.get(&path).json(), done, "seen from the node that was paused");
    assert_eq!(paused.get(&format!("{path}/report")).body, report);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn workers_outlive_a_crash_of_the_database() {
    let Some(cluster) = Cluster::start("a crash of the database") else { return };
    let place = Place::postgres_at(&cluster.url).await;
    let (asked, working) = (place.open().await, place.open().await);
    let (gate, gates) = mpsc::channel::<()>();
    let gates = Mutex::new(gates);
    let results: Work = work(move |_, _, id, progress| {
        progress.advance(1, 4);
        gates.lock().unwrap().recv().unwrap();
        Ok(vec![output("report", id.to_string().as_bytes())])
    });
    let _workers = [workers(&asked, Arc::clone(&results)), workers(&working, results)];
    let mut jobs = Vec::new();
    for _ in 0..4 {
        jobs.push(submit(&asked).await.id);
    }
    for id in &jobs[..2] {
        until(&working, *id, |job| job.gates_done == 1).await;
    }
    // Two run and two wait.
    cluster.crash();
    for id in &jobs {
        gate.send(()).unwrap();
        let job = asked.get(*id).await.unwrap().unwrap();
        assert!(!matches!(job.state, State::Failed | State::Cancelled), "{job:?}");
    }
    // Accepted after the crash, and heard of.
    jobs.push(submit(&working).await.id);
    gate.send(()).unwrap();
    for id in jobs {
        let done = until_state(&asked, id, State::Succeeded).await;
        assert_eq!(done.attempt, 1, "the lease outlasts the restart");
        assert_eq!(asked.blob(id, "report").await.unwrap().unwrap().data, id.to_string().as_bytes());
    }
    assert_eq!(asked.counts().await.unwrap().running, 0);
}
