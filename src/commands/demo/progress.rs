//! How far a job is: a bar that redraws itself on a terminal, a line every tenth elsewhere.

use super::client::Job;
use std::io::{IsTerminal as _, Write as _};

const WIDTH: usize = 30;

/// Shows one job's progress on standard error.
pub(super) struct Progress {
    redraws: bool,
    last_tenth: Option<usize>,
}

impl Progress {
    /// Looks at what standard error is.
    pub(super) fn new() -> Self {
        Self { redraws: std::io::stderr().is_terminal(), last_tenth: None }
    }

    /// Shows where the job is.
    pub(super) fn show(&mut self, job: &Job) {
        let tenth = (10.0 * job.progress.fraction) as usize;
        let line = line(job);
        if self.redraws {
            let _ = write!(std::io::stderr(), "\r\x1b[2K{line}");
        } else if self.last_tenth != Some(tenth) {
            let _ = writeln!(std::io::stderr(), "{line}");
        }
        self.last_tenth = Some(tenth);
    }

    /// Shows the end.
    pub(super) fn end(&self, job: &Job) {
        let start = if self.redraws { "\r\x1b[2K" } else { "" };
        let _ = writeln!(std::io::stderr(), "{start}{}", line(job));
    }
}

fn line(job: &Job) -> String {
    let done = ((job.progress.fraction * WIDTH as f64).round() as usize).min(WIDTH);
    let bar = format!("[{}{}]", "#".repeat(done), ".".repeat(WIDTH - done));
    let percent = 100.0 * job.progress.fraction;
    let doing = if job.is_final() { job.state.clone() } else { job.progress.stage.as_ref().unwrap_or(&job.state).replace('_', " ") };
    format!("  {bar} {percent:3.0} %  {}/{} gates  {doing}", job.progress.gates_done, job.progress.gates_total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_bar_fills_and_tells_the_stage() {
        let job = |fraction: f64, state: &str| -> Job {
            let progress = json!({"fraction": fraction, "stage": "gradient_vector_flow", "gates_done": 3, "gates_total": 8});
            serde_json::from_value(json!({"id": "x", "state": state, "progress": progress, "error": null})).unwrap()
        };
        assert_eq!(line(&job(0.5, "running")), "  [###############...............]  50 %  3/8 gates  gradient vector flow");
        assert!(line(&job(1.0, "succeeded")).ends_with("succeeded"));
        assert!(!line(&job(1.0, "succeeded")).contains('.'));
    }
}
