//! The database's clock, by which leases, pauses and times to keep are told. Somebody may set it, and a machine may sleep for a day: whatever
//! it says then, no job is taken from a worker that has it, none waits for a time that was meant to be now, and nothing is deleted for an age
//! that it does not have.

use super::{database::values, error::StoreError, lease::milliseconds, store::Store};
use std::{
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// Nothing is deleted for its age for so long after the clock was set forward: time to set it back.
const HELD: Duration = Duration::from_hours(1);
/// What differs by less than a lease over this is none of the clock's: leases carry it.
const CARRIED: u32 = 3;
/// The longest lease that can be set (`--lease-seconds`): what is further ahead, no clock that runs has made.
const LONGEST_LEASE: Duration = Duration::from_hours(1);
/// Likewise the longest pause before something is told again: 8 h, a fifth of chance in it, and what is over.
const LONGEST_PAUSE: Duration = Duration::from_hours(10);

/// How the clock was set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClockSet {
    /// By so many s: forward, or back if negative.
    pub by_s: i64,
    /// So long ago.
    pub ago: Duration,
    /// For how long nothing is deleted for its age; zero if it is.
    pub held: Duration,
}

/// What is known of the clock.
#[derive(Debug, Default)]
pub(super) struct Clock(Mutex<Known>);

#[derive(Debug, Default)]
struct Known {
    last: Option<Reading>,
    /// When a look last came to its end, with what it wrote.
    looked: Option<Instant>,
    /// When it was set, and by how many ms.
    set: Option<(Instant, i64)>,
    /// Deletions are held until then.
    held_until: Option<Instant>,
    /// Leases may have lapsed until then without their workers being lost.
    doubted_until: Option<Instant>,
}

/// What the clock said at some moment between two of ours.
#[derive(Debug, Clone, Copy)]
struct Reading {
    asked: Instant,
    answered: Instant,
    now_ms: i64,
}

impl Reading {
    /// By how many ms the clock went otherwise than time since an earlier reading, at least; zero if it may have gone as it does.
    fn set_since(&self, last: &Self) -> i64 {
        let least = milliseconds(self.asked.saturating_duration_since(last.answered));
        let most = milliseconds(self.answered.saturating_duration_since(last.asked));
        let went = self.now_ms.saturating_sub(last.now_ms);
        went - went.clamp(least, most)
    }
}

impl Known {
    /// Takes note of a reading; returns by how many ms the clock was set since the last.
    fn note(&mut self, reading: Reading, lease: Duration) -> Option<i64> {
        let last = self.last.replace(reading)?;
        let set_ms = reading.set_since(&last);
        if set_ms.unsigned_abs() <= milliseconds(lease / CARRIED).unsigned_abs() {
            return None;
        }
        self.set = Some((reading.answered, set_ms));
        if set_ms > 0 {
            self.doubted_until = Some(reading.answered + lease);
            self.held_until = Some(reading.answered + HELD);
        }
        Some(set_ms)
    }

    /// Takes note of the end of a look. One that comes more than a lease after the last had nobody who could renew one meanwhile: the database
    /// was away or took nothing that is written, or this process was stopped.
    fn looked(&mut self, at: Instant, lease: Duration) {
        let last = self.looked.replace(at);
        if last.is_some_and(|last| at.saturating_duration_since(last) > lease) {
            self.doubted_until = Some(at + lease);
        }
    }
}

