//! The value of the header `Authorization`.

use base64::{Engine as _, engine::general_purpose::STANDARD};

/// Longest value that is looked at: tokens of providers with many claims have some kilobytes.
const LONGEST: usize = 8 << 10;

/// Why the value cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unreadable {
    /// Too long.
    #[error("The header Authorization has {0} bytes; at most {LONGEST} are read.")]
    TooLong(usize),
    /// Another scheme.
    #[error(
        "The header Authorization has another scheme than Bearer and Basic, or no value after it. Send `Authorization: Bearer …` with an API key or a token."
    )]
    Scheme,
    /// Not what Basic says.
    #[error(
        "The header Authorization says Basic but is not base64 of a name, a colon and a password. The password is the API key; the name does not matter."
    )]
    Basic,
}

/// What a caller presents.
#[derive(Clone, PartialEq, Eq)]
pub enum Presented {
    /// `Bearer`: an API key or a token.
    Bearer(String),
    /// `Basic`: the password, an API key. The name is not looked at. Browsers send it by themselves.
    Basic(String),
}

impl Presented {
    /// Reads the value (RFC 6750, RFC 7617).
    ///
    /// # Errors
    /// [`Unreadable`].
    pub fn read(value: &[u8]) -> Result<Self, Unreadable> {
        if value.len() > LONGEST {
            return Err(Unreadable::TooLong(value.len()));
        }
        let text = std::str::from_utf8(value).map_err(|_| Unreadable::Scheme)?;
        let (scheme, rest) = text.trim().split_once(' ').ok_or(Unreadable::Scheme)?;
        let rest = rest.trim();
        if scheme.eq_ignore_ascii_case("bearer") && !rest.is_empty() {
            return Ok(Self::Bearer(rest.to_owned()));
        }
        if !scheme.eq_ignore_ascii_case("basic") {
            return Err(Unreadable::Scheme);
        }
        let decoded = STANDARD.decode(rest).ok().and_then(|bytes| String::from_utf8(bytes).ok()).ok_or(Unreadable::Basic)?;
        let (_, password) = decoded.split_once(':').ok_or(Unreadable::Basic)?;
        Ok(Self::Basic(password.to_owned()))
    }

    /// The key or token.
    pub(super) fn secret(&self) -> &str {
        match self {
            Self::Bearer(secret) | Self::Basic(secret) => secret,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(value: &str) -> Result<Presented, Unreadable> {
        Presented::read(value.as_bytes())
    }

    #[test]
    fn both_schemes_are_read_whatever_their_case() {
        assert!(read("Bearer abc") == Ok(Presented::Bearer("abc".to_owned())));
        assert!(read("bearer  abc ") == Ok(Presented::Bearer("abc".to_owned())));
        let basic = format!("BASIC {}", STANDARD.encode("pacs:a:b"));
        assert!(read(&basic) == Ok(Presented::Basic("a:b".to_owned())));
    }

    #[test]
    fn what_cannot_be_read_is_told_apart() {
        assert!(read("Bearer") == Err(Unreadable::Scheme));
        assert!(read("Bearer  ") == Err(Unreadable::Scheme));
        assert!(read("Digest x=1") == Err(Unreadable::Scheme));
        assert!(read("Basic !") == Err(Unreadable::Basic));
        assert!(read(&format!("Basic {}", STANDARD.encode("no colon"))) == Err(Unreadable::Basic));
        assert!(read(&format!("Bearer {}", "x".repeat(LONGEST))) == Err(Unreadable::TooLong(LONGEST + 7)));
        assert!(Presented::read(b"Bearer \xff") == Err(Unreadable::Scheme));
    }
}
