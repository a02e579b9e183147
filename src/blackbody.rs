//! The colour of what is hot: Planck's law seen by the CIE's standard observer, in linear Rec. 709.
//!
//! The integrals are sums over the observer's table in steps of 5 nm: chromaticities are within 7e-5
//! of those of the finest tables, in x and y. Colours outside of Rec. 709, below some 1,900 K, have
//! their negative channel cut off at zero.

use crate::spectrum::Rgb;

/// What the brightness of a black body means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Brightness {
    /// The peak of its spectrum is 1: the hotter, the brighter, by as much as more of the spectrum
    /// is visible. A flat spectrum of 1 is white at 1.
    #[default]
    Spectrum,
    /// The brightest channel is 1: colour alone.
    Channel,
    /// W m⁻² sr⁻¹ of luminance, so that 1 is 683 cd m⁻²: in steps of a factor of 10¹² between an
    /// ember and a star.
    Physical,
}

/// `h c / k`, in m K: exact in the SI of 2019.
const C2: f64 = 0.014_387_768_775_039_337;

/// `2 h c²`, in W m² sr⁻¹.
const C1L: f64 = 1.191_042_972_397_188e-16;

/// Wien's displacement: the peak of a spectrum times its temperature, in m K.
const WIEN: f64 = 2.897_771_955e-3;

/// First wavelength of the table, and its step, in m.
const FIRST: f64 = 380e-9;
const STEP: f64 = 5e-9;

/// Below this nothing is visible: 10⁻⁸ of an ember's luminance at 1000 K.
const LEAST_KELVIN: f64 = 400.0;

/// XYZ to linear Rec. 709 with its white at D65: the inverse of its primaries `[BT2015]`.
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [
        3.240_969_941_904_521,
        -1.537_383_177_570_093,
        -0.498_610_760_293,
    ],
    [
        -0.969_243_636_280_87,
        1.875_967_501_507_72,
        0.041_555_057_407_175,
    ],
    [
        0.055_630_079_696_993,
        -0.203_976_958_888_976,
        1.056_971_514_242_878,
    ],
];

/// Returns the spectral radiance at `wavelength` in m, in W m⁻³ sr⁻¹.
fn planck(wavelength: f64, kelvin: f64) -> f64 {
    C1L / (wavelength.powi(5) * (C2 / (wavelength * kelvin)).exp_m1())
}

/// Returns X, Y and Z of a black body, for a spectrum in W m⁻³ sr⁻¹.
pub fn xyz(kelvin: f64) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (i, row) in OBSERVER.iter().enumerate() {
        let radiance = planck(FIRST + STEP * i as f64, kelvin);
        for (sum, weight) in sum.iter_mut().zip(row) {
            *sum += STEP * radiance * f64::from(*weight);
        }
    }
    sum
}

/// Returns the radiance of a black body; black below 400 K.
pub fn radiance(kelvin: f64, brightness: Brightness) -> Rgb {
    // Not a number is no temperature either.
    if kelvin.is_nan() || kelvin < LEAST_KELVIN {
        return Rgb::BLACK;
    }
    let xyz = xyz(kelvin);
    let rgb = RGB_FROM_XYZ.map(|row| {
        let channel: f64 = row.iter().zip(xyz).map(|(m, x)| m * x).sum();
        channel.max(0.0)
    });
    let scale = match brightness {
        Brightness::Spectrum => {
            let white: f64 = OBSERVER.iter().map(|[_, y, _]| STEP * f64::from(*y)).sum();
            1.0 / (planck(WIEN / kelvin, kelvin) * white)
        }
        Brightness::Channel => 1.0 / rgb.into_iter().fold(0.0, f64::max),
        Brightness::Physical => 1.0,
    };
    #[expect(clippy::cast_possible_truncation, reason = "radiance is f32")]
    let channels = rgb.map(|c| (c * scale) as f32);
    Rgb(channels)
}

/// Radiances over a range of temperatures, to be looked up.
#[derive(Clone, Debug)]
pub struct Table {
    /// Entries for each kelvin.
    per_kelvin: f32,
    radiances: Vec<Rgb>,
}

impl Table {
    /// Kelvin for each interval: interpolation is then off by 3e-4 at 1,000 K, by less where it is
    /// hotter.
    const STEP: f32 = 2.0;

