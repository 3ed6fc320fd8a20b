//! Parameters in a query string, and how those of query, part and body are laid upon each other.

use super::ParameterError;
use serde_json::{Map, Value};

/// Dots in a name before it is refused unread: the parameters have one, and nesting costs stack.
const MAX_SECTIONS: usize = 8;

/// Parameters from a query string's pairs, nested by dots: `mesh.level=4` is `{"mesh": {"level": 4}}`. Values are read as JSON,
/// `1,2` as the array that it would be in brackets, and all else as text.
pub fn from_query(pairs: &[(String, String)]) -> Result<Value, ParameterError> {
    let mut root = Map::new();
    for (key, text) in pairs {
        let pointer = format!("/{}", key.replace('.', "/"));
        let (sections, field) = match key.rsplit_once('.') {
            Some((sections, field)) => (sections.split('.').collect::<Vec<_>>(), field),
            None => (Vec::new(), key.as_str()),
        };
        if sections.len() > MAX_SECTIONS {
            return Err(ParameterError::one("unknown_parameter", &pointer, "A parameter of the query is nested too deeply."));
        }
        let mut object = &mut root;
        for section in sections {
            let next = object.entry(section).or_insert_with(|| Value::Object(Map::new()));
            object = next.as_object_mut().ok_or_else(|| {
                ParameterError::one("invalid_parameter", &pointer, format!("`{key}`: `{section}` was already given as a value."))
            })?;
        }
        let value = value(text);
        if object.insert(field.to_owned(), value).is_some() {
            return Err(ParameterError::one("invalid_parameter", &pointer, format!("`{key}` is given twice.")));
        }
    }
    Ok(Value::Object(root))
}

fn value(text: &str) -> Value {
    let list = || text.contains(',').then(|| serde_json::from_str(&format!("[{text}]")).ok()).flatten();
    serde_json::from_str(text).ok().or_else(list).unwrap_or_else(|| Value::String(text.to_owned()))
}

/// Lays `over` upon `base`, object by object: what `over` says wins.
pub fn merge(base: &mut Value, over: Value) {
    match (base, over) {
        (Value::Object(base), Value::Object(over)) => {
            for (key, value) in over {
                merge(base.entry(key).or_insert(Value::Null), value);
            }
        }
        (base, over) => *base = over,
    }
}
