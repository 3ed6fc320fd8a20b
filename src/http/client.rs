//! Who calls, as far as the network tells: the other end of the connection, or whom it speaks for where that is a proxy that is believed.

use crate::{config::ProxyHeader, networks::Network};
use axum::http::{HeaderMap, HeaderName, header};
use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
};

const X_FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");

/// The address that a request comes from, for limits and the audit log. It is in no other log: it may name a person's workstation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct ClientAddress(pub(super) IpAddr);

/// The proxies that are believed, and the header that they are believed.
#[derive(Debug, Clone, Default)]
pub(super) struct Proxies {
    networks: Arc<[Network]>,
    header: ProxyHeader,
}

impl Proxies {
    /// Proxies in these networks.
    pub(super) fn new(networks: &[Network], header: ProxyHeader) -> Self {
        Self { networks: networks.into(), header }
    }

    /// Whether an address is that of a proxy.
    pub(super) fn trust(&self, address: IpAddr) -> bool {
        self.networks.iter().any(|network| network.contains(address))
    }

    /// Whom a request is from that came over a connection with this peer. Each proxy adds at the right whom it was asked by, so what is believed
    /// is read from there to the first address that is no proxy's; what stands before was that client's to write.
    pub(super) fn client(&self, peer: IpAddr, headers: &HeaderMap) -> ClientAddress {
        let mut nearest = peer;
        if self.trust(peer) {
            for address in self.named(headers).into_iter().rev() {
                // A proxy that does not say whom it speaks for (`unknown`, a name of its own) speaks for itself.
                let Some(address) = address else { break };
                nearest = address;
                if !self.trust(address) {
                    break;
                }
            }
        }
        ClientAddress(nearest)
    }

    /// What the header names, in its order; `None` for what is no address.
    fn named(&self, headers: &HeaderMap) -> Vec<Option<IpAddr>> {
        let name = match self.header {
            ProxyHeader::XForwardedFor => X_FORWARDED_FOR,
            ProxyHeader::Forwarded => header::FORWARDED,
        };
        let mut addresses = Vec::new();
        for line in headers.get_all(name) {
            // What is no text spoils the element that it is in, not what a proxy wrote behind it.
            let line = String::from_utf8_lossy(line.as_bytes());
            match self.header {
                ProxyHeader::XForwardedFor => addresses.extend(line.split(',').map(address)),
                ProxyHeader::Forwarded => addresses.extend(elements(&line).into_iter().map(forwarded_for)),
            }
        }
        addresses
    }
}

/// The `for` of one element of `Forwarded` (RFC 7239 4).
fn forwarded_for(element: &str) -> Option<IpAddr> {
    let (pairs, _) = unquoted(element, ';');
    let value = pairs.into_iter().find_map(|pair| {
        let (name, value) = pair.split_once('=')?;
        name.trim().eq_ignore_ascii_case("for").then_some(value.trim())
    })?;
    address(value.strip_prefix('"').and_then(|value| value.strip_suffix('"')).unwrap_or(value))
}

/// The elements of a line. Where a quote stays open, it is a client's that would swallow what proxies wrote behind it: there every comma separates.
fn elements(line: &str) -> Vec<&str> {
    let (elements, open) = unquoted(line, ',');
    if open { line.split(',').collect() } else { elements }
}

/// The parts of a text between separators that are not inside of a quoted string, and whether one stays open.
fn unquoted(text: &str, separator: char) -> (Vec<&str>, bool) {
    let (mut quoted, mut escaped) = (false, false);
    let parts = text.split(|letter: char| {
        let ends = letter == separator && !quoted;
        quoted ^= letter == '"' && !escaped;
        escaped = letter == '\\' && quoted && !escaped;
        ends
    });
    (parts.collect(), quoted)
}

