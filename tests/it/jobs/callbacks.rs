//! What is told of a job's end, to receivers on the loopback interface.

use crate::place::{Place, new_job, on_both_engines};
use hmac::{Hmac, KeyInit as _, Mac as _};
use serde_json::Value;
use sha2::Sha256;
use std::{
    net::SocketAddr,
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _},
    net::TcpListener,
    task::JoinHandle,
};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        ServerConfig,
        crypto::ring,
        pki_types::{PrivateKeyDer, PrivatePkcs8KeyDer},
    },
};
use uuid::Uuid;
use ventricle::{
    callbacks::{Allowed, Deliveries, DeliverySettings, Schedule, Sender, Signer, start},
    http::callback_body,
    jobs::{Delivery, DeliveryKind, JobError, NewJob, Outcome, Settled, Snapshot, Store},
};

on_both_engines! {
    a_callback_comes_once_and_signed_without_what_belongs_to_the_patient,
    a_failure_is_tried_again_under_the_same_id_until_it_is_given_up,
    a_redirect_is_not_followed,
    what_leads_to_this_machine_is_never_connected_to_unless_allowed,
    a_certificate_is_checked_and_who_has_a_good_one_gets_the_callback,
    what_a_lost_node_held_is_sent_again_when_its_lease_is_over,
    a_node_that_stops_gives_back_what_it_has_under_way,
    an_attempt_whose_lease_is_over_changes_nothing,
    nodes_that_race_never_claim_the_same_delivery,
}

const SECRET: &str = "0123456789abcdef0123456789abcdef";
const STUDY_UID: &str = "1.2.826.0.1.3680043.99";

/// A request as a receiver got it.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub(super) head: String,
    pub(super) body: Vec<u8>,
}

impl Seen {
    pub(super) fn header(&self, name: &str) -> &str {
        let lines = self.head.lines().skip(1).filter_map(|line| line.split_once(": "));
        lines.filter(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value).next().unwrap_or_else(|| panic!("{}", self.head))
    }
}

/// A receiver that answers what it is told to (status and headers, and a body after an empty line), the last answer again and again; `None` is no answer at all.
pub(super) struct Receiver {
    address: SocketAddr,
    seen: Arc<Mutex<Vec<Seen>>>,
    connections: Arc<AtomicUsize>,
    task: JoinHandle<()>,
}

impl Drop for Receiver {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Receiver {
    pub(super) async fn new(answers: &[Option<&str>]) -> Self {
        Self::with(answers, None).await
    }

    async fn with(answers: &[Option<&str>], tls: Option<TlsAcceptor>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (seen, connections) = (Arc::default(), Arc::new(AtomicUsize::new(0)));
        let answers: Arc<Vec<Option<String>>> = Arc::new(answers.iter().map(|answer| answer.map(str::to_owned)).collect());
        let (all, counted) = (Arc::clone(&seen), Arc::clone(&connections));
        let task = tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                counted.fetch_add(1, Ordering::SeqCst);
                let (all, answers, tls) = (Arc::clone(&all), Arc::clone(&answers), tls.clone());
                tokio::spawn(async move {
                    match tls {
                        None => serve(stream, &all, &answers).await,
                        Some(tls) => {
                            if let Ok(stream) = tls.accept(stream).await {
                                serve(stream, &all, &answers).await;
                            }
                        }
                    }
                });
            }
        });
        Self { address, seen, connections, task }
    }

    pub(super) fn url(&self) -> String {
        format!("http://{}/done?token=hidden", self.address)
    }

    pub(super) fn seen(&self) -> Vec<Seen> {
        self.seen.lock().unwrap().clone()
    }
}

