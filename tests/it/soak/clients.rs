//! Who comes: those who submit, wait, read and delete, those who look again and again, those who listen, and those who send what is no
//! study, stop in the middle of it, or have no key.

use crate::connection::{Answer, Connection};
use axum::body::Bytes;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::{
    collections::{BTreeMap, VecDeque},
    net::SocketAddr,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};
use tokio::{
    io::AsyncWriteExt,
    net::TcpStream,
    task::JoinSet,
    time::{Instant, sleep, sleep_until, timeout},
};
use ventricle::{
    phantom::{self, Imaging, Phantom, Shape, Ventricle},
    volume::Grid,
};

/// Who submit, and who wait for what they submitted: enough of both for the queue to be full now and then.
const SUBMITTERS: usize = 6;
const READERS: usize = 6;
/// Looks at jobs a second, whatever comes of them, over so many connections.
const LOOKS_A_SECOND: usize = 100;
const LOOKERS: usize = 8;
const LISTENERS: usize = 16;
/// Who send what is to be refused, and who stop in the middle.
const SPOILERS: usize = 2;
const ABORTERS: usize = 3;
/// Longest that a client obeys `Retry-After` for: the machine is to have work.
const LONGEST_PAUSE_S: u64 = 3;
/// What a reader may ask of a job that succeeded.
const RESULTS: [&str; 10] = [
    "report",
    "report.html",
    "surfaces.glb",
    "gates/1/endocardial.glb",
    "gates/1/wall.vtu",
    "gates/1/epicardial.stl",
    "polar-maps",
    "polar-maps/perfusion.png",
    "sr.dcm",
    "fhir",
];

/// Where the service is, and a key to it.
#[derive(Clone)]
pub(super) struct Target {
    pub(super) address: SocketAddr,
    pub(super) key: String,
}

impl Target {
    async fn connect(&self) -> Connection {
        Connection::open(self.address, Some(&self.key)).await
    }

    /// The value of a metric.
    pub(super) async fn metric(&self, name: &str) -> f64 {
        let text = self.connect().await.get("/metrics").await.unwrap().body;
        let text = String::from_utf8(text.to_vec()).unwrap();
        text.lines().find_map(|line| line.strip_prefix(name)?.trim().parse().ok()).unwrap_or_else(|| panic!("no {name}"))
    }
}

/// What is submitted.
pub(super) struct Studies {
    /// Four gates on a coarse grid.
    small: Bytes,
    /// Eight gates as a camera has them.
    whole: Bytes,
    /// What is refused: its media type and body.
    refused: Vec<(&'static str, Bytes)>,
}

impl Studies {
    pub(super) fn simulate() -> Self {
        let write = |imaging| {
            let phantom = Phantom { imaging, ..Phantom::of(Shape::Ventricle(Ventricle::NORMAL)) };
            Bytes::from(phantom::dicom::write(&phantom::simulate(&phantom).unwrap().study).unwrap())
        };
        let small = write(Imaging { gates: 4, grid: Grid { shape: [24, 32, 32], spacing_mm: [6.4; 3] }, ..Imaging::default() });
        let whole = write(Imaging::default());
        let (cut, mut broken) = (whole.slice(..whole.len() / 2), whole.to_vec());
        broken[200..400].fill(0xff);
        let refused = vec![
            ("application/dicom", cut),
            ("application/dicom", broken.into()),
            ("application/dicom", Bytes::from(vec![7; 300_000])),
            ("application/dicom", Bytes::new()),
            ("application/json", Bytes::from_static(b"{\"shape\": [1, 2")),
            ("application/json", Bytes::from_static(b"{\"gates\": []}")),
            ("text/plain", Bytes::from_static(b"a heart")),
            ("application/octet-stream", small.slice(64..)),
            ("multipart/form-data; boundary=b", Bytes::from_static(b"--b\r\nContent-Disposition: form-data; name=\"file\"\r\n\r\nx\r\n")),
        ];
        Self { small, whole, refused }
    }
}

/// A job on its way from who submitted it to who reads it.
struct Job {
    id: String,
    cancelled: bool,
}

/// What clients saw, and what they tell each other.
#[derive(Default)]
pub(super) struct Seen {
    pub(super) over: AtomicBool,
    pub(super) latencies_ms: Mutex<Vec<f64>>,
    /// Answers that are none of those that were to come.
    pub(super) unintended: Mutex<Vec<String>>,
    /// How often what came of what.
    outcomes: Mutex<BTreeMap<(&'static str, String), usize>>,
    /// Jobs that nobody has read yet.
    unread: Mutex<VecDeque<Job>>,
    /// Ids of jobs that are there.
    present: Mutex<Vec<String>>,
    submitters: AtomicUsize,
    accepted: AtomicUsize,
    ended: AtomicUsize,
    looks: AtomicUsize,
    busy: AtomicUsize,
}

impl Seen {
    fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    fn count(&self, what: &'static str, outcome: impl Into<String>) {
        *self.outcomes.lock().unwrap().entry((what, outcome.into())).or_default() += 1;
    }

