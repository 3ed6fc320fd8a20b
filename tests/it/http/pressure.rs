//! More clients than a queue has room for: who obeys `Retry-After` gets through.

use super::harness::{Service, held, study, with};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};
use ventricle::jobs::{State, StoreSettings};

const CLIENTS: u16 = 6;
const JOBS_EACH: u16 = 3;
const PLACES: u16 = 4;

/// Submits its studies one after the other and waits as long as it is told; returns the most often it sent one.
async fn obedient(service: &Service, client: u16, refused: &AtomicUsize) -> usize {
    let mut most = 0;
    for job in 0..JOBS_EACH {
        let body = study(client * JOBS_EACH + job).to_string();
        for sent in 1.. {
            let answer = service.post("", &[("content-type", "application/json")], body.clone()).await;
            if answer.status == 202 {
                most = most.max(sent);
                break;
            }
            answer.problem(503, "queue_full");
            refused.fetch_add(1, Ordering::SeqCst);
            tokio::time::sleep(Duration::from_secs(answer.header("retry-after").parse().unwrap())).await;
        }
    }
    most
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_that_wait_as_told_all_get_through() {
    let go = Arc::new(AtomicBool::new(true));
    let settings = StoreSettings { max_queued_jobs: PLACES.into(), ..StoreSettings::default() };
    let service = with(settings, Some(held(Arc::clone(&go))), |state| state).await;
    // One job for the rate to be known; then the worker holds the next until the queue behind it is full and clients are refused.
    service.finish(9999).await;
    go.store(false, Ordering::SeqCst);
    let began = Instant::now();
    let refused = AtomicUsize::new(0);
    let clients = futures_util::future::join_all((0..CLIENTS).map(|client| obedient(&service, client, &refused)));
    let release = async {
        while refused.load(Ordering::SeqCst) == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        go.store(true, Ordering::SeqCst);
    };
    let (most, ()) = tokio::join!(clients, release);
    // Whoever is refused found the places taken by jobs of others. If the wait is long enough for these to have left, the next refusal takes
    // as many other jobs again, and there are only so many.
    let refusals = usize::from((CLIENTS - 1) * JOBS_EACH / PLACES);
    assert!(most.iter().all(|&sent| sent <= 1 + refusals), "times that a study was sent, by client: {most:?}");
    let wanted = usize::from(CLIENTS * JOBS_EACH) + 1;
    loop {
        let page = service.store.list(ventricle::jobs::ListQuery::default()).await.unwrap();
        assert_eq!(page.jobs.len(), wanted);
        if page.jobs.iter().all(|job| job.state == State::Succeeded) {
            break;
        }
        assert!(began.elapsed() < Duration::from_secs(20));
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
