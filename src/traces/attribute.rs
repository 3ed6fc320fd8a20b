//! What may be said of a span: the list, and the type that nothing else can get past. Names are those of OpenTelemetry's semantic conventions where they
//! have one.

use opentelemetry::{KeyValue, Value};
use std::time::Duration;
use uuid::Uuid;

/// Name of the attribute with the code of what went wrong.
pub const ERROR_CODE: &str = "error.type";

/// The method of a request. What a client invents is not told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Method(Option<&'static str>);

impl Method {
    /// The methods that have a name of their own.
    const KNOWN: [&'static str; 9] = ["CONNECT", "DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT", "TRACE"];

    /// The method of this name.
    pub fn named(name: &str) -> Self {
        Self(Self::KNOWN.into_iter().find(|known| *known == name))
    }

    /// Its name, if it is none that a client has invented.
    pub(super) fn known(self) -> Option<&'static str> {
        self.0
    }
}

/// One thing that is said of a span.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute {
    /// The method of a request.
    RequestMethod(Method),
    /// The route that it took, as it is written in this program.
    HttpRoute(String),
    /// The status that it was answered.
    ResponseStatus(u16),
    /// `http` or `https`.
    UrlScheme(&'static str),
    /// A job: an id that is made here, of time and chance.
    JobId(Uuid),
    /// Which attempt at it.
    JobAttempt(i64),
    /// The preset it is reconstructed by.
    JobPreset(&'static str),
    /// From its acceptance to this attempt.
    JobWait(Duration),
    /// What the attempt came to.
    JobOutcome(&'static str),
    /// What went wrong: a status of HTTP, or a code of this program.
    ErrorCode(String),
    /// How often a stage ran: once for the study, or for gates and surfaces.
    StageRuns(u64),
    /// The time that these runs took together, of which several may have been at once.
    StageBusy(Duration),
}

impl Attribute {
    /// The names of all there are.
    pub const NAMES: [&'static str; 12] = [
        "http.request.method",
        "http.route",
        "http.response.status_code",
        "url.scheme",
        "ventricle.job.id",
        "ventricle.job.attempt",
        "ventricle.job.preset",
        "ventricle.job.wait_s",
        "ventricle.job.outcome",
        ERROR_CODE,
        "ventricle.stage.runs",
        "ventricle.stage.busy_s",
    ];

    /// The name of this one.
    pub fn name(&self) -> &'static str {
        Self::NAMES[match self {
            Self::RequestMethod(_) => 0,
            Self::HttpRoute(_) => 1,
            Self::ResponseStatus(_) => 2,
            Self::UrlScheme(_) => 3,
            Self::JobId(_) => 4,
            Self::JobAttempt(_) => 5,
            Self::JobPreset(_) => 6,
            Self::JobWait(_) => 7,
            Self::JobOutcome(_) => 8,
            Self::ErrorCode(_) => 9,
            Self::StageRuns(_) => 10,
            Self::StageBusy(_) => 11,
        }]
    }
}

impl From<Attribute> for KeyValue {
    fn from(attribute: Attribute) -> Self {
        let name = attribute.name();
        let value: Value = match attribute {
            Attribute::RequestMethod(method) => method.known().unwrap_or("_OTHER").into(),
            Attribute::HttpRoute(text) | Attribute::ErrorCode(text) => text.into(),
            Attribute::ResponseStatus(status) => i64::from(status).into(),
            Attribute::UrlScheme(text) | Attribute::JobPreset(text) | Attribute::JobOutcome(text) => text.into(),
            Attribute::JobId(id) => id.to_string().into(),
            Attribute::JobAttempt(number) => number.into(),
            Attribute::StageRuns(number) => (number as i64).into(),
            Attribute::JobWait(time) | Attribute::StageBusy(time) => time.as_secs_f64().into(),
        };
        Self::new(name, value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invented_method_is_not_told() {
        let told = |name| KeyValue::from(Attribute::RequestMethod(Method::named(name))).value.to_string();
        assert_eq!((told("GET").as_str(), told("get").as_str(), told("DOE^JANE").as_str()), ("GET", "_OTHER", "_OTHER"));
    }

    #[test]
    fn every_name_belongs_to_one_attribute() {
        let (text, time) = (String::new, Duration::ZERO);
        let all = [
            Attribute::RequestMethod(Method::named("GET")),
            Attribute::HttpRoute(text()),
            Attribute::ResponseStatus(200),
            Attribute::UrlScheme("http"),
            Attribute::JobId(Uuid::nil()),
            Attribute::JobAttempt(1),
            Attribute::JobPreset("paper"),
            Attribute::JobWait(time),
            Attribute::JobOutcome("lost"),
            Attribute::ErrorCode(text()),
            Attribute::StageRuns(1),
            Attribute::StageBusy(time),
        ];
        assert_eq!(all.map(|attribute| attribute.name()), Attribute::NAMES);
    }
}
