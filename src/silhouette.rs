//! Which pixels can see a medium: the others are known without tracing a ray.
//!
//! Every box of a grid that is not empty covers, in the image, no more than the rectangle around
//! its eight projected corners; a pixel outside of all rectangles sees past the medium with every
//! ray. Conservative: that a pixel is covered proves nothing.

use glam::DVec3;

use crate::camera::Camera;
use crate::medium::Medium;

/// Rectangles are filled until they hold this many times the pixels of the image. A medium that
/// needs more is in front of nearly all pixels.
const MAX_FILL: u64 = 64;

/// Width of the border added to a rectangle, in pixels: far above the rounding of `f64`.
const BORDER: f64 = 1e-3;

/// The pixels that may see a medium.
#[derive(Clone, Debug)]
pub struct Silhouette {
    width: usize,
    /// Row by row; empty: all of them.
    covered: Vec<bool>,
    everything: bool,
}

impl Silhouette {
    /// Finds the pixels of an image of `width` by `height` pixels.
    ///
    /// # Cost
    /// Eight projections for each box, and at most 64 stores a pixel.
    pub fn new(media: &[Medium], camera: &Camera, width: u32, height: u32) -> Self {
        let size = [width as usize, height as usize];
        let mut all = Self {
            width: size[0],
            covered: vec![false; size[0] * size[1]],
            everything: false,
        };
        let mut left = MAX_FILL * all.covered.len() as u64;
        for medium in media {
            medium.for_each_occupied(|corners| {
                if all.everything {
                    return;
                }
                let Some([x, y]) = rectangle(camera, corners, size) else {
                    all.everything = true;
                    return;
                };
                let Some(rest) = left.checked_sub((x.len() * y.len()) as u64) else {
                    all.everything = true;
                    return;
                };
                left = rest;
                for row in y {
                    let start = row * all.width;
                    all.covered[start + x.start..start + x.end].fill(true);
                }
            });
        }
        all
    }

    /// Returns whether the pixel in column `x` of row `y` may see a medium.
    pub fn covers(&self, x: u32, y: u32) -> bool {
        self.everything || self.covered[y as usize * self.width + x as usize]
    }
}

/// Returns the columns and rows that the convex hull of `corners` may cover; `None` if it reaches
/// behind the camera, where projection knows no bounds.
fn rectangle(
    camera: &Camera,
    corners: [DVec3; 8],
    size: [usize; 2],
) -> Option<[std::ops::Range<usize>; 2]> {
    let mut range = [(f64::INFINITY, f64::NEG_INFINITY); 2];
    for corner in corners {
        let film = camera.project(corner)?;
        for (axis, (min, max)) in range.iter_mut().enumerate() {
            *min = min.min(film[axis]);
            *max = max.max(film[axis]);
        }
    }
    let mut axis = 0;
    Some(range.map(|(min, max)| {
        let n = size[axis] as f64;
        axis += 1;
        // A cast saturates, and takes what is not a number to 0.
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the image"
        )]
        let pixel = |film: f64| (film * n).clamp(0.0, n) as usize;
        let start = pixel(min - BORDER / n);
        let end = (max * n + BORDER).clamp(0.0, n).ceil();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the image"
        )]
        let end = end as usize;
        start..end.max(start)
    }))
}
