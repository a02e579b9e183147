//! Everything that can go wrong with a .vdb file, in words a user can act on.
//!
//! [`VdbError`] is the boundary of the module. [`Refusal`] is not an error by itself: it marks
//! a grid that is listed but cannot be loaded. [`Damage`] is what the checked walk reports from
//! deep inside; it gets its file and grid names on the way out.

use std::io;
use std::path::PathBuf;

use glam::IVec3;

/// Why a grid that the file holds cannot be loaded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// A boolean grid: no density to render, and stored in a leaf format of its own.
    #[error("bool grids hold no numbers to render")]
    Bool,
    /// A mask grid: topology without values.
    #[error("mask grids hold no values to render")]
    Mask,
    /// A point data or point index grid.
    #[error("points grids are not volumes; convert them to a fog volume first")]
    Points,
    /// Any other value type.
    #[error(
        "values of type {0:?} are not supported; expected float, double, int32, int64, vec3s, vec3d or vec3i"
    )]
    ValueType(String),
    /// A node layout other than OpenVDB's standard one.
    #[error("tree layout {0} is not supported; expected 5_4_3, OpenVDB's standard tree")]
    Tree(String),
    /// A frustum map: voxels that grow with distance.
    #[error("frustum maps are not supported; resample the grid to an affine map")]
    FrustumMap,
    /// A map that OpenVDB itself does not define.
    #[error("map type {0:?} is not known")]
    UnknownMap(String),
    /// A map under which voxels have no volume, or that is not finite.
    #[error("the grid's map cannot be inverted: its voxels have no volume")]
    SingularMap,
}

/// Damage found by the checked walk: where, and what was expected there.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("at byte {offset}: {what}")]
pub struct Damage {
    /// Position in the file.
    pub offset: u64,
    /// What was found and what was expected.
    pub what: String,
}

impl Damage {
    pub(super) fn new(offset: usize, what: impl Into<String>) -> Self {
        Self {
            offset: offset as u64,
            what: what.into(),
        }
    }
}

/// Where a stored value sits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The grid's background.
    Background,
    /// A voxel, or the lowest voxel of a tile.
    Voxel(IVec3),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Background => write!(f, "background"),
            Self::Voxel(IVec3 { x, y, z }) => write!(f, "voxel [{x}, {y}, {z}]"),
        }
    }
}

/// An error from opening or loading a .vdb file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VdbError {
    /// The operating system could not give us the file.
    #[error("{}: cannot be read", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file does not begin as OpenVDB files do.
    #[error("{}: not an OpenVDB file: it begins with bytes {found}, expected 20 42 44 56", path.display())]
    NotVdb {
        /// The file.
        path: PathBuf,
        /// Its first bytes, in hexadecimal.
        found: String,
    },
    /// The file's format version is not one that can be read.
    #[error(
        "{}: file format version {found}, expected 222 to 225; write it again with another version of OpenVDB",
        path.display()
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// The file contradicts itself or ends too early.
    #[error("{}: {}{damage}; the file is damaged or was cut short, write it again", path.display(), in_grid(grid.as_deref()))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The grid, where the damage is inside one.
        grid: Option<String>,
        /// Where and what.
        damage: Damage,
    },
    /// The file has no grid of that name.
    #[error("{}: no grid {name:?}{}; {}", path.display(), did_you_mean(nearest.as_deref()), listing(names))]
    NoSuchGrid {
        /// The file.
        path: PathBuf,
        /// The name asked for.
        name: String,
        /// The most similar name.
        nearest: Option<String>,
        /// All names, as [`super::Archive::find`] takes them.
        names: Vec<String>,
    },
    /// The grid is listed but cannot be loaded.
    #[error("{}: grid {grid:?} cannot be loaded: {reason}", path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// Why.
        reason: Refusal,
    },
    /// A vector grid was asked for as density.
    #[error(
        "{}: grid {grid:?} has values of type {type_name}, expected one number a voxel; choose a scalar grid",
        path.display()
    )]
    NotScalar {
        /// The file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// Its value type.
        type_name: String,
    },
    /// A scalar grid was asked for where only vectors make sense.
    #[error(
        "{}: grid {grid:?} has values of type {type_name}, expected three numbers a voxel; choose a vector grid",
        path.display()
    )]
    NotVector {
        /// The file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// Its value type.
        type_name: String,
    },
    /// Loading would take more memory than allowed.
    #[error(
        "{}: grid {grid:?} needs about {}, the limit is {}; raise the limit (--max-memory) or use a smaller grid",
        path.display(), human(*needed), human(*limit)
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// Estimated bytes.
        needed: u64,
        /// Allowed bytes.
        limit: u64,
    },
    /// The grid holds NaN or infinite values.
    #[error(
        "{}: grid {grid:?}: {first}: found {value}{}, expected finite values; repair the grid, or read such values as 0 (--sanitize)",
        path.display(), and_more(*count)
    )]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// How many stored values are not finite; a tile counts once.
        count: u64,
        /// The first of them, in file order.
        first: Place,
        /// Its value.
        value: f64,
    },
    /// The decoder could not make sense of compressed values.
    #[error("{}: grid {grid:?}: compressed values cannot be decoded: {what}; the file is damaged, write it again", path.display())]
    Undecodable {
        /// The file.
        path: PathBuf,
        /// The grid.
        grid: String,
        /// What the decoder said.
        what: String,
    },
}

fn in_grid(grid: Option<&str>) -> String {
    grid.map_or_else(String::new, |g| format!("grid {g:?}: "))
}

fn did_you_mean(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |n| format!(", did you mean {n:?}?"))
}

fn listing(names: &[String]) -> String {
    // A hostile file can name thousands of grids; a person reads the first few.
    const SHOWN: usize = 20;
    if names.is_empty() {
        return "the file holds no grids".to_owned();
    }
    let mut list: Vec<_> = names.iter().take(SHOWN).map(|n| format!("{n:?}")).collect();
    if names.len() > SHOWN {
        list.push(format!("and {} more", names.len() - SHOWN));
    }
    format!("the file holds {}", list.join(", "))
}

fn and_more(count: u64) -> String {
    match count {
        0 | 1 => String::new(),
        n => format!(" (and {} more that are not finite)", n - 1),
    }
}

/// Writes a number of bytes with the unit that suits it.
fn human(bytes: u64) -> String {
    const UNITS: [&str; 4] = ["KiB", "MiB", "GiB", "TiB"];
    let mut value = bytes as f64 / 1024.0;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    format!("{value:.1} {}", UNITS[unit])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_what_to_do() {
        let e = VdbError::TooLarge {
            path: "a.vdb".into(),
            grid: "density".into(),
            needed: 3 << 30,
            limit: 1536 << 20,
        };
        assert_eq!(
            e.to_string(),
            "a.vdb: grid \"density\" needs about 3.0 GiB, the limit is 1.5 GiB; \
             raise the limit (--max-memory) or use a smaller grid"
        );
        let e = VdbError::NoSuchGrid {
            path: "a.vdb".into(),
            name: "densty".into(),
            nearest: Some("density".into()),
            names: vec!["density".into(), "flame".into()],
        };
        assert_eq!(
            e.to_string(),
            "a.vdb: no grid \"densty\", did you mean \"density\"?; \
             the file holds \"density\", \"flame\""
        );
    }
}
