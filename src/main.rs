//! The `ventricle` binary: each subcommand is a role.

mod commands;

use clap::{Parser, Subcommand};
use std::{io::Write as _, process::ExitCode};

/// Results of megabytes that come and go on many threads leave holes in the heaps that glibc keeps for each (docs/decisions.md). How it is set up is said in
/// `.cargo/config.toml`, what the service does with it in `commands/memory.rs`.
#[cfg(unix)]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

/// Reconstructs the left ventricle from gated cardiac SPECT.
#[derive(Parser)]
#[command(version, about, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Runs the HTTP service and its workers.
    Serve(Box<commands::serve::Args>),
    /// Starts a service, posts a beating phantom (or a file) through HTTP and shows the result.
    Demo(commands::demo::Args),
    /// Reconstructs a file without a service.
    Reconstruct(commands::reconstruct::Args),
    /// Writes a simulated gated study with exactly known volumes.
    Phantom(commands::phantom::Args),
    /// Redoes the tables and figures of the paper on simulated hearts.
    Tables(commands::tables::Args),
    /// Measures both presets on simulated hearts whose volumes are known, and on labelled studies.
    Accuracy(commands::accuracy::Args),
    /// Makes, lists and revokes API keys.
    Keys(commands::keys::Args),
    /// Prints the OpenAPI document.
    Openapi(commands::openapi::Args),
    /// Asks a running service whether it is ready; exit status 0 if so.
    Healthcheck(commands::healthcheck::Args),
    /// Decodes compressed images for another process of this program.
    #[command(hide = true, name = ventricle::codecs::SUBCOMMAND)]
    DecodeFrames(commands::decode_frames::Args),
}

fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A sentence for the user; `anyhow`'s own form would print a backtrace where RUST_BACKTRACE is set.
            let _ = writeln!(std::io::stderr(), "error: {}", sentence(&error));
            ExitCode::FAILURE
        }
    }
}

/// An error and what caused it. Those that quote their cause have said it.
fn sentence(error: &anyhow::Error) -> String {
    let mut said = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !said.contains(&cause) {
            said = format!("{said}: {cause}");
        }
    }
    said
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Serve(args) => commands::serve::run(*args),
        Command::Demo(args) => commands::demo::run(args),
        Command::Reconstruct(args) => commands::reconstruct::run(args),
        Command::Phantom(args) => commands::phantom::run(args),
        Command::Tables(args) => commands::tables::run(args),
        Command::Accuracy(args) => commands::accuracy::run(args),
        Command::Keys(args) => commands::keys::run(args),
        Command::Openapi(args) => commands::openapi::run(&args),
        Command::Healthcheck(args) => commands::healthcheck::run(args),
        Command::DecodeFrames(args) => commands::decode_frames::run(&args),
    }
}
