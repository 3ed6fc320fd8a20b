//! What the process takes of the machine, from `/proc`: memory, processor time, threads, open files. The names are those that Prometheus' own
//! clients use, so that common dashboards know them.
//!
//! Written as text and not through the recorder, whose counters are whole numbers: processor time is not.

use std::{fmt::Write as _, fs, io};

/// Clock ticks a second in `/proc` (`USER_HZ`), which Linux holds at 100 for programs whatever the kernel's own clock is.
const TICKS_A_SECOND: f64 = 100.0;

/// A number of the process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Name of the metric.
    pub name: &'static str,
    /// `counter` or `gauge`.
    pub kind: &'static str,
    /// The value now.
    pub value: f64,
}

/// File descriptors that are open, and how many may be; `None` where the system has no `/proc`.
///
/// # Errors
/// There is none left to look with.
pub fn descriptors() -> io::Result<Option<(u64, u64)>> {
    // To ask whether it is there takes no descriptor.
    if !fs::exists("/proc/self/fd")? {
        return Ok(None);
    }
    // One of them is this look itself.
    let open = fs::read_dir("/proc/self/fd")?.count().saturating_sub(1) as u64;
    let most = most_files(&fs::read_to_string("/proc/self/limits")?);
    Ok(Some((open, most.map_or(u64::MAX, |most| most as u64))))
}

/// User and system time that the process has used, in s; none where the system has no `/proc`.
pub fn processor_seconds() -> Option<f64> {
    processor_s(&fs::read_to_string("/proc/self/stat").ok()?)
}

/// What can be read now; nothing where the system has no `/proc`.
pub fn readings() -> Vec<Reading> {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
    let (status, stat, limits, system) =
        (read("/proc/self/status"), read("/proc/self/stat"), read("/proc/self/limits"), read("/proc/stat"));
    let open = descriptors().ok().flatten().map(|(open, _)| open as f64);
    [
        ("process_cpu_seconds_total", "counter", processor_s(&stat)),
        ("process_resident_memory_bytes", "gauge", field(&status, "VmRSS:").map(|kib| kib * 1024.0)),
        ("process_threads", "gauge", field(&status, "Threads:")),
        ("process_open_fds", "gauge", open),
        ("process_max_fds", "gauge", most_files(&limits)),
        ("process_start_time_seconds", "gauge", start_s(&stat, &system)),
    ]
    .into_iter()
    .filter_map(|(name, kind, value)| Some(Reading { name, kind, value: value? }))
    .collect()
}

/// The readings in Prometheus' text format.
pub fn text() -> String {
    readings().iter().fold(String::new(), |mut text, Reading { name, kind, value }| {
        // Writing to a string cannot fail.
        let _ = write!(text, "# TYPE {name} {kind}\n{name} {value}\n\n");
        text
    })
}

/// The number after a name at the beginning of a line.
fn field(text: &str, name: &str) -> Option<f64> {
    text.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()?.parse().ok()
}

/// The field of `/proc/self/stat` of this number in proc(5), from 3: the second, the program's name in parentheses, may hold anything.
fn stat_field(stat: &str, number: usize) -> Option<f64> {
    stat.rsplit_once(')')?.1.split_whitespace().nth(number.checked_sub(3)?)?.parse().ok()
}

/// User and system time in s.
fn processor_s(stat: &str) -> Option<f64> {
    Some((stat_field(stat, 14)? + stat_field(stat, 15)?) / TICKS_A_SECOND)
}

/// When the process began, in s since 1970: so long after the system's own start.
fn start_s(stat: &str, system: &str) -> Option<f64> {
    Some(field(system, "btime ")? + stat_field(stat, 22)? / TICKS_A_SECOND)
}

/// The soft limit on open files; none where it is unlimited.
fn most_files(limits: &str) -> Option<f64> {
    field(limits, "Max open files")
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAT: &str = "42 (a) b (c)) S 1 42 42 0 -1 4194560 900 0 0 0 150 50 0 0 20 0 9 0 12345 1000000 250 18446744073709551615 1 1";

    #[test]
    fn fields_are_counted_after_the_name_whatever_is_in_it() {
        assert_eq!(processor_s(STAT), Some(2.0));
        assert_eq!(start_s(STAT, "cpu 1 2 3\nbtime 1700000000\nprocesses 7\n"), Some(1_700_000_123.45));
        assert_eq!(processor_s(""), None);
        assert_eq!(field("VmPeak:\t 9 kB\nVmRSS:\t   2048 kB\n", "VmRSS:"), Some(2048.0));
        assert_eq!(most_files("Limit  Soft Limit  Hard Limit  Units\nMax open files            1024      4096      files\n"), Some(1024.0));
        assert_eq!(most_files("Max open files            unlimited  unlimited  files\n"), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_is_read_plausibly() {
        let readings = readings();
        let value = |name: &str| readings.iter().find(|reading| reading.name == name).unwrap_or_else(|| panic!("no {name}")).value;
        assert!((1e5..1e12).contains(&value("process_resident_memory_bytes")), "{readings:?}");
        assert!(value("process_open_fds") >= 3.0 && value("process_open_fds") < value("process_max_fds"), "{readings:?}");
        assert!(value("process_threads") >= 1.0 && value("process_cpu_seconds_total") >= 0.0, "{readings:?}");
        let now_s = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
        assert!((0.0..86_400.0).contains(&(now_s - value("process_start_time_seconds") + 2.0)), "{readings:?}");
        assert!(text().contains("# TYPE process_cpu_seconds_total counter\nprocess_cpu_seconds_total "), "{}", text());
    }
}
