//! The span that a request says it belongs to, as W3C Trace Context writes it. Anyone may send anything: what is not exactly so is no parent. The
//! header `tracestate` is not read, as it may hold any text.

use super::origins::Origin;
use opentelemetry::trace::{SpanContext, SpanId, TraceFlags, TraceId, TraceState};

/// Length of the header in the version that there is.
const LENGTH: usize = 55;

/// The parent that the values of the header `traceparent` name; none if there are several, or none that can be read.
pub fn parent<'a>(values: impl IntoIterator<Item = &'a [u8]>) -> Option<Origin> {
    let mut values = values.into_iter();
    let value = values.next()?;
    if values.next().is_some() {
        return None;
    }
    let (head, rest) = value.split_at_checked(LENGTH)?;
    let text = std::str::from_utf8(head).ok()?;
    let hexadecimal = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    let in_place = |(index, byte): (usize, u8)| if matches!(index, 2 | 35 | 52) { byte == b'-' } else { hexadecimal(byte) };
    if !text.bytes().enumerate().all(in_place) {
        return None;
    }
    // Later versions may add to it, after another hyphen.
    let well_ended = match &text[..2] {
        "00" => rest.is_empty(),
        "ff" => false,
        _ => rest.first().is_none_or(|byte| *byte == b'-'),
    };
    if !well_ended {
        return None;
    }
    let flags = TraceFlags::new(u8::from_str_radix(&text[53..], 16).ok()?) & TraceFlags::SAMPLED;
    let (trace, span) = (TraceId::from_hex(&text[3..35]).ok()?, SpanId::from_hex(&text[36..52]).ok()?);
    Origin::of(&SpanContext::new(trace, span, flags, true, TraceState::NONE))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
    const SPAN: &str = "b7ad6b7169203331";

    fn read(value: &str) -> Option<SpanContext> {
        parent([value.as_bytes()]).map(SpanContext::from)
    }

    #[test]
    fn what_the_standard_has_is_read() {
        for (value, sampled) in [
            (format!("00-{TRACE}-{SPAN}-01"), true),
            (format!("00-{TRACE}-{SPAN}-00"), false),
            (format!("00-{TRACE}-{SPAN}-fe"), false),
            (format!("cc-{TRACE}-{SPAN}-03-what-the-future-brings"), true),
            (format!("cc-{TRACE}-{SPAN}-01"), true),
        ] {
            let context = read(&value).unwrap_or_else(|| panic!("{value}"));
            assert_eq!((context.trace_id().to_string(), context.span_id().to_string()), (TRACE.to_owned(), SPAN.to_owned()));
            assert_eq!(
                (context.is_sampled(), context.is_remote(), context.trace_state().header()),
                (sampled, true, String::new()),
                "{value}"
            );
        }
    }

    #[test]
    fn everything_else_is_no_parent() {
        for value in [
            String::new(),
            format!("00-{TRACE}-{SPAN}"),
            format!("00-{TRACE}-{SPAN}-0"),
            format!("00-{TRACE}-{SPAN}-01-"),
            format!("00-{TRACE}-{SPAN}-01 "),
            format!("ff-{TRACE}-{SPAN}-01"),
            format!("cc-{TRACE}-{SPAN}-01.later"),
            format!("00-{}-{SPAN}-01", TRACE.to_uppercase()),
            format!("00-{}-{SPAN}-01", "0".repeat(32)),
            format!("00-{TRACE}-{}-01", "0".repeat(16)),
            format!("00-+{}-{SPAN}-01", &TRACE[1..]),
            format!("00-{TRACE}-{SPAN}-+1"),
            format!("00-{}é-{SPAN}-01", &TRACE[2..]),
            "DOE^JANE".repeat(9),
        ] {
            assert_eq!(read(&value), None, "{value}");
        }
        let twice = format!("00-{TRACE}-{SPAN}-01");
        assert!(parent([twice.as_bytes(), twice.as_bytes()]).is_none() && parent([]).is_none());
    }
}
