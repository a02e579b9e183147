//! False colours: numbers of pixels as small PNG pictures that a page can hold.
//!
//! Every pixel of the image is one of the picture; the page enlarges it without smoothing.

use std::fmt::Write as _;

/// A picture of 8 bit sRGB, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Colours.
    pub pixels: Vec<[u8; 3]>,
}

impl Picture {
    /// Returns the picture as a `data:` address of a PNG; empty if it has no pixels.
    pub fn data_uri(&self) -> String {
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let written = encoder.write_header().and_then(|mut writer| {
            writer.write_image_data(self.pixels.as_flattened())?;
            writer.finish()
        });
        match written {
            Ok(()) => format!("data:image/png;base64,{}", base64(&png)),
            Err(_) => String::new(),
        }
    }
}

/// Returns a colour for `x` in [0, 1] from black over purple and orange to pale yellow, of
/// rising lightness, so that order survives a grey printer.
pub fn heat(x: f64) -> [u8; 3] {
    // Seven colours at equal steps of lightness, between which it is linear.
    const STOPS: [[f64; 3]; 7] = [
        [6.0, 4.0, 24.0],
        [58.0, 12.0, 96.0],
        [120.0, 28.0, 109.0],
        [184.0, 50.0, 85.0],
        [233.0, 92.0, 42.0],
        [250.0, 160.0, 30.0],
        [252.0, 250.0, 180.0],
    ];
    ramp(&STOPS, x)
}

/// Returns a colour for `x` in [−1, 1]: blue below, white at and red above zero.
pub fn diverging(x: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] = [
        [10.0, 50.0, 120.0],
        [90.0, 155.0, 205.0],
        [250.0, 250.0, 250.0],
        [225.0, 120.0, 95.0],
        [130.0, 10.0, 35.0],
    ];
    ramp(&STOPS, f64::midpoint(x, 1.0))
}

/// NaN takes the first colour.
fn ramp(stops: &[[f64; 3]], x: f64) -> [u8; 3] {
    let last = stops.len() - 1;
    let at = (x * last as f64).max(0.0).min(last as f64);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an index of the stops"
    )]
    let below = (at.floor() as usize).min(last - 1);
    let f = at - below as f64;
    std::array::from_fn(|c| byte(stops[below][c] * (1.0 - f) + stops[below + 1][c] * f))
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "in 0..=255 after clamping"
)]
fn byte(x: f64) -> u8 {
    (x + 0.5).clamp(0.0, 255.0) as u8
}

/// RFC 4648, with padding.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let byte = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for digit in 0..4 {
            if digit <= three.len() {
                out.push(char::from(DIGITS[(word >> (18 - 6 * digit) & 63) as usize]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

/// Returns a horizontal colour bar as SVG, its ends named, for a scale of a picture.
pub fn colour_bar(colour: fn(f64) -> [u8; 3], (from, to): (f64, f64), ends: [&str; 2]) -> String {
    let mut out = String::from(
        "<svg class=\"bar\" viewBox=\"0 0 220 12\" width=\"220\" height=\"12\" role=\"img\">",
    );
    for i in 0..44 {
        let x = from + (to - from) * (f64::from(i) + 0.5) / 44.0;
        let [r, g, b] = colour(x);
        let left = i * 5;
        write!(
            out,
            "<rect x=\"{left}\" width=\"5.5\" height=\"12\" fill=\"#{r:02x}{g:02x}{b:02x}\"/>"
        )
        .expect("writing to a string cannot fail");
    }
    let [low, high] = ends;
    format!("<span class=\"scale\">{low} {out}</svg> {high}</span>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_rfc() {
        for (plain, encoded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), encoded);
        }
    }

    #[test]
    fn ramps_end_where_they_should() {
        assert_eq!((heat(0.0), heat(1.0)), ([6, 4, 24], [252, 250, 180]));
        assert_eq!((heat(-5.0), heat(7.0)), (heat(0.0), heat(1.0)));
        assert_eq!(diverging(0.0), [250; 3]);
        assert_eq!(heat(f64::NAN), heat(0.0));
        let light = |c: [u8; 3]| 2 * u32::from(c[0]) + 7 * u32::from(c[1]) + u32::from(c[2]);
        let rising = (0..100).map(|i| light(heat(f64::from(i) / 99.0)));
        assert!(rising.is_sorted(), "lightness rises");
    }

    #[test]
    fn pictures_are_pngs() {
        let picture = Picture {
            width: 2,
            height: 1,
            pixels: vec![[255, 0, 0], [0, 0, 255]],
        };
        assert!(
            picture
                .data_uri()
                .starts_with("data:image/png;base64,iVBORw0KGgo")
        );
    }
}
