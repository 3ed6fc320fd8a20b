//! Whether the service lives, whether it can take work, and its numbers.

use super::{AppState, problem::Problem};
use crate::{
    access::Audit,
    jobs::{ClockSet, Probe},
    telemetry,
};
use axum::{
    Json,
    extract::State,
    http::{StatusCode, header},
    response::IntoResponse,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The service answers.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub(super) struct Alive {
    /// Always `alive`.
    #[schema(example = "alive")]
    pub status: &'static str,
    /// Version of the program.
    pub version: &'static str,
}

/// Whether the service can take work.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub(super) struct Ready {
    /// Always `ready`; a service that is not answers 503 with a problem.
    #[schema(example = "ready")]
    pub status: &'static str,
    /// What was looked at.
    pub checks: Checks,
}

/// What readiness rests on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Checks {
    /// The database answers and can be written.
    pub store: Check,
    /// Workers run.
    pub workers: Check,
    /// There is room in the queue.
    pub queue: Check,
    /// There is room on the disk.
    pub disk: Check,
    /// The audit log, where there is one, is written.
    pub audit: Check,
    /// File descriptors are left.
    pub descriptors: Check,
    /// The clock runs as time does. Always well; its sentence says if it was set.
    pub clock: Check,
    /// The service is not stopping.
    pub service: Check,
}

/// One thing readiness rests on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
// Reports have checks too, which the contract calls by that name.
#[schema(as = ReadinessCheck)]
pub struct Check {
    /// Whether it is as it should be.
    pub ok: bool,
    /// In words.
    #[schema(example = "3 of 100 jobs and 12 of 1024 MiB are waiting")]
    pub detail: String,
}

impl Check {
    fn new(ok: bool, detail: impl Into<String>) -> Self {
        Self { ok, detail: detail.into() }
    }
}

impl Checks {
    fn all(&self) -> [(&'static str, &Check); 8] {
        let Self { store, workers, queue, disk, audit, descriptors, clock, service } = self;
        [
            ("store", store),
            ("workers", workers),
            ("queue", queue),
            ("disk", disk),
            ("audit", audit),
            ("descriptors", descriptors),
            ("clock", clock),
            ("service", service),
        ]
    }
}

/// Tells that the service lives.
///
/// Looks at nothing: restart the service only when this fails.
#[utoipa::path(get, path = "/healthz", operation_id = "healthz", tag = "operation", responses((status = 200, description = "It lives", body = Alive)))]
pub(super) async fn healthz() -> Json<Alive> {
    Json(Alive { status: "alive", version: env!("CARGO_PKG_VERSION") })
}

/// Tells whether the service can take work.
#[utoipa::path(
    get, path = "/readyz", operation_id = "readyz", tag = "operation",
    responses(
        (status = 200, description = "It can", body = Ready),
        (status = 503, description = "It cannot; `checks` says why", body = Problem, content_type = "application/problem+json"),
    ),
)]
pub(super) async fn readyz(State(state): State<AppState>) -> Result<Json<Ready>, Problem> {
    let (_, checks) = look(&state).await;
    let failing: Vec<_> =
        checks.all().into_iter().filter(|(_, check)| !check.ok).map(|(name, check)| format!("{name}: {}", check.detail)).collect();
    if failing.is_empty() {
        return Ok(Json(Ready { status: "ready", checks }));
    }
    let problem = Problem::new(StatusCode::SERVICE_UNAVAILABLE, "not_ready", format!("Not ready. {}.", failing.join("; ")));
    Err(Problem { checks: Some(checks), retry_after_s: Some(5), ..problem })
}

/// Looks, and tells the metrics what was seen.
async fn look(state: &AppState) -> (Probe, Checks) {
    let probe = state.store.probe().await;
    let checks = checks(state, probe).await;
    for (name, check) in checks.all() {
        metrics::gauge!("ventricle_ready", "check" => name).set(if check.ok { 1.0 } else { 0.0 });
    }
    (probe, checks)
}

