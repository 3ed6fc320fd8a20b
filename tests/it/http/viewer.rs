//! The viewer's pages: what is sent under which name, how long it is kept, and what it may do.

use super::harness::{Answer, Service, idle, with};
use std::collections::BTreeMap;
use ventricle::{config::Cors, jobs::StoreSettings};

const INDEX: &str = "<!doctype html><script type=module src=/assets/app-1a2b3c.js></script>";
const SCRIPT: &str = "console.log('a script')";

fn files() -> BTreeMap<String, Vec<u8>> {
    [
        ("index.html", INDEX),
        ("assets/app-1a2b3c.js", SCRIPT),
        ("assets/app-1a2b3c.js.br", "brotli"),
        ("assets/app-1a2b3c.js.gz", "gzip"),
        ("assets/app-4d5e6f.css", "body{}"),
        ("assets/font-7a8b9c.woff2", "font"),
        ("embed/ventricle-viewer.js", "customElements"),
        ("embed/ventricle-viewer.js.gz", "gzip"),
        ("favicon.svg", "<svg/>"),
    ]
    .map(|(name, text)| (name.to_owned(), text.as_bytes().to_vec()))
    .into()
}

async fn built(cors: Cors) -> Service {
    with(StoreSettings::default(), None, |state| state.with_viewer(files()).with_cors(cors)).await
}

fn text(answer: &Answer) -> &str {
    std::str::from_utf8(&answer.bytes).unwrap()
}

#[tokio::test]
async fn the_apps_routes_are_its_page_which_is_asked_for_each_time() {
    let service = built(Cors::Off).await;
    for path in ["/", "/studies/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11"] {
        let page = service.get(path).await;
        assert_eq!((page.status.as_u16(), text(&page)), (200, INDEX), "{path}");
        assert_eq!((page.header("content-type"), page.header("cache-control")), ("text/html; charset=utf-8", "no-cache"));
        assert_eq!((page.header("x-content-type-options"), page.header("referrer-policy")), ("nosniff", "no-referrer"));
        let policy = page.header("content-security-policy");
        for part in [
            "default-src 'none'",
            "script-src 'self'",
            "style-src 'self'",
            "form-action 'none'",
            "frame-ancestors 'none'",
            "base-uri 'none'",
        ] {
            assert!(policy.split("; ").any(|other| other == part), "{part}: {policy}");
        }
        assert!(!policy.contains("unsafe"), "{policy}");
        assert!(page.header("permissions-policy").contains("xr-spatial-tracking=(self)"));
        let unchanged = service.call("GET", path, &[("if-none-match", page.header("etag"))]).await;
        assert_eq!((unchanged.status.as_u16(), unchanged.bytes.len(), unchanged.header("etag")), (304, 0, page.header("etag")));
        let head = service.call("HEAD", path, &[]).await;
        assert_eq!((head.status.as_u16(), head.bytes.len(), head.header("content-length")), (200, 0, INDEX.len().to_string().as_str()));
    }
    service.call("POST", "/", &[]).await.problem(405, "method_not_allowed");
    service.get("/studies").await.problem(404, "not_found");
    service.get("/studies/a/b").await.problem(404, "not_found");
}

#[tokio::test]
async fn assets_are_kept_for_ever_and_sent_as_small_as_the_client_takes_them() {
    let service = built(Cors::Off).await;
    let script = "/assets/app-1a2b3c.js";
    let mut tags = Vec::new();
    for (accepted, coding, body) in [
        ("gzip, deflate, br, zstd", Some("br"), "brotli"),
        ("gzip", Some("gzip"), "gzip"),
        ("br;q=0, gzip", Some("gzip"), "gzip"),
        ("identity", None, SCRIPT),
    ] {
        let answer = service.call("GET", script, &[("accept-encoding", accepted)]).await;
        assert_eq!((answer.status.as_u16(), text(&answer)), (200, body), "{accepted}");
        let sent = answer.headers.get("content-encoding").map(|coding| coding.to_str().unwrap());
        assert_eq!((sent, answer.header("vary")), (coding, "accept-encoding"));
        assert_eq!(answer.header("cache-control"), "public, max-age=31536000, immutable");
        assert_eq!(answer.header("content-type"), "text/javascript; charset=utf-8");
        let again = [("accept-encoding", accepted), ("if-none-match", answer.header("etag"))];
        assert_eq!(service.call("GET", script, &again).await.status, 304);
        tags.push(answer.header("etag").to_owned());
    }
    assert!(tags[0] != tags[1] && tags[1] == tags[2] && tags[2] != tags[3], "each form has its own: {tags:?}");
    assert_eq!(text(&service.get(script).await), SCRIPT, "who says nothing gets the file");
    for (name, media_type) in [("app-4d5e6f.css", "text/css; charset=utf-8"), ("font-7a8b9c.woff2", "font/woff2")] {
        let answer = service.call("GET", &format!("/assets/{name}"), &[("accept-encoding", "br")]).await;
        assert_eq!((answer.header("content-type"), answer.headers.get("content-encoding")), (media_type, None));
        assert!(!answer.headers.contains_key("vary"));
    }
    let icon = service.get("/favicon.svg").await;
    assert_eq!((icon.header("content-type"), icon.header("cache-control")), ("image/svg+xml", "no-cache"));
}

#[tokio::test]
async fn nothing_but_the_viewers_files_is_sent() {
    let service = built(Cors::Off).await;
    for path in [
        "/assets/other.js",
        "/assets/",
        "/assets/../index.html",
        "/assets/..%2findex.html",
        "/assets/%2e%2e/%2e%2e/Cargo.toml",
        "/assets//etc/passwd",
        "/../Cargo.toml",
        "/assets/app-1a2b3c.js.br",
        "/embed/",
        "/Cargo.toml",
    ] {
        service.get(path).await.problem(404, "not_found");
    }
    service.call("POST", "/favicon.svg", &[]).await.problem(404, "not_found");
    service.call("DELETE", "/assets/app-1a2b3c.js", &[]).await.problem(405, "method_not_allowed");
}

#[tokio::test]
async fn the_component_may_be_loaded_by_other_sites_whatever_may_call_the_service() {
    for (cors, others) in [(Cors::Off, "same-origin"), (Cors::Origins(vec!["https://listed.example".into()]), "cross-origin")] {
        let service = built(cors).await;
        let component = service.call("GET", "/embed/ventricle-viewer.js", &[("origin", "https://stranger.example")]).await;
        assert_eq!((component.status.as_u16(), text(&component)), (200, "customElements"));
        assert_eq!(component.header("access-control-allow-origin"), "*");
        assert_eq!(component.header("cross-origin-resource-policy"), "cross-origin");
        assert_eq!((component.header("cache-control"), component.header("etag").len()), ("no-cache", 46));
        let page = service.call("GET", "/", &[("origin", "https://stranger.example")]).await;
        assert!(!page.headers.contains_key("access-control-allow-origin") && page.header("cross-origin-resource-policy") == others);
    }
}

#[tokio::test]
async fn a_program_without_the_viewer_says_how_to_build_it() {
    let service = idle().await;
    for path in ["/", "/studies/0199f3a2-7c1e-7d10-9a57-3f0c8e4d2b11"] {
        let page = service.get(path).await;
        assert_eq!((page.status.as_u16(), page.header("cache-control")), (200, "no-store"));
        assert!(text(&page).contains("<code>make web</code>") && text(&page).contains("/docs/"), "{path}");
    }
    service.get("/assets/app-1a2b3c.js").await.problem(404, "not_found");
    service.get("/embed/ventricle-viewer.js").await.problem(404, "not_found");
}
