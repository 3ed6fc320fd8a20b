//! Memory that a running service keeps for its next study, and gives back when there is none.
//!
//! While there is work, the allocator keeps what is freed (`.cargo/config.toml`): each study takes tens of megabytes and frees them a second later. Given
//! back each time, they made resident memory rise and fall by a third of itself, and the system fill pages with zeros again and again. A service
//! without work gives all of it back.

use std::{thread, time::Duration};
use tikv_jemalloc_ctl::{Access as _, AsName as _, arenas};
use ventricle::telemetry::process;

/// How often is looked, which takes some tens of microseconds.
const LOOK: Duration = Duration::from_secs(5);
/// Looks in a row at which there was no work: half a minute, in which a study that comes after another finds its memory.
const LOOKS: u32 = 6;
/// Share of one processor below which there is no work: the quickest reconstruction takes more of a look's time, polls and scrapes of an idle service far less.
const IDLE: f64 = 0.02;

/// Gives memory back whenever the process has had no work for half a minute, until its end. Does nothing where the system does not tell what processor
/// time is used.
pub(crate) fn give_back_when_idle() {
    let Some(mut before_s) = process::processor_seconds() else { return };
    let watch = move || {
        let mut quiet = Quiet::default();
        loop {
            thread::sleep(LOOK);
            // Not to be read for a moment, as when no descriptor is free: the next look counts the time since the last one that told.
            let Some(now_s) = process::processor_seconds() else { continue };
            if quiet.is_long_enough((now_s - before_s) / LOOK.as_secs_f64())
                && let Err(error) = give_back()
            {
                tracing::warn!(%error, "memory stays with the process");
            }
            before_s = now_s;
        }
    };
    if let Err(error) = thread::Builder::new().name("memory".to_owned()).spawn(watch) {
        tracing::warn!(%error, "memory stays with the process");
    }
}

/// Looks in a row at which there was no work.
#[derive(Default)]
struct Quiet {
    looks: u32,
}

impl Quiet {
    /// Whether there has been no work for just long enough, of the load since the look before as a share of one processor. True once; then there must be work again.
    fn is_long_enough(&mut self, load: f64) -> bool {
        self.looks = if load < IDLE { self.looks.saturating_add(1) } else { 0 };
        self.looks == LOOKS
    }
}

/// Gives back all that is free. A time of zero for which it may be kept does so at once; the time that was is set again.
fn give_back() -> Result<(), tikv_jemalloc_ctl::Error> {
    for arena in 0..arenas::narenas::read()? {
        let key = format!("arena.{arena}.dirty_decay_ms\0");
        // Arenas that no thread has used yet have no such number.
        let kept: Result<isize, _> = key.name().update(0);
        if let Ok(kept) = kept {
            key.name().write(kept)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_given_back_once_after_half_a_minute_without_work() {
        let mut quiet = Quiet::default();
        let told = |quiet: &mut Quiet, loads: &[f64]| loads.iter().map(|&load| quiet.is_long_enough(load)).collect::<Vec<_>>();
        assert_eq!(told(&mut quiet, &[0.0; 8]), [false, false, false, false, false, true, false, false]);
        assert_eq!(told(&mut quiet, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0]), [false; 7], "a study in between");
        assert_eq!(told(&mut quiet, &[0.001; 5]), [false, false, false, false, true]);
    }
}
