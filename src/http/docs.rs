//! The contract, its reference page, and what stands at the root.

use super::{
    AppState,
    access::{self, Needs},
    problem::Problem,
    results::send,
    views::CallbackView,
};
use crate::{
    jobs::Blob,
    parameters::{self, Description},
    pipeline::parameters::Parameters,
    report::PublishedSchema,
};
use axum::{
    Json, Router,
    extract::State,
    http::{HeaderMap, Method, header},
    response::{Html, IntoResponse, Response},
};
use serde::Serialize;
use utoipa::{
    OpenApi, ToSchema,
    openapi::{
        ContentBuilder, HeaderBuilder, HttpMethod, Object, PathItem, Ref, RefOr, Required, ResponseBuilder, Type,
        path::{Callback, OperationBuilder, ParameterBuilder, ParameterIn},
        request_body::RequestBodyBuilder,
        security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme},
    },
};
use utoipa_swagger_ui::{Config, SwaggerUi};

/// Where the URL of a callback stands in a JSON body; it may as well come by query or by the part `parameters`.
const CALLBACK_URL: &str = "{$request.body#/parameters/callback_url}";

/// Media type of a JSON Schema (JSON Schema 2020-12 §14.1).
const JSON_SCHEMA: &str = "application/schema+json";

/// What stands before the routes in the contract.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "Ventricle",
        description = "Reconstructs the left ventricle from gated cardiac SPECT: both surfaces of its wall over the cycle, volumes and ejection \
                       fraction.\n\nSubmit a study to `POST /v1/reconstructions`, follow the job at its `Location` (poll, long-poll or \
                       server-sent events), then fetch its report and surfaces. JSON is snake_case with units in the names; times are \
                       RFC 3339 in UTC. Every refusal is an RFC 9457 problem document with a stable `code`; every answer has an \
                       `X-Request-Id`, the one sent or a new one.\n\nNothing that names the patient is stored or returned, except that an operator can \
                       have it in the DICOM results (`--keep-patient`); DICOM UIDs are. Research use: not a medical device.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    tags(
        (name = "reconstructions", description = "Submit, follow, cancel, delete"),
        (name = "results", description = "What a finished reconstruction gives"),
        (name = "parameters", description = "How a reconstruction can be steered"),
        (name = "operation", description = "Health, numbers and this document"),
    ),
    components(schemas(parameters::Request, Problem, CallbackView)),
)]
pub(super) struct Contract;

/// Says of every operation what is true of all: that whatever else goes wrong (a fault inside, a database that does not answer) is a
/// problem document too.
pub(super) fn document_other_problems(document: &mut utoipa::openapi::OpenApi) {
    let problem = || {
        let schema = Ref::from_schema_name("Problem");
        ResponseBuilder::new()
            .description("Any other problem: 500, or 503 with `Retry-After` when the answer or the database takes too long")
            .content("application/problem+json", ContentBuilder::new().schema(Some(schema)).build())
            .build()
    };
    for item in document.paths.paths.values_mut() {
        for operation in [&mut item.get, &mut item.post, &mut item.delete].into_iter().flatten() {
            operation.responses.responses.insert("default".to_owned(), problem().into());
        }
    }
}

