//! Problem documents (RFC 9457): the one shape of every refusal, and the only place where errors of the layers below become status codes.

use super::{
    body::BodyError,
    health::Checks,
    negotiate::NotAcceptable,
    uploads::{RETRY_AFTER_S, UploadsFull},
};
use crate::{
    access::OverLimit,
    archive::ArchiveError,
    export::ExportError,
    intake::{IntakeError, Nature, sentence},
    jobs::{Job, JobError, OwnerFull, QueueFull, State, StoreError, SubmitError},
    parameters::{Complaint, ParameterError},
    phantom::PhantomError,
    pipeline::PipelineError,
    report::ComparisonError,
};
use axum::{
    body::Body,
    extract::rejection::{PathRejection, QueryRejection},
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// Media type of a problem document.
pub(super) const PROBLEM_JSON: &str = "application/problem+json";

/// Why a request was refused or a reconstruction failed (RFC 9457). Programs branch on `code`; `detail` is a sentence for people that says
/// what was received, what is wrong and what to do.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "type": "urn:problem-type:ventricle:not_finished", "title": "Conflict", "status": 409, "code": "not_finished",
    "detail": "The reconstruction is running; its results come when it has succeeded.",
    "instance": "/v1/reconstructions/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11/report", "request_id": "0199f3a2-8000-7000-8000-000000000000"
}))]
pub struct Problem {
    /// `urn:problem-type:ventricle:` and the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// The status in words.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// Stable `snake_case` name of the reason.
    pub code: String,
    /// What happened, for people.
    pub detail: String,
    /// Path of the request.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub instance: Option<String>,
    /// The request's `X-Request-Id`: quote it when asking the operator, whose log has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub request_id: Option<String>,
    /// All that is wrong with the parameters, field by field.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub errors: Vec<Complaint>,
    /// With `reconstruction_failed`: the job's own problem.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>, nullable = false)]
    pub cause: Option<Box<Problem>>,
    /// With `not_ready`: what was looked at.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub checks: Option<Checks>,
    /// Seconds for the header `Retry-After`.
    #[serde(skip)]
    pub retry_after_s: Option<u64>,
}

impl Problem {
    /// A problem with a stable code and a sentence.
    pub(super) fn new(status: StatusCode, code: &str, detail: impl Into<String>) -> Self {
        Self {
            kind: format!("urn:problem-type:ventricle:{code}"),
            title: status.canonical_reason().unwrap_or("Error").to_owned(),
            status: status.as_u16(),
            code: code.to_owned(),
            detail: detail.into(),
            instance: None,
            request_id: None,
            errors: Vec::new(),
            cause: None,
            checks: None,
            retry_after_s: None,
        }
    }

    /// The problem of a response that has only a status, as the router and the layers make them.
    pub(super) fn of_status(status: StatusCode) -> Self {
        let (code, detail) = match status {
            StatusCode::NOT_FOUND => ("not_found", "There is nothing at this path. /docs lists what there is."),
            StatusCode::METHOD_NOT_ALLOWED => {
                ("method_not_allowed", "This path does not know the method; the header Allow lists those it knows.")
            }
            StatusCode::PAYLOAD_TOO_LARGE => ("too_large", "The request is larger than the service accepts."),
            StatusCode::URI_TOO_LONG => {
                ("uri_too_long", "The path and query have more bytes than the 8192 that are accepted. Send parameters in the body.")
            }
            StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE => {
                ("headers_too_large", "The headers have more bytes than the 32768 that are accepted. Leave out what is not needed here.")
            }
            StatusCode::REQUEST_TIMEOUT => ("request_timeout", "The request did not arrive in time."),
            StatusCode::SERVICE_UNAVAILABLE => ("timeout", "The answer took longer than the service allows itself. Try again."),
            status if status.is_client_error() => ("bad_request", "The request cannot be understood."),
            _ => return Self::internal(),
        };
        Self { retry_after_s: (status == StatusCode::SERVICE_UNAVAILABLE).then_some(5), ..Self::new(status, code, detail) }
    }

