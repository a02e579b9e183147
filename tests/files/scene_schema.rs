//! The JSON Schema of scene files: it has every documented key, takes every scene of this project, and
//! refuses what is wrong.

use std::path::Path;

use majorant::scene::schema;
use serde_json::{Value, json};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn limit(rule: &Value) -> Option<usize> {
    rule.as_u64().and_then(|n| n.try_into().ok())
}

/// Says where `value` is not what `schema` says, for the keywords that ours uses; any other is an error.
#[expect(clippy::too_many_lines, reason = "an arm for each keyword")]
fn mistakes(whole: &Value, schema: &Value, value: &Value, at: &str) -> Vec<String> {
    let wrong = |why: String| vec![format!("{at}: {why}")];
    let Some(schema) = schema.as_object() else {
        return if schema == &json!(false) {
            wrong("is not to be".to_owned())
        } else {
            Vec::new()
        };
    };
    let mut found = Vec::new();
    for (keyword, rule) in schema {
        found.extend(match keyword.as_str() {
            "$ref" => {
                let path = rule.as_str().expect("a path").trim_start_matches('#');
                let target = whole.pointer(path).unwrap_or_else(|| panic!("no {path}"));
                mistakes(whole, target, value, at)
            }
            "type" => {
                let is = |name: &Value| match name.as_str().expect("a name") {
                    "object" => value.is_object(),
                    "array" => value.is_array(),
                    "string" => value.is_string(),
                    "boolean" => value.is_boolean(),
                    "integer" => value.is_i64() || value.is_u64(),
                    "number" => value.is_number(),
                    other => panic!("type {other}"),
                };
                let names = rule
                    .as_array()
                    .cloned()
                    .unwrap_or_else(|| vec![rule.clone()]);
                if names.iter().any(is) {
                    Vec::new()
                } else {
                    wrong(format!("{value} is no {rule}"))
                }
            }
            "const" if rule != value => wrong(format!("{value} is not {rule}")),
            "enum" if !rule.as_array().expect("a list").contains(value) => {
                wrong(format!("{value} is none of {rule}"))
            }
            "minimum" if value.as_f64() < rule.as_f64() => {
                wrong(format!("{value} is below {rule}"))
            }
            "maximum" if value.as_f64() > rule.as_f64() => {
                wrong(format!("{value} is above {rule}"))
            }
            "minItems" if (value.as_array().map(Vec::len)) < limit(rule) => {
                wrong(format!("less than {rule}"))
            }
            "maxItems" if (value.as_array().map(Vec::len)) > limit(rule) => {
                wrong(format!("more than {rule}"))
            }
            "minProperties" if value.as_object().is_some_and(serde_json::Map::is_empty) => {
                wrong("is empty".to_owned())
            }
            // What is no rule, rules that are kept, and patterns: beside "additionalProperties".
            "$schema" | "$defs" | "title" | "description" | "default" | "format" | "const"
            | "enum" | "minimum" | "maximum" | "minItems" | "maxItems" | "minProperties"
            | "patternProperties" => Vec::new(),
            "anyOf" | "oneOf" => {
                let all = rule.as_array().expect("a list").iter();
                let all: Vec<_> = all.map(|s| mistakes(whole, s, value, at)).collect();
                if all.iter().any(Vec::is_empty) {
                    Vec::new()
                } else {
                    all.concat()
                }
            }
            "items" => {
                let items = value.as_array().into_iter().flatten().enumerate();
                items
                    .flat_map(|(i, item)| mistakes(whole, rule, item, &format!("{at}.{i}")))
                    .collect()
            }
            "required" => {
                let missing = rule.as_array().expect("a list").iter().filter(|key| {
                    value.is_object() && value.get(key.as_str().expect("a name")).is_none()
                });
                missing.flat_map(|key| wrong(format!("no {key}"))).collect()
            }
            "properties" => {
                let keys = rule.as_object().expect("keys").iter();
                let known = keys.filter_map(|(key, s)| Some((key, s, value.get(key)?)));
                known
                    .flat_map(|(key, s, v)| mistakes(whole, s, v, &format!("{at}.{key}")))
                    .collect()
            }
            "additionalProperties" => {
                assert_eq!(rule, &json!(false), "no other is used");
                let of_keys = schema.get("properties").and_then(Value::as_object);
                // Of patterns, only that of frames.
                let frames = schema.contains_key("patternProperties");
                let is_known = |key: &String| {
                    of_keys.is_some_and(|keys| keys.contains_key(key))
                        || frames && key.parse::<i32>().is_ok()
                };
                let keys = value.as_object().into_iter().flatten().map(|(key, _)| key);
                let unknown = keys.filter(|key| !is_known(key));
                unknown
                    .flat_map(|key| wrong(format!("no key {key}")))
                    .collect()
            }
            other => panic!("{at}: keyword {other}"),
        });
    }
    found
}

