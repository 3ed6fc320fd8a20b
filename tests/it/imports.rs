//! Who may import whom, read from the sources. The table is the architecture: what a module cannot see it cannot come to depend on.
//! `#[cfg(test)]` code is free; the binary (`main.rs`, `commands/`) may use everything.

mod scan;

use scan::{Token, paths, tokens};
use std::{collections::BTreeSet, fmt, fs, path::Path};

/// What one module of the library may use.
struct Rule {
    module: &'static str,
    /// Modules of the crate.
    crate_modules: &'static [&'static str],
    /// External crates and parts of `std`.
    external: External,
}

enum External {
    /// These and `std` without [`OUTSIDE_WORLD`], nothing else.
    Only(&'static [&'static str]),
    /// Likewise, but `std::process` and `std::time` are allowed.
    OnlyAndProcesses(&'static [&'static str]),
    /// Anything but the service's crates, these, and [`OUTSIDE_WORLD`].
    NoServiceNor(&'static [&'static str]),
    /// Likewise, but `std::time` is allowed.
    NoServiceButClock,
    /// Anything but these.
    AllBut(&'static [&'static str]),
}

/// What a job is made of, and who is told what it took.
const BELOW_JOBS: &[&str] =
    &["volume", "mesh", "study", "subject", "phantom", "intake", "pipeline", "analysis", "report", "export", "parameters", "traces"];

/// `paper` and `accuracy` are not among them: nothing of the service needs them.
const EVERYTHING: &[&str] = &[
    "access",
    "volume",
    "mesh",
    "study",
    "subject",
    "phantom",
    "drawing",
    "codecs",
    "intake",
    "pipeline",
    "analysis",
    "report",
    "export",
    "archive",
    "parameters",
    "jobs",
    "callbacks",
    "assembly",
    "dimse",
    "http",
    "networks",
    "tls",
    "config",
    "telemetry",
    "traces",
];

/// Files, environment, sockets, processes, clocks: what would make a pure function impure.
const OUTSIDE_WORLD: &[&str] =
    &["std::fs", "std::env", "std::net", "std::process", "std::time", "jiff::Timestamp::now", "jiff::Zoned::now"];

/// Crates of the service, which nothing numeric touches.
const SERVICE: &[&str] = &[
    "anyhow",
    "axum",
    "clap",
    "dicom_ul",
    "futures_util",
    "hmac",
    "http_body_util",
    "hyper",
    "hyper_util",
    "metrics",
    "metrics_exporter_prometheus",
    "multer",
    "sqlx",
    "tokio",
    "tokio_rustls",
    "tokio_util",
    "tower",
    "tower_http",
    "tracing_subscriber",
    "ureq",
    "url",
    "utoipa_axum",
    "utoipa_swagger_ui",
];

/// Crates that one module alone has: no other could make a span that says more than the list in `traces` allows.
const OF_TRACES: &[&str] = &["opentelemetry", "opentelemetry_proto", "opentelemetry_sdk", "prost"];

