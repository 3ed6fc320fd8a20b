//! Compares parameters with the schema of [`Request`] before anything else reads them.

use super::{Complaint, Request};
use serde_json::Value;
use std::fmt::Write as _;
use utoipa::PartialSchema;

/// The field that says how long a job is kept.
const RETENTION: &str = "retention_seconds";
/// The fields that are about the job and not about its numbers.
const OF_THE_JOB: [&str; 2] = [RETENTION, "keep_input"];

/// The schema of [`Request`] as plain JSON, without references: for a job that may be kept for so long, in s, or for a reconstruction that is
/// nobody's job.
pub(super) fn schema(longest_retention_s: Option<u64>) -> Value {
    let mut schema = serde_json::to_value(Request::schema()).unwrap_or_default();
    if let Some(fields) = schema["properties"].as_object_mut() {
        match longest_retention_s {
            Some(longest_s) => fields[RETENTION]["maximum"] = longest_s.into(),
            None => fields.retain(|name, _| !OF_THE_JOB.contains(&name.as_str())),
        }
    }
    schema
}

/// The alternative of an optional field that is not `null`.
pub(super) fn not_null(schema: &Value) -> &Value {
    let alternatives = schema["oneOf"].as_array().or(schema["anyOf"].as_array());
    alternatives.and_then(|list| list.iter().find(|one| one["type"] != "null")).unwrap_or(schema)
}

/// The JSON type a schema asks for, `null` aside.
pub(super) fn kind(schema: &Value) -> &str {
    match &schema["type"] {
        Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null").unwrap_or("object"),
        Value::String(kind) => kind,
        _ => "object",
    }
}

/// Compares a value with its schema and collects what is wrong. `pointer` is where the value stands.
pub(super) fn check(value: &Value, schema: &Value, pointer: &str, complaints: &mut Vec<Complaint>) {
    if value.is_null() {
        return;
    }
    let mut complain = |code, pointer: &str, detail: String| complaints.push(Complaint { code, pointer: pointer.to_owned(), detail });
    let schema = not_null(schema);
    let (kind, name) = (kind(schema), dotted(pointer));
    if !is_a(value, kind) {
        return complain("invalid_parameter", pointer, format!("{name} is {}; {} is needed.", shortened(value), with_article(kind)));
    }
    if let Some(values) = schema["enum"].as_array().filter(|values| !values.contains(value)) {
        let allowed = values.iter().map(Value::to_string).collect::<Vec<_>>().join(", ");
        return complain("invalid_parameter", pointer, format!("{name} is {}; allowed is {allowed}.", shortened(value)));
    }
    if let (Some(number), Some(least), Some(most)) = (value.as_f64(), schema["minimum"].as_f64(), schema["maximum"].as_f64())
        && !(least..=most).contains(&number)
    {
        return complain("invalid_parameter", pointer, format!("{name} is {}; allowed is {least} to {most}.", shortened(value)));
    }
    match value {
        Value::Array(items) => {
            if let (Some(least), Some(most)) = (schema["minItems"].as_u64(), schema["maxItems"].as_u64())
                && !(least..=most).contains(&(items.len() as u64))
            {
                return complain("invalid_parameter", pointer, format!("{name} has {} values; {least} are needed.", items.len()));
            }
            for (i, item) in items.iter().enumerate() {
                check(item, &schema["items"], &format!("{pointer}/{i}"), complaints);
            }
        }
        Value::Object(fields) => {
            for (field, value) in fields {
                let pointer = format!("{pointer}/{}", field.replace('~', "~0").replace('/', "~1"));
                match schema["properties"].get(field) {
                    Some(property) => check(value, property, &pointer, complaints),
                    None => complaints.push(unknown(&pointer, schema)),
                }
            }
        }
        _ => {}
    }
}

fn unknown(pointer: &str, schema: &Value) -> Complaint {
    if pointer.strip_prefix('/').is_some_and(|name| OF_THE_JOB.contains(&name)) {
        let detail = format!("{} is for jobs of the service, which keeps them; here it changes nothing. Leave it out.", dotted(pointer));
        return Complaint { code: "unavailable_parameter", pointer: pointer.to_owned(), detail };
    }
    let mut detail = format!("{} is not a parameter", dotted(pointer));
    if let Some(properties) = schema["properties"].as_object() {
        let known = properties.keys().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
        let _ = write!(detail, "; known here are {known}");
    }
    Complaint { code: "unknown_parameter", pointer: pointer.to_owned(), detail: detail + "." }
}

/// A pointer as people write it: `` `edges.sigma` ``.
pub(super) fn dotted(pointer: &str) -> String {
    if pointer.is_empty() { "`parameters`".into() } else { format!("`{}`", shorten(&pointer[1..].replace('/', "."))) }
}

fn is_a(value: &Value, kind: &str) -> bool {
    match kind {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_u64() || value.is_i64(),
        _ => value.is_number(),
    }
}

fn with_article(kind: &str) -> String {
    format!("{} {kind}", if kind.starts_with(['a', 'i', 'o']) { "an" } else { "a" })
}

fn shortened(value: &Value) -> String {
    shorten(&value.to_string())
}

/// At most 64 characters of what a client sent are repeated to it.
fn shorten(text: &str) -> String {
    match text.char_indices().nth(64) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}
