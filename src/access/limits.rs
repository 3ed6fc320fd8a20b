//! What a caller may use, and what it has used: requests a second, bytes a day, jobs that wait. Counted by each node for itself, and from
//! its start.

use super::keyring::Wished;
use governor::{
    Quota, RateLimiter,
    clock::{Clock as _, DefaultClock},
    middleware::StateInformationMiddleware,
    state::{InMemoryState, NotKeyed},
};
use jiff::Timestamp;
use std::{
    collections::HashMap,
    num::NonZeroU32,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// Seconds of requests that may come at once.
const BURST_S: u32 = 2;
/// Seconds of a day.
const DAY_S: i64 = 86_400;
/// Callers that are remembered; with more, those of whom nothing is under way are forgotten. Tokens of a large clinic's staff fit.
const REMEMBERED: usize = 10_000;

/// What each caller may use whose key says nothing else.
#[derive(Debug, Clone, Copy, Default)]
pub struct Standing {
    /// Requests a second; `None`: as many as come.
    pub requests_per_second: Option<NonZeroU32>,
    /// Bytes of bodies a day (UTC).
    pub bytes_per_day: Option<u64>,
    /// Jobs of the owner that may wait.
    pub queued_jobs: Option<u64>,
}

impl Standing {
    /// As a key has it that wishes so.
    fn with(&self, wished: &Wished) -> Self {
        Self {
            requests_per_second: wished.requests_per_second.map_or(self.requests_per_second, NonZeroU32::new),
            bytes_per_day: wished.mb_per_day.map_or(self.bytes_per_day, |mb| Some(mb << 20).filter(|&bytes| bytes > 0)),
            queued_jobs: wished.queued_jobs.map_or(self.queued_jobs, |jobs| Some(jobs).filter(|&jobs| jobs > 0)),
        }
    }
}

/// What is used by all callers.
#[derive(Default)]
pub struct Allowances {
    standing: Standing,
    callers: Mutex<HashMap<String, Arc<Allowance>>>,
}

impl Allowances {
    /// With what each may use.
    pub fn new(standing: Standing) -> Self {
        Self { standing, callers: Mutex::default() }
    }

    /// Most jobs that may wait of an owner with keys of these limits, of which the most generous counts; `None`: as many as come.
    pub(super) fn queued_jobs<'a>(&self, keys: impl IntoIterator<Item = &'a Wished>) -> Option<u64> {
        let limits: Vec<Option<u64>> = keys.into_iter().map(|wished| self.standing.with(wished).queued_jobs).collect();
        if limits.is_empty() { self.standing.queued_jobs } else { limits.into_iter().collect::<Option<Vec<_>>>()?.into_iter().max() }
    }

    /// That of a caller, which keeps what it has used until its limits are others.
    pub(super) fn of(&self, caller: &str, wished: &Wished) -> Arc<Allowance> {
        let standing = self.standing.with(wished);
        let mut callers = self.callers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = callers.get(caller).filter(|known| known.is_of(&standing)) {
            return Arc::clone(known);
        }
        if callers.len() >= REMEMBERED {
            callers.retain(|_, known| Arc::strong_count(known) > 1);
        }
        let new = Arc::new(Allowance::new(standing));
        callers.insert(caller.to_owned(), Arc::clone(&new));
        new
    }
}

/// What one caller may use, and has used.
#[derive(Debug)]
pub struct Allowance {
    standing: Standing,
    requests: Option<Requests>,
    today: Mutex<Day>,
}

#[derive(Debug)]
struct Requests {
    per_second: NonZeroU32,
    limiter: RateLimiter<NotKeyed, InMemoryState, DefaultClock, StateInformationMiddleware>,
}

/// Bytes of a day.
#[derive(Debug, Default)]
struct Day {
    /// Days since 1970.
    number: i64,
    bytes: u64,
}

/// How much is left of what may come at once (draft-ietf-httpapi-ratelimit-headers).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Left {
    /// Requests a second that are allowed on the whole.
    pub per_second: u32,
    /// Requests that may come at once.
    pub at_once: u32,
    /// Of which so many are left.
    pub left: u32,
}