/// Describes who may call what, and how those are answered who may not.
pub(super) fn document_access(document: &mut utoipa::openapi::OpenApi) {
    let components = document.components.get_or_insert_default();
    let mut bearer = Http::new(HttpAuthScheme::Bearer);
    bearer.description = Some("An API key, or a token of the OpenID provider. A service on loopback without keys asks nobody.".to_owned());
    let mut basic = Http::new(HttpAuthScheme::Basic);
    basic.description = Some("An API key as the password; the name does not matter.".to_owned());
    components.add_security_scheme("bearer", SecurityScheme::Http(bearer));
    components.add_security_scheme("basic", SecurityScheme::Http(basic));
    let problem = |description: &str, headers: &[(&str, &str)]| {
        let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
        let response = ResponseBuilder::new().description(description).content("application/problem+json", content);
        let header =
            |description: &str| HeaderBuilder::new().schema(Some(Object::with_type(Type::String))).description(Some(description)).build();
        headers.iter().fold(response, |response, (name, description)| response.header(*name, header(description))).build()
    };
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in [(Method::GET, &mut item.get), (Method::POST, &mut item.post), (Method::DELETE, &mut item.delete)] {
            let Some(operation) = operation else { continue };
            let Needs::A(scope) = access::needs(&method, Some(path)) else {
                operation.security = Some(Vec::new());
                continue;
            };
            operation.security = Some(["bearer", "basic"].map(|scheme| SecurityRequirement::new(scheme, [scope.name()])).into());
            let responses = &mut operation.responses.responses;
            let who = "No key or token, or none that is valid (`credentials_missing`, `credentials_invalid`, `credentials_expired`)";
            responses.insert("401".to_owned(), problem(who, &[("WWW-Authenticate", "What is asked for")]).into());
            let scope = format!(
                "The key or token has not the scope `{}`; or nobody is asked, and a page of another site sent the request, or to a name that is not the \
                 machine's",
                scope.name()
            );
            responses.insert("403".to_owned(), problem(&scope, &[]).into());
            let much = "More requests, bytes or waiting jobs than the key or token may have, or too many refused requests of the address";
            responses.insert("429".to_owned(), problem(much, &[("Retry-After", "Seconds")]).into());
        }
    }
}

/// Describes what is sent when a job ends, at the operation that asks for it.
pub(super) fn document_callback(document: &mut utoipa::openapi::OpenApi) {
    let header = |name: &str, description: &str| {
        ParameterBuilder::new()
            .name(name)
            .parameter_in(ParameterIn::Header)
            .required(Required::True)
            .description(Some(description))
            .schema(Some(Object::with_type(Type::String)))
            .build()
    };
    let body = ContentBuilder::new().schema(Some(Ref::from_schema_name("Callback"))).build();
    let answer = |description: &str| ResponseBuilder::new().description(description).build();
    let operation = OperationBuilder::new()
        .summary(Some("A job has reached its final state"))
        .description(Some(
            "Sent at least once, with the same `Ventricle-Delivery` each time; anything but 2xx within 15 s is tried again, up to eleven times in \
             about a day, later if `Retry-After` says so. Redirects are not followed. A job that is deleted is not told of any more.",
        ))
        .parameter(header("Ventricle-Delivery", "Id of the delivery: a repetition has the same."))
        .parameter(header(
            "Ventricle-Signature",
            "`t=<unix seconds>,v1=<hex>`: HMAC-SHA256, under the secret shared with the operator, of `t`, a full stop and the body as it came. \
             Refuse what does not match or is older than five minutes.",
        ))
        .request_body(Some(RequestBodyBuilder::new().content("application/json", body).required(Some(Required::True)).build()))
        .response("2XX", answer("Received"))
        .response("default", answer("Not received: sent again later"))
        .build();
    let callback: Callback = [(CALLBACK_URL.to_owned(), RefOr::T(PathItem::new(HttpMethod::Post, operation)))].into();
    if let Some(submission) = document.paths.paths.get_mut("/v1/reconstructions").and_then(|item| item.post.as_mut()) {
        submission.callbacks.insert("jobEnded".to_owned(), RefOr::T(callback));
    }
}

/// All parameters.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ParameterList {
    /// What is used when nothing is given: the preset `clinical`, with the other preset's values of what only that one reads.
    #[schema(value_type = parameters::Request)]
    pub defaults: Parameters,
    /// What each preset uses when nothing else is given.
    #[schema(inline)]
    pub presets: Presets,
    /// Every parameter: what it is, its default, its range.
    pub parameters: Vec<Description>,
}

