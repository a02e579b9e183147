//! Ranges of frames.
//!
//! Parts between commas, each one frame (`7`), all between two (`1-10`, `10-1` backwards), or
//! every n-th of these (`1-10x3`: 1, 4, 7, 10). Numbers may be negative: `-5-5` is from −5 to 5.
//! Frames keep the order in which they are written; what is named twice is rendered once.
//!
//! `:` is refused by name: after a range it is a step to some programs and a *stagger* (every
//! n-th frame, then those between) to others.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

/// Most frames of a range: at a second each, eleven days.
const MAX_FRAMES: usize = 1_000_000;

/// Frames to render, in order, none twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameRange(Vec<i32>);

/// A text that is no range of frames.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RangeError {
    /// A part is neither a number nor a range.
    #[error("{0:?} is no frame or range, expected 7, 1-10 or 1-10x2, with commas between")]
    Part(String),
    /// A step is missing, zero or negative.
    #[error("the step of {0:?} is not a whole number from 1, expected 1-10x2")]
    Step(String),
    /// A colon, which programs read in two ways.
    #[error(
        "{0:?}: \":\" is a step to some programs and staggered frames to others: write {1:?} for \
         every n-th frame, or list the frames in the order wanted"
    )]
    Colon(String, String),
    /// More frames than any shot has.
    #[error("more than 1000000 frames")]
    TooMany,
}

impl FrameRange {
    /// Returns the frames in the order in which they were written.
    pub fn frames(&self) -> &[i32] {
        &self.0
    }

    /// Returns the frames in parts of `n`, the last perhaps smaller, each in the form of Open Job
    /// Description.
    pub fn chunks(&self, n: usize) -> Vec<String> {
        let chunks = self.0.chunks(n.max(1));
        chunks.map(|c| Self(c.to_vec()).to_openjd()).collect()
    }

    /// Reads a range in the form that Open Job Description's workers are handed: `1-10:2,15`.
    ///
    /// # Errors
    /// If it is none.
    pub fn parse_openjd(text: &str) -> Result<Self, RangeError> {
        parse(text, ':')
    }

    /// Writes the frames as Open Job Description reads them: ascending, with `:` before steps,
    /// no two parts overlapping.
    pub fn to_openjd(&self) -> String {
        let mut frames = self.0.clone();
        frames.sort_unstable();
        let mut parts = Vec::new();
        let mut rest = &frames[..];
        while let Some(&first) = rest.first() {
            let step = rest.get(1).map_or(1, |&second| second.abs_diff(first));
            let is_next = |w: &&[i32]| w[1].abs_diff(w[0]) == step;
            let run = 1 + rest.windows(2).take_while(is_next).count();
            // Two frames with a gap are not a run: the second may begin a better one.
            let run = if run == 2 && step > 1 { 1 } else { run };
            let last = rest[run - 1];
            parts.push(match (run, step) {
                (1, _) => first.to_string(),
                (_, 1) => format!("{first}-{last}"),
                _ => format!("{first}-{last}:{step}"),
            });
            rest = &rest[run..];
        }
        parts.join(",")
    }
}

impl FromStr for FrameRange {
    type Err = RangeError;

    fn from_str(text: &str) -> Result<Self, RangeError> {
        match text.find(':') {
            None => parse(text, 'x'),
            Some(_) => Err(RangeError::Colon(text.to_owned(), text.replace(':', "x"))),
        }
    }
}

impl fmt::Display for FrameRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0[..] {
            [one] => write!(f, "frame {one}"),
            [first, .., last] => write!(f, "{} frames, {first} to {last}", self.0.len()),
            [] => write!(f, "no frames"),
        }
    }
}

fn parse(text: &str, step_mark: char) -> Result<FrameRange, RangeError> {
    let mut seen = BTreeSet::new();
    let mut frames = Vec::new();
    for part in text.split(',') {
        for frame in parse_part(part.trim(), step_mark)? {
            if seen.insert(frame) {
                frames.push(frame);
            }
            if frames.len() > MAX_FRAMES {
                return Err(RangeError::TooMany);
            }
        }
    }
    Ok(FrameRange(frames))
}

