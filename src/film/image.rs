//! Images: rectangles of pixels, whole or a part of a larger one.

use super::Pixel;
use crate::aov::Planes;

/// A rectangle in an image: columns and rows from the top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column and row.
    pub min: [u32; 2],
    /// The column and row after the last.
    pub max: [u32; 2],
}

impl Region {
    /// Returns all of an image.
    pub fn whole(width: u32, height: u32) -> Self {
        Self {
            min: [0, 0],
            max: [width, height],
        }
    }

    /// Returns the part of this rectangle that lies in an image; `None` if there is none.
    pub fn within(self, width: u32, height: u32) -> Option<Self> {
        let max = [self.max[0].min(width), self.max[1].min(height)];
        let min = self.min;
        (min[0] < max[0] && min[1] < max[1]).then_some(Self { min, max })
    }

    /// Returns the number of columns.
    pub fn width(self) -> u32 {
        self.max[0] - self.min[0]
    }

    /// Returns the number of rows.
    pub fn height(self) -> u32 {
        self.max[1] - self.min[1]
    }
}

/// A rectangle of pixels, row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Columns and rows of the image that this is a part of.
    full_size: [u32; 2],
    region: Region,
    pixels: Vec<Pixel>,
    planes: Planes,
}

impl Film {
    /// Makes an empty film.
    pub fn new(width: u32, height: u32) -> Self {
        let len = width as usize * height as usize;
        let region = Region::whole(width, height);
        Self::of([width, height], region, vec![Pixel::default(); len])
    }

    /// Makes a film of the pixels of `region`, row by row, of an image of `full_size`.
    pub(super) fn of(full_size: [u32; 2], region: Region, pixels: Vec<Pixel>) -> Self {
        debug_assert_eq!(
            pixels.len(),
            region.width() as usize * region.height() as usize,
            "a pixel for each place"
        );
        Self {
            full_size,
            region,
            pixels,
            planes: Planes::default(),
        }
    }

    /// Adds output variables, as many pixels of them.
    #[must_use]
    pub fn with_planes(self, planes: Planes) -> Self {
        Self { planes, ..self }
    }

    /// Returns the output variables that were asked for.
    pub fn planes(&self) -> &Planes {
        &self.planes
    }

    /// Makes a film of the pixels of `region`, row by row, of an image of `full_size`; `None` if
    /// they are not as many, or the region reaches beyond the image.
    pub fn from_pixels(full_size: [u32; 2], region: Region, pixels: Vec<Pixel>) -> Option<Self> {
        let inside = region.within(full_size[0], full_size[1]) == Some(region);
        let count = u64::from(region.width()) * u64::from(region.height());
        (inside && pixels.len() as u64 == count).then(|| Self::of(full_size, region, pixels))
    }

    /// Returns the number of columns.
    pub fn width(&self) -> u32 {
        self.region.width()
    }

    /// Returns the number of rows.
    pub fn height(&self) -> u32 {
        self.region.height()
    }

    /// Returns columns and rows of the image that this is a part of, or all of.
    pub fn full_size(&self) -> [u32; 2] {
        self.full_size
    }

    /// Returns which part of the image this is.
    pub fn region(&self) -> Region {
        self.region
    }

    /// Returns all pixels, row by row from the top.
    pub fn pixels(&self) -> &[Pixel] {
        &self.pixels
    }

    /// Returns all pixels for writing, row by row from the top.
    pub fn pixels_mut(&mut self) -> &mut [Pixel] {
        &mut self.pixels
    }

    /// Merges other samples of the same pixels into these; `false`, and nothing done, if they are of
    /// another image or region.
    pub fn merge(&mut self, other: &Self) -> bool {
        let is_same = self.full_size == other.full_size
            && self.region == other.region
            && self.planes.channels() == other.planes.channels();
        if is_same {
            for (i, (pixel, theirs)) in self.pixels.iter_mut().zip(&other.pixels).enumerate() {
                let share = theirs.count as f64 / (pixel.count + theirs.count).max(1) as f64;
                self.planes.merge_pixel(&other.planes, i, share);
                pixel.merge(theirs);
            }
        }
        is_same
    }

    /// Returns the mean of the image and its standard error, one entry a channel.
    pub fn mean(&self) -> ([f64; 3], [f64; 3]) {
        let n = self.pixels.len() as f64;
        let mut mean = [0.0; 3];
        let mut variance = [0.0; 3];
        for pixel in &self.pixels {
            let v = pixel.variance_of_mean();
            for c in 0..3 {
                mean[c] += pixel.mean[c] / n;
                variance[c] += v[c] / (n * n);
            }
        }
        (mean, variance.map(f64::sqrt))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_are_clipped_to_the_image() {
        let region = |min, max| Region { min, max };
        let clipped = region([3, 4], [99, 6]).within(10, 5);
        assert_eq!(clipped, Some(region([3, 4], [10, 5])));
        assert_eq!(region([10, 0], [12, 5]).within(10, 5), None);
        assert_eq!(region([4, 4], [4, 5]).within(10, 5), None);
        let pixels = vec![Pixel::default(); 4];
        assert!(Film::from_pixels([3, 3], region([1, 1], [3, 3]), pixels.clone()).is_some());
        assert!(Film::from_pixels([3, 3], region([2, 1], [4, 3]), pixels).is_none());
    }
}
