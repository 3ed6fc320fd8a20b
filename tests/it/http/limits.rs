//! What a key may use: requests, bytes, waiting jobs; and how much is left.

use super::{guarded::Guarded, harness::study};
use axum::body::Body;
use base64::{Engine as _, engine::general_purpose::STANDARD};
use std::num::NonZeroU32;
use ventricle::access::{Scope, Standing, Wished};

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
        Body::from_stream(futures_util::stream::iter(chunks))
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
    assert_eq!(send(large(), &headers).await.status, 202, "what does not say how long it is, is counted afterwards");
    send(Body::from(study(3).to_string()), &headers).await.problem(429, "too_many_bytes");
    assert_eq!(guarded.ask("GET", "/v1/reconstructions", Some(&key)).await.status, 200);
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