/// The named sets of values.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Presets {
    /// The default.
    #[schema(value_type = parameters::Request)]
    pub clinical: Parameters,
    /// The published method.
    #[schema(value_type = parameters::Request)]
    pub paper: Parameters,
}

/// Lists the parameters with their defaults, ranges and meaning.
#[utoipa::path(
    get, path = "/v1/parameters", operation_id = "listParameters", tag = "parameters",
    responses((status = 200, description = "All parameters", body = ParameterList)),
)]
pub(super) async fn list_parameters(State(state): State<AppState>) -> Json<ParameterList> {
    Json(ParameterList {
        defaults: Parameters::clinical(),
        presets: Presets { clinical: Parameters::clinical(), paper: Parameters::paper() },
        parameters: parameters::describe(Some(state.longest_retention.as_secs())),
    })
}

/// Reads this document.
#[utoipa::path(
    get, path = "/openapi.json", operation_id = "openapi", tag = "operation",
    responses((status = 200, description = "OpenAPI 3.1", body = Object)),
)]
pub(super) async fn openapi(State(state): State<AppState>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-cache")], state.openapi.to_string())
}

/// Reads the JSON Schema of a report.
///
/// JSON Schema 2020-12 of `GET /v1/reconstructions/{id}/report`. Fields may be added under the same version.
#[utoipa::path(
    get, path = "/schemas/report-1.json", operation_id = "reportSchema", tag = "operation",
    responses(
        (status = 200, description = "JSON Schema 2020-12", body = Object, content_type = "application/schema+json",
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
    ),
)]
pub(super) async fn report_schema(headers: HeaderMap) -> Response {
    schema(&headers, PublishedSchema::Report)
}

/// Reads the JSON Schema of a comparison.
///
/// JSON Schema 2020-12 of `GET /v1/reconstructions/{id}/comparison`. Fields may be added under the same version.
#[utoipa::path(
    get, path = "/schemas/comparison-1.json", operation_id = "comparisonSchema", tag = "operation",
    responses(
        (status = 200, description = "JSON Schema 2020-12", body = Object, content_type = "application/schema+json",
         headers(("ETag" = String, description = "SHA-256 of the body"))),
        (status = 304, description = "The copy at hand is still right"),
    ),
)]
pub(super) async fn comparison_schema(headers: HeaderMap) -> Response {
    schema(&headers, PublishedSchema::Comparison)
}

fn schema(headers: &HeaderMap, schema: PublishedSchema) -> Response {
    send(headers, Blob::new(JSON_SCHEMA, schema.document().into_bytes()))
}

/// The reference page, with its assets from inside the program: it works without a network.
pub(super) fn reference() -> Router<AppState> {
    SwaggerUi::new("/docs").config(Config::from("/openapi.json").try_it_out_enabled(true).display_request_duration(true)).into()
}

/// What stands at the root where the viewer was not built in.
pub(super) fn root() -> Html<&'static str> {
    Html(concat!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Ventricle</title>",
        "<style>body{font:1.1rem/1.6 system-ui,sans-serif;max-width:40rem;margin:4rem auto;padding:0 1rem}</style>",
        "<h1>Ventricle ",
        env!("CARGO_PKG_VERSION"),
        "</h1><p>Reconstructs the left ventricle from gated cardiac SPECT. The viewer was not built into this program: build it with \
         <code>make web</code>, then the program again.</p><ul>",
        "<li><a href=\"/docs/\">Reference of the HTTP interface</a>, to try out (<a href=\"/openapi.json\">as OpenAPI</a>)</li>",
        "<li><a href=\"/v1/reconstructions\">Reconstructions</a>, newest first</li>",
        "<li><a href=\"/v1/parameters\">Parameters</a> with defaults and ranges</li>",
        "<li><a href=\"/readyz\">Readiness</a></li></ul>",
        "<p>Send a study: <code>curl --data-binary @study.dcm -H 'Content-Type: application/dicom' \
         http://localhost:8080/v1/reconstructions</code></p>",
        "</html>",
    ))
}