async fn checks(state: &AppState, probe: Probe) -> Checks {
    let store = match probe {
        Probe::Writable => Check::new(true, "the database answers and takes what is written"),
        Probe::NotWritable => Check::new(false, "the database answers, but takes nothing that is written"),
        Probe::Silent => Check::new(false, "the database does not answer"),
    };
    // A database that does not answer would be waited for once more.
    let counted = if probe == Probe::Silent { None } else { state.store.counts().await.ok() };
    let queue = match counted {
        Some(counts) => {
            let (jobs, mib) = (counts.queued + counts.reserved, counts.queued_bytes >> 20);
            let detail =
                format!("{jobs} of {} jobs and {mib} of {} MiB are waiting", counts.max_queued_jobs, counts.max_queued_bytes >> 20);
            Check::new(jobs < counts.max_queued_jobs && counts.queued_bytes < counts.max_queued_bytes, detail)
        }
        None => Check::new(false, "cannot be counted"),
    };
    let workers = (state.workers_alive)();
    let draining = state.draining.is_cancelled();
    let doing = match (workers, draining) {
        (true, _) => "all workers run",
        (false, true) => "take no more jobs",
        (false, false) => "a worker has ended",
    };
    let audit = match state.audit.as_ref().map(Audit::is_writable) {
        None => Check::new(true, "there is none"),
        Some(true) => Check::new(true, "takes what is written"),
        Some(false) => Check::new(false, "cannot be written"),
    };
    Checks {
        store,
        workers: Check::new(workers, doing),
        queue,
        disk: disk(state).await,
        audit,
        descriptors: descriptors().await,
        clock: clock(state.store.clock_set()),
        service: Check::new(!draining, if draining { "is stopping" } else { "accepts work" }),
    }
}

/// What of the service's own needs a descriptor now and then: a decoder, a connection to the database, a file.
const LEAST_DESCRIPTORS: u64 = 16;

async fn descriptors() -> Check {
    match tokio::task::spawn_blocking(telemetry::process::descriptors).await {
        Ok(Ok(Some((open, most)))) => Check::new(open + LEAST_DESCRIPTORS <= most, format!("{open} of {most} file descriptors are open")),
        Ok(Ok(None)) => Check::new(true, "the system does not tell"),
        _ => Check::new(false, "no file descriptor is left"),
    }
}

/// A clock that was set hinders nothing, but who looks for what is odd since then is told.
fn clock(set: Option<ClockSet>) -> Check {
    let Some(ClockSet { by_s, ago, held }) = set else { return Check::new(true, "runs as time does") };
    let direction = if by_s > 0 { "forward" } else { "back" };
    let held = match held.as_secs().div_ceil(60) {
        0 => String::new(),
        minutes => format!("; nothing is deleted for its age for {minutes} min"),
    };
    Check::new(true, format!("was set {} s {direction} {} min ago{held}", by_s.abs(), ago.as_secs() / 60))
}

/// Room on the disk of the data directory.
async fn disk(state: &AppState) -> Check {
    let Some(needed) = state.disk.clone() else { return Check::new(true, "the database is elsewhere") };
    let free = tokio::task::spawn_blocking(move || fs4::available_space(&needed.directory)).await;
    match free {
        Ok(Ok(free)) => {
            metrics::gauge!("ventricle_disk_free_bytes").set(free as f64);
            Check::new(free >= needed.bytes, format!("{} MiB free, {} MiB needed", free >> 20, needed.bytes >> 20))
        }
        _ => Check::new(false, "the data directory cannot be looked at"),
    }
}

/// Numbers for Prometheus.
#[utoipa::path(
    get, path = "/metrics", operation_id = "metrics", tag = "operation",
    responses((status = 200, description = "Prometheus text format", body = String, content_type = "text/plain")),
)]
pub(super) async fn metrics(State(state): State<AppState>) -> impl IntoResponse {
    let (probe, _) = look(&state).await;
    if probe == Probe::Silent {
        tracing::warn!("the numbers of the queue, and of what waits for its rest, are those of the last look");
    } else {
        if let Err(error) = state.store.publish_counts().await {
            tracing::warn!(%error, "the queue's numbers are those of the last look");
        }
        if let Err(error) = state.store.publish_waiting().await {
            tracing::warn!(%error, "the numbers of what waits for its rest are those of the last look");
        }
    }
    state.metrics.run_upkeep();
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], state.metrics.render() + &telemetry::process::text())
}
