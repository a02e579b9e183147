//! A scene file before it is a scene: with keyframes, and with what the command line sets.
//!
//! Wherever a scene file has a number or a vector, it may have keys instead:
//!
//! ```toml
//! vertical_fov_degrees = { keys = { 1001 = 30.0, 1100 = 45.0 }, interpolation = "smooth" }
//! ```
//!
//! Keys are replaced by their value at a frame in the tree of the TOML document, before it
//! becomes a description: whatever reads the description sees numbers, at the place of the keys.
//! `--set path.to.key=value` changes the same tree.

use std::path::Path;

use serde::Deserialize as _;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::desc::{SceneDesc, unplaced};
use super::error::{Check, Source};
use super::keyframes::{Interpolation, value_at};
use super::{SceneError, SceneFile};

/// The text of a scene file, and what is to be changed in it.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneTemplate {
    source: Source,
    sets: Vec<(Vec<String>, String)>,
}

impl SceneTemplate {
    /// Reads a scene file.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let text = std::fs::read_to_string(path).map_err(|source| SceneError::Read {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self::new(path, text))
    }

    /// Takes the text of a scene file; `path` is what errors call it and what files are relative
    /// to.
    pub fn new(path: &Path, text: String) -> Self {
        let path = path.to_owned();
        Self {
            source: Source { path, text },
            sets: Vec::new(),
        }
    }

    /// Sets a key by its path, such as `light.0.irradiance`, to a TOML value, or to the text
    /// itself if that is none.
    pub fn set(&mut self, path: &str, value: &str) {
        let path = path.split('.').map(|s| s.trim().to_owned()).collect();
        let text = if DeValue::parse(value).is_ok() {
            value.to_owned()
        } else {
            toml::Value::String(value.to_owned()).to_string()
        };
        self.sets.push((path, text));
    }

    /// Returns the scene at a frame: with the frame's number in `render.frame` and keys replaced
    /// by values; without one, at the frame that the file says.
    ///
    /// # Errors
    /// If the text is not TOML, has unknown, missing or mistyped keys, or keyframes that are none.
    pub fn at(&self, frame: Option<i32>) -> Result<SceneFile, SceneError> {
        let desc = self.describe(frame).map_err(SceneError::Description)?;
        Ok(SceneFile {
            source: self.source.clone(),
            desc,
        })
    }

    fn describe(&self, frame: Option<i32>) -> Check<SceneDesc> {
        let source = &self.source;
        let toml_error = |e: &toml::de::Error| Box::new(source.toml_error(e));
        let frame_text = frame.map(|f| f.to_string());
        let mut document = DeTable::parse(&source.text).map_err(|e| toml_error(&e))?;
        for (path, value) in &self.sets {
            let value = DeValue::parse(value).map_err(|e| toml_error(&e))?;
            let at = Setting { source, path };
            at.set(document.get_mut(), path, value.into_inner())?;
        }
        if let Some(frame) = &frame_text {
            let value = DeValue::parse(frame).expect("a whole number is TOML");
            let path = ["render".to_owned(), "frame".to_owned()];
            let at = Setting {
                source,
                path: &path,
            };
            at.set(document.get_mut(), &path, value.into_inner())?;
        }
        let frame = frame.unwrap_or_else(|| own_frame(document.get_ref()));
        let mut texts = Vec::new();
        for value in document.get_ref().values() {
            collect(source, value, frame, &mut texts)?;
        }
        // Values borrow their text, so all texts come before the first value.
        let mut values = texts
            .iter()
            .map(|t| DeValue::parse(t).expect("written as TOML"));
        for (_, value) in document.get_mut().iter_mut() {
            replace(value, &mut values);
        }
        let set_something = !self.sets.is_empty();
        SceneDesc::deserialize(toml::Deserializer::from(document)).map_err(|e| {
            let mut error = source.toml_error(&e);
            // Only what was set stands nowhere in the file.
            if error.span.is_empty() && set_something && error.help.is_none() {
                error.help = Some("see what --set says".to_owned());
            }
            Box::new(error)
        })
    }
}

