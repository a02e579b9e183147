//! The difference that people see between two pictures: FLIP, for high dynamic range.
//!
//! Both pictures are tone mapped at several exposures, from one that shows the brightest pixels
//! to one that shows the darker half; each pair is compared as a person would who flips between
//! them on a screen; the largest difference of each pixel counts `[Andersson2021]`. One
//! comparison blurs away what the eye does not resolve, takes the distance of colours, and
//! raises it where edges or points differ `[Andersson2020]`. 0 is no visible difference, 1 the
//! largest one.
//!
//! The noise of the reference cannot be subtracted here. Exposure follows the reference, so the
//! value does not depend on a scene's brightness.

use crate::film::Film;

use super::Reference;

/// Pixels that a degree of the eye's view spans: a screen of 3840 pixels and 0.7 m, 0.7 m away.
const PIXELS_PER_DEGREE: f32 = 67.020_645;

/// Numerator and denominator of the tone mapping curve, highest power first.
///
/// # Reference
/// `[Narkowicz2016]`, with the exposure of 0.6 that `[Andersson2021]` put into it.
const TONE_MAP: [f32; 6] = [
    0.6 * 0.6 * 2.51,
    0.6 * 0.03,
    0.0,
    0.6 * 0.6 * 2.43,
    0.6 * 0.59,
    0.14,
];

/// The tone-mapped value that the brightest pixel has at the lowest exposure, and the median at
/// the highest.
const BRIGHT: f32 = 0.85;

/// Exponents and the knee of the error curve, and the width of features in degrees, of
/// `[Andersson2020] sec. 4`.
const COLOUR_EXPONENT: f32 = 0.7;
const KNEE: f32 = 0.4;
const KNEE_VALUE: f32 = 0.95;
const FEATURE_WIDTH: f32 = 0.082;
const FEATURE_EXPONENT: f32 = 0.5;

/// Returns the mean FLIP of `film` against `reference`, pixels without light included.
pub fn mean_flip(film: &Film, reference: &Reference) -> f64 {
    let as_colour = |x: [f64; 3]| -> Colour {
        #[expect(clippy::cast_possible_truncation, reason = "pictures are f32")]
        let x = x.map(|x| x.max(0.0) as f32);
        x
    };
    let size = (film.width() as usize, film.height() as usize);
    let test = film.pixels().iter().map(|p| as_colour(p.mean)).collect();
    let reference = reference.mean.iter().map(|&m| as_colour(m)).collect();
    let map = flip(&Picture::new(size, reference), &Picture::new(size, test));
    map.iter().map(|&x| f64::from(x)).sum::<f64>() / (map.len().max(1) as f64)
}

type Colour = [f32; 3];

struct Picture {
    size: (usize, usize),
    pixels: Vec<Colour>,
}

impl Picture {
    fn new(size: (usize, usize), pixels: Vec<Colour>) -> Self {
        Self { size, pixels }
    }

    fn map(&self, f: impl Fn(Colour) -> Colour) -> Self {
        Self::new(self.size, self.pixels.iter().map(|&x| f(x)).collect())
    }

    fn channel(&self, c: usize) -> Vec<f32> {
        self.pixels.iter().map(|p| p[c]).collect()
    }
}

/// The largest difference over exposures, pixel by pixel.
fn flip(reference: &Picture, test: &Picture) -> Vec<f32> {
    let mut worst = vec![0.0_f32; reference.pixels.len()];
    for exposure in exposures(reference) {
        let shown = |picture: &Picture| picture.map(|x| x.map(|x| tone_map(x * exposure)));
        let map = flip_of_screens(&shown(reference), &shown(test));
        for (worst, x) in worst.iter_mut().zip(map) {
            *worst = worst.max(x);
        }
    }
    worst
}

fn tone_map(x: f32) -> f32 {
    let [a, b, c, d, e, f] = TONE_MAP;
    let mapped = ((a * x + b) * x + c) / ((d * x + e) * x + f);
    // Not a number where both overflow: as bright as can be.
    if mapped.is_nan() {
        1.0
    } else {
        mapped.clamp(0.0, 1.0)
    }
}

