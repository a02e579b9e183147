//! 8 bit sRGB pictures.

use std::path::Path;

use super::OutputError;
use super::whole::write_whole;
use crate::film::Film;

/// Writes `film` as an 8 bit sRGB picture.
///
/// # Errors
/// If the folder cannot be made or the file not be written; no part of it is then left.
pub fn write_png(path: &Path, film: &Film) -> Result<(), OutputError> {
    let pixels: Vec<_> = film
        .pixels()
        .iter()
        .map(|p| p.mean.map(srgb_byte))
        .collect();
    write_rgb_png(path, film.width(), film.height(), &pixels)
}

/// Writes 8 bit sRGB pixels, row by row from the top.
///
/// # Errors
/// If they are not as many as the size says, the folder cannot be made or the file not be written;
/// no part of it is then left.
pub fn write_rgb_png(
    path: &Path,
    width: u32,
    height: u32,
    pixels: &[[u8; 3]],
) -> Result<(), OutputError> {
    write_whole(path, |file| {
        let mut encoder = ::png::Encoder::new(file, width, height);
        encoder.set_color(::png::ColorType::Rgb);
        encoder.set_depth(::png::BitDepth::Eight);
        encoder.set_source_srgb(::png::SrgbRenderingIntent::RelativeColorimetric);
        let write = |encoder: ::png::Encoder<'_, _>| {
            let mut writer = encoder.write_header()?;
            writer.write_image_data(pixels.as_flattened())?;
            writer.finish()
        };
        write(encoder).map_err(|source| OutputError::Png {
            path: path.to_owned(),
            source,
        })
    })
}

/// Encodes a linear value for an 8 bit sRGB picture, clamped to [0, 1].
///
/// # Reference
/// `[Stokes1996]`.
pub fn srgb_byte(linear: f64) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "in 0..=255 after clamping; NaN becomes 0"
    )]
    let byte = (encoded * 255.0 + 0.5) as u8;
    byte
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_bytes_are_those_of_the_standard() {
        // 0.5 encodes to 0.735 357 of 255 = 187.5; 0.214 041 is mid-grey 127.5 of 255.
        for (linear, byte) in [(0.0, 0), (1.0, 255), (0.5, 188), (0.0021, 7), (-1.0, 0)] {
            assert_eq!(srgb_byte(linear), byte, "of {linear}");
        }
        assert_eq!(srgb_byte(7.0), 255, "clamped");
        assert_eq!(srgb_byte(f64::NAN), 0, "not a number");
    }
}
