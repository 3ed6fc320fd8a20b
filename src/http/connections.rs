//! How many connections there may be at once, in all and from one client.

use std::{
    collections::HashMap,
    net::{IpAddr, Ipv6Addr},
    sync::{Arc, Mutex, PoisonError},
};

/// Bits of an IPv6 address that tell one customer of a network from the next: the rest is the customer's own to choose.
const CUSTOMER_BITS: u32 = 64;

/// The connections that are open. Clones share them.
#[derive(Debug, Clone)]
pub(super) struct Connections(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    most: usize,
    most_of_client: usize,
    open: Mutex<Open>,
}

#[derive(Debug, Default)]
struct Open {
    all: usize,
    by_client: HashMap<IpAddr, usize>,
}

/// The place of an open connection, given back when dropped.
#[derive(Debug)]
pub(super) struct Place {
    shared: Arc<Shared>,
    client: Option<IpAddr>,
}

/// Why a connection has no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Full {
    /// There are as many as there may be.
    All,
    /// Its client has as many as one may have.
    Client,
}

impl Full {
    fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Client => "client",
        }
    }
}

/// As many connections of those that are wanted as leave this many of the system's file descriptors for what else needs one; half of them
/// where there are too few for that. Else clients that open connections and do nothing would take from the database, and from decoders.
pub(super) fn within(wanted: usize, descriptors: u64, others: u64) -> usize {
    let most = descriptors.saturating_sub(others).max(descriptors / 2);
    wanted.min(usize::try_from(most).unwrap_or(usize::MAX)).max(1)
}

impl Connections {
    /// At most so many, and so many of one client.
    pub(super) fn new(most: usize, most_of_client: usize) -> Self {
        Self(Arc::new(Shared { most, most_of_client, open: Mutex::default() }))
    }

    /// A place for a connection, counted for its client if one is given.
    pub(super) fn place(&self, client: Option<IpAddr>) -> Result<Place, Full> {
        let client = client.map(customer);
        let placed = self.0.take(client);
        if let Err(full) = placed {
            metrics::counter!("ventricle_http_connections_refused_total", "reason" => full.name()).increment(1);
        }
        placed.map(|()| Place { shared: Arc::clone(&self.0), client })
    }
}

impl Shared {
    fn take(&self, client: Option<IpAddr>) -> Result<(), Full> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if open.all >= self.most {
            return Err(Full::All);
        }
        if let Some(client) = client {
            let own = open.by_client.entry(client).or_default();
            if *own >= self.most_of_client {
                return Err(Full::Client);
            }
            *own += 1;
        }
        open.all += 1;
        metrics::gauge!("ventricle_http_connections").set(open.all as f64);
        Ok(())
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut open = self.shared.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.all -= 1;
        metrics::gauge!("ventricle_http_connections").set(open.all as f64);
        if let Some(client) = self.client
            && let Some(own) = open.by_client.get_mut(&client)
        {
            *own -= 1;
            if *own == 0 {
                open.by_client.remove(&client);
            }
        }
    }
}

/// What a client is counted by: its address, or its network where it can choose among addresses.
fn customer(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() & (u128::MAX << CUSTOMER_BITS)).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_counted_by_client_and_in_all_and_given_back() {
        let connections = Connections::new(3, 2);
        let from = |address: &str| connections.place(Some(address.parse().unwrap()));
        let first = from("192.0.2.1").unwrap();
        let second = from("192.0.2.1").unwrap();
        assert_eq!(from("192.0.2.1").unwrap_err(), Full::Client);
        let other = from("192.0.2.2").unwrap();
        assert_eq!(from("192.0.2.3").unwrap_err(), Full::All);
        assert_eq!(connections.place(None).unwrap_err(), Full::All);
        drop((first, other));
        let again = from("192.0.2.1").unwrap();
        connections.place(None).unwrap();
        drop((second, again));
        let open = connections.0.open.lock().unwrap();
        assert!(open.all == 0 && open.by_client.is_empty(), "{open:?}");
    }

    #[test]
    fn connections_leave_descriptors_for_others() {
        assert_eq!((within(4096, 1 << 20, 300), within(4096, 1024, 300), within(4096, 400, 300)), (4096, 724, 200));
        assert_eq!((within(10, 1024, 300), within(10, 0, 300), within(10, u64::MAX, 300)), (10, 1, 10));
    }

    #[test]
    fn an_ipv6_network_is_one_client() {
        let connections = Connections::new(9, 1);
        let _first = connections.place(Some("2001:db8:0:1::1".parse().unwrap())).unwrap();
        assert_eq!(connections.place(Some("2001:db8:0:1:ffff::2".parse().unwrap())).unwrap_err(), Full::Client);
        connections.place(Some("2001:db8:0:2::1".parse().unwrap())).unwrap();
    }
}
