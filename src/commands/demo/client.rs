//! The few calls of the HTTP contract that a client needs.

use anyhow::{Context as _, bail};
use serde::Deserialize;
use std::time::Duration;
use ureq::{Agent, Body, http::Response};

/// Seconds a poll waits for a change (`Prefer: wait`); short, so that Ctrl-C is noticed.
const WAIT_S: u32 = 1;

/// Largest answer accepted, in bytes: a cycle of 64 gates at the finest mesh stays below it.
const MAX_ANSWER: u64 = 256 << 20;

/// A service seen from outside.
pub(super) struct Client {
    base: String,
    agent: Agent,
}

/// A job as the contract tells it.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Job {
    /// Its id.
    pub(super) id: String,
    /// `queued`, `running`, `succeeded`, `failed` or `cancelled`.
    pub(super) state: String,
    /// How far it is.
    pub(super) progress: JobProgress,
    /// Why it failed.
    pub(super) error: Option<Problem>,
}

/// How far a job is.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct JobProgress {
    /// 0-1.
    pub(super) fraction: f64,
    /// What is being computed.
    pub(super) stage: Option<String>,
    /// Gates finished.
    pub(super) gates_done: u64,
    /// Gates of the study.
    pub(super) gates_total: u64,
}

/// What a problem document or a failed job says.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
pub(super) struct Problem {
    title: String,
    detail: String,
    message: String,
    code: String,
}

impl Problem {
    /// What is said, for people.
    pub(super) fn sentence(&self) -> String {
        let said = [&self.detail, &self.message, &self.title].into_iter().find(|text| !text.is_empty());
        said.map_or_else(|| self.code.clone(), |text| format!("{text} ({})", self.code))
    }
}

impl Job {
    /// Whether nothing more will happen to it.
    pub(super) fn is_final(&self) -> bool {
        !matches!(self.state.as_str(), "queued" | "running")
    }
}

impl Client {
    /// A client of the service at this address.
    pub(super) fn new(base: &str) -> Self {
        // No proxy: the service is on this machine or at an address the user gave.
        let config = Agent::config_builder().http_status_as_error(false).proxy(None).timeout_global(Some(Duration::from_mins(2)));
        Self { base: base.trim_end_matches('/').to_owned(), agent: config.build().new_agent() }
    }

    /// The full address of a path.
    pub(super) fn url(&self, path: &str) -> String {
        format!("{}{path}", self.base)
    }

    /// Whether the service takes work.
    pub(super) fn is_ready(&self) -> bool {
        self.agent.get(self.url("/readyz")).call().is_ok_and(|response| response.status().is_success())
    }

    /// Posts a study.
    pub(super) fn submit(&self, media_type: &str, bytes: &[u8]) -> anyhow::Result<Job> {
        // With its input kept: the viewer draws it.
        let url = self.url("/v1/reconstructions?keep_input=true");
        let response = self.agent.post(&url).header("content-type", media_type).send(bytes);
        let body = accepted(response.with_context(|| format!("{url} does not answer"))?)?;
        serde_json::from_slice(&body).context("the answer is not a job")
    }

    /// The job again, after a change or a second.
    pub(super) fn wait(&self, job: &Job) -> anyhow::Result<Job> {
        let request = self.agent.get(self.url(&format!("/v1/reconstructions/{}", job.id))).header("prefer", format!("wait={WAIT_S}"));
        serde_json::from_slice(&accepted(request.call()?)?).context("the answer is not a job")
    }

    /// What is at a path.
    pub(super) fn get(&self, path: &str) -> anyhow::Result<Vec<u8>> {
        accepted(self.agent.get(self.url(path)).call()?)
    }
}

/// The body of an answer, or its problem as an error.
fn accepted(mut response: Response<Body>) -> anyhow::Result<Vec<u8>> {
    let status = response.status();
    let body = response.body_mut().with_config().limit(MAX_ANSWER).read_to_vec().context("the answer broke off")?;
    if status.is_success() {
        return Ok(body);
    }
    let problem: Problem = serde_json::from_slice(&body).unwrap_or_default();
    bail!("{status}: {}", problem.sentence())
}