/// What was too much.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum OverLimit {
    /// Requests.
    #[error("More requests than the {per_second} a second that this key or token may make. Send the request again in {retry_after_s} s.")]
    Requests {
        /// What is allowed.
        per_second: u32,
        /// Seconds to wait.
        retry_after_s: u64,
    },
    /// Bytes.
    #[error(
        "This key or token has sent {used_mb} of its {allowed_mb} MiB a day, and the body does not fit into the rest. The next day begins in {retry_after_s} s (UTC)."
    )]
    Bytes {
        /// What was used, in MiB.
        used_mb: u64,
        /// What is allowed, in MiB.
        allowed_mb: u64,
        /// Seconds to midnight.
        retry_after_s: u64,
    },
}

impl OverLimit {
    /// The stable code of the problem.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Requests { .. } => "too_many_requests",
            Self::Bytes { .. } => "too_many_bytes",
        }
    }

    /// Seconds to wait.
    pub fn retry_after_s(&self) -> u64 {
        match self {
            Self::Requests { retry_after_s, .. } | Self::Bytes { retry_after_s, .. } => *retry_after_s,
        }
    }
}

impl Allowance {
    fn new(standing: Standing) -> Self {
        let requests = standing.requests_per_second.map(|per_second| {
            let quota = Quota::per_second(per_second).allow_burst(per_second.saturating_mul(NonZeroU32::MIN.saturating_add(BURST_S - 1)));
            Requests { per_second, limiter: RateLimiter::direct(quota).with_middleware() }
        });
        Self { standing, requests, today: Mutex::default() }
    }

    fn is_of(&self, other: &Standing) -> bool {
        let Standing { requests_per_second, bytes_per_day, queued_jobs } = self.standing;
        (requests_per_second, bytes_per_day, queued_jobs) == (other.requests_per_second, other.bytes_per_day, other.queued_jobs)
    }

    /// Counts a request; `None` where requests are not counted.
    ///
    /// # Errors
    /// Too many.
    pub fn request(&self) -> Result<Option<Left>, OverLimit> {
        let Some(Requests { per_second, limiter }) = &self.requests else { return Ok(None) };
        match limiter.check() {
            Ok(state) => Ok(Some(Left {
                per_second: per_second.get(),
                at_once: state.quota().burst_size().get(),
                left: state.remaining_burst_capacity(),
            })),
            Err(until) => {
                let retry_after_s = until.wait_time_from(DefaultClock::default().now()).as_secs() + 1;
                Err(OverLimit::Requests { per_second: per_second.get(), retry_after_s })
            }
        }
    }

    /// Takes what a body announces out of the day; `None` where bytes are not counted.
    ///
    /// # Errors
    /// It does not fit.
    pub fn body(self: &Arc<Self>, announced: u64, now: Timestamp) -> Result<Option<DayBytes>, OverLimit> {
        let Some(allowed) = self.standing.bytes_per_day else { return Ok(None) };
        let mut today = self.today(now);
        if today.bytes >= allowed || announced > allowed - today.bytes {
            return Err(over(today.bytes, allowed, now));
        }
        today.bytes += announced;
        Ok(Some(DayBytes { allowance: Arc::clone(self), day: today.number, announced }))
    }

    /// Most jobs of the owner that may wait, if that is limited.
    pub fn queued_jobs(&self) -> Option<u64> {
        self.standing.queued_jobs
    }

    /// The day and what was used of it.
    fn today(&self, now: Timestamp) -> MutexGuard<'_, Day> {
        let mut today = self.today.lock().unwrap_or_else(PoisonError::into_inner);
        let number = now.as_second().div_euclid(DAY_S);
        if today.number != number {
            *today = Day { number, bytes: 0 };
        }
        today
    }
}

fn over(used: u64, allowed: u64, now: Timestamp) -> OverLimit {
    let retry_after_s = (DAY_S - now.as_second().rem_euclid(DAY_S)) as u64;
    OverLimit::Bytes { used_mb: used.div_ceil(1 << 20), allowed_mb: allowed >> 20, retry_after_s }
}

/// What one body has of the day. What was announced and did not come is given back when this is dropped.
#[derive(Debug)]
pub struct DayBytes {
    allowance: Arc<Allowance>,
    day: i64,
    /// Announced bytes that did not come yet.
    announced: u64,
}