impl Clock {
    fn with<T>(&self, look: impl FnOnce(&mut Known) -> T) -> T {
        look(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether what seems to be old enough is not to be deleted.
    pub(super) fn holds_deletions(&self) -> bool {
        self.with(|known| known.held_until.is_some_and(|until| Instant::now() < until))
    }

    /// Whether leases that are over may be those of workers that are there.
    fn doubts_leases(&self) -> bool {
        self.with(|known| known.doubted_until.is_some_and(|until| Instant::now() < until))
    }
}

impl Store {
    /// How the clock was set since this process began, if it was.
    pub fn clock_set(&self) -> Option<ClockSet> {
        let now = Instant::now();
        self.inner.clock.with(|known| {
            let (at, by_ms) = known.set?;
            let held = known.held_until.map_or(Duration::ZERO, |until| until.saturating_duration_since(now));
            Some(ClockSet { by_s: by_ms / 1000, ago: now.saturating_duration_since(at), held })
        })
    }

    /// What the clock of the database says, in ms since 1970.
    pub(super) async fn now_ms(&self) -> Result<i64, StoreError> {
        let row = self.inner.database.fetch_one("SELECT {now}", vec![]).await?;
        row.map_or_else(|| Err(StoreError::Damaged { what: "the clock".to_owned() }), |row| row.get(0))
    }

    /// Looks whether the clock was set, and brings back what lies where no clock could have put it. Returns what it says, unless leases that
    /// are over by it may be those of workers that are there.
    pub(super) async fn look_at_clock(&self) -> Result<Option<i64>, StoreError> {
        let asked = Instant::now();
        let now_ms = self.now_ms().await?;
        let reading = Reading { asked, answered: Instant::now(), now_ms };
        if let Some(set_ms) = self.inner.clock.with(|known| known.note(reading, self.inner.settings.lease)) {
            let direction = if set_ms > 0 { "forward" } else { "back" };
            tracing::warn!(seconds = set_ms.abs() / 1000, direction, "the clock was set");
            metrics::counter!("ventricle_clock_set_total", "direction" => direction).increment(1);
        }
        self.bring_back().await?;
        self.inner.clock.with(|known| known.looked(Instant::now(), self.inner.settings.lease));
        Ok((!self.inner.clock.doubts_leases()).then_some(now_ms))
    }

    /// What waits for a time that was meant to be now, or was held for a time that was meant to be near, before the clock was set back.
    async fn bring_back(&self) -> Result<(), StoreError> {
        let settings = &self.inner.settings;
        let longest_wait = settings.retry_pause * settings.max_attempts;
        let statements = [
            ("UPDATE jobs SET run_after = {now} WHERE state = 'queued' AND run_after > {now} + $1 RETURNING id", longest_wait),
            ("UPDATE jobs SET lease_until = {now} + $1 WHERE state = 'running' AND lease_until > {now} + $1 RETURNING id", LONGEST_LEASE),
            (
                "UPDATE deliveries SET run_after = {now} WHERE state = 'pending' AND (run_after > {now} + $1 OR (attempts = 0 AND run_after > {now}))
                RETURNING id",
                LONGEST_PAUSE,
            ),
            ("UPDATE deliveries SET lease_until = {now} + $1 WHERE state = 'pending' AND lease_until > {now} + $1 RETURNING id", LONGEST_LEASE),
            ("UPDATE instances SET received_at = {now} WHERE job_id IS NULL AND received_at > {now} + $1 RETURNING owner", Duration::ZERO),
        ];
        for (sql, furthest) in statements {
            let rows = self.inner.database.fetch(sql, values![milliseconds(furthest)]).await?;
            if !rows.is_empty() {
                tracing::warn!(rows = rows.len(), "brought back what waited for a time that the clock will not reach soon");
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEASE: Duration = Duration::from_secs(30);

    /// Notes readings: when each was asked for, how long the answer took and what it was, in ms.
    fn noted(known: &mut Known, begin: Instant, readings: &[(u64, u64, i64)]) -> Vec<Option<i64>> {
        let reading = |&(asked_ms, took_ms, now_ms): &(u64, u64, i64)| {
            let asked = begin + Duration::from_millis(asked_ms);
            Reading { asked, answered: asked + Duration::from_millis(took_ms), now_ms }
        };
        readings.iter().map(|each| known.note(reading(each), LEASE)).collect()
    }

    #[test]
    fn a_clock_that_runs_as_time_does_was_not_set_however_late_it_answers() {
        let mut known = Known::default();
        let readings = [(0, 1, 1_000_000), (10_000, 4000, 1_012_000), (24_000, 1, 1_024_000), (34_000, 1, 1_043_000)];
        assert_eq!(noted(&mut known, Instant::now(), &readings), [None; 4], "9 s are carried by a lease of 30");
        assert!(known.held_until.is_none() && known.doubted_until.is_none() && known.set.is_none(), "{known:?}");
    }

    #[test]
    fn one_that_was_set_forward_holds_deletions_and_leases_and_back_neither() {
        let (mut known, begin) = (Known::default(), Instant::now());
        let day_ms = 86_400_000;
        let told = noted(&mut known, begin, &[(0, 0, 0), (10_000, 0, day_ms + 10_000)]);
        assert_eq!(told, [None, Some(day_ms)]);
        let set_at = begin + Duration::from_secs(10);
        assert_eq!((known.held_until, known.doubted_until), (Some(set_at + HELD), Some(set_at + LEASE)));
        assert_eq!(noted(&mut known, begin, &[(20_000, 0, 20_000)]), [Some(-day_ms)]);
        assert_eq!((known.held_until, known.doubted_until), (Some(set_at + HELD), Some(set_at + LEASE)), "as they were");
    }

    #[test]
    fn leases_are_doubted_after_a_time_in_which_nobody_could_renew_them() {
        let (mut known, begin) = (Known::default(), Instant::now());
        for (at_s, doubted_until_s) in [(0, None), (29, None), (60, Some(90)), (70, Some(90))] {
            known.looked(begin + Duration::from_secs(at_s), LEASE);
            assert_eq!(known.doubted_until, doubted_until_s.map(|end_s| begin + Duration::from_secs(end_s)), "{at_s}");
        }
    }
}
