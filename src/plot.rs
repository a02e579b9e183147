//! Curves on logarithmic axes, as SVG text.
//!
//! Written out by hand: two axes, lines and markers are less than a plotting library needs to be
//! told. Needs no script; names show when the pointer rests on a curve. Colours come in an order
//! that stays apart for most forms of colour blindness, and markers differ as well.

use std::fmt::Write as _;

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Points from left to right; any that is not positive in both is left out.
    pub points: Vec<CurvePoint>,
    /// Draws attention to a curve that is not to be believed, by dashes.
    pub dashed: bool,
}

/// One point of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Place on the horizontal axis.
    pub x: f64,
    /// Place on the vertical axis.
    pub y: f64,
    /// Half the length of its error bar; 0 for none.
    pub error: f64,
}

/// Curves and their axes, both logarithmic.
#[derive(Clone, Debug, PartialEq)]
pub struct LogPlot {
    /// What the horizontal axis shows.
    pub x_label: String,
    /// What the vertical axis shows.
    pub y_label: String,
    /// The curves.
    pub curves: Vec<Curve>,
    /// Slope of grey lines in the background, if they help to read the plot.
    pub guide_slope: Option<f64>,
    /// Level below which nothing can be told, with a name.
    pub floor: Option<(f64, String)>,
}

const WIDTH: f64 = 1010.0;
const HEIGHT: f64 = 480.0;
/// Left, right, top and bottom of the area of the curves; the legend is to its right.
const FRAME: [f64; 4] = [78.0, 672.0, 14.0, 426.0];
/// Height of a line of the legend.
const LINE: f64 = 19.0;

/// Okabe and Ito's colours but the yellow, which is too light on white, and a brown and a grey.
const COLOURS: [&str; 8] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7a4a1e", "#555555",
];

/// The colour and the shape of a curve's markers.
#[derive(Clone, Copy)]
struct Look {
    colour: &'static str,
    shape: usize,
}

impl LogPlot {
    /// Draws the plot.
    pub fn to_svg(&self) -> String {
        let visible = |p: &&CurvePoint| {
            let good = |v: f64| v > 0.0 && v.is_finite();
            good(p.x) && good(p.y)
        };
        let curves: Vec<(&Curve, Vec<CurvePoint>)> = self
            .curves
            .iter()
            .map(|c| (c, c.points.iter().filter(visible).copied().collect()))
            .collect();
        let all = || curves.iter().flat_map(|(_, points)| points);
        let xs = Axis::over(all().map(|p| p.x), FRAME[0], FRAME[1]);
        let ys = Axis::over(all().map(|p| p.y), FRAME[3], FRAME[2]);
        let legend_height = FRAME[2] + LINE * (curves.len() as f64 + 2.0);
        let height = HEIGHT.max(legend_height);
        let mut svg = Svg(format!(
            "<svg class=\"plot\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" \
             font-family=\"sans-serif\" font-size=\"12\" fill=\"#222\">"
        ));
        svg.axes(&xs, &ys, self);
        if let Some(slope) = self.guide_slope {
            svg.guides(&xs, &ys, slope);
        }
        if let Some((level, name)) = &self.floor {
            svg.floor(&ys, *level, name);
        }
        for (i, (curve, points)) in curves.iter().enumerate() {
            let look = Look {
                colour: COLOURS[i % COLOURS.len()],
                shape: i % 5,
            };
            svg.curve(&xs, &ys, curve, points, look);
            svg.legend(FRAME[2] + LINE * (i as f64 + 0.6), curve, look);
        }
        svg.0.push_str("</svg>");
        svg.0
    }
}

/// A logarithmic axis between two places of the drawing.
struct Axis {
    /// Powers of ten at both ends.
    from: f64,
    to: f64,
    at_from: f64,
    at_to: f64,
}

impl Axis {
    /// Reaches over all values with some room; from 0.1 to 10 if there are none.
    fn over(values: impl Iterator<Item = f64>, at_from: f64, at_to: f64) -> Self {
        let (low, high) = values
            .map(f64::log10)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (low.min(x), high.max(x))
            });
        let (low, high) = if low <= high {
            (low, high)
        } else {
            (-1.0, 1.0)
        };
        // At least half a decade, so that a single value has an axis.
        let room = 0.06 * (high - low).max(0.5) + (0.25 - (high - low) / 2.0).max(0.0);
        Self {
            from: low - room,
            to: high + room,
            at_from,
            at_to,
        }
    }

    fn at(&self, value: f64) -> f64 {
        let Self {
            from,
            to,
            at_from,
            at_to,
        } = self;
        at_from + (value.log10() - from) / (to - from) * (at_to - at_from)
    }

    /// Values with a line, and whether with a label: 1, 2 and 5 are labelled on short axes.
    fn ticks(&self) -> Vec<(f64, bool)> {
        let decades = self.to - self.from;
        #[expect(clippy::cast_possible_truncation, reason = "a few powers of ten")]
        let (first, last) = (self.from.floor() as i32, self.to.ceil() as i32);
        let all = (first..=last).flat_map(|power| {
            (1..10).map(move |digit| (f64::from(digit) * 10.0_f64.powi(power), digit, power))
        });
        all.filter(|(value, _, _)| (self.from..=self.to).contains(&value.log10()))
            .map(|(value, digit, power)| {
                let labelled = match digit {
                    1 => decades < 12.0 || power % 3 == 0,
                    2 | 5 => decades < 2.5,
                    _ => false,
                };
                (value, labelled)
            })
            .collect()
    }
}

