//! What the operator allows beyond https to public addresses.

use super::address::special;
use crate::networks::Network;
use std::net::{IpAddr, SocketAddr};
use url::{Host, Url};

/// Hosts and networks of the operator's, where callbacks may go although the addresses are not public; without TLS too where the host is
/// named or the URL holds the address.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Allowed {
    entries: Vec<Entry>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Entry {
    what: What,
    /// Any if absent.
    port: Option<u16>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum What {
    /// In lower case, without a dot at its end.
    Name(String),
    Network(Network),
}

/// An entry that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{entry}` is not a place callbacks may be allowed to go: write a host (hooks.hospital.example), an address (10.1.2.3), either with a \
     port (hooks.hospital.example:8443, [fd00::1]:8443), or a network (10.0.0.0/8), without scheme and path."
)]
pub struct AllowError {
    /// What was given.
    pub entry: String,
}

impl Allowed {
    /// Reads the operator's list.
    pub fn parse<'a>(entries: impl IntoIterator<Item = &'a str>) -> Result<Self, AllowError> {
        let entries = entries.into_iter().map(|entry| Entry::parse(entry.trim()).ok_or_else(|| AllowError { entry: entry.to_owned() }));
        Ok(Self { entries: entries.collect::<Result<_, _>>()? })
    }

    /// The same, and the hosts of these URLs at their ports.
    #[must_use]
    pub fn with_hosts_of<'a>(mut self, urls: impl IntoIterator<Item = &'a str>) -> Self {
        let urls = urls.into_iter().filter_map(|url| Url::parse(url).ok());
        self.entries.extend(urls.filter_map(|url| {
            let what = match url.host()? {
                Host::Domain(name) => What::Name(plain_name(name)),
                Host::Ipv4(address) => What::Network(Network::one(address.into())),
                Host::Ipv6(address) => What::Network(Network::one(IpAddr::from(address).to_canonical())),
            };
            Some(Entry { what, port: url.port_or_known_default() })
        }));
        self
    }

    /// Whether the host is on the list by its name.
    pub(super) fn names(&self, host: &str, port: u16) -> bool {
        let host = plain_name(host);
        self.entries.iter().any(|entry| matches!(&entry.what, What::Name(name) if *name == host) && entry.is_for(port))
    }

    /// Whether the address is on the list.
    pub(super) fn has(&self, address: IpAddr, port: u16) -> bool {
        let address = address.to_canonical();
        self.entries.iter().any(|entry| matches!(entry.what, What::Network(network) if network.contains(address)) && entry.is_for(port))
    }

    /// Why a connection to this address is refused, if it is: not public, and not on the list.
    pub(super) fn refusal(&self, address: IpAddr, port: u16) -> Option<&'static str> {
        special(address).filter(|_| !self.has(address, port))
    }
}

impl Entry {
    fn parse(text: &str) -> Option<Self> {
        if let Ok(network) = text.parse() {
            return Some(Self { what: What::Network(network), port: None });
        }
        if let Ok(address) = text.parse::<SocketAddr>() {
            return Some(Self { what: What::Network(Network::one(address.ip().to_canonical())), port: Some(address.port()) });
        }
        let (host, port) = match text.split_once(':') {
            Some((host, port)) => (host, Some(port.parse().ok().filter(|port| *port != 0)?)),
            None => (text, None),
        };
        match Host::parse(host).ok()? {
            Host::Domain(name) => Some(Self { what: What::Name(plain_name(&name)), port }),
            Host::Ipv4(address) => Some(Self { what: What::Network(Network::one(address.into())), port }),
            Host::Ipv6(_) => None,
        }
    }

    fn is_for(&self, port: u16) -> bool {
        self.port.is_none_or(|own| own == port)
    }
}

/// A host name in the one form in which names are compared.
fn plain_name(host: &str) -> String {
    host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_allow_what_they_say_and_no_more() {
        let allowed =
            Allowed::parse(["Hooks.Example", "other.example:8443", "10.0.0.0/8", "192.168.1.5:80", "[fd00::1]:9", "::1"]).unwrap();
        assert!(allowed.names("hooks.example", 1) && allowed.names("HOOKS.example.", 2) && !allowed.names("a.hooks.example", 1));
        assert!(allowed.names("other.example", 8443) && !allowed.names("other.example", 443));
        let refused = |address: &str, port| allowed.refusal(address.parse().unwrap(), port);
        assert_eq!(refused("10.200.0.1", 1), None);
        assert_eq!(refused("::ffff:10.200.0.1", 1), None);
        assert_eq!(refused("11.0.0.1", 1), None);
        assert_eq!(refused("192.168.1.5", 80), None);
        assert_eq!(refused("192.168.1.5", 81), Some("private"));
        assert_eq!(refused("192.168.1.6", 80), Some("private"));
        assert_eq!(refused("fd00::1", 9), None);
        assert_eq!(refused("fd00::1", 10), Some("private"));
        assert_eq!(refused("::1", 443), None);
        assert_eq!(refused("127.0.0.1", 443), Some("loopback"));
    }

    #[test]
    fn a_url_allows_its_host_at_its_port() {
        let allowed = Allowed::default().with_hosts_of(["https://login.example/realms/a", "http://10.1.2.3:8080/", "no url"]);
        assert!(allowed.names("login.example", 443) && !allowed.names("login.example", 8443));
        assert_eq!(allowed.refusal("10.1.2.3".parse().unwrap(), 8080), None);
        assert_eq!(allowed.refusal("10.1.2.3".parse().unwrap(), 80), Some("private"));
    }

    #[test]
    fn what_is_no_place_is_refused_by_name() {
        for wrong in ["", "https://a.example", "a.example/path", "a.example:0", "a.example:x", "10.0.0.0/33", "a b", "10.0.0.0/"] {
            assert_eq!(Allowed::parse([wrong]), Err(AllowError { entry: wrong.to_owned() }), "{wrong}");
        }
    }
}