/// The frames of one part, lazily: a part may be of any length.
fn parse_part(part: &str, step_mark: char) -> Result<impl Iterator<Item = i32>, RangeError> {
    let unknown = || RangeError::Part(part.to_owned());
    let (range, step) = match part.split_once(step_mark) {
        None => (part, 1),
        Some((range, step)) => {
            let step = step.parse::<u32>().ok().filter(|&n| n > 0);
            (
                range,
                step.ok_or_else(|| RangeError::Step(part.to_owned()))?,
            )
        }
    };
    // A sign may stand first; the next one separates.
    let dash = range.char_indices().skip(1).find(|&(_, c)| c == '-');
    let (first, last) = match dash {
        // `5x2` is no range.
        None if range.len() == part.len() => (range, range),
        None => return Err(unknown()),
        Some((at, _)) => (&range[..at], &range[at + 1..]),
    };
    let number = |s: &str| s.parse::<i32>().ok().ok_or_else(unknown);
    let (first, last) = (i64::from(number(first)?), i64::from(number(last)?));
    let (count, step) = (first.abs_diff(last) / u64::from(step), i64::from(step));
    let step = if last < first { -step } else { step };
    Ok((0..=count).map(move |i| {
        let frame = first + step * i64::try_from(i).expect("at most 2^32 frames");
        i32::try_from(frame).expect("between two frames")
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(text: &str) -> Vec<i32> {
        text.parse::<FrameRange>().unwrap().0
    }

    #[test]
    fn every_documented_form_is_read() {
        assert_eq!(frames("7"), [7]);
        assert_eq!(frames("-7"), [-7]);
        assert_eq!(frames("1001-1004"), [1001, 1002, 1003, 1004]);
        assert_eq!(frames("1-10x3"), [1, 4, 7, 10]);
        assert_eq!(frames("1-10x4"), [1, 5, 9]);
        assert_eq!(frames("1,5,9-11"), [1, 5, 9, 10, 11]);
        assert_eq!(frames("-2-2"), [-2, -1, 0, 1, 2]);
        assert_eq!(frames("-5--3"), [-5, -4, -3]);
        assert_eq!(frames("3-1"), [3, 2, 1]);
        assert_eq!(frames("10-1x4"), [10, 6, 2]);
        assert_eq!(frames("3, 1-4"), [3, 1, 2, 4], "in order, none twice");
        assert_eq!(frames("2147483647"), [i32::MAX]);
    }

    #[test]
    fn what_is_no_range_is_an_error() {
        for bad in [
            "",
            "a",
            "1-",
            "-",
            "1--",
            "1-2-3",
            "1.5",
            "1,",
            "1..3",
            "99999999999",
            "5x2",
        ] {
            assert!(bad.parse::<FrameRange>().is_err(), "{bad:?}");
        }
        for bad in ["1-10x0", "1-10x", "1-10x-2", "1-10x1.5"] {
            let error = bad.parse::<FrameRange>().unwrap_err();
            assert!(matches!(error, RangeError::Step(_)), "{bad:?}: {error}");
        }
        let huge = "-2147483648-2147483647".parse::<FrameRange>();
        assert_eq!(huge.unwrap_err(), RangeError::TooMany);
    }

    #[test]
    fn a_colon_is_refused_with_both_its_meanings() {
        let said = "1-10:2".parse::<FrameRange>().unwrap_err().to_string();
        for word in ["step", "staggered", "\"1-10x2\""] {
            assert!(said.contains(word), "{said}");
        }
    }

    #[test]
    fn open_job_description_gets_its_own_form() {
        for (ours, theirs) in [
            ("1001-1100x2", "1001-1099:2"),
            ("1,5,9-11", "1-9:4,10-11"),
            ("10-1", "1-10"),
            ("1-10,5-8", "1-10"),
            ("-5-5", "-5-5"),
            ("4,9", "4,9"),
            ("1-7x3,8", "1-7:3,8"),
        ] {
            let range: FrameRange = ours.parse().unwrap();
            assert_eq!(range.to_openjd(), theirs, "{ours}");
            let mut sorted = range.0.clone();
            sorted.sort_unstable();
            assert_eq!(FrameRange::parse_openjd(theirs).unwrap().0, sorted);
        }
    }
}