const RULES: &[Rule] = &[
    Rule { module: "volume", crate_modules: &[], external: External::Only(&["ndarray", "glam", "serde"]) },
    Rule { module: "mesh", crate_modules: &[], external: External::Only(&["ndarray", "glam", "serde"]) },
    Rule { module: "study", crate_modules: &["volume"], external: External::Only(&["ndarray", "glam", "serde"]) },
    Rule { module: "subject", crate_modules: &[], external: External::Only(&["base64", "serde", "serde_json", "thiserror"]) },
    Rule {
        module: "elements",
        crate_modules: &[],
        external: External::Only(&["dicom_core", "dicom_dictionary_std", "dicom_object", "sha2"]),
    },
    Rule { module: "phantom", crate_modules: &["volume", "study", "mesh", "elements"], external: External::NoServiceNor(&["utoipa"]) },
    // The one module that starts processes, and the one that has the decoders of others.
    Rule {
        module: "codecs",
        crate_modules: &[],
        external: External::OnlyAndProcesses(&["thiserror", "hayro_jpeg2000", "jpeg_decoder", "jpegls"]),
    },
    Rule {
        module: "intake",
        crate_modules: &["volume", "study", "subject", "codecs"],
        external: External::NoServiceNor(&["utoipa", "rayon", "hayro_jpeg2000", "jpeg_decoder", "jpegls"]),
    },
    Rule {
        module: "pipeline",
        crate_modules: &["volume", "mesh", "study"],
        external: External::Only(&["ndarray", "glam", "serde", "rayon", "tracing", "thiserror"]),
    },
    Rule {
        module: "analysis",
        crate_modules: &["volume", "mesh", "study", "pipeline"],
        external: External::Only(&["glam", "serde", "rayon"]),
    },
    Rule { module: "report", crate_modules: &["study", "pipeline", "mesh", "analysis"], external: External::NoServiceNor(&[]) },
    Rule {
        module: "export",
        crate_modules: &["study", "pipeline", "mesh", "analysis", "drawing"],
        external: External::NoServiceNor(&["utoipa"]),
    },
    // Made from what is stored, so from neither study nor reconstruction.
    Rule {
        module: "archive",
        crate_modules: &["subject", "elements", "pipeline", "report", "export", "drawing"],
        external: External::NoServiceNor(&["glam", "ndarray", "rayon", "utoipa"]),
    },
    Rule { module: "parameters", crate_modules: &["pipeline"], external: External::NoServiceNor(&[]) },
    Rule { module: "drawing", crate_modules: &[], external: External::NoServiceNor(&["rayon", "utoipa"]) },
    // Tables 1 and 4 print seconds.
    Rule {
        module: "paper",
        crate_modules: &["volume", "mesh", "study", "phantom", "pipeline", "analysis", "report", "drawing"],
        external: External::NoServiceButClock,
    },
    // How long a study takes is part of what is compared.
    Rule {
        module: "accuracy",
        crate_modules: &["volume", "mesh", "study", "phantom", "pipeline", "analysis", "report", "drawing"],
        external: External::NoServiceButClock,
    },
    Rule {
        module: "jobs",
        crate_modules: BELOW_JOBS,
        external: External::AllBut(&[
            "axum",
            "clap",
            "hmac",
            "http_body_util",
            "hyper",
            "hyper_util",
            "multer",
            "std::env",
            "tokio_rustls",
            "tower",
            "tower_http",
            "ureq",
            "url",
            "utoipa_axum",
            "utoipa_swagger_ui",
        ]),
    },
    // It is given its connections: who may be connected to is decided in `callbacks`.
    Rule {
        module: "dimse",
        crate_modules: &["access", "assembly", "elements", "intake", "jobs", "tls"],
        external: External::AllBut(&[
            "axum",
            "clap",
            "glam",
            "hmac",
            "http_body_util",
            "hyper",
            "hyper_util",
            "ndarray",
            "rayon",
            "sqlx",
            "std::env",
            "std::fs",
            "std::net",
            "tower",
            "tower_http",
            "ureq",
            "url",
            "utoipa",
            "utoipa_axum",
        ]),
    },
    // The one module that connects to where a client says: nothing else has an HTTP client or TLS to do so with.
    Rule {
        module: "callbacks",
        crate_modules: &["dimse", "jobs", "networks"],
        external: External::AllBut(&[
            "axum",
            "clap",
            "glam",
            "ndarray",
            "rayon",
            "sqlx",
            "std::env",
            "tower",
            "tower_http",
            "ureq",
            "utoipa",
            "utoipa_axum",
        ]),
    },
    Rule {
        module: "assembly",
        crate_modules: &["access", "intake", "study", "pipeline", "jobs"],
        external: External::AllBut(&[
            "axum",
            "clap",
            "dicom_ul",
            "glam",
            "hyper",
            "multer",
            "ndarray",
            "rayon",
            "sqlx",
            "std::env",
            "tokio_rustls",
            "ureq",
            "utoipa",
        ]),
    },
    Rule {
        module: "http",
        crate_modules: EVERYTHING,
        external: External::AllBut(&[
            "dicom_ul",
            "glam",
            "gltf_json",
            "hayro_jpeg2000",
            "jpeg_decoder",
            "jpegls",
            "ndarray",
            "nifti",
            "rayon",
            "sqlx",
            "std::env",
            "tokio_rustls",
            "ureq",
            "url",
        ]),
    },
    // Who calls, whatever the protocol: it is given a header's value and an address, and someone who fetches.
    Rule {
        module: "access",
        crate_modules: &["jobs"],
        external: External::AllBut(&[
            "axum",
            "clap",
            "glam",
            "hyper",
            "ndarray",
            "rayon",
            "sqlx",
            "std::env",
            "tokio_rustls",
            "ureq",
            "utoipa",
        ]),
    },
    Rule {
        module: "networks",
        crate_modules: &[],
        external: External::AllBut(&["axum", "clap", "hyper", "sqlx", "std::env", "std::fs", "tokio", "tokio_rustls", "url"]),
    },
    // What `http` and `dimse` accept encrypted connections with.
    Rule {
        module: "tls",
        crate_modules: &[],
        external: External::AllBut(&["axum", "clap", "hyper", "hyper_util", "sqlx", "std::env", "tower", "ureq", "url"]),
    },
    Rule {
        module: "config",
        crate_modules: &["access", "dimse", "jobs", "networks"],
        external: External::AllBut(&["axum", "dicom_ul", "sqlx", "tokio"]),
    },
    // It is given what is true of a request or a job, and someone who sends.
    Rule {
        module: "traces",
        crate_modules: &[],
        external: External::AllBut(&[
            "axum",
            "clap",
            "glam",
            "hyper",
            "ndarray",
            "rayon",
            "sqlx",
            "std::env",
            "std::fs",
            "std::net",
            "tokio_rustls",
            "tracing_subscriber",
            "ureq",
            "url",
        ]),
    },
    Rule { module: "telemetry", crate_modules: &["config"], external: External::AllBut(&["axum", "sqlx", "std::env"]) },
];

