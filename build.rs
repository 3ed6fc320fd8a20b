//! Builds the crate again when the viewer was built: `rust-embed` knows of changed files, but not of new ones. Runs nothing else, npm least of
//! all: without `web/dist` the program is built without the viewer.

use std::path::Path;

fn main() {
    // A path that is not there would be looked for with every build, and build everything again.
    let watched = ["web/dist", "web", "build.rs"].into_iter().find(|path| Path::new(path).exists());
    if let Some(path) = watched {
        println!("cargo::rerun-if-changed={path}");
    }
}