/// Returns `render.frame`, if it is there and a number; what else it may be is found later.
fn own_frame(document: &DeTable<'_>) -> i32 {
    let render = document.get("render").and_then(|v| v.get_ref().as_table());
    let frame = render.and_then(|table| table.get("frame"));
    let integer = frame.and_then(|v| v.get_ref().as_integer());
    integer.and_then(|i| i.as_str().parse().ok()).unwrap_or(0)
}

/// A path of `--set`, for errors.
struct Setting<'a> {
    source: &'a Source,
    path: &'a [String],
}

impl Setting<'_> {
    fn error(&self, message: &str, expected: &str) -> Box<super::DescriptionError> {
        let message = format!("--set {}: {message}", self.path.join("."));
        self.source.error(0..0, message, expected)
    }

    /// Puts `value` at `path` below `table`; makes tables that are missing.
    fn set<'i>(&self, table: &mut DeTable<'i>, path: &[String], value: DeValue<'i>) -> Check<()> {
        let Some((key, rest)) = path.split_first().filter(|(key, _)| !key.is_empty()) else {
            return Err(self.error("a part is empty", "path.to.key=value"));
        };
        if table.get_mut(key.as_str()).is_none() {
            let empty = DeValue::Table(DeTable::new());
            table.insert(unplaced(key.clone().into()), unplaced(empty));
        }
        let entry = table.get_mut(key.as_str()).expect("inserted above");
        self.descend(entry, key, rest, value)
    }

    fn descend<'i>(
        &self,
        entry: &mut Spanned<DeValue<'i>>,
        key: &str,
        rest: &[String],
        value: DeValue<'i>,
    ) -> Check<()> {
        let Some((next, further)) = rest.split_first() else {
            *entry = unplaced(without_places(value));
            return Ok(());
        };
        match entry.get_mut() {
            DeValue::Table(table) => self.set(table, rest, value),
            DeValue::Array(array) => {
                let count = array.len();
                let index = next.parse::<usize>().ok();
                let Some(item) = index.and_then(|i| array.get_mut(i)) else {
                    let message = format!("no {key} {next:?}, the scene has {count}");
                    return Err(self.error(&message, "their number, from 0"));
                };
                self.descend(item, next, further, value)
            }
            _ => Err(self.error(&format!("{key} is a value"), "a path that ends there")),
        }
    }
}

/// Takes the places off a value that stands in no file.
fn without_places(value: DeValue<'_>) -> DeValue<'_> {
    placed(value, &(0..0))
}

/// Puts a value and all in it at one place.
fn placed<'i>(value: DeValue<'i>, span: &std::ops::Range<usize>) -> DeValue<'i> {
    match value {
        DeValue::Array(items) => {
            let mut array = DeArray::new();
            for item in items {
                array.push(Spanned::new(span.clone(), placed(item.into_inner(), span)));
            }
            DeValue::Array(array)
        }
        DeValue::Table(entries) => {
            let mut table = DeTable::new();
            for (key, item) in entries {
                let key = Spanned::new(span.clone(), key.into_inner());
                table.insert(
                    key,
                    Spanned::new(span.clone(), placed(item.into_inner(), span)),
                );
            }
            DeValue::Table(table)
        }
        other => other,
    }
}

/// Returns the table of keys, if `value` is keyframed.
fn keyframed<'a, 'i>(value: &'a DeValue<'i>) -> Option<&'a DeTable<'i>> {
    value.as_table().filter(|table| table.contains_key("keys"))
}

/// Writes the values of all keyframes below `value`, in order, as TOML.
fn collect(
    source: &Source,
    value: &Spanned<DeValue<'_>>,
    frame: i32,
    texts: &mut Vec<String>,
) -> Check<()> {
    if let Some(table) = keyframed(value.get_ref()) {
        texts.push(evaluate(source, value, table, frame)?);
        return Ok(());
    }
    match value.get_ref() {
        DeValue::Array(items) => {
            for item in items {
                collect(source, item, frame, texts)?;
            }
        }
        DeValue::Table(table) => {
            for item in table.values() {
                collect(source, item, frame, texts)?;
            }
        }
        _ => {}
    }
    Ok(())
}

