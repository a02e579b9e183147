//! The scene format as a JSON Schema, for editors that complete and check TOML.
//!
//! Made from the structs that scene files are read into, so that no key can be missing, and from
//! their documentation. It holds types and names; ranges, and keys that only some types of light or
//! phase function know, are for `check`.

use serde_json::{Map, Value, json};

use super::desc::SceneDesc;

/// Where the schema says what keyframes are.
const KEYFRAMES: &str = "#/$defs/Keyframes";

/// Returns the JSON Schema (draft 2020-12) of scene files.
pub fn schema() -> Value {
    let mut schema = schemars::schema_for!(SceneDesc).to_value();
    allow_keyframes(&mut schema);
    let Some(whole) = schema.as_object_mut() else {
        return schema;
    };
    whole.insert("title".to_owned(), json!("majorant scene"));
    let definitions = whole.entry("$defs").or_insert_with(|| json!({}));
    if let Some(definitions) = definitions.as_object_mut() {
        definitions.insert("Keyframes".to_owned(), keyframes());
    }
    schema
}

/// What may stand in place of a number or a vector.
fn keyframes() -> Value {
    json!({
        "description": "Values at frames, and how those between them follow.",
        "type": "object",
        "properties": {
            "keys": {
                "type": "object",
                "patternProperties": { "^-?[0-9]+$": { "type": ["number", "array"] } },
                "additionalProperties": false,
                "minProperties": 1,
            },
            "interpolation": { "enum": ["linear", "smooth"] },
        },
        "required": ["keys"],
        "additionalProperties": false,
    })
}

/// Lets keyframes stand for every number and vector below `schema`; TOML has no null.
fn allow_keyframes(schema: &mut Value) {
    match schema {
        Value::Array(all) => all.iter_mut().for_each(allow_keyframes),
        Value::Object(object) => {
            drop_null(object);
            object.values_mut().for_each(allow_keyframes);
            if is_keyable(object) {
                let mut outer = Map::new();
                for key in ["description", "default"] {
                    outer.extend(object.remove_entry(key));
                }
                let inner = std::mem::take(object);
                outer.insert("anyOf".to_owned(), json!([inner, { "$ref": KEYFRAMES }]));
                *object = outer;
            }
        }
        _ => {}
    }
}

/// Returns whether a schema is that of a number or of some of them.
fn is_keyable(schema: &Map<String, Value>) -> bool {
    let is_number = |of: &Value| matches!(of.as_str(), Some("number" | "integer"));
    match schema.get("type") {
        Some(Value::String(array)) if array == "array" => {
            // Its items have become what they may be by now.
            let first = schema.get("items").and_then(|items| items.get("anyOf"));
            let item = first.and_then(|any| any.get(0)?.get("type"));
            item.is_some_and(is_number)
        }
        Some(of) => is_number(of),
        None => false,
    }
}

/// Leaves null out of what a value may be: a key that is not set is not there.
fn drop_null(schema: &mut Map<String, Value>) {
    if let Some(Value::Array(types)) = schema.get_mut("type") {
        types.retain(|of| of != "null");
        if let [one] = &types[..] {
            let one = one.clone();
            schema.insert("type".to_owned(), one);
        }
    }
    if let Some(Value::Array(any)) = schema.get_mut("anyOf") {
        any.retain(|of| of.get("type").is_none_or(|of| of != "null"));
        if let [Value::Object(one)] = &any[..] {
            let one = one.clone();
            schema.remove("anyOf");
            schema.extend(one);
        }
    }
    if schema.get("default").is_some_and(Value::is_null) {
        schema.remove("default");
    }
}
