//! What a key may use: requests, bytes, waiting jobs; and how much is left.

use super::{guarded::Guarded, harness::study};
use crate::parted;
use axum::body::Body;
use base64::{Engine as _, engine::general_purpose::STANDARD};
use dicom_dictionary_std::tags;
use futures_util::stream;
use std::{num::NonZeroU32, time::Duration};
use ventricle::{
    access::{Attempts, Scope, Standing, Wished},
    http::AppState,
};

const BOTH: [Scope; 2] = [Scope::Submit, Scope::Read];

#[tokio::test]
async fn requests_over_the_limit_are_told_when_to_come_again() {
    let guarded = Guarded::new(None, Standing { requests_per_second: NonZeroU32::new(2), ..Standing::default() }).await;
    let (key, other) = (guarded.key("ours", &BOTH), guarded.key("ours", &BOTH));
    let unlimited = guarded.key_with("ours", &BOTH, Wished { requests_per_second: Some(0), ..Wished::default() });
    let first = guarded.ask("GET", "/v1/reconstructions", Some(&key)).await;
    assert_eq!(first.header("ratelimit-policy"), "\"requests\";q=2;w=1");
    assert_eq!(first.header("ratelimit"), "\"requests\";r=3;t=1");
    let mut last = first;
    for _ in 0..20 {
        last = guarded.ask("GET", "/v1/reconstructions", Some(&key)).await;
    }
    last.problem(429, "too_many_requests");
    assert_eq!(last.header("retry-after"), "1");
    assert_eq!(guarded.ask("GET", "/v1/reconstructions", Some(&other)).await.status, 200, "each key has its own");
    for _ in 0..30 {
        let answer = guarded.ask("GET", "/v1/reconstructions", Some(&unlimited)).await;
        assert!(answer.status == 200 && answer.headers.get("ratelimit").is_none());
    }
}

#[tokio::test]
async fn bytes_of_a_day_are_counted_as_they_come_however_they_come() {
    let guarded = Guarded::new(None, Standing::default()).await;
    let key = guarded.key_with("ours", &BOTH, Wished { mb_per_day: Some(1), ..Wished::default() });
    let headers = [("content-type", "application/json")];
    // In chunks, without a length.
    let large = || {
        let counts: Vec<u8> = (0..4 * 16 * 64 * 64_u32).flat_map(|voxel| ((voxel % 89) as u16).to_le_bytes()).collect();
        let study = serde_json::json!({
            "grid": { "gates": 4, "shape": [16, 64, 64], "spacing_mm": [5.0, 5.0, 5.0] }, "dtype": "uint16", "counts": STANDARD.encode(counts),
        });
        let bytes = study.to_string().into_bytes();
        let chunks: Vec<Result<Vec<u8>, std::io::Error>> = bytes.chunks(10_000).map(|chunk| Ok(chunk.to_vec())).collect();
        Body::from_stream(stream::iter(chunks))
    };
    let send =
        async |body: Body, headers: &[(&str, &str)]| guarded.ask_with("POST", "/v1/reconstructions", Some(&key), headers, body).await;
    assert_eq!(send(large(), &headers).await.status, 202);
    let announced = [headers[0], ("content-length", "600000")];
    let refused = send(Body::from(vec![b' '; 600_000]), &announced).await;
    let problem = refused.problem(429, "too_many_bytes");
    assert!(problem["detail"].as_str().unwrap().contains("of its 1 MiB a day"), "{problem}");
    assert!((1..=86_400).contains(&refused.header("retry-after").parse::<u64>().unwrap()));
    assert_eq!(send(Body::from(study(2).to_string()), &headers).await.status, 202, "what fits still does");
    let stopped = send(large(), &headers).await;
    let problem = stopped.problem(429, "too_many_bytes");
    assert!(
        problem["detail"].as_str().unwrap().contains("of its 1 MiB a day"),
        "what does not say how long it is, is let in as far as it may: {problem}"
    );
    assert_eq!(stopped.header("content-type"), "application/problem+json");
    send(Body::from(study(3).to_string()), &headers).await.problem(429, "too_many_bytes");
    assert_eq!(guarded.ask("GET", "/v1/reconstructions", Some(&key)).await.status, 200);
}

#[tokio::test]
async fn what_is_announced_is_taken_and_given_back_if_it_does_not_come() {
    let guarded = Guarded::new(None, Standing::default()).await;
    let key = guarded.key_with("ours", &BOTH, Wished { mb_per_day: Some(1), ..Wished::default() });
    let announced = [("content-type", "application/json"), ("content-length", "700000")];
    let (go, gone) = tokio::sync::oneshot::channel::<()>();
    // Its end comes, without the bytes, when it is told to.
    let ending = stream::once(async move { gone.await.map(|()| Vec::new()).map_err(std::io::Error::other) });
    let first = guarded.ask_with("POST", "/v1/reconstructions", Some(&key), &announced, Body::from_stream(ending));
    let second = async {
        let refused = guarded.ask_with("POST", "/v1/reconstructions", Some(&key), &announced, Body::from(vec![b' '; 700_000])).await;
        refused.problem(429, "too_many_bytes");
        go.send(()).unwrap();
    };
    let (first, ()) = tokio::join!(first, second);
    first.problem(400, "empty_body");
    let third = guarded.ask_with("POST", "/v1/reconstructions", Some(&key), &announced, Body::from(vec![b' '; 700_000])).await;
    assert_ne!(third.status, 429, "the first one's bytes never came");
}