/// A use that the table forbids.
#[derive(Debug, PartialEq, Eq)]
struct Violation {
    module: String,
    used: String,
    line: usize,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: `{}` may not use `{}`", self.line, self.module, self.used)
    }
}

#[test]
fn every_module_imports_only_what_the_table_allows() {
    let source = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src"));
    let externals = external_crates();
    let (mut seen, mut broken) = (BTreeSet::new(), Vec::new());
    for (path, module_path) in files(source, &[]) {
        if module_path.is_empty() || matches!(module_path[0].as_str(), "main" | "commands") {
            continue;
        }
        seen.insert(module_path[0].clone());
        let text = fs::read_to_string(&path).unwrap();
        let shown = path.strip_prefix(source).unwrap().display().to_string();
        broken.extend(violations(&text, &module_path, &externals).iter().map(|violation| format!("src/{shown}, {violation}")));
    }
    assert!(broken.is_empty(), "\n{}", broken.join("\n"));
    let ruled: BTreeSet<String> = RULES.iter().map(|rule| rule.module.to_owned()).collect();
    assert_eq!(seen, ruled, "modules of src and rows of the table");
}

#[test]
fn one_module_alone_has_unsafe_code() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut unsafe_files: Vec<_> = files(&source, &[])
        .into_iter()
        .filter(|(path, _)| tokens(&fs::read_to_string(path).unwrap()).iter().any(|(_, token)| *token == Token::Name("unsafe".to_owned())))
        .map(|(path, _)| path.strip_prefix(&source).unwrap().to_owned())
        .collect();
    unsafe_files.sort();
    assert_eq!(unsafe_files, [Path::new("pipeline/simd.rs")]);
}