/// Returns a short name of a value: `0.02`, `5`, `3000` or `2e-5`.
fn name(value: f64) -> String {
    if (1e-3..1e4).contains(&value) {
        format!("{}", (value * 1e6).round() / 1e6)
    } else {
        format!("{value:.0e}")
    }
}

/// Returns text that is safe between tags and in attributes.
pub fn escape(text: &str) -> String {
    text.chars().fold(String::new(), |mut out, x| {
        match x {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            x => out.push(x),
        }
        out
    })
}

struct Svg(String);

impl Svg {
    fn push(&mut self, text: std::fmt::Arguments<'_>) {
        self.0
            .write_fmt(text)
            .expect("writing to a string cannot fail");
    }

    fn axes(&mut self, xs: &Axis, ys: &Axis, plot: &LogPlot) {
        let [left, right, top, bottom] = FRAME;
        for (value, labelled) in xs.ticks() {
            let x = xs.at(value);
            let colour = if labelled { "#d5d5d5" } else { "#efefef" };
            self.push(format_args!(
                "<path d=\"M{x:.1} {top}V{bottom}\" stroke=\"{colour}\"/>"
            ));
            if labelled {
                let name = name(value);
                let y = bottom + 16.0;
                self.push(format_args!(
                    "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{name}</text>"
                ));
            }
        }
        for (value, labelled) in ys.ticks() {
            let y = ys.at(value);
            let colour = if labelled { "#d5d5d5" } else { "#efefef" };
            self.push(format_args!(
                "<path d=\"M{left} {y:.1}H{right}\" stroke=\"{colour}\"/>"
            ));
            if labelled {
                let name = name(value);
                let (x, y) = (left - 7.0, y + 4.0);
                self.push(format_args!(
                    "<text x=\"{x}\" y=\"{y:.1}\" text-anchor=\"end\">{name}</text>"
                ));
            }
        }
        let (width, height) = (right - left, bottom - top);
        self.push(format_args!(
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" fill=\"none\" \
             stroke=\"#888\"/>"
        ));
        let (x_label, y_label) = (escape(&plot.x_label), escape(&plot.y_label));
        let (middle, below) = (f64::midpoint(left, right), bottom + 38.0);
        let centre = f64::midpoint(top, bottom);
        self.push(format_args!(
            "<text x=\"{middle}\" y=\"{below}\" text-anchor=\"middle\" font-size=\"13\">{x_label}\
             </text><text transform=\"translate(18 {centre}) rotate(-90)\" text-anchor=\"middle\" \
             font-size=\"13\">{y_label}</text>"
        ));
    }

    /// Lines of equal efficiency, a decade apart.
    fn guides(&mut self, xs: &Axis, ys: &Axis, slope: f64) {
        let [left, right, top, bottom] = FRAME;
        let (width, height) = (right - left, bottom - top);
        self.push(format_args!(
            "<svg x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"{left} {top} {width} {height}\">"
        ));
        // Where the line meets the left end of the axis, in powers of ten.
        let span = slope.abs() * (xs.to - xs.from);
        #[expect(clippy::cast_possible_truncation, reason = "a few powers of ten")]
        let (first, last) = (
            (ys.from - span).floor() as i32,
            (ys.to + span).ceil() as i32,
        );
        for start in first..=last {
            let end = 10.0_f64.powf(f64::from(start) + slope * (xs.to - xs.from));
            let (y0, y1) = (ys.at(10.0_f64.powi(start)), ys.at(end));
            self.push(format_args!(
                "<path d=\"M{left} {y0:.1}L{right} {y1:.1}\" stroke=\"#9a9a9a\" \
                 stroke-dasharray=\"1 5\"/>"
            ));
        }
        self.push(format_args!("</svg>"));
        let slope = slope.to_string().replace('-', "−").replace("0.5", "½");
        let (x, y) = (right - 8.0, top + 17.0);
        self.push(format_args!(
            "<text x=\"{x}\" y=\"{y}\" text-anchor=\"end\" fill=\"#666\">dotted: slope {slope}\
             </text>"
        ));
    }

    fn floor(&mut self, ys: &Axis, level: f64, name: &str) {
        let [left, right, top, bottom] = FRAME;
        let y = ys.at(level);
        // Also leaves out what is not a number.
        if !(top..=bottom).contains(&y) {
            return;
        }
        let (name, x, above) = (escape(name), left + 8.0, y - 5.0);
        self.push(format_args!(
            "<path d=\"M{left} {y:.1}H{right}\" stroke=\"#b00020\" stroke-dasharray=\"7 4\"/>\
             <text x=\"{x}\" y=\"{above:.1}\" fill=\"#b00020\">{name}</text>"
        ));
    }

