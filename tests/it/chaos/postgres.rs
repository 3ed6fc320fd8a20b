//! Three nodes on one PostgreSQL: nodes killed, paused beyond their lease and replaced, listeners cut off, the database crashed.

use super::{Address, COUNTS, PLACES, Plan, Seen, alone, assert_reports_agree, executions, post_all};
use crate::{
    cluster::{Cluster, listeners},
    place::Place,
    served::{Directory, Served},
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sqlx::{Connection, PgConnection};
use std::{
    collections::{BTreeMap, BTreeSet},
    io::{BufRead, BufReader, Read, Write},
    net::TcpListener,
    sync::{Arc, Mutex, atomic::Ordering},
    thread,
    time::{Duration, Instant},
};
use tokio::runtime::Runtime;

const NODES: [&str; 3] = ["a", "b", "c"];
/// Long enough for a busy machine to keep it, short enough for a test to wait for its end.
const LEASE: &str = "4";
/// What is waited for comes sooner than this, on a machine that does other things too.
const SOON: Duration = Duration::from_mins(1);

#[test]
fn three_nodes_on_postgres_lose_nothing_to_kills_pauses_and_crashes() {
    let _alone = alone();
    let Some(cluster) = Cluster::start("the chaos of several nodes") else { return };
    let plan = Plan::of(40, 1);
    let runtime = Runtime::new().unwrap();
    let place = runtime.block_on(Place::postgres_at(&cluster.url));
    let told = Told::start();
    let mut nodes = Nodes::start(place.url(), &told.url);
    let addresses = NODES.map(|node| Address::of(&nodes.running[node]));
    let seen = Seen::default();
    let mut random = ChaCha8Rng::seed_from_u64(21);
    let began = Instant::now();
    let mut done = Done::default();
    post_all(plan.jobs, &addresses, &seen, || {
        for _ in 0..plan.kills {
            // Five things a round.
            let mut pause = || Plan { jobs: plan.jobs, kills: 5 * plan.kills }.pause(&mut random);
            pause();
            // Back under its name, while its lease may still last.
            nodes.kill("a");
            done.kills += 1;
            pause();
            nodes.start_again("a");
            addresses[0].set(&nodes.running["a"]);
            pause();
            pause_beyond_lease(&runtime, &place, &nodes.running["b"]);
            done.pauses += 1;
            pause();
            let cut_off = runtime.block_on(cut_off_listeners(&place));
            assert!(cut_off > 0, "nobody listened");
            pause();
            cluster.crash();
            done.crashes += 1;
            pause();
            nodes.replace("c");
            addresses[2].set(&nodes.running["c"]);
        }
    });
    let accepted = seen.accepted();
    let executions = executions(&nodes.running["a"], &accepted);
    assert_reports_agree(&nodes.running["c"], &accepted);
    seen.say("PostgreSQL, 3 nodes", &format!("{done:?}"), executions, began);
    assert!(accepted.len() >= plan.jobs && seen.full.load(Ordering::Relaxed) > 0);
    // A node has one worker; a crash of the database that outlasts the leases costs each node its job.
    let lost = done.kills + done.pauses + done.crashes * NODES.len();
    assert!(executions <= accepted.len() + lost, "{executions} executions of {} jobs", accepted.len());
    assert!(executions >= accepted.len() + done.pauses, "what a paused node held was done again");
    told.each_once(&accepted);
    runtime.block_on(assert_whole(&place, accepted.len()));
}

/// What was done.
#[derive(Debug, Default)]
struct Done {
    kills: usize,
    pauses: usize,
    crashes: usize,
}

struct Nodes {
    data: Directory,
    flags: Vec<String>,
    running: BTreeMap<&'static str, Served>,
}

impl Nodes {
    fn start(database: &str, callback: &str) -> Self {
        let data = Directory::new("chaos-nodes");
        let authorities = data.0.join("roots.pem");
        std::fs::write(&authorities, rcgen::generate_simple_self_signed(["unused".to_owned()]).unwrap().cert.pem()).unwrap();
        let flags = [
            ["--database-url", database],
            ["--lease-seconds", LEASE],
            ["--workers", "1"],
            ["--threads-per-worker", "1"],
            ["--callback-url", callback],
            ["--callback-secret", "0123456789abcdef"],
            ["--callback-allow", "127.0.0.1"],
            ["--callback-ca-file", authorities.to_str().unwrap()],
            PLACES,
        ];
        let flags = flags.concat().into_iter().map(str::to_owned).collect();
        let mut nodes = Self { data, flags, running: BTreeMap::new() };
        for node in NODES {
            nodes.start_again(node);
        }
        nodes
    }

    fn start_again(&mut self, node: &'static str) {
        let flags: Vec<&str> = self.flags.iter().map(String::as_str).chain(["--node", node]).collect();
        self.running.insert(node, Served::start(&self.data.0, &flags));
    }

    fn kill(&mut self, node: &str) {
        self.running.remove(node).unwrap().kill();
    }

    /// As an upgrade does: what it works on is finished or given back, uncharged.
    fn replace(&mut self, node: &'static str) {
        let mut ending = self.running.remove(node).unwrap();
        ending.signal("TERM");
        let deadline = Instant::now() + SOON;
        while ending.is_alive() {
            assert!(Instant::now() < deadline, "{node} does not end");
            thread::sleep(Duration::from_millis(20));
        }
        self.start_again(node);
    }
}

/// Stops a node while it holds a job, until another has taken the job back, and lets it go on: it notices.
fn pause_beyond_lease(runtime: &Runtime, place: &Place, node: &Served) {
    let deadline = Instant::now() + SOON;
    let lost = || {
        let metrics = String::from_utf8(node.get("/metrics").body).unwrap();
        let line = metrics.lines().find_map(|line| line.strip_prefix("ventricle_leases_lost_total "));
        line.map_or(0, |count| count.parse::<u64>().unwrap())
    };
    let before = lost();
    loop {
        node.signal("STOP");
        // What it had sent before is answered.
        thread::sleep(Duration::from_millis(100));
        if runtime.block_on(held(place)) > 0 {
            break;
        }
        node.signal("CONT");
        assert!(Instant::now() < deadline, "the node never works");
        thread::sleep(Duration::from_millis(50));
    }
    while runtime.block_on(held(place)) > 0 {
        assert!(Instant::now() < deadline, "nobody takes the job back");
        thread::sleep(Duration::from_millis(100));
    }
    node.signal("CONT");
    while lost() == before {
        assert!(Instant::now() < deadline, "the node never noticed");
        thread::sleep(Duration::from_millis(50));
    }
}

/// Jobs that the node to be paused holds.
async fn held(place: &Place) -> i64 {
    let mut connection = place.connect().await;
    let sql = "SELECT COUNT(*) FROM jobs WHERE state = 'running' AND lease_owner LIKE 'b/%'";
    let count = sqlx::query_scalar(sql).fetch_one(&mut connection).await.unwrap();
    connection.close().await.unwrap();
    count
}

/// Ends the connections by which nodes hear of each other; returns how many.
async fn cut_off_listeners(place: &Place) -> usize {
    let mut connection = place.connect().await;
    let found = listeners(&mut connection).await;
    for pid in &found {
        sqlx::query("SELECT pg_terminate_backend($1)").bind(pid).execute(&mut connection).await.unwrap();
    }
    found.len()
}

async fn assert_whole(place: &Place, jobs: usize) {
    let jobs = i64::try_from(jobs).unwrap();
    let mut connection = place.connect().await;
    let count =
        async |connection: &mut PgConnection, sql: &'static str| -> i64 { sqlx::query_scalar(sql).fetch_one(connection).await.unwrap() };
    for (what, sql, every) in COUNTS {
        assert_eq!(count(&mut connection, sql).await, if every { jobs } else { 0 }, "{what}");
    }
    let delivered = "SELECT COUNT(*) FROM deliveries WHERE state = 'delivered'";
    let deadline = Instant::now() + SOON;
    while count(&mut connection, delivered).await < jobs {
        assert!(Instant::now() < deadline, "not all callbacks are delivered");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert_eq!(count(&mut connection, "SELECT COUNT(*) FROM deliveries").await, jobs, "one to deliver a job");
}

/// A receiver of callbacks, and which deliveries it was told of each job.
struct Told {
    url: String,
    deliveries: Arc<Mutex<BTreeMap<String, BTreeSet<String>>>>,
}

impl Told {
    /// Listens as long as the process lives.
    fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/done", listener.local_addr().unwrap());
        let deliveries: Arc<Mutex<BTreeMap<String, BTreeSet<String>>>> = Arc::default();
        let seen = Arc::clone(&deliveries);
        thread::spawn(move || {
            for stream in listener.incoming() {
                // A node that was killed while it told leaves half a request, which nobody is promised an answer to.
                let Some((delivery, job)) = stream.ok().and_then(|stream| receive(&stream)) else { continue };
                seen.lock().unwrap().entry(job).or_default().insert(delivery);
            }
        });
        Self { url, deliveries }
    }

    /// Of every job, and of no other, by one delivery, however often it came.
    fn each_once(&self, jobs: &BTreeSet<String>) {
        let deadline = Instant::now() + SOON;
        while self.deliveries.lock().unwrap().len() < jobs.len() {
            assert!(Instant::now() < deadline, "told of {} jobs of {}", self.deliveries.lock().unwrap().len(), jobs.len());
            thread::sleep(Duration::from_millis(50));
        }
        let deliveries = self.deliveries.lock().unwrap();
        assert!(deliveries.keys().eq(jobs));
        assert!(deliveries.values().all(|ids| ids.len() == 1), "{deliveries:?}");
    }
}

/// Reads one request; returns the ids of the delivery and of the job.
fn receive(mut stream: &std::net::TcpStream) -> Option<(String, String)> {
    stream.set_read_timeout(Some(Duration::from_secs(10))).ok()?;
    let mut reader = BufReader::new(stream);
    let (mut length, mut delivery) = (0, String::new());
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line).ok()? == 0 {
            return None;
        }
        let Some((name, value)) = line.trim().split_once(": ") else {
            if line.trim().is_empty() {
                break;
            }
            continue;
        };
        match name.to_ascii_lowercase().as_str() {
            "content-length" => length = value.parse().ok()?,
            "ventricle-delivery" => value.clone_into(&mut delivery),
            _ => {}
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    let body: serde_json::Value = serde_json::from_slice(&body).ok()?;
    stream.write_all(b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n").ok()?;
    Some((delivery, body["id"].as_str()?.to_owned()))
}
