//! How often an address may be refused.

use governor::clock::Clock as _;
use governor::{Quota, RateLimiter, clock::DefaultClock, middleware::NoOpMiddleware, state::keyed::HashMapStateStore};
use std::{
    net::{IpAddr, Ipv6Addr},
    num::NonZeroU32,
    sync::atomic::{AtomicU64, Ordering},
};

/// Refusals a minute of an address, and as many at once, if nothing else is said: who mistypes a key notices, who tries keys gains nothing.
const PER_MINUTE: NonZeroU32 = NonZeroU32::new(20).expect("it is not zero");
/// After so many refusals addresses of long ago are forgotten.
const TIDY_EVERY: u64 = 1000;

/// The refusals of each address.
pub struct Attempts {
    refusals: RateLimiter<IpAddr, HashMapStateStore<IpAddr>, DefaultClock, NoOpMiddleware>,
    seen: AtomicU64,
}

impl Default for Attempts {
    fn default() -> Self {
        Self::new(PER_MINUTE)
    }
}

impl Attempts {
    /// With so many refusals a minute, and as many at once.
    pub fn new(per_minute: NonZeroU32) -> Self {
        Self { refusals: RateLimiter::hashmap(Quota::per_minute(per_minute)), seen: AtomicU64::new(0) }
    }

    /// Counts a refusal of an address; where there were too many, seconds until the next may come.
    pub fn refused(&self, address: IpAddr) -> Option<u64> {
        if self.seen.fetch_add(1, Ordering::Relaxed) % TIDY_EVERY == TIDY_EVERY - 1 {
            self.refusals.retain_recent();
        }
        let until = self.refusals.check_key(&network(address)).err()?;
        Some(until.wait_time_from(DefaultClock::default().now()).as_secs() + 1)
    }
}

/// The address, or the network of one that has a network of its own (IPv6: the first 64 bits are a site's or a household's).
fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() & (u128::MAX << 64))),
        v4 @ IpAddr::V4(_) => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_told_to_wait_after_too_many_and_others_are_not() {
        let attempts = Attempts::default();
        let (one, other) = ("192.0.2.1".parse().unwrap(), "192.0.2.2".parse().unwrap());
        assert!((0..PER_MINUTE.get()).all(|_| attempts.refused(one).is_none()));
        let wait_s = attempts.refused(one).unwrap();
        assert!((1..=4).contains(&wait_s), "{wait_s}");
        assert_eq!(attempts.refused(other), None);
    }

    #[test]
    fn a_site_is_one_however_many_addresses_it_has() {
        let attempts = Attempts::default();
        for host in 0..PER_MINUTE.get() {
            assert_eq!(attempts.refused(format!("2001:db8::{host:x}").parse().unwrap()), None);
        }
        assert!(attempts.refused("2001:db8::ffff".parse().unwrap()).is_some());
        assert_eq!(attempts.refused("2001:db8:0:1::1".parse().unwrap()), None);
    }
}
