//! A sky from an image: radiance by direction, and directions by radiance.
//!
//! The image is latitude–longitude: columns are the azimuth, rows the angle from the zenith, the
//! zenith in the first row. The middle column is `+x` of the map's own frame, and columns to the
//! right turn clockwise as seen from above, so that the image is what an observer in the centre
//! sees. [`Orientation`] says where that frame's axes are in the world.
//!
//! Radiance is bilinear between the centres of texels. Directions are drawn from a density that is
//! constant in each **cell** between four such centres, in proportion to the cell's mean luminance
//! *above that of the whole sky*: what is no brighter than the mean is found by scattering anyway,
//! and sampling it too would only draw samples away from what is bright `[Karlik2019]`. Where the
//! density is zero the light must therefore come from elsewhere: this is a partner for another
//! technique in multiple importance sampling, and no sampler of the whole sky by itself.
//!
//! Cells are drawn by an alias table: one look for a map of any size.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DQuat, DVec3};

use super::Beacon;
use crate::alias::AliasTable;
use crate::sampling::Stream;
use crate::spectrum::Rgb;

/// Cosine of the angle from the brightest cell within which cells count as the brightest part.
const COS_BEACON: f64 = 0.97;

/// How a map lies in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// World directions to the frame of the map.
    map_from_world: DMat3,
}

impl Orientation {
    /// The zenith is the unit vector `up`, and the map is turned about it by `radians`, counter-clockwise as seen
    /// from above. With `up` along z and no turn, the map's frame is the world's; another `up` tilts it
    /// along the shortest way, so that with y up the map's `+y` is the world's `−z`.
    pub fn new(up: DVec3, radians: f64) -> Self {
        let tilt = DQuat::from_rotation_arc(DVec3::Z, up);
        let world_from_map = DMat3::from_quat(tilt) * DMat3::from_rotation_z(radians);
        Self {
            map_from_world: world_from_map.transpose(),
        }
    }

    /// Returns the rotation of the map's frame into the world.
    pub fn world_from_map(&self) -> DMat3 {
        self.map_from_world.transpose()
    }
}

/// A map that is too large to be indexed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{width} by {height} texels are not from 1 by 1 to {max} in all", max = EnvironmentMap::MAX_TEXELS)]
pub struct EnvironmentTooLarge {
    width: usize,
    height: usize,
}

/// A sky from an image.
#[derive(Clone)]
pub struct EnvironmentMap {
    width: usize,
    height: usize,
    /// `[row][column]`, from the zenith down.
    texels: Vec<Rgb>,
    orientation: Orientation,
    /// Of the cells, `[row][column]`: one row more than texels, half a row high at the poles. `None`
    /// where no cell is brighter than the mean.
    cells: Option<AliasTable>,
    /// Sum over cells of the luminance above the mean times solid angle.
    excess: f64,
    mean_luminance: f32,
    mean: Rgb,
    usual: Rgb,
    beacon: Beacon,
}

/// A sample of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapSample {
    /// Unit vector to the sky.
    pub direction: DVec3,
    /// What arrives from there.
    pub radiance: Rgb,
    /// Density per steradian, not zero.
    pub pdf: f32,
}

/// A place in the map: the cell, and where in it.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// From 0 to the number of rows of texels.
    row: usize,
    column: usize,
    /// From the centre of the upper left texel, in texels.
    across: f32,
    down: f32,
}

impl std::fmt::Debug for EnvironmentMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "EnvironmentMap({} by {})", self.width, self.height)
    }
}

impl EnvironmentMap {
    /// Most texels of a map: 16384 by 8192.
    pub const MAX_TEXELS: usize = 1 << 27;

    /// Makes a map of `width` by `height` texels, row by row from the zenith, each times `scale`.
    ///
    /// Texels must be finite and not negative.
    ///
    /// # Errors
    /// If the number of texels is not that, or is 0 or above [`MAX_TEXELS`](Self::MAX_TEXELS).
    ///
    /// # Cost
    /// Three passes over the cells, and 20 bytes for each texel.
    pub fn new(
        (width, height): (usize, usize),
        mut texels: Vec<Rgb>,
        scale: f32,
        orientation: Orientation,
    ) -> Result<Self, EnvironmentTooLarge> {
        let count = width.checked_mul(height);
        if count != Some(texels.len()) || !(1..=Self::MAX_TEXELS).contains(&texels.len()) {
            return Err(EnvironmentTooLarge { width, height });
        }
        for texel in &mut texels {
            *texel *= scale;
        }
        let mut map = Self {
            width,
            height,
            texels,
            orientation,
            cells: None,
            excess: 0.0,
            mean_luminance: 0.0,
            mean: Rgb::BLACK,
            usual: Rgb::BLACK,
            beacon: Beacon {
                direction: DVec3::Z,
                typical_radiance: 0.0,
            },
        };
        map.mean = map.average(|radiance| radiance);
        map.mean_luminance = map.mean.luminance();
        let mean = map.mean_luminance;
        map.usual = map.average(|radiance| {
            let luminance = radiance.luminance();
            // Not zero: above the mean.
            if luminance > mean {
                radiance * (mean / luminance)
            } else {
                radiance
            }
        });
        map.beacon = map.find_beacon();
        map.weigh();
        Ok(map)
    }

