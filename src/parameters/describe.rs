//! What every parameter is, for `GET /v1/parameters`: read from the schema, so that it cannot differ from what is checked.

use super::{
    check::{kind, not_null, schema},
    idle,
};
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;

/// One parameter as `GET /v1/parameters` lists it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Description {
    /// JSON pointer of the field in the parameters.
    #[schema(example = "/edges/sigma")]
    pub pointer: String,
    /// What it is.
    pub description: String,
    /// JSON type.
    #[serde(rename = "type")]
    #[schema(example = "number")]
    pub kind: String,
    /// The presets that read it: `clinical`, `paper` or both. With another one a value that departs from the default is refused.
    #[schema(value_type = Vec<String>, example = json!(["paper"]))]
    pub presets: Vec<&'static str>,
    /// Value when left out, with the presets that read it; absent where it is estimated from the counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub default: Option<Value>,
    /// Smallest value allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub minimum: Option<f64>,
    /// Largest value allowed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maximum: Option<f64>,
    /// The values allowed.
    #[serde(rename = "enum", skip_serializing_if = "Option::is_none")]
    pub values: Option<Vec<Value>>,
}

/// Every parameter with its documentation, in the order of the schema: of a job that may be kept for so long, in s, or of a reconstruction that
/// is nobody's job.
pub fn describe(longest_retention_s: Option<u64>) -> Vec<Description> {
    let mut out = Vec::new();
    describe_fields(&schema(longest_retention_s), "", &mut out);
    out
}

fn describe_fields(schema: &Value, prefix: &str, out: &mut Vec<Description>) {
    let Some(properties) = schema["properties"].as_object() else { return };
    for (name, property) in properties {
        let pointer = format!("{prefix}/{name}");
        let field = not_null(property);
        if field["properties"].is_object() {
            describe_fields(field, &pointer, out);
            continue;
        }
        out.push(Description {
            presets: idle::presets(&pointer),
            pointer,
            description: property["description"].as_str().or(field["description"].as_str()).unwrap_or_default().to_owned(),
            kind: kind(field).to_owned(),
            default: property.get("default").or(field.get("default")).cloned(),
            minimum: field["minimum"].as_f64(),
            maximum: field["maximum"].as_f64(),
            values: field["enum"].as_array().cloned(),
        });
    }
}
