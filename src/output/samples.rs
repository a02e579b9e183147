//! Which samples of its pixels an image holds.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// Ranges of sample indices, in order, none empty, no two touching.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SampleRanges(Vec<Range<u64>>);

/// A text that does not say which samples, or ranges that cannot be put together.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SampleRangesError {
    /// Not of the form `0..64,128..192`.
    #[error("{0:?} is no range of samples, expected A..B with A below B, such as 256..512")]
    Syntax(String),
    /// Some samples are in both.
    #[error("samples {}..{} are in both", .0.start, .0.end)]
    Overlap(Range<u64>),
}

/// Samples up to here are told apart by the sequence and counted exactly in a float channel.
const MAX_SAMPLES: u64 = 1 << 24;

impl SampleRanges {
    /// Makes a single range; `None` if it is empty.
    pub fn one(range: Range<u64>) -> Option<Self> {
        (!range.is_empty()).then(|| Self(vec![range]))
    }

    /// Returns the ranges.
    pub fn ranges(&self) -> &[Range<u64>] {
        &self.0
    }

    /// Returns how many samples there are.
    pub fn count(&self) -> u64 {
        self.0.iter().map(|r| r.end - r.start).sum()
    }

    /// Returns all samples of both.
    ///
    /// # Errors
    /// If any is in both.
    pub fn union(&self, other: &Self) -> Result<Self, SampleRangesError> {
        let mut all = [&self.0[..], &other.0[..]].concat();
        all.sort_by_key(|r| r.start);
        let mut joined: Vec<Range<u64>> = Vec::new();
        for range in all {
            match joined.last_mut() {
                Some(last) if range.start < last.end => {
                    let shared = range.start..range.end.min(last.end);
                    return Err(SampleRangesError::Overlap(shared));
                }
                Some(last) if range.start == last.end => last.end = range.end,
                _ => joined.push(range),
            }
        }
        Ok(Self(joined))
    }
}

impl fmt::Display for SampleRanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, Range { start, end }) in self.0.iter().enumerate() {
            let comma = if i > 0 { "," } else { "" };
            write!(f, "{comma}{start}..{end}")?;
        }
        Ok(())
    }
}

impl FromStr for SampleRanges {
    type Err = SampleRangesError;

    fn from_str(text: &str) -> Result<Self, SampleRangesError> {
        let wrong = || SampleRangesError::Syntax(text.to_owned());
        let range = |part: &str| {
            let (start, end) = part.split_once("..")?;
            let range = start.parse().ok()?..end.parse().ok().filter(|&n| n <= MAX_SAMPLES)?;
            Self::one(range)
        };
        let mut parts = text.split(',');
        let first = parts.next().and_then(range).ok_or_else(wrong)?;
        parts.try_fold(first, |all, part| {
            all.union(&range(part).ok_or_else(wrong)?)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranges(text: &str) -> SampleRanges {
        text.parse().unwrap()
    }

    #[test]
    fn parts_join_where_they_touch() {
        let all = ranges("64..128").union(&ranges("0..64")).unwrap();
        assert_eq!(all.to_string(), "0..128");
        assert_eq!(all.count(), 128);
        let gap = ranges("0..16").union(&ranges("32..64")).unwrap();
        assert_eq!(gap.to_string(), "0..16,32..64");
        assert_eq!(ranges("0..16,32..64"), gap);
        assert_eq!(gap.count(), 48);
        let overlap = gap.union(&ranges("8..40"));
        assert_eq!(overlap, Err(SampleRangesError::Overlap(8..16)));
    }

    #[test]
    fn what_is_no_range_is_an_error() {
        for bad in [
            "",
            "3",
            "3..3",
            "4..3",
            "-1..3",
            "0..16777217",
            "0..4,2..6",
            "a..b",
            "0..4,",
        ] {
            assert!(bad.parse::<SampleRanges>().is_err(), "{bad:?}");
        }
    }
}