    fn unintended(&self, what: &'static str, outcome: impl std::fmt::Display) {
        self.count(what, "not intended");
        self.unintended.lock().unwrap().push(format!("{what}: {outcome}"));
    }

    /// A job that is there, if any is.
    fn any(&self, random: &mut ChaCha8Rng) -> Option<String> {
        let present = self.present.lock().unwrap();
        (!present.is_empty()).then(|| present[random.next_u64() as usize % present.len()].clone())
    }

    /// Share of looks at which all workers were busy.
    pub(super) fn busy(&self) -> f64 {
        self.busy.load(Ordering::Relaxed) as f64 / self.looks.load(Ordering::Relaxed).max(1) as f64
    }

    pub(super) fn told(&self) -> String {
        let outcomes = self.outcomes.lock().unwrap();
        let lines: Vec<String> = outcomes.iter().map(|((what, outcome), count)| format!("  {what}: {outcome} {count}")).collect();
        lines.join("\n")
    }

    pub(super) fn assert_every_job_ended(&self) {
        let (accepted, ended) = (self.accepted.load(Ordering::Relaxed), self.ended.load(Ordering::Relaxed));
        assert!(accepted > 0 && accepted == ended, "{accepted} jobs were accepted, {ended} seen to their end");
    }
}

/// What every kind of client has.
struct Client {
    target: Target,
    studies: Arc<Studies>,
    seen: Arc<Seen>,
    random: ChaCha8Rng,
    number: usize,
}

impl Client {
    fn one_in(&mut self, so_many: u64) -> bool {
        self.random.next_u64().is_multiple_of(so_many)
    }