    fn curve(&mut self, xs: &Axis, ys: &Axis, curve: &Curve, points: &[CurvePoint], look: Look) {
        let Look { colour, .. } = look;
        let title = escape(&curve.name);
        let dashes = if curve.dashed {
            " stroke-dasharray=\"6 4\""
        } else {
            ""
        };
        self.push(format_args!("<g><title>{title}</title><path d=\""));
        for (i, p) in points.iter().enumerate() {
            let command = if i == 0 { 'M' } else { 'L' };
            let (x, y) = (xs.at(p.x), ys.at(p.y));
            self.push(format_args!("{command}{x:.1} {y:.1}"));
        }
        self.push(format_args!(
            "\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.8\"{dashes}/>"
        ));
        for p in points {
            let (x, y) = (xs.at(p.x), ys.at(p.y));
            if p.error > 0.0 {
                let high = ys.at(p.y + p.error).max(FRAME[2]);
                // An error bar to zero or below ends at the frame.
                let low = p.y - p.error;
                let low = if low > 0.0 {
                    ys.at(low).min(FRAME[3])
                } else {
                    FRAME[3]
                };
                self.push(format_args!(
                    "<path d=\"M{x:.1} {high:.1}V{low:.1}\" stroke=\"{colour}\" \
                     stroke-opacity=\"0.45\"/>"
                ));
            }
            self.marker(x, y, look);
        }
        self.push(format_args!("</g>"));
    }

    fn marker(&mut self, x: f64, y: f64, Look { colour, shape }: Look) {
        let path = match shape {
            0 => "m-3 0a3 3 0 1 0 6 0a3 3 0 1 0 -6 0",
            1 => "m-2.8-2.8h5.6v5.6h-5.6z",
            2 => "m0-3.8l3.6 6.4h-7.2z",
            3 => "m0-3.9l3.9 3.9-3.9 3.9-3.9-3.9z",
            _ => "m0 3.8l3.6-6.4h-7.2z",
        };
        self.push(format_args!(
            "<path d=\"M{x:.1} {y:.1}{path}\" fill=\"{colour}\" stroke=\"#fff\" \
             stroke-width=\"0.6\"/>"
        ));
    }

    fn legend(&mut self, y: f64, curve: &Curve, look: Look) {
        let (name, x) = (escape(&curve.name), FRAME[1] + 16.0);
        let dashes = if curve.dashed {
            " stroke-dasharray=\"6 4\""
        } else {
            ""
        };
        let (end, text, base) = (x + 26.0, x + 33.0, y + 4.0);
        let Look { colour, .. } = look;
        self.push(format_args!(
            "<path d=\"M{x} {y:.1}H{end}\" stroke=\"{colour}\" stroke-width=\"1.8\"{dashes}/>"
        ));
        self.marker(x + 13.0, y, look);
        self.push(format_args!(
            "<text x=\"{text}\" y=\"{base:.1}\">{name}</text>"
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: &[(f64, f64)]) -> LogPlot {
        let point = |&(x, y): &(f64, f64)| CurvePoint {
            x,
            y,
            error: 0.5 * y,
        };
        LogPlot {
            x_label: "CPU s".to_owned(),
            y_label: "error".to_owned(),
            curves: vec![Curve {
                name: "a < b & c".to_owned(),
                points: points.iter().map(point).collect(),
                dashed: true,
            }],
            guide_slope: Some(-1.0),
            floor: Some((0.02, "noise".to_owned())),
        }
    }

    #[test]
    fn decades_are_equally_far_apart() {
        let axis = Axis::over([0.1, 1.0, 10.0].into_iter(), 0.0, 100.0);
        let step = axis.at(1.0) - axis.at(0.1);
        assert!((axis.at(10.0) - axis.at(1.0) - step).abs() < 1e-9);
        assert!(
            axis.at(0.1) > 0.0 && axis.at(10.0) < 100.0,
            "room at both ends"
        );
    }

    #[test]
    fn any_numbers_make_a_drawing() {
        for points in [
            &[][..],
            &[(1.0, 1.0)],
            &[
                (0.0, 1.0),
                (f64::NAN, 1.0),
                (1.0, -1.0),
                (f64::INFINITY, 1.0),
            ],
            &[(1e-9, 1e-12), (1e9, 1e12)],
        ] {
            let svg = plot(points).to_svg();
            assert!(svg.starts_with("<svg") && svg.ends_with("</svg>"), "{svg}");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            assert!(svg.contains("a &lt; b &amp; c"), "{svg}");
            assert_eq!(svg.matches("<g>").count(), svg.matches("</g>").count());
        }
    }

    #[test]
    fn values_have_short_names() {
        for (value, text) in [(0.02, "0.02"), (5.0, "5"), (3000.0, "3000"), (2e-5, "2e-5")] {
            assert_eq!(name(value), text);
        }
    }
}
