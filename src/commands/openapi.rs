//! `ventricle openapi`.

use std::io::Write as _;

/// Arguments of `ventricle openapi`.
#[derive(clap::Args)]
pub struct Args {}

/// Prints the OpenAPI document.
pub fn run(_args: Args) -> anyhow::Result<()> {
    Ok(std::io::stdout().write_all(ventricle::http::openapi_json().as_bytes())?)
}
