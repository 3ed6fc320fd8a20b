//! `ventricle openapi`.

use clap::builder::PossibleValue;
use std::io::Write as _;
use ventricle::report::PublishedSchema;

/// Arguments of `ventricle openapi`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Prints this JSON Schema (2020-12) instead: of a report or of a comparison.
    #[arg(long, value_name = "NAME")]
    schema: Option<Schema>,
}

/// A schema that can be asked for.
#[derive(Debug, Clone, Copy)]
struct Schema(PublishedSchema);

impl clap::ValueEnum for Schema {
    fn value_variants<'a>() -> &'a [Self] {
        &[Self(PublishedSchema::Report), Self(PublishedSchema::Comparison)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()))
    }
}

/// Prints the OpenAPI document, or a schema.
pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let document = args.schema.map_or_else(ventricle::http::openapi_json, |schema| schema.0.document());
    Ok(std::io::stdout().write_all(document.as_bytes())?)
}