fn check(toml: &str) -> Vec<String> {
    let scene: toml::Value = toml::from_str(toml).expect("TOML");
    let scene = serde_json::to_value(scene).expect("any TOML is JSON but for dates");
    let schema = schema();
    mistakes(&schema, &schema, &scene, "scene")
}

const CAMERA: &str = "[camera]\nposition = [0, -3, 0]\nlook_at = [0, 0, 0]\n";

#[test]
fn every_scene_of_the_project_is_valid() {
    let folder = Path::new(ROOT).join("data/scenes");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).expect("the project has scenes") {
        let path = entry.expect("it can be listed").path();
        let text = std::fs::read_to_string(&path).expect("it can be read");
        assert_eq!(check(&text), Vec::<String>::new(), "{}", path.display());
        count += 1;
    }
    assert!(count >= 10, "{count}");
    let page = std::fs::read_to_string(Path::new(ROOT).join("docs/scene-format.md"));
    let page = page.expect("the page is part of the project");
    for example in page.split("```toml\n").skip(1) {
        let text = example.split("```").next().expect("it ends");
        // Some show a part: the rest is the least that a scene needs.
        let text = if text.contains("[camera]") {
            text.to_owned()
        } else {
            format!("{text}\n{CAMERA}")
        };
        if toml::from_str::<toml::Value>(&text).is_ok_and(|v| v.get("volume").is_some()) {
            assert_eq!(check(&text), Vec::<String>::new(), "{text}");
        }
    }
}

/// Returns the schemas of the key `name` of an object that may be `schema`.
fn members<'a>(whole: &'a Value, schema: &'a Value, name: &str) -> Vec<&'a Value> {
    let mut found: Vec<_> = schema
        .get("properties")
        .and_then(|p| p.get(name))
        .into_iter()
        .collect();
    if let Some(path) = schema.get("$ref").and_then(Value::as_str) {
        let target = whole
            .pointer(path.trim_start_matches('#'))
            .expect("a definition");
        found.extend(members(whole, target, name));
    }
    for of in ["anyOf", "oneOf", "items"]
        .iter()
        .filter_map(|of| schema.get(of))
    {
        let all = of
            .as_array()
            .map_or_else(|| vec![of], |all| all.iter().collect());
        found.extend(all.into_iter().flat_map(|s| members(whole, s, name)));
    }
    found
}

#[test]
fn every_documented_key_is_in_it() {
    let schema = schema();
    let page = std::fs::read_to_string(Path::new(ROOT).join("docs/scene-format.md"));
    let page = page.expect("the page is part of the project");
    let rows = page
        .lines()
        .filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    let keys: Vec<_> = rows.filter(|key| key.contains('.')).collect();
    assert!(keys.len() > 50, "{keys:?}");
    for key in keys {
        let found = key.split('.').fold(vec![&schema], |at, name| {
            at.iter().flat_map(|s| members(&schema, s, name)).collect()
        });
        assert!(!found.is_empty(), "{key}");
        let described = found.iter().any(|s| s.get("description").is_some());
        assert!(described || key.ends_with("type"), "{key}: {found:?}");
    }
}

#[test]
fn what_is_wrong_is_refused_and_keyframes_are_not() {
    let scene = |volume: &str, rest: &str| {
        check(&format!(
            "{CAMERA}{rest}\n[[volume]]\nfile = \"a.vdb\"\n{volume}\n"
        ))
    };
    for right in [
        scene("", ""),
        scene("albedo = { grid = \"Cd\" }", ""),
        scene(
            "density = { scale = { keys = { 1 = 1, 10 = 2.5 }, interpolation = \"smooth\" } }",
            "",
        ),
        scene(
            "translate = { keys = { 1 = [0, 0, 1], -10 = [0, 0, 2] } }",
            "up = [0, 1, 0]",
        ),
    ] {
        assert_eq!(right, Vec::<String>::new());
    }
    for (wrong, says) in [
        (scene("densty = { scale = 1.0 }", ""), "no key densty"),
        (scene("density = { scale = \"thick\" }", ""), "thick"),
        (
            scene("density = { scale = { keys = { first = 1 } } }", ""),
            "no key first",
        ),
        (scene("phase = { type = \"mie\" }", ""), "mie"),
        (scene("rotate = [0, 0]", ""), "less than 3"),
        (scene("", "up = [0, 1, 0, 0]"), "more than 3"),
        (check("[camera]\nposition = [0, 0, 0]\n"), "no \"look_at\""),
    ] {
        assert!(wrong.iter().any(|w| w.contains(says)), "{says}: {wrong:?}");
    }
}