/// Puts `values` in the places of keyframes, in the order of [`collect`].
fn replace<'i>(
    value: &mut Spanned<DeValue<'i>>,
    values: &mut impl Iterator<Item = Spanned<DeValue<'i>>>,
) {
    if keyframed(value.get_ref()).is_some() {
        let new = values.next().expect("one for each").into_inner();
        *value = Spanned::new(value.span(), placed(new, &value.span()));
        return;
    }
    match value.get_mut() {
        DeValue::Array(items) => {
            for item in items.iter_mut() {
                replace(item, values);
            }
        }
        DeValue::Table(table) => {
            for (_, item) in table.iter_mut() {
                replace(item, values);
            }
        }
        _ => {}
    }
}

/// Returns the value of keyframes at `frame`, as TOML.
fn evaluate(
    source: &Source,
    whole: &Spanned<DeValue<'_>>,
    table: &DeTable<'_>,
    frame: i32,
) -> Check<String> {
    let mut how = Interpolation::default();
    for (key, value) in table {
        match key.get_ref().as_ref() {
            "keys" => {}
            "interpolation" => how = interpolation(source, value)?,
            other => {
                let message = format!("keyframes have no {other}");
                return Err(source.error(key.span(), message, "keys and interpolation only"));
            }
        }
    }
    let keys = table.get("keys").and_then(|k| k.get_ref().as_table());
    let Some(keys) = keys.filter(|k| !k.is_empty()) else {
        let message = "keys is not a table of frames and values";
        return Err(source.error(whole.span(), message, "keys = { 1001 = 1.0, 1100 = 2.0 }"));
    };
    let mut frames = Vec::new();
    for (key, value) in keys {
        let Ok(frame) = key.get_ref().parse::<i32>() else {
            let message = format!("{:?} is no frame", key.get_ref());
            return Err(source.error(key.span(), message, "a whole number"));
        };
        frames.push((frame, components(source, value)?));
    }
    // The table is in the order of texts.
    frames.sort_by_key(|&(frame, _)| frame);
    let length = frames[0].1.len();
    if frames.iter().any(|(_, values)| values.len() != length) {
        let message = "keys have values of different lengths";
        return Err(source.error(whole.span(), message, "numbers, or vectors of one length"));
    }
    let channel = |c: usize| {
        let keys: Vec<_> = frames.iter().map(|(f, values)| (*f, values[c])).collect();
        toml::Value::Float(value_at(&keys, how, frame)).to_string()
    };
    let values: Vec<_> = (0..length).map(channel).collect();
    let is_vector = keys.values().any(|v| v.get_ref().is_array());
    Ok(if is_vector {
        format!("[{}]", values.join(", "))
    } else {
        values.join("")
    })
}

fn interpolation(source: &Source, value: &Spanned<DeValue<'_>>) -> Check<Interpolation> {
    match value.get_ref().as_str() {
        Some("linear") => Ok(Interpolation::Linear),
        Some("smooth") => Ok(Interpolation::Smooth),
        _ => Err(source.error(
            value.span(),
            "unknown interpolation",
            "\"linear\" or \"smooth\"",
        )),
    }
}

