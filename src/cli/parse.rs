//! Values on the command line: sizes, ranges, times, places. Errors say what was expected.

use std::ops::Range;

use glam::{DVec3, IVec3};
use majorant::film::Region;
use majorant::output::{SampleRanges, SampleRangesError};
use majorant::scene::MAX_RESOLUTION;

pub(super) fn parse_resolution(s: &str) -> Result<[u32; 2], String> {
    let expected = || format!("expected WIDTHxHEIGHT, each from 1 to {MAX_RESOLUTION}");
    let (width, height) = s.split_once('x').ok_or_else(expected)?;
    let edge = |s: &str| s.parse().ok().filter(|n| (1..=MAX_RESOLUTION).contains(n));
    edge(width)
        .zip(edge(height))
        .map(|(w, h)| [w, h])
        .ok_or_else(expected)
}

/// Reads `X0,Y0,X1,Y1`.
pub(super) fn parse_crop(s: &str) -> Result<Region, String> {
    let numbers: Option<Vec<u32>> = s.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x0, y0, x1, y1]) if x0 < x1 && y0 < y1 => Ok(Region {
            min: [x0, y0],
            max: [x1, y1],
        }),
        _ => Err("expected X0,Y0,X1,Y1 in pixels, the second corner beyond the first".to_owned()),
    }
}

/// Reads `A..B`.
pub(super) fn parse_samples(s: &str) -> Result<Range<u32>, String> {
    let ranges: SampleRanges = s.parse().map_err(|e: SampleRangesError| e.to_string())?;
    let edge = |n: u64| u32::try_from(n).ok();
    match ranges.ranges() {
        [one] => edge(one.start).zip(edge(one.end)).map(|(a, b)| a..b),
        _ => None,
    }
    .ok_or_else(|| "expected one range A..B, such as 256..512".to_owned())
}

/// Reads `I/N`.
pub(super) fn parse_shard(s: &str) -> Result<[u32; 2], String> {
    let numbers = s.split_once('/');
    let numbers = numbers.and_then(|(i, n)| i.parse().ok().zip(n.parse().ok()));
    match numbers {
        Some((i, n)) if i < n => Ok([i, n]),
        _ => Err("expected I/N with I from 0 to N - 1, such as 0/4".to_owned()),
    }
}

/// Reads `tev` or `tev=HOST[:PORT]` as an address.
pub(super) fn parse_viewer(s: &str) -> Result<String, String> {
    const PORT: &str = "14158";
    let place = match s.split_once('=') {
        None if s == "tev" => "127.0.0.1",
        Some(("tev", place)) if !place.is_empty() => place,
        _ => return Err("expected tev, tev=HOST or tev=HOST:PORT".to_owned()),
    };
    // Addresses with colons of their own are in brackets.
    match place.rsplit_once(':') {
        Some((_, port)) if !port.ends_with(']') => match port.parse::<u16>() {
            Ok(_) => Ok(place.to_owned()),
            Err(_) => Err(format!("{port:?} is no port, expected a number to 65535")),
        },
        _ => Ok(format!("{place}:{PORT}")),
    }
}

/// Reads `path.to.key=value`.
pub(super) fn parse_setting(s: &str) -> Result<(String, String), String> {
    let (path, value) = s
        .split_once('=')
        .ok_or("expected path.to.key=value, such as light.0.irradiance=[6,5,4]")?;
    Ok((path.trim().to_owned(), value.trim().to_owned()))
}

pub(super) fn parse_positive(s: &str) -> Result<f64, String> {
    let number = s.parse().ok().filter(|x: &f64| *x > 0.0 && x.is_finite());
    number.ok_or_else(|| "expected a number above 0".to_owned())
}

/// Reads `90s`, `2m`, `1.5h` or plain seconds.
pub(super) fn parse_duration(s: &str) -> Result<f64, String> {
    let digits = s.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &s[digits.len()..] {
        "" | "s" => Some(1.0),
        "m" | "min" => Some(60.0),
        "h" => Some(3600.0),
        _ => None,
    };
    let count = parse_positive(digits).ok();
    let secs = count.zip(unit).map(|(count, unit)| count * unit);
    secs.ok_or_else(|| "expected a time above 0, such as 90s, 2m or 1h".to_owned())
}

fn parse_three<T: std::str::FromStr>(s: &str, separator: char) -> Option<[T; 3]> {
    let mut parts = s.split(separator).map(|p| p.trim().parse().ok());
    let three = [parts.next()??, parts.next()??, parts.next()??];
    parts.next().is_none().then_some(three)
}

pub(super) fn parse_index(s: &str) -> Result<IVec3, String> {
    parse_three(s, ',')
        .map(IVec3::from_array)
        .ok_or_else(|| "expected three integers of 32 bit, I,J,K".to_owned())
}

pub(super) fn parse_point(s: &str) -> Result<DVec3, String> {
    parse_three(s, ',')
        .map(DVec3::from_array)
        .filter(|p| p.is_finite())
        .ok_or_else(|| "expected three finite numbers, X,Y,Z".to_owned())
}

/// Reads one `i j k` of a line of `--at-file`.
pub(super) fn parse_index_line(line: &str) -> Option<IVec3> {
    let words = line.split_whitespace().collect::<Vec<_>>().join(",");
    parse_three(&words, ',').map(IVec3::from_array)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resolutions() {
        assert_eq!(parse_resolution("480x270"), Ok([480, 270]));
        for bad in ["480", "0x1", "1x65537", "-1x5", "4 x 5", "4x5x6", ""] {
            assert!(parse_resolution(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn durations() {
        for (text, secs) in [("90", 90.0), ("90s", 90.0), ("2m", 120.0), ("1.5h", 5400.0)] {
            assert_eq!(parse_duration(text), Ok(secs));
        }
        for bad in ["", "0", "-1s", "s", "1d", "inf", "nan"] {
            assert!(parse_duration(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn voxels_and_points() {
        assert_eq!(parse_index("-1,2,3"), Ok(IVec3::new(-1, 2, 3)));
        assert_eq!(parse_index_line(" -1\t2  3 "), Some(IVec3::new(-1, 2, 3)));
        assert_eq!(parse_index_line("1 2"), None);
        assert!(parse_index("1,2,3000000000").is_err(), "beyond 32 bit");
        assert!(parse_index("1,2,3,4").is_err(), "four");
        assert!(parse_point("1,2,nan").is_err(), "not a number");
    }

    #[test]
    fn viewers() {
        let all = [
            ("tev", "127.0.0.1:14158"),
            ("tev=studio", "studio:14158"),
            ("tev=studio:9", "studio:9"),
            ("tev=[::1]", "[::1]:14158"),
            ("tev=[::1]:9", "[::1]:9"),
        ];
        for (text, address) in all {
            assert_eq!(parse_viewer(text).as_deref(), Ok(address));
        }
        for bad in [
            "",
            "tev=",
            "mplay",
            "tev:9",
            "tev=studio:port",
            "tev=studio:70000",
        ] {
            assert!(parse_viewer(bad).is_err(), "{bad:?}");
        }
    }
}