/// An address with or without a port, one of IPv6 with or without brackets.
fn address(text: &str) -> Option<IpAddr> {
    let text = text.trim();
    let bare = text.strip_prefix('[').and_then(|text| text.strip_suffix(']')).unwrap_or(text);
    let address = bare.parse().ok().or_else(|| text.parse::<SocketAddr>().ok().map(|address| address.ip()));
    address.map(|address| address.to_canonical())
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    /// Whom a request from this peer is from, with these lines of a header.
    fn client(header: ProxyHeader, peer: &str, lines: &[(&'static str, &str)]) -> String {
        let networks = ["10.0.0.0/8", "fd00::/8"].map(|network| network.parse().unwrap());
        let mut headers = HeaderMap::new();
        for (name, value) in lines {
            headers.append(*name, value.parse().unwrap());
        }
        Proxies::new(&networks, header).client(peer.parse().unwrap(), &headers).0.to_string()
    }

    fn by_x_forwarded_for(peer: &str, lines: &[&str]) -> String {
        client(ProxyHeader::XForwardedFor, peer, &lines.iter().map(|line| ("x-forwarded-for", *line)).collect::<Vec<_>>())
    }

    fn by_forwarded(line: &str) -> String {
        client(ProxyHeader::Forwarded, "10.0.0.1", &[("forwarded", line)])
    }

    #[test]
    fn the_nearest_address_that_is_no_proxys_is_the_client() {
        assert_eq!(by_x_forwarded_for("10.0.0.1", &["192.0.2.7"]), "192.0.2.7");
        assert_eq!(
            by_x_forwarded_for("10.0.0.1", &["198.51.100.1, 192.0.2.7, 10.3.3.3"]),
            "192.0.2.7",
            "what a client claims is not believed"
        );
        assert_eq!(by_x_forwarded_for("10.0.0.1", &["198.51.100.1", "192.0.2.7", "fd00::9"]), "192.0.2.7", "lines are one list");
        assert_eq!(by_x_forwarded_for("10.0.0.1", &["192.0.2.7:51234"]), "192.0.2.7");
        assert_eq!(by_x_forwarded_for("10.0.0.1", &["[2001:db8::1]:51234"]), "2001:db8::1");
        assert_eq!(by_x_forwarded_for("10.0.0.1", &["::ffff:192.0.2.7"]), "192.0.2.7");
        assert_eq!(by_x_forwarded_for("10.0.0.1", &["10.2.2.2, 10.3.3.3"]), "10.2.2.2", "proxies alone: the first of them asked");
    }

    #[test]
    fn what_names_nobody_ends_the_list() {
        for nobody in ["", "unknown", "192.0.2.7.example", "198.51.100.1, unknown"] {
            assert_eq!(by_x_forwarded_for("10.0.0.1", &[nobody]), "10.0.0.1", "{nobody:?}");
        }
        assert_eq!(by_x_forwarded_for("10.0.0.1", &["198.51.100.1, unknown, 10.3.3.3"]), "10.3.3.3");
        assert_eq!(by_x_forwarded_for("10.0.0.1", &[]), "10.0.0.1");
    }

    #[test]
    fn what_a_client_spoils_hides_nothing_that_a_proxy_wrote_behind_it() {
        let headers = HeaderMap::from_iter([(X_FORWARDED_FOR, HeaderValue::from_bytes(b"\xff, 192.0.2.7").unwrap())]);
        let proxies = Proxies::new(&["10.0.0.0/8".parse().unwrap()], ProxyHeader::XForwardedFor);
        assert_eq!(proxies.client("10.0.0.1".parse().unwrap(), &headers).0.to_string(), "192.0.2.7");
        for open in ["for=9.9.9.9;x=\"", "for=9.9.9.9;x=\"\\", "for=\"9.9.9.9\", x=\"\\\""] {
            assert_eq!(by_forwarded(&format!("{open}, for=192.0.2.7")), "192.0.2.7", "{open}");
            assert_eq!(by_forwarded(&format!("{open}, for=\"192.0.2.7:5555\";proto=https")), "192.0.2.7", "{open}");
        }
    }

    #[test]
    fn nobody_else_and_no_other_header_is_believed() {
        assert_eq!(by_x_forwarded_for("192.0.2.9", &["198.51.100.1"]), "192.0.2.9");
        assert_eq!(client(ProxyHeader::XForwardedFor, "10.0.0.1", &[("forwarded", "for=198.51.100.1")]), "10.0.0.1");
        assert_eq!(client(ProxyHeader::Forwarded, "10.0.0.1", &[("x-forwarded-for", "198.51.100.1")]), "10.0.0.1");
        let nobody = Proxies::default();
        let headers = HeaderMap::from_iter([(X_FORWARDED_FOR, "198.51.100.1".parse().unwrap())]);
        assert_eq!(nobody.client("127.0.0.1".parse().unwrap(), &headers).0.to_string(), "127.0.0.1");
    }

    #[test]
    fn forwarded_is_read_as_its_standard_has_it() {
        assert_eq!(by_forwarded("for=192.0.2.60;proto=http;by=203.0.113.43"), "192.0.2.60");
        assert_eq!(by_forwarded("proto=https; For=\"[2001:db8:cafe::17]:4711\""), "2001:db8:cafe::17");
        assert_eq!(by_forwarded("for=198.51.100.1, for=192.0.2.43;host=\"a,b;for=9.9.9.9\", for=10.2.2.2"), "192.0.2.43");
        assert_eq!(by_forwarded("for=192.0.2.43, for=_hidden"), "10.0.0.1");
        assert_eq!(by_forwarded("for=\"192.0.2.43"), "10.0.0.1");
        assert_eq!(by_forwarded("host=\"\\\"\", for=192.0.2.44"), "192.0.2.44");
    }
}
