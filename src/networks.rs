//! Ranges of addresses, as operators write them.

use std::{net::IpAddr, str::FromStr};

/// The addresses of one family that share their first bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Network {
    address: IpAddr,
    length: u8,
}

/// A text that is no range of addresses.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{given}` is neither an address nor a network: write 10.1.2.3, fd00::1, or a network with the number of its bits, as 10.0.0.0/8.")]
pub struct NetworkError {
    /// What was given.
    pub given: String,
}

impl Network {
    /// The addresses that share their first `length` bits with this one; `None` if it has fewer.
    pub fn new(address: IpAddr, length: u8) -> Option<Self> {
        (u32::from(length) <= bits(address).1).then_some(Self { address, length })
    }

    /// This address alone.
    pub fn one(address: IpAddr) -> Self {
        Self { address, length: bits(address).1 as u8 }
    }

    /// Whether an address lies in it. One of IPv4 written as IPv6 is another than itself: make it canonical first.
    pub fn contains(self, address: IpAddr) -> bool {
        let ((network, width), (address, of)) = (bits(self.address), bits(address));
        let shift = width - u32::from(self.length);
        // A shift by all bits is none: everything lies in a network of length 0.
        width == of && network.checked_shr(shift).unwrap_or(0) == address.checked_shr(shift).unwrap_or(0)
    }
}

impl FromStr for Network {
    type Err = NetworkError;

    fn from_str(text: &str) -> Result<Self, NetworkError> {
        let read = match text.split_once('/') {
            Some((address, length)) => {
                address.parse().ok().zip(length.parse().ok()).and_then(|(address, length)| Self::new(address, length))
            }
            None => {
                text.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>().ok().map(|address| Self::one(address.to_canonical()))
            }
        };
        read.ok_or_else(|| NetworkError { given: text.to_owned() })
    }
}

/// An address as a number, and how many bits it has.
fn bits(address: IpAddr) -> (u128, u32) {
    match address {
        IpAddr::V4(address) => (address.to_bits().into(), 32),
        IpAddr::V6(address) => (address.to_bits(), 128),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn networks_end_where_their_bits_do() {
        let network = |address: &str, length| Network::new(address.parse().unwrap(), length);
        let has = |address: &str, length, other: &str| network(address, length).unwrap().contains(other.parse().unwrap());
        assert!(has("10.1.0.0", 16, "10.1.255.255") && !has("10.1.0.0", 16, "10.2.0.0"));
        assert!(has("10.1.2.3", 0, "255.0.0.1") && !has("10.1.2.3", 0, "::1"));
        assert!(has("fd00::", 8, "fd12::1") && !has("fd00::", 8, "fe00::") && has("::", 0, "ff02::1"));
        assert!(has("10.1.2.3", 32, "10.1.2.3") && !has("10.1.2.3", 32, "10.1.2.2"));
        assert_eq!(network("10.0.0.0", 33), None);
        assert_eq!(network("::", 129), None);
    }

    #[test]
    fn what_operators_write_is_read_and_nothing_else() {
        let one = |address: &str| Network::one(address.parse().unwrap());
        assert_eq!("10.1.2.3".parse(), Ok(one("10.1.2.3")));
        assert_eq!("[fd00::1]".parse(), Ok(one("fd00::1")));
        assert_eq!("::ffff:10.1.2.3".parse(), Ok(one("10.1.2.3")));
        assert_eq!("10.0.0.0/8".parse(), Ok(Network::new("10.0.0.0".parse().unwrap(), 8).unwrap()));
        assert_eq!("fd00::/8".parse(), Ok(Network::new("fd00::".parse().unwrap(), 8).unwrap()));
        for wrong in ["", "proxy.example", "10.0.0.0/33", "10.0.0.0/", "10.0.0/8", "::/129", "10.1.2.3:80", "/8"] {
            assert_eq!(wrong.parse::<Network>(), Err(NetworkError { given: wrong.to_owned() }), "{wrong}");
        }
    }
}
