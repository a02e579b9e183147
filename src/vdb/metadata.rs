//! Metadata maps: named, typed values of the file and of each grid.
//!
//! Two of them matter for loading (`is_saved_as_half_float`, `class`); the rest is shown to the
//! user. Nothing that the walk can find out by itself is taken from metadata: bounding boxes
//! and counts in real files are wrong or missing.

use std::fmt::Write;

use bytemuck::AnyBitPattern;

use super::cursor::Cursor;
use super::error::Damage;

/// Reads a metadata map as text, in file order.
pub(super) fn read(c: &mut Cursor<'_>) -> Result<Vec<(String, String)>, Damage> {
    let count = c.len32("the number of metadata entries")?;
    // Each entry takes at least three lengths of 4 bytes, so `count` alone allocates nothing.
    let mut entries = Vec::with_capacity(count.min(c.left() / 12));
    for _ in 0..count {
        let name = text(c.string("a metadata name")?);
        let type_name = c.string("a metadata type")?;
        let value = c.string("a metadata value")?;
        entries.push((name, show(type_name, value)));
    }
    Ok(entries)
}

/// Looks up `name`; of repeated entries the last one counts.
pub(super) fn get<'a>(entries: &'a [(String, String)], name: &str) -> Option<&'a str> {
    let found = entries.iter().rev().find(|(n, _)| n == name);
    found.map(|(_, value)| value.as_str())
}

/// Returns the bytes as UTF-8, with replacement characters where they are not.
pub(super) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn show(type_name: &[u8], value: &[u8]) -> String {
    let shown = match type_name {
        b"string" => Some(text(value)),
        b"bool" => value.first().map(|&b| (b != 0).to_string()),
        b"int32" | b"vec2i" | b"vec3i" | b"vec4i" => numbers::<i32>(value),
        b"int64" => numbers::<i64>(value),
        b"float" | b"vec2s" | b"vec3s" | b"vec4s" | b"mat4s" => numbers::<f32>(value),
        b"double" | b"vec2d" | b"vec3d" | b"vec4d" | b"mat4d" => numbers::<f64>(value),
        _ => None,
    };
    shown.unwrap_or_else(|| format!("({}, {} bytes)", text(type_name), value.len()))
}

/// Writes up to 16 numbers (a matrix); `None` where the bytes are not whole numbers.
fn numbers<T: AnyBitPattern + std::fmt::Display>(value: &[u8]) -> Option<String> {
    let size = size_of::<T>();
    if value.is_empty() || !value.len().is_multiple_of(size) || value.len() > 16 * size {
        return None;
    }
    let mut out = String::new();
    for (i, bytes) in value.chunks_exact(size).enumerate() {
        let gap = if i == 0 { "" } else { " " };
        write!(out, "{gap}{}", bytemuck::pod_read_unaligned::<T>(bytes)).ok()?;
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(out: &mut Vec<u8>, name: &str, type_name: &str, value: &[u8]) {
        for part in [name.as_bytes(), type_name.as_bytes(), value] {
            out.extend(u32::try_from(part.len()).unwrap().to_le_bytes());
            out.extend(part);
        }
    }

    #[test]
    fn values_are_shown_by_type_and_wrong_sizes_do_no_harm() {
        let mut b = 5_u32.to_le_bytes().to_vec();
        entry(&mut b, "s", "string", "dichte_ä".as_bytes());
        entry(&mut b, "v", "vec3i", bytemuck::bytes_of(&[1_i32, -2, 3]));
        entry(&mut b, "short", "double", &[1, 2, 3]);
        entry(&mut b, "x", "__delayedload", &[0; 7]);
        entry(&mut b, "none", "bool", &[]);
        let entries = read(&mut Cursor::new(&b, 0)).unwrap();
        let shown: Vec<_> = entries.iter().map(|(_, v)| v.as_str()).collect();
        assert_eq!(
            shown,
            [
                "dichte_ä",
                "1 -2 3",
                "(double, 3 bytes)",
                "(__delayedload, 7 bytes)",
                "(bool, 0 bytes)"
            ]
        );
    }

    #[test]
    fn a_hostile_count_is_an_error_not_an_allocation() {
        let b = u32::MAX.to_le_bytes();
        assert!(
            read(&mut Cursor::new(&b, 0)).is_err(),
            "4 billion entries in 4 bytes"
        );
    }
}