    /// A fault of the service. Says nothing of its inside; the request id leads to the log.
    pub(super) fn internal() -> Self {
        Self::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "internal_error",
            "The service failed to answer. The operator finds the reason in the log under this request id.",
        )
    }

    /// The service is stopping.
    pub(super) fn draining() -> Self {
        let detail = "The service is stopping and accepts no new work. Send the request again in a few seconds.";
        Self { retry_after_s: Some(5), ..Self::new(StatusCode::SERVICE_UNAVAILABLE, "draining", detail) }
    }

    /// No such job.
    pub(super) fn no_such_reconstruction(id: Uuid) -> Self {
        let detail = format!("There is no reconstruction {id}. It never existed, was deleted, or has expired.");
        Self::new(StatusCode::NOT_FOUND, "not_found", detail)
    }

    /// Something is asked that needs the input, which was not kept.
    pub(super) fn input_not_kept(job: &Job) -> Self {
        let detail = format!(
            "The reconstruction is {} and its input is not there any more. Send the study again with the parameter `keep_input` true, or ask              the operator to set --keep-input.",
            job.state.name()
        );
        Self::new(StatusCode::CONFLICT, "input_not_kept", detail)
    }

    /// A result is asked of a job that does not have it: because it is not finished, has failed, was cancelled, or has fewer gates.
    pub(super) fn no_result(job: &Job, name: &str) -> Self {
        match job.state {
            State::Queued | State::Running => {
                let detail = format!("The reconstruction is {}; its results come when it has succeeded.", job.state.name());
                Self { retry_after_s: Some(1), ..Self::new(StatusCode::CONFLICT, "not_finished", detail) }
            }
            State::Failed => Self {
                cause: job.error.as_ref().map(|error| Box::new(error.into())),
                ..Self::new(
                    StatusCode::CONFLICT,
                    "reconstruction_failed",
                    "The reconstruction failed and has no results; `cause` says why.",
                )
            },
            State::Cancelled => {
                Self::new(StatusCode::CONFLICT, "reconstruction_cancelled", "The reconstruction was cancelled and has no results.")
            }
            State::Succeeded => {
                let detail = format!("The reconstruction has {} gates and no result {name}; gates count from 1.", job.gates_total);
                Self::new(StatusCode::NOT_FOUND, "no_such_result", detail)
            }
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let body = serde_json::to_vec(&self).unwrap_or_default();
        let mut response = (status, [(header::CONTENT_TYPE, PROBLEM_JSON)], Body::from(body)).into_response();
        if let Some(seconds) = self.retry_after_s {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// Seconds after which it is worth to ask again for what fails for the moment.
const SOON_S: u64 = 5;

impl From<IntakeError> for Problem {
    fn from(error: IntakeError) -> Self {
        let status = match error.nature() {
            Nature::Malformed => StatusCode::BAD_REQUEST,
            Nature::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Nature::Unsupported => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            Nature::Refused => StatusCode::UNPROCESSABLE_ENTITY,
            Nature::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
        };
        let retry_after_s = (error.nature() == Nature::Unavailable).then_some(SOON_S);
        Self { retry_after_s, ..Self::new(status, error.code(), sentence(&error.to_string())) }
    }
}

impl From<ParameterError> for Problem {
    fn from(error: ParameterError) -> Self {
        let problem = Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.code(), error.to_string());
        Self { errors: error.complaints, ..problem }
    }
}

/// What is wrong with a given region is known as soon as the study is; everything else that can fail in the pipeline is told by the job.
impl From<PipelineError> for Problem {
    fn from(error: PipelineError) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.code(), sentence(&error.to_string()))
    }
}

impl From<BodyError> for Problem {
    fn from(error: BodyError) -> Self {
        let status = match error {
            BodyError::TooLarge { .. } | BodyError::ParametersTooLarge { .. } => StatusCode::PAYLOAD_TOO_LARGE,
            BodyError::TooSlow { .. } | BodyError::Stalled { .. } => StatusCode::REQUEST_TIMEOUT,
            BodyError::OverLimit(over) => return over.into(),
            BodyError::Encoded { .. } => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            BodyError::Interrupted
            | BodyError::ContentLength
            | BodyError::NoBoundary
            | BodyError::Multipart { .. }
            | BodyError::ParametersNotJson { .. }
            | BodyError::BodyNotJson { .. }
            | BodyError::SeveralParameters
            | BodyError::TooManyParts { .. } => StatusCode::BAD_REQUEST,
        };
        Self::new(status, error.code(), error.to_string())
    }
}

impl From<QueueFull> for Problem {
    fn from(full: QueueFull) -> Self {
        let detail = format!("Too much work is waiting. Send the request again in {} s.", full.retry_after_s);
        Self { retry_after_s: Some(full.retry_after_s), ..Self::new(StatusCode::SERVICE_UNAVAILABLE, "queue_full", detail) }
    }
}

impl From<OwnerFull> for Problem {
    fn from(full: OwnerFull) -> Self {
        Self { retry_after_s: Some(full.retry_after_s), ..Self::new(StatusCode::TOO_MANY_REQUESTS, "too_many_jobs", full.to_string()) }
    }
}

impl From<OverLimit> for Problem {
    fn from(over: OverLimit) -> Self {
        Self { retry_after_s: Some(over.retry_after_s()), ..Self::new(StatusCode::TOO_MANY_REQUESTS, over.code(), over.to_string()) }
    }
}

