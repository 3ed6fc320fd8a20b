//! What the system says of the service while it runs.

use std::{fs, time::Duration};
use tokio::time::{Instant, MissedTickBehavior, interval};

/// How often is looked.
const LOOKS_A_MINUTE: usize = 60;

/// Looks at the service.
#[derive(Default)]
pub(super) struct Gauges {
    resident_mib: Vec<f64>,
    files: Vec<usize>,
}

/// File descriptors that a process has open.
pub(super) fn files(process: u32) -> usize {
    fs::read_dir(format!("/proc/{process}/fd")).unwrap().count()
}

fn resident_mib(process: u32) -> f64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
}

impl Gauges {
    /// Looks once a second for so long.
    pub(super) async fn watch(mut self, process: u32, time: Duration) -> Self {
        let end = Instant::now() + time;
        let mut looks = interval(Duration::from_mins(1) / LOOKS_A_MINUTE as u32);
        looks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        while Instant::now() < end {
            looks.tick().await;
            self.resident_mib.push(resident_mib(process));
            self.files.push(files(process));
        }
        self
    }

    pub(super) fn most_files(&self) -> usize {
        self.files.iter().copied().max().unwrap()
    }

    /// The median of each minute: what jobs take and give back again is none of the level.
    fn minutes(&self) -> Vec<f64> {
        self.resident_mib.chunks(LOOKS_A_MINUTE).map(median).collect()
    }

    pub(super) fn by_minute_mib(&self) -> Vec<f64> {
        self.minutes().iter().map(|mib| mib.round()).collect()
    }

    /// The medians of the last minutes.
    pub(super) fn last_mib(&self, time: Duration) -> Vec<f64> {
        let whole = self.resident_mib.len() / LOOKS_A_MINUTE * LOOKS_A_MINUTE;
        let minutes: Vec<f64> = self.resident_mib[..whole].chunks(LOOKS_A_MINUTE).map(median).collect();
        minutes[minutes.len().saturating_sub((time.as_secs() / 60) as usize)..].to_vec()
    }

    /// The medians of the second and of the last third.
    pub(super) fn thirds_mib(&self) -> (f64, f64) {
        let third = self.resident_mib.len() / 3;
        (median(&self.resident_mib[third..2 * third]), median(&self.resident_mib[2 * third..]))
    }
}

pub(super) fn median(values: &[f64]) -> f64 {
    quantile(&mut values.to_vec(), 0.5)
}

/// The value that this share is not above.
pub(super) fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).ceil() as usize]
}
