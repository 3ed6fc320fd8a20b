//! `ventricle openapi`.

use std::io::Write as _;

/// Arguments of `ventricle openapi`.
#[derive(clap::Args)]
pub(crate) struct Args {}

/// Prints the OpenAPI document.
pub(crate) fn run(_args: Args) -> anyhow::Result<()> {
    Ok(std::io::stdout().write_all(ventricle::http::openapi_json().as_bytes())?)
}