async fn serve(mut stream: impl AsyncRead + AsyncWrite + Unpin, all: &Mutex<Vec<Seen>>, answers: &[Option<String>]) {
    let mut bytes = Vec::new();
    let (head, length, start) = loop {
        if stream.read_buf(&mut bytes).await.unwrap_or(0) == 0 {
            return;
        }
        let Some(end) = bytes.windows(4).position(|window| window == b"\r\n\r\n") else { continue };
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        let seen = Seen { head, body: Vec::new() };
        let length: usize = seen.header("content-length").parse().unwrap();
        break (seen.head, length, end + 4);
    };
    while bytes.len() < start + length {
        if stream.read_buf(&mut bytes).await.unwrap_or(0) == 0 {
            return;
        }
    }
    let answer = {
        let mut all = all.lock().unwrap();
        all.push(Seen { head, body: bytes[start..].to_vec() });
        answers.get(all.len() - 1).or(answers.last()).unwrap().clone()
    };
    let Some(answer) = answer else { return std::future::pending().await };
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, "ok"));
    let text = format!("HTTP/1.1 {head}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}", body.len());
    let _ = stream.write_all(text.as_bytes()).await;
    let _ = stream.shutdown().await;
}

/// A certificate for `localhost`, the file that makes it trusted, and a server that has it.
pub(super) struct Identity {
    file: PathBuf,
    tls: TlsAcceptor,
}

impl Identity {
    pub(super) fn new() -> Self {
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        let file = std::env::temp_dir().join(format!("ventricle-roots-{}.pem", Uuid::now_v7()));
        std::fs::write(&file, made.cert.pem()).unwrap();
        let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(made.signing_key.serialize_der()));
        let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_no_client_auth()
            .with_single_cert(vec![made.cert.der().clone()], key)
            .unwrap();
        Self { file, tls: TlsAcceptor::from(Arc::new(config)) }
    }
}

impl Drop for Identity {
    fn drop(&mut self) {
        std::fs::remove_file(&self.file).ok();
    }
}

/// Settings that lose no time, with these places allowed.
pub(super) fn settings(allowed: &[&str], trusted: &Identity) -> DeliverySettings {
    let allowed = Arc::new(Allowed::parse(allowed.iter().copied()).unwrap());
    let sender = Sender::new(allowed, &trusted.file).unwrap();
    let quick = Duration::from_millis(20);
    let schedule = Schedule { attempts: 3, first: quick, factor: 1.0, longest: quick };
    let usual = DeliverySettings::new(sender, Some((Signer::new(SECRET).unwrap(), Arc::new(callback_body))), None);
    DeliverySettings { schedule, poll: quick, ..usual }
}

fn loopback() -> DeliverySettings {
    settings(&["127.0.0.1"], &Identity::new())
}

/// A job that has failed and whose end is to be told there.
async fn ended(store: &Store, url: String) -> Uuid {
    let mut new = NewJob { callback_url: Some(url), ..new_job() };
    new.study.acquisition.study_instance_uid = Some(STUDY_UID.to_owned());
    let job = store.submit(store.reserve(100).unwrap(), new).await.unwrap().job().id;
    let claim = store.claim("test").await.unwrap().unwrap();
    assert_eq!(claim.id, job);
    assert_eq!(store.deliveries(job).await.unwrap(), [], "nothing is told before the end");
    let error = JobError { code: "no_left_ventricle".into(), message: "None in this study.".into() };
    store.finish(&claim, Outcome::Failed(error), &Snapshot::default()).await.unwrap();
    job
}

