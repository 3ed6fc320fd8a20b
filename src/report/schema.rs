//! The shapes of what is published as JSON, as JSON Schema (2020-12): of a report, of a comparison.
//!
//! Made from the types themselves: OpenAPI 3.1 describes them in JSON Schema 2020-12 already, so what is left is to put them into a document of
//! their own and to take out what only OpenAPI knows.

use super::{Comparison, Report, comparison::COMPARISON_SCHEMA, report::SCHEMA};
use serde_json::{Map, Value, json};
use utoipa::ToSchema;

/// The dialect.
const DIALECT: &str = "https://json-schema.org/draft/2020-12/schema";
/// Where OpenAPI keeps what it refers to, and where JSON Schema does.
const REFERENCES: (&str, &str) = ("#/components/schemas/", "#/$defs/");

/// A schema that is published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PublishedSchema {
    /// Of a [`Report`].
    Report,
    /// Of a [`Comparison`].
    Comparison,
}

impl PublishedSchema {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Report, Self::Comparison];

    /// Its name, with the version of the shape: `report-1`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Report => "report-1",
            Self::Comparison => "comparison-1",
        }
    }

    /// The document, as text that ends with a line feed. The same for every call.
    pub fn document(self) -> String {
        let schema = match self {
            Self::Report => document::<Report>(self.name(), SCHEMA),
            Self::Comparison => document::<Comparison>(self.name(), COMPARISON_SCHEMA),
        };
        format!("{schema:#}\n")
    }
}

/// The schema of a type, with all it refers to, for documents whose `schema` is `version`.
fn document<T: ToSchema>(name: &str, version: &str) -> Value {
    let mut referred = Vec::new();
    T::schemas(&mut referred);
    let defined: Map<String, Value> = referred.iter().map(|(name, schema)| (name.clone(), plain(json!(schema)))).collect();
    let mut schema = Map::from_iter([
        ("$schema".to_owned(), json!(DIALECT)),
        ("$id".to_owned(), json!(format!("urn:ventricle:schema:{name}"))),
        ("title".to_owned(), json!(version)),
    ]);
    if let Value::Object(own) = plain(json!(T::schema())) {
        schema.extend(own);
    }
    if let Some(told) = schema.get_mut("properties").and_then(|properties| properties.get_mut("schema")) {
        told["const"] = json!(version);
    }
    schema.insert("$defs".to_owned(), Value::Object(defined));
    Value::Object(schema)
}

/// Without what only OpenAPI knows: its references, `example`, and formats of numbers.
fn plain(schema: Value) -> Value {
    match schema {
        Value::Object(members) => Value::Object(members.into_iter().filter_map(|(name, value)| member(name, value)).collect()),
        Value::Array(items) => Value::Array(items.into_iter().map(plain).collect()),
        other => other,
    }
}

fn member(name: String, value: Value) -> Option<(String, Value)> {
    match (name.as_str(), &value) {
        ("$ref", Value::String(target)) => {
            let referred = target.strip_prefix(REFERENCES.0).unwrap_or(target);
            Some((name, json!(format!("{}{referred}", REFERENCES.1))))
        }
        // As a keyword these are no objects; as the name of a property they are.
        ("example", example) if !example.is_object() => Some(("examples".to_owned(), json!([example]))),
        ("format", Value::String(format)) if ["double", "float", "int32", "int64"].contains(&format.as_str()) => None,
        // What is a value stays as it is.
        ("const" | "default" | "enum" | "examples" | "required", _) => Some((name, value)),
        _ => Some((name, plain(value))),
    }
}