    /// Returns the mean over the sphere.
    pub fn mean_radiance(&self) -> Rgb {
        self.mean
    }

    /// Returns the mean over the sphere without what is brighter than the mean: near that of most
    /// directions.
    pub fn usual_radiance(&self) -> Rgb {
        self.usual
    }

    /// Returns the direction of the brightest part, and what it brings above the mean.
    pub fn beacon(&self) -> Beacon {
        self.beacon
    }

    /// Returns whether `direction`, a unit vector, is towards the brightest part.
    pub fn is_towards_beacon(&self, direction: DVec3) -> bool {
        direction.dot(self.beacon.direction) > COS_BEACON
    }

    /// Returns whether some of the sky is brighter than its mean, so that there is what to sample.
    pub fn is_sampled(&self) -> bool {
        self.cells.is_some()
    }

    /// Returns how much of the sky's luminance is above its mean.
    pub fn sampled_share(&self) -> f64 {
        let all = f64::from(self.mean_luminance) * 2.0 * TAU;
        // Zero: a black sky.
        if all > 0.0 { self.excess / all } else { 0.0 }
    }

    /// Returns the radiance from `direction`, a unit vector to the sky.
    pub fn radiance(&self, direction: DVec3) -> Rgb {
        self.radiance_at(self.place(direction))
    }

    /// Returns the radiance from `direction`, a unit vector to the sky, and the density per
    /// steradian with which [`sample`](Self::sample) draws it.
    pub fn radiance_and_pdf(&self, direction: DVec3) -> (Rgb, f32) {
        let place = self.place(direction);
        (self.radiance_at(place), self.pdf(place))
    }

    /// Draws a direction; `None` if the sky is the same all over.
    ///
    /// # Cost
    /// Five texels, two random numbers of 64 bits, an arc cosine, a sine and a cosine.
    pub fn sample(&self, stream: &mut Stream) -> Option<MapSample> {
        let chosen = self.cells.as_ref()?.index(stream.bits());
        let bits = stream.bits();
        let half = |bits: u64| ((bits & 0xffff_ffff) as f64 + 0.5) / 4_294_967_296.0;
        let (u, v) = (half(bits), half(bits >> 32));
        let (row, column) = (chosen / self.width, chosen % self.width);
        let (top, bottom) = self.polar_angles(row);
        // Uniform in the cosine; half angles keep the digits at the poles.
        let (sin2_top, sin2_bottom) = ((top / 2.0).sin().powi(2), (bottom / 2.0).sin().powi(2));
        let sin2_half = sin2_top + v * (sin2_bottom - sin2_top);
        let theta = 2.0 * sin2_half.sqrt().min(1.0).asin();
        let azimuth = TAU * (0.5 - (column as f64 + 0.5 + u) / self.width as f64);
        let (sin_theta, (sin, cos)) = (theta.sin(), azimuth.sin_cos());
        let local = DVec3::new(sin_theta * cos, sin_theta * sin, 1.0 - 2.0 * sin2_half);
        #[expect(clippy::cast_possible_truncation, reason = "fractions of a texel")]
        let place = Place {
            row,
            column,
            across: u as f32,
            down: (theta / PI * self.height as f64 + 0.5 - row as f64) as f32,
        };
        Some(MapSample {
            direction: self.orientation.world_from_map() * local,
            radiance: self.radiance_at(place),
            pdf: self.pdf(place),
        })
    }

    /// Returns the angles from the zenith between which the cells of a row lie.
    fn polar_angles(&self, row: usize) -> (f64, f64) {
        let step = PI / self.height as f64;
        let top = (row as f64 - 0.5) * step;
        (top.max(0.0), (top + step).min(PI))
    }

    /// Returns the solid angle of each cell of a row.
    fn solid_angle(&self, row: usize) -> f64 {
        let (top, bottom) = self.polar_angles(row);
        let band = 2.0 * f64::midpoint(top, bottom).sin() * ((bottom - top) / 2.0).sin();
        TAU / self.width as f64 * band
    }