/// Returns the factors by which the pictures are exposed, at most one stop apart.
fn exposures(reference: &Picture) -> Vec<f32> {
    let mut luminance: Vec<f32> = reference.pixels.iter().map(|&p| xyz(p)[1]).collect();
    luminance.sort_by(f32::total_cmp);
    let [a, b, c, d, e, f] = TONE_MAP;
    let (qa, qb, qc) = (a - BRIGHT * d, b - BRIGHT * e, c - BRIGHT * f);
    let root = (qb * qb - 4.0 * qa * qc).sqrt();
    let bright = ((-qb + root) / (2.0 * qa)).max((-qb - root) / (2.0 * qa));
    let brightest = luminance.last().copied().unwrap_or(0.0);
    // A black picture has no exposure of its own.
    if brightest <= 0.0 {
        return vec![1.0];
    }
    let middle = luminance.len() / 2;
    let median = if luminance.len().is_multiple_of(2) {
        f32::midpoint(luminance[middle - 1], luminance[middle])
    } else {
        luminance[middle]
    };
    let first = (bright / brightest).log2();
    // Where most of the picture is black, 16 stops show all there is.
    let last = (bright / median.max(brightest * 2.0_f32.powi(-16))).log2();
    let steps = (last - first).ceil().max(2.0) - 1.0;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "from 1 to 15"
    )]
    let count = steps as u16;
    (0..=count)
        .map(|i| (first + (last - first) * f32::from(i) / steps).exp2())
        .collect()
}

/// The difference of two pictures of values in [0, 1], linear, as seen on a screen.
fn flip_of_screens(reference: &Picture, test: &Picture) -> Vec<f32> {
    let colours = (perceived(reference), perceived(test));
    let features = (Features::of(reference), Features::of(test));
    let largest =
        distance(lab_hunt([0.0, 1.0, 0.0]), lab_hunt([0.0, 0.0, 1.0])).powf(COLOUR_EXPONENT);
    let knee = KNEE * largest;
    (0..reference.pixels.len())
        .map(|i| {
            let d = distance(colours.0.pixels[i], colours.1.pixels[i]).powf(COLOUR_EXPONENT);
            let colour = if d < knee {
                KNEE_VALUE / knee * d
            } else {
                KNEE_VALUE + (d - knee) / (largest - knee) * (1.0 - KNEE_VALUE)
            };
            let edge = (features.0.edges[i] - features.1.edges[i]).abs();
            let point = (features.0.points[i] - features.1.points[i]).abs();
            let feature = (edge.max(point) / 2.0_f32.sqrt()).powf(FEATURE_EXPONENT);
            colour.powf(1.0 - feature)
        })
        .collect()
}

/// What the eye resolves of a picture, as colours whose distance is what people see.
fn perceived(picture: &Picture) -> Picture {
    // Amplitude and width of one or two Gaussians for each channel: [Andersson2020] table 1.
    const SENSITIVITY: [&[(f32, f32)]; 3] = [
        &[(1.0, 0.0047)],
        &[(1.0, 0.0053)],
        &[(34.1, 0.04), (13.5, 0.025)],
    ];
    const WIDEST: f32 = 0.04;
    let pi = std::f32::consts::PI;
    let radius = (3.0 * (WIDEST / (2.0 * pi * pi)).sqrt() * PIXELS_PER_DEGREE).ceil();
    let opponent = picture.map(|rgb| opponent(xyz(rgb)));
    let channels: [Vec<f32>; 3] = std::array::from_fn(|c| {
        let plane = opponent.channel(c);
        let mut sum = vec![0.0; plane.len()];
        let mut total = 0.0;
        for &(amplitude, width) in SENSITIVITY[c] {
            let kernel = sampled(radius, |x| {
                let degrees = x / PIXELS_PER_DEGREE;
                (-pi * pi * degrees * degrees / width).exp()
            });
            let height = amplitude * (pi / width).sqrt();
            total += height * kernel.iter().sum::<f32>().powi(2);
            let blurred = convolve(&plane, picture.size, &kernel, &kernel);
            for (sum, x) in sum.iter_mut().zip(blurred) {
                *sum += height * x;
            }
        }
        for x in &mut sum {
            *x /= total;
        }
        sum
    });
    let [y, cx, cz] = channels;
    let pixels = y.iter().zip(&cx).zip(&cz);
    let seen = pixels.map(|((&y, &cx), &cz)| {
        let rgb = rgb(from_opponent([y, cx, cz])).map(|x| x.clamp(0.0, 1.0));
        lab_hunt(rgb)
    });
    Picture::new(picture.size, seen.collect())
}

/// Strength of edges and points.
struct Features {
    edges: Vec<f32>,
    points: Vec<f32>,
}

