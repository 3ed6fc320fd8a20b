//! `ventricle serve`.

use anyhow::Context as _;
use ventricle::{config::ServeSettings, http, telemetry};

/// Arguments of `ventricle serve`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    settings: ServeSettings,
}

/// Runs the service until it is told to stop.
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    telemetry::init(args.settings.log_format, &args.settings.log)?;
    allow_descriptors();
    #[cfg(unix)]
    super::memory::give_back_when_idle();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("The runtime did not start")?;
    Ok(runtime.block_on(http::serve(args.settings))?)
}

/// Takes as many file descriptors as the system allows to whoever asks: the usual soft limit (1024, kept low for programs that call `select`) is
/// less than the clients that may listen to events.
fn allow_descriptors() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let maximum = getrlimit(Resource::Nofile).maximum;
    if let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }) {
        tracing::warn!(%error, "the limit on open files stays as it was");
    }
}