#[test]
fn a_violating_source_is_caught() {
    for (module, text, used) in [
        ("volume", "use crate::study::Study;", "crate::study"),
        ("mesh", "fn f() { crate::volume::sample_scalar(); }", "crate::volume"),
        ("mesh", "use rayon::prelude::*;", "rayon"),
        ("study", "use crate::{volume::Grid, pipeline::{Fit, Surface}};", "crate::pipeline"),
        ("pipeline", "use super::jobs::Store;", "crate::jobs"),
        ("pipeline", "use std::{sync::Arc, time::{Duration, Instant}};", "std::time"),
        ("pipeline", "fn f() { let now = std::time::SystemTime::now(); }", "std::time"),
        ("pipeline", "use std::fs::File;", "std::fs"),
        ("pipeline", "use ::tokio as runtime;", "tokio"),
        ("pipeline", "#[derive(utoipa::ToSchema)] struct P;", "utoipa"),
        ("pipeline", "mod inner { use super::super::http; }", "crate::http"),
        ("report", "fn f() { let _ = '\"'; axum::serve(); }", "axum"),
        ("export", "use crate::jobs::{self, Store};", "crate::jobs"),
        ("intake", "impl From<crate::http::Problem> for X {}", "crate::http"),
        ("intake", "use jpeg_decoder::Decoder;", "jpeg_decoder"),
        ("intake", "use std::process::Command;", "std::process"),
        ("codecs", "use std::{process::Command, fs};", "std::fs"),
        ("codecs", "use crate::intake::Limits;", "crate::intake"),
        ("jobs", "use axum::Router;", "axum"),
        ("jobs", "use crate::http::router;", "crate::http"),
        ("jobs", "use tokio_rustls::TlsConnector;", "tokio_rustls"),
        ("jobs", "use crate::callbacks::Target;", "crate::callbacks"),
        ("callbacks", "use crate::http::views;", "crate::http"),
        ("dimse", "use crate::callbacks::Target;", "crate::callbacks"),
        ("dimse", "use std::net::TcpStream;", "std::net"),
        ("http", "use dicom_ul::pdu::Pdu;", "dicom_ul"),
        ("callbacks", "use ureq::Agent;", "ureq"),
        ("http", "use tokio_rustls::TlsConnector;", "tokio_rustls"),
        ("tls", "use crate::config::Cors;", "crate::config"),
        ("networks", "use tokio::net::TcpStream;", "tokio"),
        ("http", "use ndarray::Array3;", "ndarray"),
        ("telemetry", "use std::env;", "std::env"),
        ("paper", "use std::{time::Instant, fs};", "std::fs"),
        ("paper", "use crate::{phantom, intake};", "crate::intake"),
        ("accuracy", "use crate::paper::printed;", "crate::paper"),
        ("drawing", "use crate::mesh::Mesh;", "crate::mesh"),
        ("http", "use opentelemetry::KeyValue;", "opentelemetry"),
        ("jobs", "use opentelemetry_sdk::trace::SdkTracer;", "opentelemetry_sdk"),
        ("traces", "use crate::http::router;", "crate::http"),
        ("traces", "use tokio_rustls::TlsConnector;", "tokio_rustls"),
    ] {
        let found = violations(text, &[module.to_owned()], &external_crates());
        let expected = Violation { module: module.to_owned(), used: used.to_owned(), line: 1 };
        assert_eq!(found, [expected], "{module}: {text}");
    }
}

#[test]
fn comments_strings_tests_and_ones_own_module_are_no_violation() {
    let text = r##"
        //! See [`crate::http`]; tokio::spawn is not used here.
        use super::study::Study; use crate::pipeline::gvf; use self::canny::edges; use std::sync::Arc;
        /* crate::jobs /* nested */ std::fs */
        const TEXT: &str = "crate::jobs::Store \" std::fs"; const RAW: &str = r#"use axum::Router; " "#;
        fn f<'a>(x: &'a str) -> Vec<u8> { let c = '\''; let d = '"'; Vec::new() }
        #[cfg(test)]
        mod tests { use crate::phantom; fn g() { std::fs::read("x"); if true { } } }
    "##;
    assert_eq!(violations(text, &["pipeline".to_owned()], &external_crates()), []);
}