impl Features {
    fn of(picture: &Picture) -> Self {
        let sd = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE;
        let radius = (3.0 * sd).ceil();
        let gauss = |x: f32| (-x * x / (2.0 * sd * sd)).exp();
        let mut blur = sampled(radius, gauss);
        let sum: f32 = blur.iter().sum();
        for x in &mut blur {
            *x /= sum;
        }
        let first = balanced(sampled(radius, |x| -x * gauss(x)));
        let second = balanced(sampled(radius, |x| (x * x / (sd * sd) - 1.0) * gauss(x)));
        let luminance: Vec<f32> = picture.pixels.iter().map(|&p| xyz(p)[1]).collect();
        let strength = |kernel: &[f32]| {
            let x = convolve(&luminance, picture.size, kernel, &blur);
            let y = convolve(&luminance, picture.size, &blur, kernel);
            x.iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
        };
        Self {
            edges: strength(&first),
            points: strength(&second),
        }
    }
}

/// Samples a function at whole pixels from `-radius` to `radius`.
fn sampled(radius: f32, f: impl Fn(f32) -> f32) -> Vec<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "a few pixels")]
    let radius = radius as i16;
    (-radius..=radius).map(|x| f(f32::from(x))).collect()
}

/// Scales the positive values to the sum 1 and the negative ones to −1.
fn balanced(mut kernel: Vec<f32>) -> Vec<f32> {
    let positive: f32 = kernel.iter().filter(|&&x| x > 0.0).sum();
    let negative: f32 = -kernel.iter().filter(|&&x| x < 0.0).sum::<f32>();
    for x in &mut kernel {
        *x /= if *x > 0.0 { positive } else { negative };
    }
    kernel
}

/// Filters rows by `across` and columns by `down`; pixels beyond the border are those on it.
fn convolve(
    plane: &[f32],
    (width, height): (usize, usize),
    across: &[f32],
    down: &[f32],
) -> Vec<f32> {
    let at = |x: usize, offset: usize, radius: usize, len: usize| {
        (x + offset).saturating_sub(radius).min(len - 1)
    };
    let mut rows = vec![0.0; plane.len()];
    for (row, out) in plane.chunks(width).zip(rows.chunks_mut(width)) {
        for (x, out) in out.iter_mut().enumerate() {
            let taps = across.iter().enumerate();
            *out = taps
                .map(|(k, w)| w * row[at(x, k, across.len() / 2, width)])
                .sum();
        }
    }
    let mut result = vec![0.0; plane.len()];
    for (y, out) in result.chunks_mut(width).enumerate() {
        for (k, w) in down.iter().enumerate() {
            let from = at(y, k, down.len() / 2, height) * width;
            for (out, x) in out.iter_mut().zip(&rows[from..from + width]) {
                *out += w * x;
            }
        }
    }
    result
}

/// XYZ of the white that Rec. 709 colours are relative to.
const WHITE: Colour = [0.950_428_6, 1.0, 1.088_900_4];

fn product(matrix: &[Colour; 3], x: Colour) -> Colour {
    matrix.map(|row| row[0] * x[0] + row[1] * x[1] + row[2] * x[2])
}

/// # Reference
/// `[Stokes1996]`, with the digits of the primaries' exact matrix.
fn xyz(rgb: Colour) -> Colour {
    const M: [Colour; 3] = [
        [0.412_386_56, 0.357_591_5, 0.180_450_49],
        [0.212_636_82, 0.715_183, 0.072_180_2],
        [0.019_330_62, 0.119_197_16, 0.950_372_6],
    ];
    product(&M, rgb)
}

fn rgb(xyz: Colour) -> Colour {
    const M: [Colour; 3] = [
        [3.241_003_2, -1.537_399, -0.498_615_9],
        [-0.969_224_3, 1.875_93, 0.041_554_23],
        [0.055_639_42, -0.204_011_21, 1.057_149],
    ];
    product(&M, xyz)
}

/// Luminance and two differences of colour, linear in the light.
fn opponent(xyz: Colour) -> Colour {
    let [x, y, z] = [xyz[0] / WHITE[0], xyz[1], xyz[2] / WHITE[2]];
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn from_opponent([l, cx, cz]: Colour) -> Colour {
    let y = (l + 16.0) / 116.0;
    [(y + cx / 500.0) * WHITE[0], y, (y - cz / 200.0) * WHITE[2]]
}

/// CIE L*a*b*, its colours weaker where it is dark, as the Hunt effect has it.
fn lab_hunt(rgb: Colour) -> Colour {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| {
        if t > DELTA.powi(3) {
            t.cbrt()
        } else {
            t / (3.0 * DELTA * DELTA) + 4.0 / 29.0
        }
    };
    let [x, y, z] = xyz(rgb);
    let [x, y, z] = [f(x / WHITE[0]), f(y), f(z / WHITE[2])];
    let l = 116.0 * y - 16.0;
    [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
}

/// The `HyAB` distance: lightness apart from colour.
fn distance(a: Colour, b: Colour) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

#[cfg(test)]
#[expect(
    clippy::cast_possible_truncation,
    reason = "pictures are f32, and small"
)]
mod tests {
    use super::*;

