//! The viewer: the files of `web/dist`, which are inside of the program where they were built before it.

use super::{docs, negotiate, problem::Problem};
use axum::{
    extract::State,
    http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header},
    response::{IntoResponse, Response},
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use rust_embed::RustEmbed;
use sha2::{Digest, Sha256};
use std::{borrow::Cow, collections::BTreeMap, sync::Arc};

/// The files that were built.
#[derive(RustEmbed)]
#[folder = "web/dist"]
#[allow_missing = true]
struct Built;

/// The page of all the app's routes.
const INDEX: &str = "index.html";
/// Files whose names change with their content are below it.
const HASHED: &str = "assets/";
/// Files for pages of other sites are below it.
const FOR_OTHERS: &str = "embed/";
/// What is sent instead of a file, the smallest first: `Content-Encoding` and the end of its name.
const CODINGS: [(&str, &str); 2] = [("br", ".br"), ("gzip", ".gz")];
/// What the pages may do: nothing but what comes from here.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self' blob:; \
                      font-src 'self'; manifest-src 'self'; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// What of the device they may use: the headset, or the phone's view of the room, for the ventricle in it.
const PERMISSIONS: &str = "xr-spatial-tracking=(self), camera=(), geolocation=(), microphone=()";

/// A file as it is sent.
pub(super) struct File {
    data: Cow<'static, [u8]>,
    etag: String,
}

/// The viewer's files by name.
pub(super) type Files = Arc<BTreeMap<String, File>>;

/// Those inside of the program; none where it was built without.
pub(super) fn embedded() -> Files {
    Arc::new(Built::iter().filter_map(|name| Some((name.to_string(), File::new(Built::get(&name)?.data)))).collect())
}

/// Others.
pub(super) fn given(files: BTreeMap<String, Vec<u8>>) -> Files {
    Arc::new(files.into_iter().map(|(name, data)| (name, File::new(data.into()))).collect())
}

impl File {
    fn new(data: Cow<'static, [u8]>) -> Self {
        let etag = format!("\"{}\"", STANDARD.encode(Sha256::digest(&data)));
        Self { data, etag }
    }
}

/// The page, whichever of the app's routes it is; without the viewer, what else there is to see.
pub(super) async fn page(State(files): State<Files>, headers: HeaderMap) -> Response {
    send(&files, INDEX, &headers).unwrap_or_else(|| docs::root().into_response())
}

/// A file of the viewer.
pub(super) async fn file(State(files): State<Files>, uri: Uri, headers: HeaderMap) -> Response {
    named(&files, &uri, &headers)
}

/// What no route knows: a file beside the page, as its icon, or nothing.
pub(super) async fn other(State(files): State<Files>, method: Method, uri: Uri, headers: HeaderMap) -> Response {
    if method == Method::GET || method == Method::HEAD { named(&files, &uri, &headers) } else { nothing() }
}

/// The file of the path. Names are looked up, never opened: a path that leads out of the folder is the name of nothing.
fn named(files: &Files, uri: &Uri, headers: &HeaderMap) -> Response {
    let name = uri.path().trim_start_matches('/');
    send(files, name, headers).unwrap_or_else(nothing)
}

fn nothing() -> Response {
    Problem::of_status(StatusCode::NOT_FOUND).into_response()
}

/// A file in the smallest form that the client takes; `None` where there is none of this name.
fn send(files: &BTreeMap<String, File>, name: &str, headers: &HeaderMap) -> Option<Response> {
    let plain = files.get(name).filter(|_| !CODINGS.iter().any(|(_, end)| name.ends_with(end)))?;
    let coded = CODINGS.iter().filter_map(|&(coding, end)| Some((coding, files.get(&format!("{name}{end}"))?))).collect::<Vec<_>>();
    let taken = coded.iter().find(|(coding, _)| negotiate::accepts_coding(headers, coding));
    let file = taken.map_or(plain, |(_, file)| file);
    let mut response = if negotiate::none_match(headers, &file.etag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        file.data.clone().into_response()
    };
    let mut set = |name, value: &str| HeaderValue::from_str(value).map(|value| response.headers_mut().insert(name, value)).ok();
    set(header::CONTENT_TYPE, &media_type(name));
    set(header::ETAG, &file.etag);
    set(header::CACHE_CONTROL, if name.starts_with(HASHED) { "public, max-age=31536000, immutable" } else { "no-cache" });
    if !coded.is_empty() {
        set(header::VARY, "accept-encoding");
    }
    if let Some((coding, _)) = taken {
        set(header::CONTENT_ENCODING, coding);
    }
    if name.starts_with(FOR_OTHERS) {
        set(header::ACCESS_CONTROL_ALLOW_ORIGIN, "*");
        set(header::HeaderName::from_static("cross-origin-resource-policy"), "cross-origin");
    }
    if name == INDEX {
        set(header::CONTENT_SECURITY_POLICY, POLICY);
        set(header::HeaderName::from_static("permissions-policy"), PERMISSIONS);
    }
    Some(response)
}

/// By the end of the name; text is UTF-8.
fn media_type(name: &str) -> String {
    let guessed = mime_guess::from_path(name).first_or_octet_stream();
    if guessed.type_() == "text" { format!("{guessed}; charset=utf-8") } else { guessed.to_string() }
}