/// The crates of `[dependencies]`, as Rust names them, and `std`.
fn external_crates() -> BTreeSet<String> {
    let manifest = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml")).unwrap();
    let dependencies = manifest.split("[dependencies]").nth(1).unwrap().split("\n[").next().unwrap();
    let names = dependencies.lines().filter_map(|line| line.split_once(" = ")).map(|(name, _)| name.trim().replace('-', "_"));
    let found: BTreeSet<String> = names.chain(["std".to_owned()]).collect();
    assert!(found.contains("axum") && found.contains("dicom_object"), "{found:?}");
    found
}

/// All Rust files below a folder with the module path of each; files that are modules only of tests are left out.
fn files(folder: &Path, module: &[String]) -> Vec<(std::path::PathBuf, Vec<String>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let below: Vec<String> = module.iter().cloned().chain([stem.clone()]).collect();
        let declared_for_tests = ["mod.rs", "lib.rs"].iter().any(|parent| {
            let parent = fs::read_to_string(folder.join(parent)).unwrap_or_default();
            parent.split("#[cfg(test)]").skip(1).any(|after| after.trim_start().starts_with(&format!("mod {stem};")))
        });
        if declared_for_tests {
            continue;
        }
        if path.is_dir() {
            found.extend(files(&path, &below));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push((path, if matches!(stem.as_str(), "mod" | "lib") { module.to_vec() } else { below }));
        }
    }
    found
}

fn violations(text: &str, module_path: &[String], externals: &BTreeSet<String>) -> Vec<Violation> {
    let rule = RULES.iter().find(|rule| rule.module == module_path[0]).unwrap_or_else(|| panic!("no rule for {module_path:?}"));
    let mut found: Vec<Violation> = Vec::new();
    for (line, path) in paths(&tokens(text), module_path) {
        let Some(used) = forbidden(rule, &path, externals) else { continue };
        if !found.iter().any(|other| other.used == used && other.line == line) {
            found.push(Violation { module: rule.module.to_owned(), used, line });
        }
    }
    found
}

/// The part of a path that the rule forbids, if any.
fn forbidden(rule: &Rule, path: &[String], externals: &BTreeSet<String>) -> Option<String> {
    if path[0] == "crate" {
        let module = path.get(1)?;
        let known = RULES.iter().any(|other| other.module == *module);
        let allowed = module == rule.module || rule.crate_modules.contains(&module.as_str());
        return (known && !allowed).then(|| format!("crate::{module}"));
    }
    if !externals.contains(&path[0]) {
        return None;
    }
    if rule.module != "traces" && OF_TRACES.contains(&path[0].as_str()) {
        return Some(path[0].clone());
    }
    let whole = path.join("::");
    let within =
        |list: &[&str]| list.iter().find(|&&name| whole == name || whole.starts_with(&format!("{name}::"))).map(|&name| name.to_owned());
    match rule.external {
        External::Only(list) => {
            within(OUTSIDE_WORLD).or_else(|| (path[0] != "std" && !list.contains(&path[0].as_str())).then(|| path[0].clone()))
        }
        External::OnlyAndProcesses(list) => within(OUTSIDE_WORLD)
            .filter(|used| !matches!(used.as_str(), "std::process" | "std::time"))
            .or_else(|| (path[0] != "std" && !list.contains(&path[0].as_str())).then(|| path[0].clone())),
        External::NoServiceNor(list) => within(OUTSIDE_WORLD).or_else(|| within(SERVICE)).or_else(|| within(list)),
        External::NoServiceButClock => within(OUTSIDE_WORLD).filter(|used| used != "std::time").or_else(|| within(SERVICE)),
        External::AllBut(list) => within(list),
    }
}
