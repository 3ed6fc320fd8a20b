//! How threads that compute stand back behind those that answer.
//!
//! Who looks at a job waits for a thread of the runtime that needs a processor for some tens of microseconds. Where all processors compute, it is
//! the system's scheduler that lets it through, and it does so sooner and for longer if what computes has asked for less.

/// What reconstructions add to the nice value of their threads: a ninth of the share of a thread that answers. Not the most that there
/// is (19, a seventieth), which would leave them next to nothing beside another busy program, as a database on the same machine.
pub const RECONSTRUCTING: i32 = 10;
/// What parsing adds: a client waits for it, so it goes before reconstructions and after looks at jobs.
pub const PARSING: i32 = 5;

/// Adds to the nice value of the calling thread; threads that it starts inherit it, as do processes. It cannot be taken back without privileges, so
/// the thread must be one that does nothing else. Only Linux has nice values of threads; elsewhere this does nothing.
pub fn lower(by: i32) {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{getpriority_process, setpriority_process};
        // Without a number Linux takes the calling thread, not all of its process.
        if let Err(error) = getpriority_process(None).and_then(|nice| setpriority_process(None, nice + by)) {
            tracing::debug!(%error, "the priority of a thread could not be lowered");
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = by;
}

#[cfg(test)]
#[cfg(target_os = "linux")]
pub(super) mod tests {
    use super::*;

    /// The nice value of the calling thread, as the system tells it (proc(5): field 19 of `stat`, the 17th after the name).
    pub(in crate::jobs) fn nice() -> i32 {
        let stat = std::fs::read_to_string("/proc/thread-self/stat").expect("a thread has a stat");
        let after_name = stat.rsplit_once(')').expect("the name is in parentheses").1;
        after_name.split_whitespace().nth(16).and_then(|field| field.parse().ok()).expect("a nice value")
    }

    #[test]
    fn a_thread_is_lowered_alone_and_with_those_it_starts() {
        let before = nice();
        let (lowered, inherited) = std::thread::spawn(|| {
            lower(3);
            (nice(), std::thread::spawn(nice).join().expect("ends"))
        })
        .join()
        .expect("ends");
        assert_eq!((lowered, inherited), ((before + 3).min(19), (before + 3).min(19)));
        assert_eq!(nice(), before, "who started it stays as it was");
    }
}
