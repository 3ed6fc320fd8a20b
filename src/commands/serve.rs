//! `ventricle serve`.

use anyhow::Context as _;
use ventricle::{config::ServeSettings, http, telemetry};

/// Stack of the runtime's threads, where files are parsed: four times the usual, for the deepest nesting the limits allow.
const STACK_BYTES: usize = 8 << 20;

/// Arguments of `ventricle serve`.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    settings: ServeSettings,
}

/// Runs the service until it is told to stop.
pub(crate) fn run(args: Args) -> anyhow::Result<()> {
    telemetry::init(args.settings.log_format, &args.settings.log)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .thread_stack_size(STACK_BYTES)
        .build()
        .context("The runtime did not start")?;
    Ok(runtime.block_on(http::serve(args.settings))?)
}