impl From<SubmitError> for Problem {
    fn from(error: SubmitError) -> Self {
        match error {
            SubmitError::KeyReused => Self::new(StatusCode::UNPROCESSABLE_ENTITY, "idempotency_key_reused", error.to_string()),
            SubmitError::InstanceConflict | SubmitError::InstancesGone => {
                Self::new(StatusCode::CONFLICT, "instance_conflict", error.to_string())
            }
            SubmitError::TooLarge { .. } => Self::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", error.to_string()),
            SubmitError::QueueFull(full) => full.into(),
            SubmitError::OwnerFull(full) => full.into(),
            SubmitError::Store(error) => error.into(),
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        tracing::error!(%error, "the store failed");
        match error {
            StoreError::Database(_) | StoreError::Interrupted => Self {
                retry_after_s: Some(SOON_S),
                ..Self::new(
                    StatusCode::SERVICE_UNAVAILABLE,
                    "store_unavailable",
                    format!("The database does not answer, or takes nothing that is written. Send the request again in {SOON_S} s."),
                )
            },
            StoreError::DirectoryInUse { .. }
            | StoreError::Directory { .. }
            | StoreError::NoConnection { .. }
            | StoreError::SqliteTooOld { .. }
            | StoreError::Setting { .. }
            | StoreError::SchemaTooNew { .. }
            | StoreError::Damaged { .. } => Self::internal(),
        }
    }
}

/// Why a job failed, as a problem: the input's fault unless the worker or the program failed.
impl From<&JobError> for Problem {
    fn from(error: &JobError) -> Self {
        let status = match error.code.as_str() {
            "internal_error" | "worker_lost" | "export_failed" => StatusCode::INTERNAL_SERVER_ERROR,
            _ => StatusCode::UNPROCESSABLE_ENTITY,
        };
        Self::new(status, &error.code, error.message.clone())
    }
}

/// Results are made from what this program stored itself: nothing that a client could mend.
impl From<ArchiveError> for Problem {
    fn from(error: ArchiveError) -> Self {
        tracing::error!(%error, "a result could not be made");
        Self::internal()
    }
}

impl From<ExportError> for Problem {
    fn from(error: ExportError) -> Self {
        tracing::error!(%error, "a result could not be made from what is stored");
        Self::internal()
    }
}

impl From<PhantomError> for Problem {
    fn from(error: PhantomError) -> Self {
        tracing::error!(%error, "the phantom could not be made");
        Self::internal()
    }
}

impl From<ComparisonError> for Problem {
    fn from(error: ComparisonError) -> Self {
        match error {
            ComparisonError::WithoutSegments { .. } => Self::new(StatusCode::CONFLICT, "result_too_old", sentence(&error.to_string())),
        }
    }
}

impl From<UploadsFull> for Problem {
    fn from(error: UploadsFull) -> Self {
        Self { retry_after_s: Some(RETRY_AFTER_S), ..Self::new(StatusCode::SERVICE_UNAVAILABLE, "uploads_full", error.to_string()) }
    }
}

impl From<NotAcceptable> for Problem {
    fn from(error: NotAcceptable) -> Self {
        Self::new(StatusCode::NOT_ACCEPTABLE, "not_acceptable", error.to_string())
    }
}

impl From<QueryRejection> for Problem {
    fn from(rejection: QueryRejection) -> Self {
        let text = rejection.body_text();
        // Without the extractor's own words: what follows names the field.
        let why = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text);
        Self::new(StatusCode::BAD_REQUEST, "invalid_query", sentence(&format!("The query is not accepted: {why}")))
    }
}

impl From<PathRejection> for Problem {
    fn from(_: PathRejection) -> Self {
        let detail = "There is nothing at this path: ids are UUIDs as POST /v1/reconstructions gives them, gates are numbers from 1.";
        Self::new(StatusCode::NOT_FOUND, "not_found", detail)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_status_has_a_document_without_empty_members() {
        for status in [404, 405, 408, 413, 414, 415, 431, 500, 503].map(|status| StatusCode::from_u16(status).unwrap()) {
            let json = serde_json::to_value(Problem::of_status(status)).unwrap();
            assert_eq!(json["status"], status.as_u16());
            assert_eq!(json["type"], format!("urn:problem-type:ventricle:{}", json["code"].as_str().unwrap()));
            assert_eq!(json.as_object().unwrap().len(), 5, "{json}");
        }
    }

    #[test]
    fn store_failures_say_nothing_of_the_inside() {
        let error = StoreError::Directory { directory: "/secret/place".into(), source: std::io::Error::other("disk on fire") };
        let text = serde_json::to_string(&Problem::from(error)).unwrap();
        assert!(!text.contains("secret") && !text.contains("fire"), "{text}");
    }
}