impl DayBytes {
    /// Counts bytes that came.
    ///
    /// # Errors
    /// They were not announced, and are more than the day has left.
    pub fn came(&mut self, bytes: u64, now: Timestamp) -> Result<(), OverLimit> {
        let covered = bytes.min(self.announced);
        self.announced -= covered;
        let Some(allowed) = self.allowance.standing.bytes_per_day.filter(|_| covered < bytes) else { return Ok(()) };
        let mut today = self.allowance.today(now);
        today.bytes = today.bytes.saturating_add(bytes - covered);
        if today.bytes > allowed { Err(over(today.bytes, allowed, now)) } else { Ok(()) }
    }
}

impl Drop for DayBytes {
    fn drop(&mut self) {
        let mut today = self.allowance.today.lock().unwrap_or_else(PoisonError::into_inner);
        if today.number == self.day {
            today.bytes = today.bytes.saturating_sub(self.announced);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standing() -> Standing {
        Standing { requests_per_second: NonZeroU32::new(3), bytes_per_day: Some(10 << 20), queued_jobs: None }
    }

    #[test]
    fn requests_are_counted_for_each_caller() {
        let all = Allowances::new(standing());
        let one = all.of("key 1", &Wished::default());
        let left: Vec<u32> = (0..6).map(|_| one.request().unwrap().unwrap().left).collect();
        assert_eq!(left, [5, 4, 3, 2, 1, 0]);
        assert_eq!(one.request(), Err(OverLimit::Requests { per_second: 3, retry_after_s: 1 }));
        assert!(all.of("key 1", &Wished::default()).request().is_err(), "it is remembered");
        assert!(all.of("key 2", &Wished::default()).request().is_ok());
        let generous = Wished { requests_per_second: Some(0), ..Wished::default() };
        assert_eq!(all.of("key 3", &generous).request(), Ok(None), "0 is no limit");
    }

    #[test]
    fn the_most_generous_key_of_an_owner_says_how_many_jobs_may_wait() {
        let all = Allowances::new(Standing { queued_jobs: Some(5), ..Standing::default() });
        let [little, much, all_of_them] = [Some(1), Some(9), Some(0)].map(|queued_jobs| Wished { queued_jobs, ..Wished::default() });
        assert_eq!(all.queued_jobs([]), Some(5), "who has no key, as who comes by a token or an association");
        assert_eq!(all.queued_jobs([&little]), Some(1));
        assert_eq!(all.queued_jobs([&little, &Wished::default()]), Some(5));
        assert_eq!(all.queued_jobs([&little, &much]), Some(9));
        assert_eq!(all.queued_jobs([&much, &all_of_them]), None);
    }

    #[test]
    fn bytes_are_counted_by_the_day() {
        let all = Allowances::new(standing());
        let one = all.of("key 1", &Wished::default());
        let evening: Timestamp = "2026-03-01T23:59:00Z".parse().unwrap();
        let mut six = one.body(6 << 20, evening).unwrap().unwrap();
        assert_eq!(one.body(5 << 20, evening).unwrap_err(), OverLimit::Bytes { used_mb: 6, allowed_mb: 10, retry_after_s: 60 });
        let four = one.body(4 << 20, evening).unwrap().unwrap();
        assert!(one.body(0, evening).is_err(), "all of it is announced");
        six.came(5 << 20, evening).unwrap();
        drop((six, four));
        // Five of them came. Of what does not say how long it is, only so much is let in as fits.
        let mut chunks = one.body(0, evening).unwrap().unwrap();
        chunks.came(5 << 20, evening).unwrap();
        assert_eq!(chunks.came(1, evening).unwrap_err(), OverLimit::Bytes { used_mb: 11, allowed_mb: 10, retry_after_s: 60 });
        let next_day: Timestamp = "2026-03-02T00:00:00Z".parse().unwrap();
        drop(one.body(5 << 20, next_day).unwrap());
        drop(chunks);
        assert!(one.body(10 << 20, next_day).is_ok(), "yesterday's is not given back today");
        let small = all.of("key 1", &Wished { mb_per_day: Some(1), ..Wished::default() });
        assert!(small.body(2 << 20, evening).is_err(), "a changed key has its new limit at once");
    }
}
