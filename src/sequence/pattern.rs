//! The frame's number in a file's name.
//!
//! | written | digits |
//! |---|---|
//! | `#` alone | 4 |
//! | `##`, `###`, … | as many as there are |
//! | `@`, `@@`, … | as many as there are |
//! | `%d`, `%04d` | at least 1, 4 |
//! | `$F`, `$F4` | at least 1, 4 |
//! | `<F>`, `<F4>` | at least 1, 4 |
//!
//! A sign counts as a digit, as in C: frame −5 in `####` is `-005`. Every mark in a path is
//! replaced; `%%` is a percent sign.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Widest number: wider ones would be a mistake.
const MAX_WIDTH: usize = 16;

/// A path with the frame's number in it, or a plain one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    pieces: Vec<Piece>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Piece {
    Text(String),
    /// The number in at least so many digits.
    Number(usize),
}

impl Pattern {
    /// Reads a path. Every text is one: what is no mark of a number is itself.
    pub fn new(path: &str) -> Self {
        let mut pieces = Vec::new();
        let mut text = String::new();
        let mut rest = path;
        while let Some(c) = rest.chars().next() {
            if let Some((width, length)) = mark(rest) {
                if !text.is_empty() {
                    pieces.push(Piece::Text(std::mem::take(&mut text)));
                }
                pieces.push(Piece::Number(width));
                rest = &rest[length..];
            } else {
                text.push(c);
                // A doubled percent sign is one.
                let length = if rest.starts_with("%%") {
                    2
                } else {
                    c.len_utf8()
                };
                rest = &rest[length..];
            }
        }
        if !text.is_empty() {
            pieces.push(Piece::Text(text));
        }
        Self { pieces }
    }

    /// Reads a path; `None` if it has no frame number in it, or is not Unicode.
    pub fn of(path: &Path) -> Option<Self> {
        let pattern = Self::new(path.to_str()?);
        pattern.has_number().then_some(pattern)
    }

    /// Returns whether there is a number in it.
    pub fn has_number(&self) -> bool {
        self.pieces.iter().any(|p| matches!(p, Piece::Number(_)))
    }

    /// Returns the path of a frame.
    pub fn path(&self, frame: i32) -> PathBuf {
        let mut path = String::new();
        for piece in &self.pieces {
            match piece {
                Piece::Text(text) => path.push_str(text),
                Piece::Number(width) => {
                    write!(path, "{frame:0width$}").expect("writing to a string cannot fail");
                }
            }
        }
        path.into()
    }

    /// Returns the frame whose path is `path`, if it is one of these.
    pub fn frame(&self, path: &Path) -> Option<i32> {
        let text = path.to_str()?;
        let number = match self.pieces.first() {
            Some(Piece::Text(start)) => text.strip_prefix(start.as_str())?,
            _ => text,
        };
        let sign = usize::from(number.starts_with('-'));
        let digits = number[sign..].bytes().take_while(u8::is_ascii_digit);
        // Shorter ones too: digits of the name may follow those of the number.
        (1..=digits.count().min(MAX_WIDTH)).rev().find_map(|n| {
            let frame = number[..sign + n].parse().ok()?;
            (self.path(frame) == path).then_some(frame)
        })
    }
}

/// Returns width and length of the mark that `text` begins with.
fn mark(text: &str) -> Option<(usize, usize)> {
    let run = |c: char| text.chars().take_while(|&x| x == c).count();
    match text.chars().next()? {
        '#' => {
            let n = run('#');
            (n <= MAX_WIDTH).then_some((if n == 1 { 4 } else { n }, n))
        }
        '@' => {
            let n = run('@');
            (n <= MAX_WIDTH).then_some((n, n))
        }
        '%' => {
            let rest = &text[1..];
            // `%04d` and `%d`: a width without a zero would pad with spaces.
            let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
            let width = width(&rest[..digits], true)?;
            rest[digits..]
                .starts_with('d')
                .then_some((width, 1 + digits + 1))
        }
        '$' => {
            let rest = text.strip_prefix("$F")?;
            let digits = rest.bytes().take_while(u8::is_ascii_digit).count().min(2);
            Some((width(&rest[..digits], false)?, 2 + digits))
        }
        '<' => {
            let rest = text.strip_prefix("<F")?;
            let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
            let width = width(&rest[..digits], false)?;
            rest[digits..]
                .starts_with('>')
                .then_some((width, 2 + digits + 1))
        }
        _ => None,
    }
}

/// Returns the width that `digits` say: 1 if there are none.
fn width(digits: &str, needs_zero: bool) -> Option<usize> {
    if digits.is_empty() {
        return Some(1);
    }
    if needs_zero && !digits.starts_with('0') {
        return None;
    }
    digits.parse().ok().filter(|n| (1..=MAX_WIDTH).contains(n))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(pattern: &str, frame: i32) -> String {
        Pattern::new(pattern).path(frame).display().to_string()
    }

    #[test]
    fn every_documented_mark_is_replaced() {
        for (pattern, expected) in [
            ("a.####.exr", "a.0007.exr"),
            ("a.#.exr", "a.0007.exr"),
            ("a.##.exr", "a.07.exr"),
            ("a.@@@@.exr", "a.0007.exr"),
            ("a.@.exr", "a.7.exr"),
            ("a.%04d.exr", "a.0007.exr"),
            ("a.%d.exr", "a.7.exr"),
            ("a.$F4.exr", "a.0007.exr"),
            ("a.$F.exr", "a.7.exr"),
            ("a.<F4>.exr", "a.0007.exr"),
            ("a.<F>.exr", "a.7.exr"),
            ("####/a_####.exr", "0007/a_0007.exr"),
            ("100%%.%03d.exr", "100%.007.exr"),
        ] {
            assert_eq!(path(pattern, 7), expected, "{pattern}");
        }
        assert_eq!(path("a.####.exr", -5), "a.-005.exr");
        assert_eq!(
            path("a.##.exr", 1001),
            "a.1001.exr",
            "more digits than asked for"
        );
    }

    #[test]
    fn what_is_no_mark_is_itself() {
        for plain in [
            "a.exr", "50%.exr", "%s.exr", "%4d.exr", "$HOME/a", "<b>.exr", "a%", "<F4",
        ] {
            let pattern = Pattern::new(plain);
            assert!(!pattern.has_number(), "{plain}");
            assert_eq!(pattern.path(1).to_str(), Some(plain));
        }
    }

    #[test]
    fn names_are_read_back() {
        for pattern in [
            "d/a_####.vdb",
            "a.%d.vdb",
            "####.vdb",
            "a$F4b.vdb",
            "a##2.vdb",
        ] {
            let pattern = Pattern::new(pattern);
            for frame in [0, 7, 1001, -5, 123_456, i32::MAX, i32::MIN] {
                assert_eq!(
                    pattern.frame(&pattern.path(frame)),
                    Some(frame),
                    "{pattern:?}"
                );
            }
            for other in ["", "a.vdb", "d/a_00x4.vdb", "b.0001.vdb"] {
                assert_eq!(pattern.frame(Path::new(other)), None, "{other}");
            }
        }
        let padded = Pattern::new("a.####.vdb");
        assert_eq!(padded.frame(Path::new("a.7.vdb")), None, "not padded");
    }
}
