//! Reads the image of a sky: latitude–longitude, OpenEXR or Radiance HDR.
//!
//! Only RGB is looked at. Negative numbers, which filters leave behind, count as zero; what is not
//! finite is an error, since it has no place in a mean.

use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageReader, Limits};

use crate::light::{EnvironmentMap, EnvironmentTooLarge, Orientation};
use crate::spectrum::Rgb;

/// Bytes for each texel while a map is built: the image as it is decoded and as kept, two tables.
const BYTES_PER_TEXEL: u64 = 16 + 12 + 8 + 8;

/// Largest radiance: sums over a map stay far from the end of `f32`.
const MAX_RADIANCE: f32 = 1e20;

/// An image that cannot be a sky.
#[derive(Debug, thiserror::Error)]
pub(super) enum EnvironmentError {
    #[error("{}: cannot read the image: {source}", path.display())]
    Read {
        path: PathBuf,
        source: image::ImageError,
    },
    #[error("{}: a sky of {width} by {height} texels takes {needed} bytes, of {allowed} allowed; \
             allow more by --max-memory or use a smaller image", path.display())]
    TooLarge {
        path: PathBuf,
        width: u32,
        height: u32,
        needed: u64,
        allowed: u64,
    },
    #[error("{}: column {column}, row {row} is {value} times the scale", path.display())]
    NotFinite {
        path: PathBuf,
        column: usize,
        row: usize,
        value: f32,
    },
    #[error("{}: {source}", path.display())]
    Size {
        path: PathBuf,
        source: EnvironmentTooLarge,
    },
}

/// Reads a map, within `max_memory_bytes`.
pub(super) fn read_environment(
    path: &Path,
    max_memory_bytes: u64,
    scale: f32,
    orientation: Orientation,
) -> Result<EnvironmentMap, EnvironmentError> {
    let path_of = || path.to_owned();
    let failed = |source| EnvironmentError::Read {
        path: path_of(),
        source,
    };
    let open = || -> Result<_, image::ImageError> {
        let mut reader = ImageReader::open(path)?.with_guessed_format()?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(max_memory_bytes);
        reader.limits(limits);
        Ok(reader)
    };
    let (width, height) = open()
        .and_then(ImageReader::into_dimensions)
        .map_err(failed)?;
    let needed = u64::from(width) * u64::from(height) * BYTES_PER_TEXEL;
    if needed > max_memory_bytes {
        return Err(EnvironmentError::TooLarge {
            path: path_of(),
            width,
            height,
            needed,
            allowed: max_memory_bytes,
        });
    }
    let image = open().and_then(ImageReader::decode).map_err(failed)?;
    let texels = texels(image);
    let width = width as usize;
    let limit = MAX_RADIANCE / scale.max(1.0);
    if let Some((i, value)) = first_beyond(&texels, limit) {
        return Err(EnvironmentError::NotFinite {
            path: path_of(),
            column: i % width,
            row: i / width,
            value,
        });
    }
    EnvironmentMap::new((width, height as usize), texels, scale, orientation).map_err(|source| {
        EnvironmentError::Size {
            path: path_of(),
            source,
        }
    })
}

fn texels(image: DynamicImage) -> Vec<Rgb> {
    let image = image.into_rgb32f();
    let texels = image
        .pixels()
        .map(|p| Rgb(p.0.map(|c| if c < 0.0 { 0.0 } else { c })));
    texels.collect()
}

/// Returns the first number that is no radiance, and the texel it is in.
fn first_beyond(texels: &[Rgb], limit: f32) -> Option<(usize, f32)> {
    texels.iter().enumerate().find_map(|(i, texel)| {
        let bad = texel.0.into_iter().find(|c| c.is_nan() || *c > limit);
        bad.map(|c| (i, c))
    })
}
