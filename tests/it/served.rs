//! A service in a process of its own, as an operator runs it, and a client as simple as curl.

use serde_json::Value;
use std::{
    ffi::OsString,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

/// The program that is tested: the one that was built with the tests, or the one that `TEST_PROGRAM` names: `make chaos` and `make soak` run the
/// release, which the tests need not be built like.
#[expect(clippy::disallowed_methods, reason = "which program is tested is a matter of the run")]
pub(crate) fn program() -> OsString {
    std::env::var_os("TEST_PROGRAM").unwrap_or_else(|| env!("CARGO_BIN_EXE_ventricle").into())
}

/// A running `ventricle serve` on a free loopback port; killed when dropped.
pub(crate) struct Served {
    child: Child,
    pub(crate) url: String,
    /// Port for DICOM associations; 0 if there is none.
    pub(crate) dimse_port: u16,
    agent: ureq::Agent,
}

/// An answer of the service.
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) media_type: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{}: {}", self.status, String::from_utf8_lossy(&self.body)))
    }
}

/// An empty directory under the system's temporary one, removed when dropped.
pub(crate) struct Directory(pub(crate) PathBuf);

impl Directory {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("ventricle-{name}-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

impl Served {
    /// Starts the service on a data directory and waits until it says where it listens.
    pub(crate) fn start(data: &Path, flags: &[&str]) -> Self {
        Self::start_at(data, "127.0.0.1:0", flags)
    }

    /// The same at an address.
    pub(crate) fn start_at(data: &Path, listen: &str, flags: &[&str]) -> Self {
        let mut command = Command::new(program());
        command.args(["serve", "--listen", listen, "--log", "warn", "--data-dir"]).arg(data);
        Self::start_by(command, flags)
    }

    /// The same with all that it logs, as JSON, in a file.
    pub(crate) fn start_logging(data: &Path, log: &Path, flags: &[&str]) -> Self {
        let mut command = Command::new(program());
        command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn,ventricle=trace", "--log-format", "json", "--data-dir"]).arg(data);
        command.stderr(std::fs::File::create(log).unwrap());
        Self::start_by(command, flags)
    }

    /// By a command that ends in flags of the service.
    pub(crate) fn start_by(mut command: Command, flags: &[&str]) -> Self {
        let mut child = command.args(flags).stdout(Stdio::piped()).spawn().unwrap();
        let (mut line, mut stdout) = (String::new(), BufReader::new(child.stdout.take().unwrap()));
        stdout.read_line(&mut line).unwrap();
        let mut dimse = String::new();
        if flags.contains(&"--dimse-listen") {
            stdout.read_line(&mut dimse).unwrap();
        }
        let url = line.trim().rsplit(' ').next().unwrap_or_default().to_owned();
        assert!(url.starts_with("http://127.0.0.1:"), "the service said {line:?}");
        let config = ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(Duration::from_mins(1)));
        let dimse_port = dimse.trim().rsplit(':').next().and_then(|port| port.parse().ok()).unwrap_or(0);
        assert_eq!(dimse_port == 0, dimse.is_empty(), "the service said {dimse:?}");
        Self { child, url, dimse_port, agent: config.build().new_agent() }
    }

    /// Sends the process a signal by name.
    pub(crate) fn signal(&self, name: &str) {
        let status = Command::new("kill").args([format!("-{name}"), self.child.id().to_string()]).status().unwrap();
        assert!(status.success(), "kill -{name}: {status}");
    }

    /// `kill -9`.
    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// The status with which the process ends by itself.
    pub(crate) fn ended(mut self, within: Duration) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(start.elapsed() < within, "it runs on after {within:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn is_alive(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// The most memory the process has held so far, in MiB.
    pub(crate) fn peak_mib(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmHWM:")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        answer(self.agent.get(format!("{}{path}", self.url)).call().unwrap())
    }

    /// The value of a metric with these labels, as `name{label="value"}`; 0 before it has one.
    pub(crate) fn metric(&self, series: &str) -> f64 {
        let text = String::from_utf8(self.get("/metrics").body).unwrap();
        let value = text.lines().find_map(|line| line.strip_prefix(series)?.strip_prefix(' '));
        value.map_or(0.0, |value| value.parse().unwrap())
    }

    /// Nothing where the process ended meanwhile.
    pub(crate) fn try_get(&self, path: &str) -> Option<Answer> {
        self.agent.get(format!("{}{path}", self.url)).call().ok().and_then(try_answer)
    }

    pub(crate) fn post(&self, media_type: &str, body: &[u8]) -> Answer {
        self.post_with("", media_type, body)
    }

    /// To another path.
    pub(crate) fn post_to(&self, path: &str, media_type: &str, body: &[u8]) -> Answer {
        answer(self.agent.post(format!("{}{path}", self.url)).header("content-type", media_type).send(body).unwrap())
    }

    /// To another path, with an `Accept`.
    pub(crate) fn post_accepting(&self, path: &str, media_type: &str, body: &[u8], accept: &str) -> Answer {
        let request = self.agent.post(format!("{}{path}", self.url)).header("content-type", media_type);
        answer(request.header("accept", accept).send(body).unwrap())
    }

    pub(crate) fn delete(&self, path: &str) -> Answer {
        answer(self.agent.delete(format!("{}{path}", self.url)).call().unwrap())
    }

    /// With an idempotency key.
    pub(crate) fn post_keyed(&self, key: &str, media_type: &str, body: &[u8]) -> Answer {
        let request = self.agent.post(format!("{}/v1/reconstructions", self.url)).header("content-type", media_type);
        answer(request.header("idempotency-key", key).send(body).unwrap())
    }

    /// With parameters in the query.
    pub(crate) fn post_with(&self, query: &str, media_type: &str, body: &[u8]) -> Answer {
        let request = self.agent.post(format!("{}/v1/reconstructions?{query}", self.url)).header("content-type", media_type);
        answer(request.send(body).unwrap())
    }

    /// The job once it has reached a final state.
    pub(crate) fn finished(&self, id: &str, within: Duration) -> Value {
        let start = Instant::now();
        loop {
            let answer = self.agent.get(format!("{}/v1/reconstructions/{id}", self.url)).header("prefer", "wait=10");
            let job = self::answer(answer.call().unwrap()).json();
            if ["succeeded", "failed", "cancelled"].contains(&job["state"].as_str().unwrap()) {
                return job;
            }
            assert!(start.elapsed() < within, "after {within:?}: {job}");
        }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What an audit log says, once it has so many lines.
pub(crate) fn audited(log: &Path, lines: usize) -> Vec<Value> {
    let start = Instant::now();
    loop {
        let text = std::fs::read_to_string(log).unwrap();
        let told: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        if told.len() >= lines {
            return told;
        }
        assert!(start.elapsed() < Duration::from_secs(10), "{text}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

pub(crate) fn answer(response: ureq::http::Response<ureq::Body>) -> Answer {
    try_answer(response).unwrap()
}

fn try_answer(mut response: ureq::http::Response<ureq::Body>) -> Option<Answer> {
    let media_type = response.headers().get("content-type").map(|value| value.to_str().unwrap().to_owned()).unwrap_or_default();
    let body = response.body_mut().with_config().limit(64 << 20).read_to_vec().ok()?;
    Some(Answer { status: response.status().as_u16(), media_type, body })
}
