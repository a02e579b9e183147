//! A clear sky and its sun by formula: Preetham's model of daylight.
//!
//! The sky's luminance and chromaticity follow Perez's function of the angles to the zenith and to
//! the sun, with coefficients linear in the turbidity; the sun's light is what air and haze leave of
//! it. Radiance is in kcd/m² and irradiance in klx, of a white of Rec. 709, times the scale that is
//! asked for.
//!
//! The fit holds for turbidities of 2 (very clear) to 10 (haze) and a sun above the horizon; there is
//! no night, and the light of a low sun is redder in the sky than in the model. Below the horizon
//! lies ground of one albedo that scatters sun and sky evenly.
//!
//! # Reference
//! `[Preetham1999]` appendix A.2 for the sky; A.1 for the sun, whose spectrum is taken here at one
//! wavelength for each channel, and without ozone, vapour and mixed gases.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DVec3};

use super::{DistantLight, EnvironmentMap, Orientation};
use crate::spectrum::Rgb;

/// Rows of the map that the sky is tabulated in; twice as many columns.
const ROWS: u16 = 256;

/// Angle that the sun's disk spans, as seen from Earth.
pub const SUN_DIAMETER_DEGREES: f64 = 0.533;

/// Illuminance of the sun outside the atmosphere, in klx.
const SOLAR_KLX: f64 = 133.0;

/// Colour of the sun outside the atmosphere in linear Rec. 709, of luminance 1: that of a black body
/// of 5,778 K.
const SOLAR_COLOUR: [f64; 3] = [1.113, 0.975, 0.914];

/// Wavelengths that stand for the three channels, in micrometres.
const WAVELENGTHS: [f64; 3] = [0.612, 0.549, 0.464];

/// A clear day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunSky {
    /// 2 for very clear air to 10 for haze.
    pub turbidity: f64,
    /// Height of the sun above the horizon, above 0.
    pub elevation_radians: f64,
    /// Direction of the sun around the zenith, counter-clockwise from the map's `+x`.
    pub azimuth_radians: f64,
    /// Of what is below the horizon, a Lambertian plane.
    pub ground_albedo: Rgb,
    /// What radiance and irradiance are multiplied by.
    pub scale: f32,
}

/// One of Perez's functions: five coefficients, and the value at the zenith.
struct Perez {
    coefficients: [f64; 5],
    zenith: f64,
}

impl Perez {
    /// Evaluates the function that is `zenith` above, at an angle `theta` from the zenith and
    /// `gamma` from the sun, which is at `theta_sun`.
    fn at(&self, theta_sun: f64, theta: f64, gamma: f64) -> f64 {
        self.zenith * self.shape(theta, gamma) / self.shape(0.0, theta_sun)
    }

    fn shape(&self, theta: f64, gamma: f64) -> f64 {
        let [a, b, c, d, e] = self.coefficients;
        // At the horizon itself the exponent has no limit; within 0.6 degrees nothing changes.
        let cos = theta.cos().max(0.01);
        (1.0 + a * (b / cos).exp()) * (1.0 + c * (d * gamma).exp() + e * gamma.cos().powi(2))
    }
}

impl SunSky {
    /// Returns the map of the sky and the sun, both turned by `orientation`.
    #[expect(clippy::missing_panics_doc, reason = "cannot: see what is expected")]
    pub fn lights(&self, orientation: Orientation) -> (EnvironmentMap, DistantLight) {
        let (sin, cos) = self.elevation_radians.sin_cos();
        let (sin_azimuth, cos_azimuth) = self.azimuth_radians.sin_cos();
        let to_sun = DVec3::new(cos * cos_azimuth, cos * sin_azimuth, sin);
        let world = orientation.world_from_map() * to_sun;
        let irradiance = self.sun_irradiance() * self.scale;
        let diameter = SUN_DIAMETER_DEGREES.to_radians();
        let sun = DistantLight::new(world, irradiance, diameter).expect("a unit vector");
        let size = (2 * usize::from(ROWS), usize::from(ROWS));
        let map = EnvironmentMap::new(size, self.sky(to_sun), self.scale, orientation);
        (map.expect("the texels fill the size"), sun)
    }

    /// Returns the sun's irradiance on a plane that faces it, in klx.
    #[expect(clippy::cast_possible_truncation, reason = "irradiance is f32")]
    fn sun_irradiance(&self) -> Rgb {
        let zenith_degrees = 90.0 - self.elevation_radians.to_degrees();
        // Air masses that the light passes.
        let mass = 1.0
            / (zenith_degrees.to_radians().cos() + 0.15 * (93.885 - zenith_degrees).powf(-1.253));
        let haze = 0.04608 * self.turbidity - 0.04586;
        Rgb(std::array::from_fn(|c| {
            let wavelength = WAVELENGTHS[c];
            let air = 0.008735 * wavelength.powf(-4.08);
            let haze = haze * wavelength.powf(-1.3);
            (SOLAR_KLX * SOLAR_COLOUR[c] * (-mass * (air + haze)).exp()) as f32
        }))
    }

