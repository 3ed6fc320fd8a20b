//! A callback's URL: what is asked of it before anyone connects.

use super::allow::Allowed;
use std::net::IpAddr;
use url::{Host, Position, Url};

/// Longest URL: what common servers and proxies pass on.
pub(super) const LONGEST_URL: usize = 2048;

/// A URL that may be called, as far as the URL itself can tell; where its name leads is judged when it is resolved.
#[derive(Clone, PartialEq, Eq)]
pub struct Target {
    /// Whether with TLS.
    pub(super) secure: bool,
    pub(super) host: Host<String>,
    pub(super) port: u16,
    /// Host, and port where it is not the scheme's, as the header `Host` has it.
    pub(super) authority: String,
    /// Path and query.
    pub(super) path: String,
    /// Whether the operator named the host: its addresses may be any.
    pub(super) named: bool,
}

impl std::fmt::Debug for Target {
    /// Without path and query, which may hold what only the receiver should know.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Target").field("authority", &self.authority).finish_non_exhaustive()
    }
}

/// Why a URL is not called. Each says what was given and what to give.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TargetError {
    /// Longer than accepted.
    #[error("has {length} characters; at most {LONGEST_URL} are accepted.")]
    TooLong {
        /// Its bytes.
        length: usize,
    },
    /// No URL.
    #[error("is not an absolute URL: {why}. Send one as https://receiver.example/path.")]
    NotAUrl {
        /// What the parser met.
        why: String,
    },
    /// Another scheme.
    #[error("has the scheme `{scheme}`; send one that begins with https://.")]
    Scheme {
        /// What was given.
        scheme: String,
    },
    /// http to a host that is not on the list.
    #[error(
        "is http to `{host}`; http is accepted only to hosts that the operator allows (--callback-allow). Send one that begins with https://."
    )]
    NotSecure {
        /// The host.
        host: String,
    },
    /// User or password.
    #[error("holds a user name or password. Leave them out: callbacks are signed, see `Ventricle-Signature`.")]
    UserInfo,
    /// A fragment.
    #[error("has a fragment (`#…`), which is never sent. Leave it out.")]
    Fragment,
    /// An address that is not public.
    #[error(
        "leads to {address}, which is {why} and no address of the public internet; it is called only if the operator allows it \
         (--callback-allow)."
    )]
    Address {
        /// The address.
        address: IpAddr,
        /// What it is.
        why: &'static str,
    },
}

impl Target {
    /// Reads and checks a URL.
    pub fn parse(text: &str, allowed: &Allowed) -> Result<Self, TargetError> {
        if text.len() > LONGEST_URL {
            return Err(TargetError::TooLong { length: text.len() });
        }
        // The parser would drop some of these in silence: what is called should be what was sent.
        if text.chars().any(|letter| letter.is_whitespace() || letter.is_control()) {
            return Err(TargetError::NotAUrl { why: "it holds white space".to_owned() });
        }
        let url = Url::parse(text).map_err(|error| TargetError::NotAUrl { why: error.to_string() })?;
        if !matches!(url.scheme(), "https" | "http") {
            return Err(TargetError::Scheme { scheme: url.scheme().chars().take(32).collect() });
        }
        if !url.username().is_empty() || url.password().is_some() {
            return Err(TargetError::UserInfo);
        }
        if url.fragment().is_some() {
            return Err(TargetError::Fragment);
        }
        let no_place = || TargetError::NotAUrl { why: "it names no host and port".to_owned() };
        let host = url.host().ok_or_else(no_place)?.to_owned();
        let port = url.port_or_known_default().filter(|port| *port != 0).ok_or_else(no_place)?;
        let address = match &host {
            Host::Domain(_) => None,
            Host::Ipv4(address) => Some(IpAddr::from(*address)),
            Host::Ipv6(address) => Some(IpAddr::from(*address)),
        };
        if let Some(address) = address
            && let Some(why) = allowed.refusal(address, port)
        {
            return Err(TargetError::Address { address, why });
        }
        let named = matches!(&host, Host::Domain(name) if allowed.names(name, port));
        let secure = url.scheme() == "https";
        if !secure && !named && !address.is_some_and(|address| allowed.has(address, port)) {
            return Err(TargetError::NotSecure { host: host.to_string() });
        }
        let authority = url[Position::BeforeHost..Position::AfterPort].to_owned();
        let path = url[Position::BeforePath..Position::AfterQuery].to_owned();
        Ok(Self { secure, host, port, authority, path, named })
    }

    /// Whether it is called with TLS.
    pub fn secure(&self) -> bool {
        self.secure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(url: &str) -> Result<Target, TargetError> {
        Target::parse(url, &Allowed::parse(["inside.example:8080", "10.1.0.0/16"]).unwrap())
    }

    #[test]
    fn public_https_and_what_is_allowed_pass() {
        let target = parse("https://Hooks.Example/done?token=a%20b").unwrap();
        assert_eq!((target.secure, target.port, target.named), (true, 443, false));
        assert_eq!((target.authority.as_str(), target.path.as_str()), ("hooks.example", "/done?token=a%20b"));
        assert!(!format!("{target:?}").contains("token"));
        assert_eq!(parse("https://hooks.example:8443").unwrap().path, "/");
        assert!(parse("http://inside.example:8080/x").unwrap().named);
        assert!(!parse("http://10.1.2.3/x").unwrap().secure);
        assert!(parse("https://8.8.8.8/").is_ok() && parse("https://[2606:4700::1111]/").is_ok());
    }

    #[test]
    fn everything_else_is_refused_for_its_reason() {
        let refused = |url: &str| parse(url).unwrap_err().to_string();
        for (url, reason) in [
            ("http://hooks.example/", "is http to `hooks.example`"),
            ("http://inside.example/", "is http"),
            ("http://8.8.8.8/", "is http to `8.8.8.8`"),
            ("ftp://hooks.example/", "has the scheme `ftp`"),
            ("file:///etc/passwd", "has the scheme `file`"),
            ("https://user@hooks.example/", "user name or password"),
            ("https://:pw@hooks.example/", "user name or password"),
            ("https://hooks.example/#top", "fragment"),
            ("hooks.example/done", "not an absolute URL"),
            ("/done", "not an absolute URL"),
            ("https://", "not an absolute URL"),
            ("https://hooks.example:0/", "not an absolute URL"),
            ("https://hooks.example/a\tb", "white space"),
            ("https://127.0.0.1/", "127.0.0.1, which is loopback"),
            ("http://10.2.0.1/", "10.2.0.1, which is private"),
            // What people write to get round such rules; the URL standard makes addresses of them.
            ("https://127.1/", "which is loopback"),
            ("https://2130706433/", "which is loopback"),
            ("https://0x7f.0.0.1/", "which is loopback"),
            ("https://0177.0.0.1/", "which is loopback"),
            ("https://127。0。0。1/", "which is loopback"),
            ("https://[::ffff:127.0.0.1]/", "which is loopback"),
            ("https://[::1]:8443/", "which is loopback"),
            ("https://169.254.169.254/latest/meta-data/", "which is link-local"),
            ("https://[64:ff9b::a9fe:a9fe]/", "NAT64"),
        ] {
            assert!(refused(url).contains(reason), "{url}: {}", refused(url));
        }
        let long = format!("https://hooks.example/{}", "a".repeat(LONGEST_URL));
        assert!(refused(&long).contains("at most 2048"));
        assert!(parse(&long[..LONGEST_URL]).is_ok());
    }
}