/// Returns the number or the numbers of a key's value.
fn components(source: &Source, value: &Spanned<DeValue<'_>>) -> Check<Vec<f64>> {
    let number = |value: &Spanned<DeValue<'_>>| {
        let text = match value.get_ref() {
            DeValue::Integer(i) if i.radix() == 10 => Some(i.as_str()),
            DeValue::Float(f) => Some(f.as_str()),
            _ => None,
        };
        text.and_then(|t| t.parse::<f64>().ok()).ok_or_else(|| {
            let found = value.get_ref().type_str();
            source.error(
                value.span(),
                format!("a key's value is a {found}"),
                "a number",
            )
        })
    };
    match value.get_ref() {
        DeValue::Array(items) if !items.is_empty() => items.iter().map(number).collect(),
        _ => Ok(vec![number(value)?]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &str = "[camera]\nposition = { keys = { 10 = [0, -3, 0], 20 = [0.0, -5.0, 2] } }\n\
                         look_at = [0, 0, 0]\nvertical_fov_degrees = { keys = { 10 = 30, 20 = 40 }, \
                         interpolation = \"smooth\" }\n[[volume]]\nfile = \"a.vdb\"\n";

    fn template(text: &str) -> SceneTemplate {
        SceneTemplate::new(Path::new("a.toml"), text.to_owned())
    }

    fn error(template: &SceneTemplate, frame: Option<i32>) -> String {
        template.at(frame).unwrap_err().to_string()
    }

    #[test]
    fn keys_become_their_values_at_a_frame() {
        let desc = template(SCENE).at(Some(15)).unwrap().desc;
        assert_eq!(*desc.camera.position.get_ref(), [0.0, -4.0, 1.0]);
        assert_eq!(*desc.camera.vertical_fov_degrees.get_ref(), 35.0);
        assert_eq!(desc.render.frame, 15);
        let at_rest = template(SCENE).at(None).unwrap().desc;
        assert_eq!(*at_rest.camera.position.get_ref(), [0.0, -3.0, 0.0]);
        let own = format!("{SCENE}[render]\nframe = 20\n");
        let desc = template(&own).at(None).unwrap().desc;
        assert_eq!(*desc.camera.position.get_ref(), [0.0, -5.0, 2.0]);
    }

    #[test]
    fn errors_about_keyed_values_point_at_the_keys() {
        let wide = SCENE.replace("20 = 40", "20 = 400");
        let file = template(&wide).at(Some(20)).unwrap();
        let said = file.check(1 << 30).unwrap_err().to_string();
        assert!(
            said.starts_with("a.toml:4:24: vertical_fov_degrees is 400"),
            "{said}"
        );
        for (from, to, place) in [
            ("10 = 30", "a = 30", "a.toml:4:35: \"a\" is no frame"),
            ("10 = 30", "10 = [1, 2]", "different lengths"),
            (
                "10 = 30",
                "10 = true",
                "a.toml:4:40: a key's value is a boolean",
            ),
            ("\"smooth\"", "\"soft\"", "unknown interpolation"),
            ("{ 10 = 30, 20 = 40 }", "{}", "not a table of frames"),
            ("interpolation", "interpol", "keyframes have no interpol"),
        ] {
            let said = error(&template(&SCENE.replace(from, to)), Some(15));
            assert!(said.contains(place), "{to}: {said}");
        }
    }

    #[test]
    fn values_are_set_by_path() {
        let mut scene = template(SCENE);
        scene.set("camera.position", "[1, 2, 3]");
        scene.set("volume.0.density.scale", "7.5");
        scene.set("render.integrator", "analog");
        scene.set("camera.vertical_fov_degrees", "{ keys = { 0 = 1, 2 = 3 } }");
        let desc = scene.at(Some(1)).unwrap().desc;
        assert_eq!(*desc.camera.position.get_ref(), [1.0, 2.0, 3.0]);
        assert_eq!(*desc.camera.vertical_fov_degrees.get_ref(), 2.0);
        assert_eq!(*desc.volume[0].get_ref().density.scale.get_ref(), 7.5);
        let kind = *desc.render.integrator.get_ref();
        assert_eq!(kind, crate::integrator::IntegratorKind::Analog);
    }

    #[test]
    fn paths_that_lead_nowhere_are_errors() {
        for (path, value, expected) in [
            ("camera.fov", "3", "unknown field `fov`"),
            ("volume.1.file", "x", "no volume \"1\", the scene has 1"),
            ("camera.up.x.y", "3", "invalid type"),
            ("camera..up", "3", "a part is empty"),
            ("camera.look_at.0.x", "3", "0 is a value"),
            ("camera.up", "no vector", "invalid type"),
        ] {
            let mut scene = template(SCENE);
            scene.set(path, value);
            let said = error(&scene, None);
            assert!(said.contains(expected), "{path}: {said}");
        }
    }
}