    async fn pause(&mut self, most_ms: u64) {
        sleep(Duration::from_millis(self.random.next_u64() % most_ms)).await;
    }
}

/// Has one job of each kind done, so that what every job needs is there.
pub(super) async fn warm_up(target: &Target, studies: &Studies) {
    let mut connection = target.connect().await;
    for (preset, body) in [("clinical", &studies.whole), ("paper", &studies.small)] {
        let path = format!("/v1/reconstructions?preset={preset}");
        let answer = connection.ask("POST", &path, &[("content-type", "application/dicom")], body.clone()).await.unwrap();
        assert_eq!(answer.status, 202);
        let path = format!("/v1/reconstructions/{}", answer.json()["id"].as_str().unwrap());
        while connection.ask("GET", &path, &[("prefer", "wait=10")], Bytes::new()).await.unwrap().json()["state"] != "succeeded" {}
    }
}

/// Lets all clients in.
pub(super) fn start(running: &mut JoinSet<()>, target: &Target, studies: &Arc<Studies>, seen: &Arc<Seen>) {
    let mut seed = 0;
    let mut client = |number: usize| {
        seed += 1;
        let random = ChaCha8Rng::seed_from_u64(seed);
        Client { target: target.clone(), studies: Arc::clone(studies), seen: Arc::clone(seen), random, number }
    };
    seen.submitters.store(SUBMITTERS, Ordering::Relaxed);
    (0..SUBMITTERS).for_each(|number| drop(running.spawn(submit(client(number)))));
    (0..READERS).for_each(|number| drop(running.spawn(read(client(number)))));
    (0..LOOKERS).for_each(|number| drop(running.spawn(look(client(number)))));
    (0..LISTENERS).for_each(|number| drop(running.spawn(listen(client(number)))));
    (0..SPOILERS).for_each(|number| drop(running.spawn(spoil(client(number)))));
    (0..ABORTERS).for_each(|number| drop(running.spawn(abort(client(number)))));
    running.spawn(guess(client(0)));
    running.spawn(operate(client(0)));
}

/// Submits studies, waits when told to, and takes one in sixteen back.
async fn submit(mut client: Client) {
    let mut connection = client.target.connect().await;
    let mut number = 0;
    while !client.seen.is_over() {
        number += 1;
        let body = if client.one_in(3) { client.studies.whole.clone() } else { client.studies.small.clone() };
        let preset = if client.one_in(4) { "paper" } else { "clinical" };
        let path = format!("/v1/reconstructions?preset={preset}&retention_seconds=60");
        let key = format!("{}-{number}", client.number);
        let headers = [("content-type", "application/dicom"), ("idempotency-key", key.as_str())];
        match connection.ask("POST", &path, &headers, body.clone()).await {
            Ok(answer) if answer.status == 202 => {
                client.seen.count("submit", "202");
                client.seen.accepted.fetch_add(1, Ordering::Relaxed);
                let id = answer.json()["id"].as_str().unwrap().to_owned();
                client.seen.present.lock().unwrap().push(id.clone());
                let cancelled = client.one_in(16);
                if client.one_in(8) {
                    match connection.ask("POST", &path, &headers, body).await {
                        Ok(again) if again.status == 200 && again.json()["id"] == id.as_str() => client.seen.count("submit again", "200"),
                        // Its room is asked for before it is known.
                        Ok(again) if again.status == 503 && again.code() == "queue_full" => {
                            client.seen.count("submit again", "503 queue_full");
                        }
                        other => client.seen.unintended("submit again", told(other)),
                    }
                }
                if cancelled {
                    match connection.ask("DELETE", &format!("/v1/reconstructions/{id}"), &[], Bytes::new()).await {
                        Ok(answer) if (200..300).contains(&answer.status) => client.seen.count("cancel", answer.status.to_string()),
                        other => client.seen.unintended("cancel", told(other)),
                    }
                }
                client.seen.unread.lock().unwrap().push_back(Job { id, cancelled });
            }
            Ok(answer) if answer.status == 503 && answer.code() == "queue_full" => {
                client.seen.count("submit", "503 queue_full");
                sleep(Duration::from_secs(answer.retry_after_s.unwrap().min(LONGEST_PAUSE_S))).await;
            }
            other => client.seen.unintended("submit", told(other)),
        }
    }
    client.seen.submitters.fetch_sub(1, Ordering::Relaxed);
}

/// Waits for jobs, reads some of their results, and deletes most.
async fn read(mut client: Client) {
    let mut connection = client.target.connect().await;
    loop {
        let Some(job) = client.seen.unread.lock().unwrap().pop_front() else {
            if client.seen.submitters.load(Ordering::Relaxed) == 0 {
                return;
            }
            sleep(Duration::from_millis(50)).await;
            continue;
        };
        let path = format!("/v1/reconstructions/{}", job.id);
        // Whether it succeeded, or was taken back as asked; or what came instead.
        let ended = loop {
            match connection.ask("GET", &path, &[("prefer", "wait=10")], Bytes::new()).await {
                Ok(answer) if answer.status == 200 => match answer.json()["state"].as_str() {
                    Some("queued" | "running") => {}
                    Some("succeeded") => break Ok(true),
                    Some("cancelled") if job.cancelled => break Ok(false),
                    _ => break Err(told(Ok(answer))),
                },
                // What is taken back before it began is gone at once.
                Ok(answer) if answer.status == 404 && job.cancelled => break Ok(false),
                other => break Err(told(other)),
            }
        };
        client.seen.ended.fetch_add(1, Ordering::Relaxed);
        let succeeded = match ended {
            Ok(succeeded) => succeeded,
            Err(told) => {
                client.seen.unintended("job", told);
                continue;
            }
        };
        client.seen.count("job", if succeeded { "succeeded" } else { "cancelled" });
        for _ in 0..if succeeded { 3 } else { 0 } {
            let result = RESULTS[client.random.next_u64() as usize % RESULTS.len()];
            match connection.get(&format!("{path}/{result}")).await {
                Ok(answer) if answer.status == 200 && !answer.body.is_empty() => client.seen.count("result", result),
                other => client.seen.unintended("result", format!("{result}: {}", told(other))),
            }
        }
        client.seen.present.lock().unwrap().retain(|id| *id != job.id);
        // Who looks at it just now is answered first.
        sleep(Duration::from_secs(1)).await;
        // What is left is for the service to delete, a minute after its end.
        if succeeded && !client.one_in(8) {
            match connection.ask("DELETE", &path, &[], Bytes::new()).await {
                Ok(answer) if answer.status == 204 => client.seen.count("delete", "204"),
                other => client.seen.unintended("delete", told(other)),
            }
        }
    }
}

/// Looks at jobs at a fixed rate. A look that waits for a stall counts all of it from when it was due, as do those due meanwhile.
async fn look(mut client: Client) {
    let mut connection = client.target.connect().await;
    let pause = Duration::from_secs_f64(LOOKERS as f64 / LOOKS_A_SECOND as f64);
    let mut due = Instant::now() + pause.mul_f64(client.number as f64 / LOOKERS as f64);
    while !client.seen.is_over() {
        due += pause;
        sleep_until(due).await;
        let Some(id) = client.seen.any(&mut client.random) else { continue };
        match connection.get(&format!("/v1/reconstructions/{id}")).await {
            Ok(answer) if answer.status == 200 => {
                client.seen.latencies_ms.lock().unwrap().push(due.elapsed().as_secs_f64() * 1e3);
            }
            // Taken back meanwhile.
            Ok(answer) if answer.status == 404 => client.seen.count("look", "404"),
            other => client.seen.unintended("look", told(other)),
        }
    }
}

/// Listens to one job or to all, and goes away at the end or in the middle.
async fn listen(mut client: Client) {
    while !client.seen.is_over() {
        let all = client.number.is_multiple_of(2);
        let path = match client.seen.any(&mut client.random) {
            _ if all => "/v1/reconstructions/events".to_owned(),
            Some(id) => format!("/v1/reconstructions/{id}/events"),
            None => {
                sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let mut events = match client.target.connect().await.listen(&path).await {
            Ok((200, events)) => events,
            Ok((404, _)) if !all => continue,
            Ok((status, _)) => {
                client.seen.unintended("listen", status);
                continue;
            }
            Err(error) => {
                client.seen.unintended("listen", error);
                continue;
            }
        };
        let end = Instant::now() + Duration::from_millis(500 + client.random.next_u64() % 10_000);
        let outcome = loop {
            match timeout(end.saturating_duration_since(Instant::now()), events.next()).await {
                Ok(Some(Ok(_))) => {}
                Ok(Some(Err(error))) => {
                    client.seen.unintended("listen", error);
                    break "cut off";
                }
                Ok(None) => break "to the end",
                Err(_) => break "went away",
            }
        };
        client.seen.count("listen", outcome);
    }
}

/// Sends what is to be refused.
async fn spoil(mut client: Client) {
    let mut connection = client.target.connect().await;
    while !client.seen.is_over() {
        client.pause(200).await;
        let (media_type, body) = client.studies.refused[client.random.next_u64() as usize % client.studies.refused.len()].clone();
        match connection.ask("POST", "/v1/reconstructions", &[("content-type", media_type)], body).await {
            Ok(answer) if (400..500).contains(&answer.status) && !answer.code().is_empty() => {
                client.seen.count("bad file", format!("{} {}", answer.status, answer.code()));
            }
            // There is no room to look at it.
            Ok(answer) if answer.status == 503 && answer.code() == "queue_full" => client.seen.count("bad file", "503 queue_full"),
            other => client.seen.unintended("bad file", told(other)),
        }
    }
}

/// Begins to send a study, fast or slowly, and goes away.
async fn abort(mut client: Client) {
    while !client.seen.is_over() {
        let body = client.studies.whole.clone();
        let (sent, key) = (client.random.next_u64() as usize % body.len(), &client.target.key);
        let head = format!(
            "POST /v1/reconstructions HTTP/1.1\r\nHost: soak\r\nAuthorization: Bearer {key}\r\nContent-Type: application/dicom\r\nContent-Length: {}\r\n\r\n",
            body.len()
        );
        let mut stream = TcpStream::connect(client.target.address).await.unwrap();
        // The service may answer before all is there, and close.
        let _ = stream.write_all(head.as_bytes()).await;
        for part in body[..sent].chunks(sent / 4 + 1) {
            let _ = stream.write_all(part).await;
            client.pause(100).await;
        }
        client.seen.count("upload", "aborted");
    }
}

/// Tries keys that are none.
async fn guess(mut client: Client) {
    while !client.seen.is_over() {
        client.pause(2000).await;
        let key = format!("ventricle_000000000000_{:032x}", client.random.next_u64());
        match Connection::open(client.target.address, Some(&key)).await.get("/v1/reconstructions").await {
            Ok(answer) if [401, 429].contains(&answer.status) => client.seen.count("wrong key", answer.status.to_string()),
            other => client.seen.unintended("wrong key", told(other)),
        }
    }
}

/// Looks at readiness, numbers and whether all workers are busy, as those do who keep the service.
async fn operate(mut client: Client) {
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let mut connection = client.target.connect().await;
    while !client.seen.is_over() {
        client.pause(500).await;
        match connection.get("/readyz").await {
            Ok(answer) if answer.status == 200 => client.seen.count("ready", "200"),
            Ok(answer) if answer.status == 503 => {
                let document = answer.json();
                let failing: Vec<&String> = document["checks"]
                    .as_object()
                    .unwrap()
                    .iter()
                    .filter(|(_, check)| check["ok"] == false)
                    .map(|(name, _)| name)
                    .collect();
                if failing == ["queue"] {
                    client.seen.count("ready", "503 queue");
                } else {
                    client.seen.unintended("ready", document);
                }
            }
            other => client.seen.unintended("ready", told(other)),
        }
        match connection.get("/metrics").await {
            Ok(answer) if answer.status == 200 => {}
            other => client.seen.unintended("metrics", told(other)),
        }
        match connection.get("/v1/reconstructions?state=running&limit=50").await {
            Ok(answer) if answer.status == 200 => {
                client.seen.looks.fetch_add(1, Ordering::Relaxed);
                let running = answer.json()["reconstructions"].as_array().unwrap().len();
                client.seen.busy.fetch_add(usize::from(running >= workers), Ordering::Relaxed);
            }
            other => client.seen.unintended("list", told(other)),
        }
    }
}

fn told(answer: hyper::Result<Answer>) -> String {
    match answer {
        Ok(answer) => format!("{} {}", answer.status, String::from_utf8_lossy(&answer.body[..answer.body.len().min(300)])),
        Err(error) => format!("no answer: {error:?}"),
    }
}
