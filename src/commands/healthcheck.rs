//! `ventricle healthcheck`.

/// Arguments of `ventricle healthcheck`.
#[derive(clap::Args)]
pub struct Args {}

/// Runs it.
pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("not built yet")
}
