//! Results that are sent where the operator says, by STOW-RS; by C-STORE they are sent in `dimse.rs`.

use super::callbacks::{Identity, Receiver, delivery, settings};
use crate::{
    parted,
    place::{Place, on_both_engines, output, submit},
};
use dicom_dictionary_std::tags;
use std::{sync::Arc, time::Duration};
use uuid::Uuid;
use ventricle::{
    callbacks::{DeliverySettings, Document, Results, start},
    dimse::Title,
    jobs::{DeliveryKind, JobError, Outcome, Snapshot, Store, StoreSettings},
};

on_both_engines! {
    a_result_is_sent_until_the_answer_names_it_as_stored,
    only_what_succeeded_is_sent_and_only_where_that_is_wished,
    a_credential_goes_to_the_receiver_that_it_is_for_alone,
}

async fn open(place: &Place, url: String) -> Store {
    Store::open(StoreSettings { results_to: Some(url), ..place.settings() }).await.unwrap()
}

async fn ended(store: &Store, outcome: Outcome) -> Uuid {
    let job = submit(store).await.id;
    let claim = store.claim("test").await.unwrap().unwrap();
    assert_eq!(claim.id, job);
    store.finish(&claim, outcome, &Snapshot::default()).await.unwrap();
    job
}

fn succeeded() -> Outcome {
    Outcome::Succeeded([output("report", b"{}")].into())
}

/// Sends this document of every job.
fn sending(document: Result<Vec<u8>, String>) -> DeliverySettings {
    sending_with(document, None)
}

/// Likewise, with a credential for a URL.
fn sending_with(document: Result<Vec<u8>, String>, authorization: Option<(String, String)>) -> DeliverySettings {
    let document: Document = Arc::new(move |_, _| Box::pin(std::future::ready(document.clone())));
    let results = Some(Results { document, calling: Title::parse("VENTRICLE").unwrap(), authorization });
    DeliverySettings { callbacks: None, results, ..settings(&["127.0.0.1"], &Identity::new()) }
}

async fn a_result_is_sent_until_the_answer_names_it_as_stored(place: &Place) {
    let document = parted::ungated(1);
    let instance = parted::text_of(&document, tags::SOP_INSTANCE_UID);
    let stored = |sequence: &str| {
        format!(
            "200 OK\r\nContent-Type: application/dicom+json\r\n\r\n\
             {{\"{sequence}\":{{\"vr\":\"SQ\",\"Value\":[{{\"00081155\":{{\"vr\":\"UI\",\"Value\":[\"{instance}\"]}}}}]}}}}"
        )
    };
    // 200 without a word, 200 for a failed instance, and the right answer.
    let receiver = Receiver::new(&[Some("200 OK"), Some(&stored("00081198")), Some(&stored("00081199"))]).await;
    let store = open(place, receiver.url()).await;
    let job = ended(&store, succeeded()).await;
    let courier = start(store.clone(), sending(Ok(document.clone())));
    let sent = delivery(&store, job, |delivery| delivery.state != "pending").await;
    assert_eq!((sent.kind, sent.state.as_str(), sent.attempts), (DeliveryKind::Result, "delivered", 3));
    courier.stop(Duration::from_secs(5)).await;
    let seen = receiver.seen();
    assert_eq!(seen.len(), 3);
    assert!(seen[0].head.starts_with("POST /done?token=hidden HTTP/1.1"), "{}", seen[0].head);
    assert_eq!(seen[0].header("accept"), "application/dicom+json");
    let boundary = seen[0].header("content-type").strip_prefix("multipart/related; type=\"application/dicom\"; boundary=").unwrap();
    let head = format!("--{boundary}\r\nContent-Type: application/dicom\r\nContent-Length: {}\r\n\r\n", document.len());
    assert_eq!(seen[0].body, [head.as_bytes(), &document, format!("\r\n--{boundary}--\r\n").as_bytes()].concat());
    assert!(seen.iter().all(|other| other.body == seen[0].body));
}

async fn only_what_succeeded_is_sent_and_only_where_that_is_wished(place: &Place) {
    let receiver = Receiver::new(&[Some("503 Service Unavailable")]).await;
    let store = open(place, receiver.url()).await;
    let failed = Outcome::Failed(JobError { code: "no_left_ventricle".into(), message: "None in this study.".into() });
    let failed = ended(&store, failed).await;
    assert_eq!(store.deliveries(failed).await.unwrap(), []);

    // A node that only tells of jobs' ends leaves it to others.
    let job = ended(&store, succeeded()).await;
    let teller = start(store.clone(), settings(&["127.0.0.1"], &Identity::new()));
    tokio::time::sleep(Duration::from_millis(200)).await;
    let waiting = delivery(&store, job, |_| true).await;
    assert_eq!((waiting.kind, waiting.state.as_str(), waiting.attempts), (DeliveryKind::Result, "pending", 0));
    teller.stop(Duration::from_secs(5)).await;

    let courier = start(store.clone(), sending(Ok(parted::ungated(1))));
    let given_up = delivery(&store, job, |delivery| delivery.state == "given_up").await;
    assert_eq!((given_up.attempts, given_up.last_error.as_deref()), (3, Some("status 503")));
    courier.stop(Duration::from_secs(5)).await;
    assert_eq!(receiver.seen().len(), 3);

    // What cannot be made is not sent.
    let broken = ended(&store, succeeded()).await;
    let _courier = start(store.clone(), sending(Err("there is no report".to_owned())));
    let given_up = delivery(&store, broken, |delivery| delivery.state == "given_up").await;
    assert_eq!(given_up.last_error.as_deref(), Some("the document cannot be made: there is no report"));
    assert_eq!(receiver.seen().len(), 3);
}

async fn a_credential_goes_to_the_receiver_that_it_is_for_alone(place: &Place) {
    let (before, now) = (Receiver::new(&[Some("401 Unauthorized")]).await, Receiver::new(&[Some("200 OK")]).await);
    let store = open(place, before.url()).await;
    let waits = ended(&store, succeeded()).await;
    store.close().await;
    // The operator named another receiver, and what it is to be told, before that was sent.
    let store = open(place, now.url()).await;
    let job = ended(&store, succeeded()).await;
    let credential = Some((now.url(), "Bearer of the new one".to_owned()));
    let courier = start(store.clone(), sending_with(Ok(parted::ungated(1)), credential));
    for job in [waits, job] {
        delivery(&store, job, |delivery| delivery.state == "given_up").await;
    }
    courier.stop(Duration::from_secs(5)).await;
    assert!(now.seen().iter().all(|seen| seen.header("authorization") == "Bearer of the new one") && now.seen().len() == 3);
    let old: Vec<_> = before.seen().iter().map(|seen| seen.head.to_lowercase()).collect();
    assert!(old.len() == 3 && old.iter().all(|head| !head.contains("authorization:")), "{old:?}");
}
