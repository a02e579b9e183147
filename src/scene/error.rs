//! What can be wrong with a scene, and where.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::cache::CacheError;
use crate::grid::{GridTooLarge, TooLargeForHalf};
use crate::vdb::VdbError;

/// A scene that cannot be rendered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The scene file itself cannot be read.
    #[error("{}: cannot read the scene file: {source}", path.display())]
    Read {
        /// The scene file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The scene file says something that cannot be.
    #[error("{0}")]
    Description(Box<DescriptionError>),
    /// A volume file cannot be read or its grid cannot be rendered.
    #[error("{source}")]
    Volume {
        /// Where the scene names the file or grid, if a scene file was written at all.
        at: Option<Box<DescriptionError>>,
        /// What is wrong with it.
        source: VdbError,
    },
    /// A cache file cannot be read.
    #[error("{source}")]
    Cache {
        /// Where the scene names the file, if a scene file was written at all.
        at: Option<Box<DescriptionError>>,
        /// What is wrong with it.
        source: CacheError,
    },
    /// The grid's bounds do not fit into the memory that may be used.
    #[error("{}: grid {grid:?}: {source}; allow more by --max-memory", path.display())]
    TooLarge {
        /// The volume file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// How much it needs.
        source: GridTooLarge,
    },
    /// The grid does not fit into the encoding that was asked for.
    #[error("{}: grid {grid:?}: {source}; use encoding = \"auto\"", path.display())]
    TooLargeForHalf {
        /// The volume file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// The value that does not fit.
        source: TooLargeForHalf,
    },
    /// A bare volume file holds nothing that looks like a density.
    #[error("{}: no grid looks like a density: {found}", path.display())]
    NoDensity {
        /// The volume file.
        path: PathBuf,
        /// Its grids, each with the reason.
        found: String,
    },
}

/// A place in a scene file, and what is wrong there.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}:{}: {message}", path.display(), position(text, span.start))]
pub struct DescriptionError {
    /// The scene file.
    pub path: PathBuf,
    /// Its whole text.
    pub text: String,
    /// The bytes of `text` that are wrong; `0..0` where the error is about the whole file or a
    /// default.
    pub span: Range<usize>,
    /// What was found.
    pub message: String,
    /// What was expected, for a label at the place.
    pub expected: Option<String>,
    /// What to do about it.
    pub help: Option<String>,
}

/// Returns `line:column` of byte `offset`, both from 1, columns in characters.
fn position(text: &str, offset: usize) -> String {
    let before = text.get(..offset).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
    format!("{line}:{column}")
}

impl SceneError {
    /// Returns the place in the scene file that the error is about, if it is about one.
    pub fn place(&self) -> Option<&DescriptionError> {
        match self {
            Self::Description(at) => Some(at),
            Self::Volume { at, .. } | Self::Cache { at, .. } => at.as_deref(),
            Self::Read { .. }
            | Self::TooLarge { .. }
            | Self::TooLargeForHalf { .. }
            | Self::NoDensity { .. } => None,
        }
    }
}

/// The outcome of a check; boxed, since the error carries the whole text.
pub(super) type Check<T> = Result<T, Box<DescriptionError>>;

/// The text that errors refer to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Source {
    pub(super) path: PathBuf,
    pub(super) text: String,
}

impl Source {
    /// Makes an error at `span`; an empty span (a default) is shown without an arrow.
    pub(super) fn error(
        &self,
        span: Range<usize>,
        message: impl Into<String>,
        expected: impl Into<String>,
    ) -> Box<DescriptionError> {
        Box::new(DescriptionError {
            path: self.path.clone(),
            text: self.text.clone(),
            span,
            message: message.into(),
            expected: Some(expected.into()),
            help: None,
        })
    }

    /// Turns an error of the TOML reader into ours, with the nearest known key as help.
    pub(super) fn toml_error(&self, error: &toml::de::Error) -> DescriptionError {
        let message = error.message().lines().next().unwrap_or("not TOML");
        DescriptionError {
            path: self.path.clone(),
            text: self.text.clone(),
            span: error.span().unwrap_or(0..0),
            message: in_plain_words(message),
            expected: None,
            help: nearest_in(message),
        }
    }

    pub(super) fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }
}

/// Replaces the names of Rust's types at the end of serde's "invalid type: …, expected u32".
fn in_plain_words(message: &str) -> String {
    const WORDS: [(&str, &str); 4] = [
        ("u32", "a whole number from 0 to 4294967295"),
        ("u64", "a whole number from 0 to 18446744073709551615"),
        ("i32", "a whole number of 32 bit"),
        ("f64", "a number"),
    ];
    for (rust, words) in WORDS {
        if let Some(start) = message.strip_suffix(&format!("expected {rust}")) {
            return format!("{start}expected {words}").replace(" as i128", "");
        }
    }
    message.to_owned()
}

/// Suggests the nearest name in serde's "unknown field `x`, expected one of `a`, `b`".
fn nearest_in(message: &str) -> Option<String> {
    message.strip_prefix("unknown ")?;
    // Every second piece between backticks is a name: the unknown one, then the known ones.
    let mut names = message.split('`').skip(1).step_by(2);
    let unknown = names.next()?;
    names
        .map(|name| (strsim::damerau_levenshtein(unknown, name), name))
        .min()
        // Beyond half its letters a name is another word.
        .filter(|&(distance, name)| 2 * distance <= name.len())
        .map(|(_, name)| format!("did you mean `{name}`?"))
}