    fn noise(size: (usize, usize), scale: f32) -> Picture {
        let n = size.0 * size.1;
        let at = |i: usize| {
            let x = (i as f32 * 12.9898).sin() * 43_758.547;
            (x - x.floor()) * scale
        };
        Picture::new(
            size,
            (0..n)
                .map(|i| [at(3 * i), at(3 * i + 1), at(3 * i + 2)])
                .collect(),
        )
    }

    fn mean(map: &[f32]) -> f32 {
        map.iter().sum::<f32>() / map.len() as f32
    }

    /// Two pictures that any program can make: stripes of light, with a checkerboard in blue, and
    /// the same with up to 30 % of noise.
    fn known_pictures() -> (Picture, Picture) {
        let size = (60, 40);
        let light = |i: usize| {
            let (x, y) = ((i % 60) as f64, (i / 60) as f64);
            let check = ((i % 60) / 10 + (i / 60) / 10) % 2;
            let blue = 0.3 + 0.5 * check as f64;
            [0.05 + 2.0 * x / 60.0, 0.1 + 1.5 * y / 40.0, blue]
        };
        let noise = |i: u32| f64::from(i.wrapping_mul(2_654_435_761)) / 4_294_967_296.0;
        let pixel = |i: usize| light(i).map(|x| x as f32);
        let noisy = |i: usize| -> Colour {
            let at = |c: usize| 0.7 + 0.6 * noise((3 * i + c) as u32);
            std::array::from_fn(|c| (light(i)[c] * at(c)) as f32)
        };
        let picture = |f: &dyn Fn(usize) -> Colour| Picture::new(size, (0..2400).map(f).collect());
        (picture(&pixel), picture(&noisy))
    }

    #[test]
    fn known_pictures_differ_as_the_authors_program_says() {
        let (a, b) = known_pictures();
        // flip-evaluator 1.7, "HDR" and "LDR" with linear input; it computes in f32 as well.
        let found = mean(&flip(&a, &b));
        assert!((found - 0.064_688_8).abs() < 2e-6, "{found}");
        let dim = |p: &Picture| p.map(|x| x.map(|x| (x / 3.0).clamp(0.0, 1.0)));
        let found = mean(&flip_of_screens(&dim(&a), &dim(&b)));
        assert!((found - 0.069_848_7).abs() < 2e-6, "{found}");
    }

    #[test]
    fn equal_pictures_do_not_differ() {
        let a = noise((40, 30), 2.0);
        assert!(flip(&a, &a).iter().all(|&x| x == 0.0));
    }

    #[test]
    fn pure_green_and_blue_differ_most() {
        let flat = |c: Colour| Picture::new((8, 8), vec![c; 64]);
        let map = flip_of_screens(&flat([0.0, 1.0, 0.0]), &flat([0.0, 0.0, 1.0]));
        assert!((mean(&map) - 1.0).abs() < 1e-3, "{}", mean(&map));
    }

    #[test]
    fn on_a_screen_the_order_does_not_matter_and_more_is_more() {
        let (a, b) = (noise((40, 30), 1.0), noise((40, 30), 0.9));
        let (ab, ba) = (flip_of_screens(&a, &b), flip_of_screens(&b, &a));
        assert!(ab.iter().zip(&ba).all(|(x, y)| (x - y).abs() < 1e-5));
        let c = noise((40, 30), 0.5);
        assert!(mean(&flip_of_screens(&a, &c)) > 2.0 * mean(&ab));
        assert!(flip(&a, &c).iter().all(|x| (0.0..=1.0).contains(x)));
    }

    #[test]
    fn the_colour_transforms_undo_each_other() {
        for c in [[0.2, 0.5, 0.9], [1.0, 0.0, 0.3]] {
            let back = rgb(from_opponent(opponent(xyz(c))));
            for k in 0..3 {
                assert!((back[k] - c[k]).abs() < 1e-5, "{c:?} {back:?}");
            }
        }
        let white = opponent(xyz([1.0; 3]));
        assert!(
            (white[0] - 100.0).abs() < 1e-3 && white[1].abs() < 1e-2,
            "{white:?}"
        );
    }

    #[test]
    fn exposure_does_not_change_the_difference() {
        let (a, b) = (noise((24, 24), 1.0), noise((24, 24), 0.8));
        let brighter = |p: &Picture| p.map(|x| x.map(|x| x * 64.0));
        let (one, other) = (flip(&a, &b), flip(&brighter(&a), &brighter(&b)));
        assert!(one.iter().zip(&other).all(|(x, y)| (x - y).abs() < 1e-3));
    }
}
