//! Names under which a service that asks nobody who he is may be called.

use std::net::IpAddr;

/// Such names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Hosts {
    /// All.
    Any,
    /// Those that a machine has for itself, and these.
    Own(Vec<String>),
}

impl Hosts {
    /// Whether a name, without a port, is one of them.
    pub fn include(&self, host: &str) -> bool {
        let Self::Own(more) = self else { return true };
        let host = host.strip_suffix('.').unwrap_or(host);
        let address = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
        if let Ok(address) = address.parse::<IpAddr>()
            && address.to_canonical().is_loopback()
        {
            return true;
        }
        // RFC 6761 6.3: names below it lead to the machine itself too.
        let last_label = host.rsplit('.').next().unwrap_or_default();
        last_label.eq_ignore_ascii_case("localhost") || more.iter().any(|name| name.eq_ignore_ascii_case(host))
    }
}

/// A name or an address of a host, without scheme and port, or `*`.
pub(super) fn host(text: &str) -> Result<String, String> {
    let address = text.strip_prefix('[').and_then(|text| text.strip_suffix(']'));
    let is_name = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
    if text == "*" || is_name || address.is_some_and(|address| address.parse::<IpAddr>().is_ok()) {
        return Ok(text.to_owned());
    }
    Err("give a name as `viewer.hospital.example`, or an address (`[fd00::1]`), without scheme and port, or `*` for any.".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_has_names_for_itself() {
        let own = Hosts::Own(vec!["Viewer.example".to_owned(), "[fd00::1]".to_owned()]);
        for ours in [
            "localhost",
            "LOCALHOST.",
            "a.localhost",
            "127.0.0.1",
            "127.9.9.9",
            "[::1]",
            "[::ffff:127.0.0.1]",
            "viewer.EXAMPLE",
            "[fd00::1]",
        ] {
            assert!(own.include(ours), "{ours}");
        }
        for other in ["", "localhost.example", "notlocalhost", "127.0.0.1.example", "10.0.0.1", "[fd00::2]", "0.0.0.0", "x.viewer.example"]
        {
            assert!(!own.include(other), "{other}");
        }
        assert!(Hosts::Any.include("anything"));
    }

    #[test]
    fn names_are_given_without_scheme_and_port() {
        for right in ["viewer.example", "10.0.0.1", "[fd00::1]", "*"] {
            assert_eq!(host(right).as_deref(), Ok(right));
        }
        for wrong in ["", "http://viewer.example", "viewer.example:8080", "fd00::1", "a b", "*.example"] {
            assert!(host(wrong).is_err(), "{wrong}");
        }
    }
}