    /// Returns the texels of the map, row by row from the zenith.
    fn sky(&self, to_sun: DVec3) -> Vec<Rgb> {
        let theta_sun = FRAC_PI_2 - self.elevation_radians;
        let functions = self.functions(theta_sun);
        let step = PI / f64::from(ROWS);
        let direction = |row: u16, column: u16| {
            let (sin, cos) = ((f64::from(row) + 0.5) * step).sin_cos();
            let azimuth = PI - (f64::from(column) + 0.5) * step;
            DVec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)
        };
        let mut texels = Vec::with_capacity(2 * usize::from(ROWS) * usize::from(ROWS));
        let mut from_sky = [0.0; 3];
        for row in 0..ROWS / 2 {
            for column in 0..2 * ROWS {
                let d = direction(row, column);
                let radiance = radiance(&functions, theta_sun, d.z.acos(), d.angle_between(to_sun));
                // d.z is the cosine to the ground, the sine of the polar angle the texel's size.
                let weight = d.z * (1.0 - d.z * d.z).sqrt() * step * step;
                for (sum, part) in from_sky.iter_mut().zip(radiance.0) {
                    *sum += f64::from(part) * weight;
                }
                texels.push(radiance);
            }
        }
        let sun = self.sun_irradiance();
        #[expect(clippy::cast_possible_truncation, reason = "radiance is f32")]
        let ground = Rgb(std::array::from_fn(|c| {
            let irradiance = from_sky[c] + f64::from(sun.0[c]) * to_sun.z;
            (f64::from(self.ground_albedo.0[c]) * irradiance / PI) as f32
        }));
        texels.resize(2 * usize::from(ROWS) * usize::from(ROWS), ground);
        texels
    }

    /// Returns luminance in kcd/m², x and y of the sky.
    fn functions(&self, theta_sun: f64) -> [Perez; 3] {
        let t = self.turbidity;
        let linear = |table: [[f64; 2]; 5]| table.map(|[slope, offset]| slope * t + offset);
        let cubic = |table: [[f64; 4]; 3]| {
            let row =
                |[a, b, c, d]: [f64; 4]| ((a * theta_sun + b) * theta_sun + c) * theta_sun + d;
            let [a, b, c] = table.map(row);
            (a * t + b) * t + c
        };
        let chi = (4.0 / 9.0 - t / 120.0) * (PI - 2.0 * theta_sun);
        [
            Perez {
                coefficients: linear([
                    [0.1787, -1.4630],
                    [-0.3554, 0.4275],
                    [-0.0227, 5.3251],
                    [0.1206, -2.5771],
                    [-0.0670, 0.3703],
                ]),
                zenith: (4.0453 * t - 4.9710) * chi.tan() - 0.2155 * t + 2.4192,
            },
            Perez {
                coefficients: linear([
                    [-0.0193, -0.2592],
                    [-0.0665, 0.0008],
                    [-0.0004, 0.2125],
                    [-0.0641, -0.8989],
                    [-0.0033, 0.0452],
                ]),
                zenith: cubic([
                    [0.00166, -0.00375, 0.00209, 0.0],
                    [-0.02903, 0.06377, -0.03202, 0.00394],
                    [0.11693, -0.21196, 0.06052, 0.25886],
                ]),
            },
            Perez {
                coefficients: linear([
                    [-0.0167, -0.2608],
                    [-0.0950, 0.0092],
                    [-0.0079, 0.2102],
                    [-0.0441, -1.6537],
                    [-0.0109, 0.0529],
                ]),
                zenith: cubic([
                    [0.00275, -0.00610, 0.00317, 0.0],
                    [-0.04214, 0.08970, -0.04153, 0.00516],
                    [0.15346, -0.26756, 0.06670, 0.26688],
                ]),
            },
        ]
    }
}

/// Returns the sky's radiance in kcd/m².
#[expect(clippy::cast_possible_truncation, reason = "radiance is f32")]
fn radiance(functions: &[Perez; 3], theta_sun: f64, theta: f64, gamma: f64) -> Rgb {
    let [luminance, x, y] = functions.each_ref().map(|f| f.at(theta_sun, theta, gamma));
    // At the ends of the fit luminance can fall below nothing.
    let luminance = luminance.max(0.0);
    let xyz = DVec3::new(x / y, 1.0, (1.0 - x - y) / y) * luminance;
    // Columns: what X, Y and Z are in linear Rec. 709 with the white of D65.
    let rgb_from_xyz = DMat3::from_cols_array(&[
        3.2409699, -0.9692436, 0.0556301, -1.5373832, 1.8759675, -0.2039770, -0.4986108, 0.0415551,
        1.0569715,
    ]);
    let rgb = rgb_from_xyz * xyz;
    Rgb(rgb.max(DVec3::ZERO).to_array().map(|c| c as f32))
}
