//! Tells the program what it was built from, and builds the crate again when the viewer was built: `rust-embed` knows of changed files, but not
//! of new ones. Runs `git` and `rustc` to ask them, nothing else, npm least of all: without `web/dist` the program is built without the viewer.

#![expect(clippy::disallowed_methods, reason = "cargo tells a build script by the environment")]

use std::{env, path::Path, process::Command};

/// What is told where nobody knows.
const UNKNOWN: &str = "unknown";

fn main() {
    // A path that is not there would be looked for with every build, and build everything again.
    let watched = ["web/dist", "web", "build.rs"].into_iter().find(|path| Path::new(path).exists());
    if let Some(path) = watched {
        watch(path);
    }
    watch("build.rs");
    println!("cargo::rerun-if-env-changed=VENTRICLE_COMMIT");
    let profile = env::var("PROFILE").unwrap_or_else(|_| UNKNOWN.to_owned());
    println!("cargo::rustc-env=BUILT_COMMIT={}", commit(&profile));
    println!("cargo::rustc-env=BUILT_BY={}", compiler());
    println!("cargo::rustc-env=BUILT_AS={profile}");
}

fn watch(path: &str) {
    println!("cargo::rerun-if-changed={path}");
}

/// The commit that is checked out: as `VENTRICLE_COMMIT` says where there is no repository (a build in a container), else as git does. Only of
/// release builds, for it would build a developer's crate again after every commit.
fn commit(profile: &str) -> String {
    if let Ok(given) = env::var("VENTRICLE_COMMIT")
        && !given.is_empty()
    {
        return given;
    }
    if profile != "release" {
        return UNKNOWN.to_owned();
    }
    // Sources unpacked inside of somebody else's repository are not of its commit.
    let here = env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    let top = git(&["rev-parse", "--show-toplevel"]);
    if top.is_none_or(|top| Path::new(&top).canonicalize().ok() != Path::new(&here).canonicalize().ok()) {
        return UNKNOWN.to_owned();
    }
    // What moves when another commit is checked out: HEAD, and the branch that it names, in a file of its own or packed with others.
    let branch = git(&["symbolic-ref", "--quiet", "HEAD"]);
    for name in ["HEAD", "packed-refs"].into_iter().chain(branch.as_deref()) {
        if let Some(path) = git(&["rev-parse", "--git-path", name]).filter(|path| Path::new(path).exists()) {
            watch(&path);
        }
    }
    git(&["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(|| UNKNOWN.to_owned())
}

fn git(arguments: &[&str]) -> Option<String> {
    output("git", arguments)
}

/// The compiler's version, as `1.95.0`.
fn compiler() -> String {
    let said = output(&env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned()), &["--version"]);
    said.and_then(|said| said.split_whitespace().nth(1).map(str::to_owned)).unwrap_or_else(|| UNKNOWN.to_owned())
}

/// The line that a program answers; none where there is no such program or it fails.
fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok().filter(|output| output.status.success())?;
    let line = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (!line.is_empty()).then_some(line)
}