/// The one delivery of a job once it is as wanted.
pub(super) async fn delivery(store: &Store, job: Uuid, wanted: impl Fn(&Delivery) -> bool) -> Delivery {
    let deadline = Instant::now() + Duration::from_secs(20);
    loop {
        let [delivery] = store.deliveries(job).await.unwrap().try_into().unwrap();
        if wanted(&delivery) {
            return delivery;
        }
        assert!(Instant::now() < deadline, "it never got there: {delivery:?}");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

async fn until(wanted: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !wanted() {
        assert!(Instant::now() < deadline, "it never came");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

async fn a_callback_comes_once_and_signed_without_what_belongs_to_the_patient(place: &Place) {
    let receiver = Receiver::new(&[Some("204 No Content")]).await;
    let store = place.open().await;
    let job = ended(&store, receiver.url()).await;
    let courier = start(store.clone(), loopback());
    let told = delivery(&store, job, |delivery| delivery.state == "delivered").await;
    assert_eq!((told.attempts, told.last_error), (1, None));
    courier.stop(Duration::from_secs(5)).await;
    assert_eq!(store.claim_delivery(&DeliveryKind::ALL, Duration::from_secs(1)).await.unwrap(), None);
    let [seen] = receiver.seen().try_into().unwrap();
    assert!(seen.head.starts_with("POST /done?token=hidden HTTP/1.1"), "{}", seen.head);
    assert!(seen.head.contains("\r\nVentricle-Signature: t="), "as documented, for receivers that compare letters: {}", seen.head);
    assert_eq!(seen.header("host"), receiver.address.to_string());
    assert_eq!(seen.header("content-type"), "application/json");
    assert_eq!(seen.header("ventricle-delivery"), told.id.to_string());
    assert_eq!(seen.header("user-agent"), concat!("ventricle/", env!("CARGO_PKG_VERSION")));

    let (time, signature) = seen.header("ventricle-signature").strip_prefix("t=").unwrap().split_once(",v1=").unwrap();
    let now_s = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs();
    assert!(now_s.abs_diff(time.parse().unwrap()) < 60, "{time}");
    let mut expected = Hmac::<Sha256>::new_from_slice(SECRET.as_bytes()).unwrap();
    expected.update(format!("{time}.").as_bytes());
    expected.update(&seen.body);
    expected.verify_slice(&hex::decode(signature).unwrap()).unwrap();

    let body: Value = serde_json::from_slice(&seen.body).unwrap();
    let fields: Vec<&str> = body.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(fields.len(), 6, "{body}");
    let stored = store.get(job).await.unwrap().unwrap();
    assert_eq!(body["id"], job.to_string());
    assert_eq!(body["state"], "failed");
    assert_eq!(body["version"], stored.version);
    assert_eq!(body["finished_at"], stored.finished_at.unwrap().to_string());
    assert_eq!(body["error_code"], "no_left_ventricle");
    assert_eq!(body["links"]["report"], format!("/v1/reconstructions/{job}/report"));
    assert!(!body.to_string().contains(STUDY_UID));
}

async fn a_failure_is_tried_again_under_the_same_id_until_it_is_given_up(place: &Place) {
    let store = place.open().await;
    let receiver = Receiver::new(&[Some("500 Internal Server Error"), Some("200 OK")]).await;
    let dead = Receiver::new(&[Some("404 Not Found")]).await;
    let (job, hopeless) = (ended(&store, receiver.url()).await, ended(&store, dead.url()).await);
    let _courier = start(store.clone(), loopback());
    let told = delivery(&store, job, |delivery| delivery.state == "delivered").await;
    assert_eq!(told.attempts, 2);
    let ids: Vec<String> = receiver.seen().iter().map(|seen| seen.header("ventricle-delivery").to_owned()).collect();
    assert_eq!(ids, [told.id.to_string(), told.id.to_string()]);
    assert_eq!(receiver.seen()[0].body, receiver.seen()[1].body);
    let given_up = delivery(&store, hopeless, |delivery| delivery.state == "given_up").await;
    assert_eq!((given_up.attempts, given_up.last_error.as_deref()), (3, Some("status 404")));
    assert_eq!(dead.seen().len(), 3);
    // A receiver that is not there at all.
    let gone = Receiver::new(&[Some("200 OK")]).await.url();
    let nobody = ended(&store, gone).await;
    let given_up = delivery(&store, nobody, |delivery| delivery.state == "given_up").await;
    let why = given_up.last_error.unwrap();
    assert!(why.starts_with("no connection") && !why.contains("hidden"), "{why}");
}

async fn a_redirect_is_not_followed(place: &Place) {
    let store = place.open().await;
    let elsewhere = Receiver::new(&[Some("200 OK")]).await;
    for status in ["301 Moved Permanently", "302 Found", "307 Temporary Redirect"] {
        let receiver = Receiver::new(&[Some(&format!("{status}\r\nLocation: {}", elsewhere.url()))]).await;
        let job = ended(&store, receiver.url()).await;
        let courier = start(store.clone(), loopback());
        let given_up = delivery(&store, job, |delivery| delivery.state == "given_up").await;
        assert_eq!(given_up.last_error, Some(format!("status {}", &status[..3])));
        assert_eq!(receiver.seen().len(), 3);
        courier.stop(Duration::from_secs(5)).await;
    }
    assert_eq!(elsewhere.connections.load(Ordering::SeqCst), 0);
}

async fn what_leads_to_this_machine_is_never_connected_to_unless_allowed(place: &Place) {
    let store = place.open().await;
    let receiver = Receiver::new(&[Some("200 OK")]).await;
    let port = receiver.address.port();
    // As if they had got past the check at submission, or a name had come to lead here since.
    let _courier = start(store.clone(), settings(&["10.0.0.0/8", "127.0.0.1:1", "localhost:1"], &Identity::new()));
    for (url, why) in [
        (format!("https://127.0.0.1:{port}/"), "loopback"),
        (format!("https://[::ffff:127.0.0.1]:{port}/"), "loopback"),
        (format!("https://localhost:{port}/"), "the host leads to"),
        (format!("http://localhost:{port}/"), "is http to `localhost`"),
        ("https://user:pw@127.0.0.1/".to_owned(), "user name"),
    ] {
        let job = ended(&store, url.clone()).await;
        let refused = delivery(&store, job, |delivery| delivery.state == "given_up").await;
        let reason = refused.last_error.unwrap();
        assert!(reason.contains(why), "{url}: {reason}");
    }
    assert_eq!(receiver.connections.load(Ordering::SeqCst), 0);
}

async fn a_certificate_is_checked_and_who_has_a_good_one_gets_the_callback(place: &Place) {
    let store = place.open().await;
    let (known, unknown) = (Identity::new(), Identity::new());
    let receiver = Receiver::with(&[Some("200 OK")], Some(known.tls.clone())).await;
    let impostor = Receiver::with(&[Some("200 OK")], Some(unknown.tls.clone())).await;
    let _courier = start(store.clone(), settings(&["localhost", "127.0.0.1"], &known));
    let url = |receiver: &Receiver, host: &str| format!("https://{host}:{}/done", receiver.address.port());
    let job = ended(&store, url(&receiver, "localhost")).await;
    delivery(&store, job, |delivery| delivery.state == "delivered").await;
    assert_eq!(receiver.seen()[0].header("host"), format!("localhost:{}", receiver.address.port()));
    for (receiver, host) in [(&impostor, "localhost"), (&receiver, "127.0.0.1")] {
        let job = ended(&store, url(receiver, host)).await;
        let refused = delivery(&store, job, |delivery| delivery.state == "given_up").await;
        assert!(refused.last_error.as_deref().unwrap().starts_with("no TLS: "), "{refused:?}");
    }
    assert_eq!((receiver.seen().len(), impostor.seen().len()), (1, 0));
}

async fn what_a_lost_node_held_is_sent_again_when_its_lease_is_over(place: &Place) {
    let store = place.open().await;
    let receiver = Receiver::new(&[None, Some("200 OK")]).await;
    let job = ended(&store, receiver.url()).await;
    let lease = Duration::from_millis(500);
    let lost: Deliveries = start(store.clone(), DeliverySettings { lease, ..loopback() });
    until(|| receiver.seen().len() == 1).await;
    let claimed = Instant::now();
    drop(lost);
    let _courier = start(store.clone(), loopback());
    let told = delivery(&store, job, |delivery| delivery.state == "delivered").await;
    assert!(claimed.elapsed() > lease / 2, "taken while the lease ran: {:?}", claimed.elapsed());
    assert_eq!(told.attempts, 2);
    let ids: Vec<String> = receiver.seen().iter().map(|seen| seen.header("ventricle-delivery").to_owned()).collect();
    assert_eq!(ids, [told.id.to_string(), told.id.to_string()]);
}

async fn a_node_that_stops_gives_back_what_it_has_under_way(place: &Place) {
    let store = place.open().await;
    let receiver = Receiver::new(&[None]).await;
    let job = ended(&store, receiver.url()).await;
    let courier = start(store.clone(), DeliverySettings { lease: Duration::from_hours(1), ..loopback() });
    until(|| receiver.seen().len() == 1).await;
    assert_eq!(store.claim_delivery(&DeliveryKind::ALL, Duration::from_secs(1)).await.unwrap(), None, "it is held");
    courier.stop(Duration::from_millis(20)).await;
    let claim = store.claim_delivery(&DeliveryKind::ALL, Duration::from_secs(1)).await.unwrap().unwrap();
    assert_eq!((claim.job, claim.attempt), (job, 2));
    assert!(!format!("{claim:?}").contains("hidden"));
}

async fn an_attempt_whose_lease_is_over_changes_nothing(place: &Place) {
    let store = place.open().await;
    let job = ended(&store, "https://receiver.example/".to_owned()).await;
    let first = store.claim_delivery(&DeliveryKind::ALL, Duration::from_millis(1)).await.unwrap().unwrap();
    let second = loop {
        if let Some(claim) = store.claim_delivery(&DeliveryKind::ALL, Duration::from_mins(1)).await.unwrap() {
            break claim;
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    };
    assert_eq!((first.id, first.attempt, second.id, second.attempt), (second.id, 1, first.id, 2));
    assert!(!store.settle_delivery(&first, &Settled::Delivered).await.unwrap());
    assert!(!store.settle_delivery(&first, &Settled::GivenBack).await.unwrap());
    assert_eq!(store.deliveries(job).await.unwrap()[0].state, "pending");
    let again = Settled::Again { after: Duration::from_hours(1), why: "status 500".to_owned() };
    assert!(store.settle_delivery(&second, &again).await.unwrap());
    assert_eq!(store.claim_delivery(&DeliveryKind::ALL, Duration::from_secs(1)).await.unwrap(), None, "not due");
    assert!(store.settle_delivery(&second, &Settled::Delivered).await.unwrap());
    assert!(!store.settle_delivery(&second, &Settled::Delivered).await.unwrap(), "once is enough");
    store.delete(job).await.unwrap();
    assert_eq!(store.deliveries(job).await.unwrap(), [], "they go with their job");
}

async fn nodes_that_race_never_claim_the_same_delivery(place: &Place) {
    let store = place.open().await;
    for _ in 0..12 {
        ended(&store, "https://receiver.example/".to_owned()).await;
    }
    let racing = (0..4).map(|_| {
        let store = store.clone();
        tokio::spawn(async move {
            let mut claimed = Vec::new();
            // None may also mean that another holds the one row that was looked at.
            for _ in 0..40 {
                claimed.extend(store.claim_delivery(&DeliveryKind::ALL, Duration::from_mins(1)).await.unwrap().map(|claim| claim.id));
            }
            claimed
        })
    });
    let mut claimed = Vec::new();
    for racer in racing.collect::<Vec<_>>() {
        claimed.extend(racer.await.unwrap());
    }
    let unique: std::collections::BTreeSet<Uuid> = claimed.iter().copied().collect();
    assert_eq!((claimed.len(), unique.len()), (12, 12));
}
