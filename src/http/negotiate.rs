//! What a client says in headers about the answer it wants: media types, conditions, preferences.

use axum::http::{HeaderMap, HeaderName, header};
use std::time::Duration;

/// Longest wait a client can ask for: below the idle time-outs of common proxies (60 s).
const LONGEST_WAIT: Duration = Duration::from_secs(30);

/// The client accepts nothing of what is offered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("Here is only {offered}, which the header Accept of the request does not allow.")]
pub(super) struct NotAcceptable {
    /// The one media type there is.
    pub offered: &'static str,
}

/// Whether `Accept` (RFC 9110 §12.5.1) allows the one media type there is. No header, or one that lists nothing, allows everything. The most specific range decides.
pub(super) fn acceptable(headers: &HeaderMap, offered: &'static str) -> Result<(), NotAcceptable> {
    let listed = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).flat_map(|line| line.split(','));
    let mut listed = listed.filter(|entry| !entry.trim().is_empty()).peekable();
    if listed.peek().is_none() {
        return Ok(());
    }
    let family = offered.split('/').next().unwrap_or_default();
    let mut decision: Option<(u8, bool)> = None;
    for entry in listed {
        let mut pieces = entry.split(';').map(str::trim);
        let range = pieces.next().unwrap_or_default().to_ascii_lowercase();
        let refused = pieces.any(|piece| piece.strip_prefix("q=").is_some_and(|q| q.parse::<f32>().is_ok_and(|q| q == 0.0)));
        let specific = match range.as_str() {
            "*/*" => 0,
            range if range.strip_suffix("/*") == Some(family) => 1,
            range if range == offered => 2,
            _ => continue,
        };
        if decision.is_none_or(|(before, _)| specific >= before) {
            decision = Some((specific, !refused));
        }
    }
    if decision.is_some_and(|(_, allowed)| allowed) { Ok(()) } else { Err(NotAcceptable { offered }) }
}

/// The first of several media types for the same content that `Accept` allows; in the error the first of all.
pub(super) fn first_acceptable(headers: &HeaderMap, offered: &[&'static str]) -> Result<&'static str, NotAcceptable> {
    let allowed = offered.iter().copied().find(|media_type| acceptable(headers, media_type).is_ok());
    allowed.ok_or(NotAcceptable { offered: offered.first().copied().unwrap_or_default() })
}

/// Whether `Accept-Encoding` (RFC 9110 §12.5.3) allows a coding. No header allows none.
pub(super) fn accepts_coding(headers: &HeaderMap, coding: &str) -> bool {
    let listed = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok()).flat_map(|line| line.split(','));
    let mut of_all = false;
    for entry in listed {
        let mut pieces = entry.split(';').map(str::trim);
        let name = pieces.next().unwrap_or_default();
        let refused = pieces.any(|piece| piece.strip_prefix("q=").is_some_and(|q| q.parse::<f32>().is_ok_and(|q| q == 0.0)));
        if name.eq_ignore_ascii_case(coding) {
            return !refused;
        }
        of_all |= name == "*" && !refused;
    }
    of_all
}

/// Whether `If-None-Match` names this entity tag (weak comparison, RFC 9110 §13.1.2).
pub(super) fn none_match(headers: &HeaderMap, etag: &str) -> bool {
    let opaque = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    let wanted = opaque(etag);
    let mut listed = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok()).flat_map(|line| line.split(','));
    listed.any(|tag| tag.trim() == "*" || opaque(tag) == wanted)
}

/// The time of `Prefer: wait=N` (RFC 7240 §4.3), at most [`LONGEST_WAIT`].
pub(super) fn wait(headers: &HeaderMap) -> Option<Duration> {
    let prefer = HeaderName::from_static("prefer");
    let mut listed = headers.get_all(prefer).iter().filter_map(|value| value.to_str().ok()).flat_map(|line| line.split([',', ';']));
    let seconds = listed.find_map(|preference| {
        let (name, value) = preference.split_once('=')?;
        name.trim().eq_ignore_ascii_case("wait").then(|| value.trim().trim_matches('"').parse::<u64>().ok())?
    })?;
    Some(Duration::from_secs(seconds).min(LONGEST_WAIT))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: &'static str, value: &str) -> HeaderMap {
        HeaderMap::from_iter([(HeaderName::from_static(name), value.parse().unwrap())])
    }

    #[test]
    fn accept_is_read_as_http_says() {
        assert!(acceptable(&HeaderMap::new(), "application/json").is_ok());
        for (accept, allowed) in [
            ("", true),
            (" , ", true),
            ("*/*", true),
            ("application/json", true),
            ("application/*;q=0.1", true),
            ("text/html, application/xhtml+xml, */*;q=0.8", true),
            ("Application/JSON; charset=utf-8", true),
            ("text/html", false),
            ("model/gltf-binary", false),
            ("*/*, application/json;q=0", false),
            ("application/json, */*;q=0", true),
        ] {
            assert_eq!(acceptable(&headers("accept", accept), "application/json").is_ok(), allowed, "{accept}");
        }
    }

    #[test]
    fn entity_tags_are_compared_weakly() {
        for (sent, matches) in [("\"a\"", true), ("W/\"a\"", true), ("\"b\", W/\"a\"", true), ("*", true), ("\"b\"", false), ("a", false)] {
            assert_eq!(none_match(&headers("if-none-match", sent), "W/\"a\""), matches, "{sent}");
        }
        assert!(!none_match(&HeaderMap::new(), "\"a\""));
    }

    #[test]
    fn codings_are_allowed_by_name_or_by_all() {
        for (sent, allowed) in [
            ("gzip, deflate, br", true),
            ("BR;q=0.5", true),
            ("*", true),
            ("br;q=0, *", false),
            ("*, br;q=0.0", false),
            ("*;q=0", false),
            ("gzip", false),
            ("", false),
        ] {
            assert_eq!(accepts_coding(&headers("accept-encoding", sent), "br"), allowed, "{sent}");
        }
        assert!(!accepts_coding(&HeaderMap::new(), "br"));
    }

    #[test]
    fn waiting_is_capped() {
        for (sent, seconds) in [
            ("wait=5", Some(5)),
            ("respond-async, wait=10", Some(10)),
            ("Wait = \"7\"", Some(7)),
            ("wait=9999", Some(30)),
            ("wait=-1", None),
            ("waiting=3", None),
        ] {
            assert_eq!(wait(&headers("prefer", sent)), seconds.map(Duration::from_secs), "{sent}");
        }
    }
}
