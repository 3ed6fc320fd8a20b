//! Where results go: an address of the operator's, judged by the rules of callbacks.

use super::{
    allow::Allowed,
    target::{Target, TargetError},
};
use crate::dimse::Title;

/// How a DICOM destination begins.
const DICOM: &str = "dicom://";

/// Where results go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Destination {
    /// Posted there by STOW-RS (PS3.18 10.5).
    Stow(Target),
    /// Sent there by C-STORE (PS3.4 B).
    Store {
        /// The receiver's AE title.
        called: Title,
        /// Its host and port.
        target: Target,
    },
}

/// Why results cannot go there. Each says what was given and what to give.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DestinationError {
    /// The URL may not be called.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// It names no application.
    #[error("names no AE title of 1 to 16 characters; give dicom://TITLE@host:port.")]
    NoTitle,
    /// It names no port, or more than a host and a port.
    #[error("names no host and port; give dicom://TITLE@host:port.")]
    NoPort,
    /// DICOM to a host that is not on the list.
    #[error("is DICOM, unencrypted, to `{host}`, which is accepted only to hosts that the operator allows (--callback-allow).")]
    NotAllowed {
        /// The host.
        host: String,
    },
}

impl Destination {
    /// Reads and checks `https://host/path`, or `dicom://TITLE@host:port`, which is allowed where http is.
    pub fn parse(text: &str, allowed: &Allowed) -> Result<Self, DestinationError> {
        let Some(place) = text.strip_prefix(DICOM) else { return Ok(Self::Stow(Target::parse(text, allowed)?)) };
        let (title, place) = place.rsplit_once('@').ok_or(DestinationError::NoTitle)?;
        let called = Title::parse(title).ok_or(DestinationError::NoTitle)?;
        let place = place.trim_end_matches('/');
        let port = place.rsplit_once(':').and_then(|(_, port)| port.parse::<u16>().ok());
        if port.is_none() || place.contains(['/', '?', '#', '@']) {
            return Err(DestinationError::NoPort);
        }
        let target = Target::parse(&format!("http://{place}/"), allowed).map_err(|error| match error {
            TargetError::NotSecure { host } => DestinationError::NotAllowed { host },
            error => error.into(),
        })?;
        Ok(Self::Store { called, target })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Destination, DestinationError> {
        Destination::parse(text, &Allowed::parse(["pacs.example:104", "10.0.0.0/8"]).unwrap())
    }

    #[test]
    fn both_kinds_are_read_and_judged_as_callbacks_are() {
        assert!(matches!(parse("https://archive.example/dicom-web/studies"), Ok(Destination::Stow(_))));
        for right in ["dicom://PACS@pacs.example:104", "dicom://PACS@10.1.2.3:11112/", "dicom://A B@pacs.example:104"] {
            assert!(matches!(parse(right), Ok(Destination::Store { .. })), "{right}");
        }
        let Ok(Destination::Store { target, .. }) = parse("dicom://PACS@10.1.2.3:80") else { panic!() };
        assert_eq!(target.port, 80);
    }

    #[test]
    fn everything_else_is_refused_for_its_reason() {
        for (wrong, reason) in [
            ("dicom://pacs.example:104", "no AE title"),
            ("dicom://@pacs.example:104", "no AE title"),
            ("dicom://SEVENTEEN_LETTERS@pacs.example:104", "no AE title"),
            ("dicom://PACS@pacs.example", "no host and port"),
            ("dicom://PACS@pacs.example:104/path", "no host and port"),
            ("dicom://PACS@pacs.example:0", "not an absolute URL"),
            ("dicom://PACS@pacs.example:11112", "unencrypted"),
            ("dicom://PACS@8.8.8.8:104", "unencrypted"),
            ("dicom://PACS@192.168.1.1:104", "which is private"),
            ("http://archive.example/studies", "is http to"),
            ("ftp://archive.example/", "the scheme `ftp`"),
        ] {
            let error = parse(wrong).unwrap_err().to_string();
            assert!(error.contains(reason), "{wrong}: {error}");
        }
    }
}
