//! Which pages may make a browser ask: what a service that asks nobody who he is, or that is asked with what browsers send by themselves, must know.
//!
//! A browser goes wherever a page sends it, also to the service on its own machine. It says whose page it was (`Sec-Fetch-Site`, `Origin`), and under
//! which name it came (`Host`): a page whose name leads here for the moment (DNS rebinding) is of the same site by the first two, and not by the third.

use super::problem::Problem;
use crate::config::{Cors, Hosts};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header, uri::Authority};

/// Characters of a name that are repeated to the client.
const SHOWN_CHARACTERS: usize = 80;

/// Lets in who is asked for nothing, unless it came under a name that is none of these, or would change something for the page of another site that
/// may not call.
pub(super) fn admit(hosts: &Hosts, pages: &Cors, method: &Method, uri: &Uri, headers: &HeaderMap) -> Result<(), Problem> {
    // A browser always has a name; without one it is none.
    if let Some(named) = named(uri, headers)
        && !hosts.include(host(&named))
    {
        return Err(not_this_host(&named));
    }
    if method.is_safe() || !from_elsewhere(uri, headers) || may_call(pages, headers) {
        return Ok(());
    }
    let detail = "A page of another site made the browser send this to a service that asks nobody who he is. If that page may do so, the operator \
                  names its origin with --cors-origin; a proxy before the service must pass on the header Host.";
    Err(Problem::new(StatusCode::FORBIDDEN, "cross_site_request", detail))
}

/// Whether the operator lets the page call that a request is of.
fn may_call(pages: &Cors, headers: &HeaderMap) -> bool {
    match pages {
        Cors::Off => false,
        Cors::Any => true,
        Cors::Origins(origins) => headers.get(header::ORIGIN).is_some_and(|origin| origins.iter().any(|one| one.as_bytes() == origin)),
    }
}

fn not_this_host(named: &str) -> Problem {
    let named: String = named.chars().take(SHOWN_CHARACTERS).collect();
    let detail = format!(
        "The request is for `{named}`, and this service, which asks nobody who he is, is called by the names of its own machine only: localhost, \
         127.0.0.1, [::1]. Use one of these; if it is reached by another name, the operator gives that with --allowed-host."
    );
    Problem::new(StatusCode::FORBIDDEN, "host_not_allowed", detail)
}

/// Whether a browser says that another site's page made it send this: by Fetch Metadata, which it sends over TLS and to the machine itself, else by
/// `Origin`.
pub(super) fn from_elsewhere(uri: &Uri, headers: &HeaderMap) -> bool {
    if let Some(site) = headers.get("sec-fetch-site").map(HeaderValue::as_bytes) {
        return site != b"same-origin" && site != b"none";
    }
    let Some(origin) = headers.get(header::ORIGIN) else { return false };
    let origin = origin.to_str().ok().and_then(|origin| origin.split_once("://")).map(|(_, authority)| authority);
    // `null` is nobody's own.
    !origin.zip(named(uri, headers)).is_some_and(|(origin, named)| origin.eq_ignore_ascii_case(&named))
}

/// Whom the request is for, as its client has it. What is no text is nobody's name.
fn named(uri: &Uri, headers: &HeaderMap) -> Option<String> {
    let of_header = || headers.get(header::HOST).map(|host| String::from_utf8_lossy(host.as_bytes()).into_owned());
    uri.authority().map(Authority::to_string).or_else(of_header)
}

/// A name without its port.
fn host(named: &str) -> &str {
    match named.rsplit_once(':') {
        Some((host, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) && !host.ends_with(':') => host,
        _ => named,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(pages: &Cors, method: &Method, headers: &[(&'static str, &str)]) -> Result<(), String> {
        let headers = headers.iter().map(|(name, value)| (header::HeaderName::from_static(name), value.parse().unwrap())).collect();
        admit(&Hosts::Own(vec![]), pages, method, &Uri::from_static("/v1/reconstructions"), &headers).map_err(|problem| problem.code)
    }

    #[test]
    fn a_name_is_looked_at_without_its_port() {
        for (named, without) in
            [("localhost:8080", "localhost"), ("[::1]:80", "[::1]"), ("[::1]", "[::1]"), ("a.example", "a.example"), ("::1", "::1")]
        {
            assert_eq!(host(named), without);
        }
        for named in ["localhost:8080", "127.0.0.1:1", "[::1]:8080"] {
            assert_eq!(answer(&Cors::Off, &Method::GET, &[("host", named)]), Ok(()), "{named}");
        }
        for named in ["rebound.example:8080", "localhost:8080@evil.example", "user@localhost", "127.0.0.1.example"] {
            assert_eq!(answer(&Cors::Off, &Method::GET, &[("host", named)]), Err("host_not_allowed".to_owned()), "{named}");
        }
        assert_eq!(answer(&Cors::Off, &Method::GET, &[]), Ok(()), "no browser");
    }

    #[test]
    fn pages_of_other_sites_change_nothing_unless_they_may() {
        let own = [("host", "localhost:8080"), ("origin", "http://localhost:8080")];
        let other = [("host", "localhost:8080"), ("origin", "https://a.example")];
        let told = [("host", "localhost:8080"), ("origin", "https://a.example"), ("sec-fetch-site", "cross-site")];
        let neighbour = [("host", "localhost:8080"), ("origin", "http://localhost:3000"), ("sec-fetch-site", "same-site")];
        let nobody = [("host", "localhost:8080"), ("origin", "null")];
        for right in [&own[..], &[own[0]], &[own[0], ("sec-fetch-site", "none")]] {
            assert_eq!(answer(&Cors::Off, &Method::POST, right), Ok(()), "{right:?}");
        }
        let allowed = Cors::Origins(vec!["https://a.example".to_owned()]);
        for page in [&other[..], &told, &neighbour, &nobody] {
            for method in [Method::POST, Method::DELETE] {
                assert_eq!(answer(&Cors::Off, &method, page), Err("cross_site_request".to_owned()), "{page:?}");
            }
            assert_eq!(answer(&Cors::Off, &Method::GET, page), Ok(()), "it cannot read what comes back: {page:?}");
            assert_eq!(answer(&Cors::Any, &Method::POST, page), Ok(()));
            let may = page[1].1 == "https://a.example";
            assert_eq!(answer(&allowed, &Method::POST, page).is_ok(), may, "{page:?}");
        }
    }
}