    /// Returns the texels at the corners of a cell: upper left, upper right, lower left, lower right.
    fn corners(&self, row: usize, column: usize) -> [Rgb; 4] {
        let right = if column + 1 < self.width {
            column + 1
        } else {
            0
        };
        let upper = row.saturating_sub(1) * self.width;
        let lower = row.min(self.height - 1) * self.width;
        [
            self.texels[upper + column],
            self.texels[upper + right],
            self.texels[lower + column],
            self.texels[lower + right],
        ]
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the map"
    )]
    fn place(&self, direction: DVec3) -> Place {
        let d = self.orientation.map_from_world * direction;
        let theta = d.x.hypot(d.y).atan2(d.z);
        let down = theta / PI * self.height as f64 + 0.5;
        let row = (down as usize).min(self.height);
        let across = (0.5 - d.y.atan2(d.x) / TAU) * self.width as f64 - 0.5;
        // From −0.5 to width − 0.5: the first half column is in the last cell.
        let across = if across < 0.0 {
            across + self.width as f64
        } else {
            across
        };
        let column = (across as usize).min(self.width - 1);
        Place {
            row,
            column,
            across: (across - column as f64) as f32,
            down: (down - row as f64) as f32,
        }
    }

    fn radiance_at(&self, place: Place) -> Rgb {
        let Place { across, down, .. } = place;
        let [a, b, c, d] = self.corners(place.row, place.column);
        let upper = a * (1.0 - across) + b * across;
        let lower = c * (1.0 - across) + d * across;
        upper * (1.0 - down) + lower * down
    }

    /// Returns the mean of the four corners: that of the cell, but for the sphere's curvature.
    fn cell_mean(&self, row: usize, column: usize) -> Rgb {
        let [a, b, c, d] = self.corners(row, column);
        (a + b + c + d) * 0.25
    }

    /// Returns how much brighter than the whole sky a cell is.
    fn cell_excess(&self, row: usize, column: usize) -> f32 {
        (self.cell_mean(row, column).luminance() - self.mean_luminance).max(0.0)
    }

    #[expect(clippy::cast_possible_truncation, reason = "densities are f32")]
    fn pdf(&self, place: Place) -> f32 {
        // Zero: nothing is brighter than the mean, and nothing is drawn.
        if self.cells.is_none() {
            return 0.0;
        }
        (f64::from(self.cell_excess(place.row, place.column)) / self.excess) as f32
    }

    /// Calls `visit` with row, column and solid angle of each cell.
    fn for_each_cell(&self, mut visit: impl FnMut(usize, usize, f64)) {
        for row in 0..=self.height {
            let solid_angle = self.solid_angle(row);
            for column in 0..self.width {
                visit(row, column, solid_angle);
            }
        }
    }

    /// Returns the mean over the sphere of what `of` makes of a cell's mean.
    #[expect(clippy::cast_possible_truncation, reason = "radiance is f32")]
    fn average(&self, of: impl Fn(Rgb) -> Rgb) -> Rgb {
        let mut sum = [0.0; 3];
        self.for_each_cell(|row, column, solid_angle| {
            let part = of(self.cell_mean(row, column));
            for (sum, part) in sum.iter_mut().zip(part.0) {
                *sum += f64::from(part) * solid_angle;
            }
        });
        Rgb(sum.map(|sum| (sum / (2.0 * TAU)) as f32))
    }

    /// Returns the direction to the centre of a cell.
    fn centre(&self, row: usize, column: usize) -> DVec3 {
        let (top, bottom) = self.polar_angles(row);
        let (sin_theta, cos_theta) = f64::midpoint(top, bottom).sin_cos();
        let azimuth = TAU * (0.5 - (column as f64 + 1.0) / self.width as f64);
        let (sin, cos) = azimuth.sin_cos();
        self.orientation.world_from_map() * DVec3::new(sin_theta * cos, sin_theta * sin, cos_theta)
    }

    #[expect(clippy::cast_possible_truncation, reason = "radiance is f32")]
    fn find_beacon(&self) -> Beacon {
        let mut peak = (0.0, 0, 0);
        self.for_each_cell(|row, column, _| {
            let excess = self.cell_excess(row, column);
            if excess > peak.0 {
                peak = (excess, row, column);
            }
        });
        let towards = self.centre(peak.1, peak.2);
        let (mut sum, mut direction, mut brightest) = (0.0, DVec3::ZERO, 0.0);
        self.for_each_cell(|row, column, solid_angle| {
            let excess = self.cell_excess(row, column);
            // Zero: most cells need no direction.
            if excess > 0.0 {
                let centre = self.centre(row, column);
                if centre.dot(towards) > COS_BEACON {
                    let part = f64::from(excess) * solid_angle;
                    sum += part;
                    direction += centre * part;
                    let mean = self.cell_mean(row, column);
                    brightest += f64::from(mean.max_channel()) * solid_angle;
                }
            }
        });
        Beacon {
            direction: direction.try_normalize().unwrap_or(DVec3::Z),
            typical_radiance: if sum > 0.0 {
                (brightest / (2.0 * TAU)) as f32
            } else {
                0.0
            },
        }
    }

    /// Weighs the cells by what they bring above the mean.
    fn weigh(&mut self) {
        let mut weights = Vec::with_capacity(self.width * (self.height + 1));
        let mut total = 0.0;
        self.for_each_cell(|row, column, solid_angle| {
            let part = f64::from(self.cell_excess(row, column)) * solid_angle;
            total += part;
            #[expect(clippy::cast_possible_truncation, reason = "a weight")]
            weights.push(part as f32);
        });
        // Below, it is what rounding makes of a sky that is the same all over.
        if total > 1e-6 * f64::from(self.mean_luminance) * 2.0 * TAU {
            self.excess = total;
            self.cells = AliasTable::new(&weights);
        }
    }
}