    /// Most intervals: 200 kB, up to 33,000 K in steps of 2 K.
    const MAX_INTERVALS: f32 = 16384.0;

    /// Prepares temperatures from 0 to `most_kelvin`, which is above 0 and finite.
    pub fn new(most_kelvin: f32, brightness: Brightness) -> Self {
        let intervals = (most_kelvin / Self::STEP).ceil();
        let intervals = intervals.clamp(1.0, Self::MAX_INTERVALS);
        let step = f64::from(most_kelvin / intervals);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped"
        )]
        let entries = 0..=intervals as u16;
        Self {
            per_kelvin: intervals / most_kelvin,
            radiances: entries
                .map(|i| radiance(f64::from(i) * step, brightness))
                .collect(),
        }
    }

    /// Returns the radiance at `kelvin`, that of the end beyond the range.
    #[inline] // bench: frame
    pub fn radiance(&self, kelvin: f32) -> Rgb {
        let last = self.radiances.len() - 1;
        let at = (kelvin * self.per_kelvin).clamp(0.0, last as f32);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped; NaN becomes 0"
        )]
        let i = (at as usize).min(last - 1);
        let part = at - i as f32;
        self.radiances[i] * (1.0 - part) + self.radiances[i + 1] * part
    }
}

/// The CIE 1931 standard observer of 2 degrees, from 380 to 780 nm in steps of 5 nm.
///
/// # Reference
/// `[CIE2018]`.
const OBSERVER: [[f32; 3]; 81] = [
    [0.001368, 0.000039, 0.00645],
    [0.002236, 0.000064, 0.01055],
    [0.004243, 0.00012, 0.02005],
    [0.00765, 0.000217, 0.03621],
    [0.01431, 0.000396, 0.06785],
    [0.02319, 0.00064, 0.1102],
    [0.04351, 0.00121, 0.2074],
    [0.07763, 0.00218, 0.3713],
    [0.13438, 0.004, 0.6456],
    [0.21477, 0.0073, 1.03905],
    [0.2839, 0.0116, 1.3856],
    [0.3285, 0.01684, 1.62296],
    [0.34828, 0.023, 1.74706],
    [0.34806, 0.0298, 1.7826],
    [0.3362, 0.038, 1.77211],
    [0.3187, 0.048, 1.7441],
    [0.2908, 0.06, 1.6692],
    [0.2511, 0.0739, 1.5281],
    [0.19536, 0.09098, 1.28764],
    [0.1421, 0.1126, 1.0419],
    [0.09564, 0.13902, 0.81295],
    [0.05795, 0.1693, 0.6162],
    [0.03201, 0.20802, 0.46518],
    [0.0147, 0.2586, 0.3533],
    [0.0049, 0.323, 0.272],
    [0.0024, 0.4073, 0.2123],
    [0.0093, 0.503, 0.1582],
    [0.0291, 0.6082, 0.1117],
    [0.06327, 0.71, 0.07825],
    [0.1096, 0.7932, 0.05725],
    [0.1655, 0.862, 0.04216],
    [0.22575, 0.91485, 0.02984],
    [0.2904, 0.954, 0.0203],
    [0.3597, 0.9803, 0.0134],
    [0.43345, 0.99495, 0.00875],
    [0.51205, 1.0, 0.00575],
    [0.5945, 0.995, 0.0039],
    [0.6784, 0.9786, 0.00275],
    [0.7621, 0.952, 0.0021],
    [0.8425, 0.9154, 0.0018],
    [0.9163, 0.87, 0.00165],
    [0.9786, 0.8163, 0.0014],
    [1.0263, 0.757, 0.0011],
    [1.0567, 0.6949, 0.001],
    [1.0622, 0.631, 0.0008],
    [1.0456, 0.5668, 0.0006],
    [1.0026, 0.503, 0.00034],
    [0.9384, 0.4412, 0.00024],
    [0.85445, 0.381, 0.00019],
    [0.7514, 0.321, 0.0001],
    [0.6424, 0.265, 0.00005],
    [0.5419, 0.217, 0.00003],
    [0.4479, 0.175, 0.00002],
    [0.3608, 0.1382, 0.00001],
    [0.2835, 0.107, 0.0],
    [0.2187, 0.0816, 0.0],
    [0.1649, 0.061, 0.0],
    [0.1212, 0.04458, 0.0],
    [0.0874, 0.032, 0.0],
    [0.0636, 0.0232, 0.0],
    [0.04677, 0.017, 0.0],
    [0.0329, 0.01192, 0.0],
    [0.0227, 0.00821, 0.0],
    [0.01584, 0.005723, 0.0],
    [0.011359, 0.004102, 0.0],
    [0.008111, 0.002929, 0.0],
    [0.00579, 0.002091, 0.0],
    [0.004109, 0.001484, 0.0],
    [0.002899, 0.001047, 0.0],
    [0.002049, 0.00074, 0.0],
    [0.00144, 0.00052, 0.0],
    [0.001, 0.000361, 0.0],
    [0.00069, 0.000249, 0.0],
    [0.000476, 0.000172, 0.0],
    [0.000332, 0.00012, 0.0],
    [0.000235, 0.000085, 0.0],
    [0.000166, 0.00006, 0.0],
    [0.000117, 0.000042, 0.0],
    [0.000083, 0.00003, 0.0],
    [0.000059, 0.000021, 0.0],
    [0.000042, 0.000015, 0.0],
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Published chromaticities of the Planckian locus, to four digits.
    #[test]
    fn chromaticities_are_the_published_ones() {
        for (kelvin, [x, y]) in [
            (1_000.0, [0.6528, 0.3444]),
            (2_000.0, [0.5267, 0.4133]),
            (3_000.0, [0.4369, 0.4041]),
            (6_500.0, [0.3135, 0.3237]),
            (10_000.0, [0.2807, 0.2884]),
        ] {
            let c = xyz(kelvin);
            let sum: f64 = c.iter().sum();
            let got = [c[0] / sum, c[1] / sum];
            // Four digits, and the 7e-5 of the table.
            for (got, published) in got.into_iter().zip([x, y]) {
                assert!(
                    (got - published).abs() < 2e-4,
                    "{kelvin} K: {got:.4}, not {published}"
                );
            }
        }
    }

    /// Luminances by numerical integration of Planck's law with the finest table.
    #[test]
    fn white_is_white_and_brightness_is_what_it_says() {
        // A black body of 6,500 K is a little pinker than daylight of that colour temperature.
        let Rgb([r, g, b]) = radiance(6_500.0, Brightness::Spectrum);
        let is_near_white = (r / g - 1.0).abs() < 0.08 && (b / g - 1.0).abs() < 0.08;
        assert!(is_near_white && (0.8..1.0).contains(&g), "{r} {g} {b}");
        let Rgb(cold) = radiance(1_500.0, Brightness::Channel);
        assert_eq!(
            (cold[0], cold[2]),
            (1.0, 0.0),
            "red, its blue outside of Rec. 709"
        );
        assert_eq!(radiance(300.0, Brightness::Channel), Rgb::BLACK);
        assert_eq!(radiance(f64::NAN, Brightness::Physical), Rgb::BLACK);
        // The luminance of a black body at the freezing point of platinum, published as 2,042 K, was
        // the candela: 600,000 cd m⁻². It grows by 0.6 % a kelvin, so half a kelvin of rounding is
        // 0.3 %, and 683 lm W⁻¹ another 0.1 %; the table's step of 5 nm is worth 1e-5. (Today's
        // 2,041.4 K gives 0.59 % less than the old candela, which is the old scale's error.)
        let [_, y, _] = xyz(2_042.0);
        assert!((683.0 * y / 6e5 - 1.0).abs() < 0.004, "{}", 683.0 * y);
        let [_, hotter, _] = xyz(2_043.0);
        assert!((hotter / y - 1.006).abs() < 2e-4, "{}", hotter / y);
    }

    #[test]
    fn tables_are_as_good_as_the_sums() {
        let table = Table::new(3_000.0, Brightness::Spectrum);
        for kelvin in [800.0_f32, 1_234.5, 1_999.9, 2_999.0, 3_000.0] {
            let exact = radiance(kelvin.into(), Brightness::Spectrum);
            let got = table.radiance(kelvin);
            for c in 0..3 {
                let error = (got.0[c] - exact.0[c]).abs();
                assert!(
                    error <= 1e-3 * exact.0[0],
                    "{kelvin} K: {got:?} for {exact:?}"
                );
            }
        }
        assert_eq!(table.radiance(-1.0), Rgb::BLACK);
        assert_eq!(table.radiance(1e30), table.radiance(3_000.0));
    }
}