/// A body of STOW-RS.
fn multipart(files: &[Vec<u8>]) -> Body {
    let mut body = Vec::new();
    for file in files {
        body.extend_from_slice(b"--x\r\nContent-Type: application/dicom\r\n\r\n");
        body.extend_from_slice(file);
        body.extend_from_slice(b"\r\n");
    }
    Body::from([&body[..], b"--x--\r\n"].concat())
}

const RELATED: [(&str, &str); 1] = [("content-type", "multipart/related; type=\"application/dicom\"; boundary=x")];

#[tokio::test]
async fn no_way_to_submit_gives_an_owner_more_waiting_jobs_than_may() {
    let guarded = Guarded::new(None, Standing { queued_jobs: Some(2), ..Standing::default() }).await;
    let (ours, theirs) = (guarded.key("ours", &BOTH), guarded.key("theirs", &BOTH));
    // Several studies in one request.
    let studies: Vec<_> = (1..5).map(parted::whole).collect();
    let stored = guarded.ask_with("POST", "/dicom-web/studies", Some(&ours), &RELATED, multipart(&studies)).await;
    assert_eq!(stored.status, 202, "{}", stored.json());
    let failed = stored.json()["00081198"]["Value"].as_array().unwrap().clone();
    assert_eq!(failed.len(), 2, "{failed:?}");
    let words = failed[0]["00000902"].to_string();
    assert!(failed[0]["00081197"]["Value"][0] == 0xA700 && words.contains("jobs of this owner wait already"), "{failed:?}");
    let more = guarded.ask_with("POST", "/dicom-web/studies", Some(&ours), &RELATED, multipart(&studies[2..])).await;
    more.problem(429, "too_many_jobs");
    // Several requests at once, none of which finds a job when it is let in.
    let answers = futures_util::future::join_all((0..6).map(|seed| guarded.submit(seed, &theirs))).await;
    let mut statuses: Vec<u16> = answers.iter().map(|answer| answer.status.as_u16()).collect();
    statuses.sort_unstable();
    assert_eq!(statuses, [202, 202, 429, 429, 429, 429]);
    answers.iter().find(|answer| answer.status == 429).unwrap().problem(429, "too_many_jobs");
    let counts = guarded.service.store.counts().await.unwrap();
    assert_eq!((counts.queued, counts.reserved), (4, 0));
}

#[tokio::test]
async fn series_that_go_quiet_wait_until_their_owner_may_have_another_job() {
    let quiet = Duration::from_millis(200);
    let change = |state: AppState| state.with_studies(1 << 30, quiet);
    let guarded = Guarded::with(None, Standing { queued_jobs: Some(1), ..Standing::default() }, Attempts::default(), change).await;
    let (ours, theirs) = (guarded.key("ours", &BOTH), guarded.key("theirs", &BOTH));
    // Gates that do not say how many they are.
    let series = |seed| {
        let gates = parted::gates(&parted::whole(seed));
        multipart(&gates.iter().map(|file| parted::without(file, &[tags::NUMBER_OF_TIME_SLOTS])).collect::<Vec<_>>())
    };
    for (seed, key) in [(1, &ours), (2, &ours), (3, &theirs)] {
        assert_eq!(guarded.ask_with("POST", "/dicom-web/studies", Some(key), &RELATED, series(seed)).await.status, 200);
    }
    let _watch = guarded.service.state.assembler().watch(None);
    let jobs =
        async |key: &str| guarded.ask("GET", "/v1/reconstructions", Some(key)).await.json()["reconstructions"].as_array().unwrap().clone();
    let soon = async |key: &str, count: usize| {
        for _ in 0..500 {
            if jobs(key).await.len() == count {
                return;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        panic!("{:?}", jobs(key).await);
    };
    soon(&theirs, 1).await;
    soon(&ours, 1).await;
    tokio::time::sleep(4 * quiet).await;
    assert_eq!(jobs(&ours).await.len(), 1, "the other waits");
    let first = jobs(&ours).await[0]["links"]["self"].as_str().unwrap().to_owned();
    // Cancelled, it waits no more.
    assert!(guarded.ask("DELETE", &first, Some(&ours)).await.status.is_success());
    soon(&ours, 2).await;
}

#[tokio::test]
async fn an_owner_has_as_many_waiting_jobs_as_may() {
    let guarded = Guarded::new(None, Standing { queued_jobs: Some(2), ..Standing::default() }).await;
    let (ours, theirs) = (guarded.key("ours", &BOTH), guarded.key("theirs", &BOTH));
    let first = guarded.submit(1, &ours).await;
    assert_eq!((first.status.as_u16(), guarded.submit(2, &ours).await.status.as_u16()), (202, 202));
    let refused = guarded.submit(3, &ours).await;
    refused.problem(429, "too_many_jobs");
    assert!(refused.header("retry-after").parse::<u64>().is_ok());
    assert_eq!(guarded.submit(3, &theirs).await.status, 202, "another owner's do not count");
    guarded.ask("DELETE", first.header("location"), Some(&ours)).await;
    assert_eq!(guarded.submit(3, &ours).await.status, 202);
}
