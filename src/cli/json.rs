//! Numbers as `info --json` and `probe --json` write them.
//!
//! Each keeps its own type, so an `f32` is written with the digits that an `f32` has. JSON has
//! no NaN and no infinity: they become `null`, and `not_finite` says which they were.

use serde::{Serialize, Serializer};

use majorant::grid::Voxel;

/// One component of a voxel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Number {
    F32(f32),
    F64(f64),
    Int(i64),
}

impl Number {
    pub(super) fn as_f64(self) -> f64 {
        match self {
            Self::F32(x) => f64::from(x),
            Self::F64(x) => x,
            Self::Int(x) => x as f64,
        }
    }

    fn is_finite(self) -> bool {
        match self {
            Self::F32(x) => x.is_finite(),
            Self::F64(x) => x.is_finite(),
            Self::Int(_) => true,
        }
    }
}

impl std::fmt::Display for Number {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::F32(x) => write!(f, "{x}"),
            Self::F64(x) => write!(f, "{x}"),
            Self::Int(x) => write!(f, "{x}"),
        }
    }
}

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            _ if !self.is_finite() => serializer.serialize_none(),
            Self::F32(x) => serializer.serialize_f32(*x),
            Self::F64(x) => serializer.serialize_f64(*x),
            Self::Int(x) => serializer.serialize_i64(*x),
        }
    }
}

/// A scalar, written as a number, or a vector, written as an array.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Value(pub(super) Vec<Number>);

impl Value {
    /// Returns the value in words if JSON cannot say it.
    pub(super) fn not_finite(&self) -> Option<String> {
        let all_finite = self.0.iter().all(|n| n.is_finite());
        (!all_finite).then(|| self.to_string())
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let words: Vec<_> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&words.join(" "))
    }
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.0[..] {
            [one] => one.serialize(serializer),
            many => many.serialize(serializer),
        }
    }
}

/// A voxel value that can be shown.
pub(super) trait Shown: Voxel {
    /// Returns the components.
    fn numbers(self) -> Vec<Number>;
}

macro_rules! shown {
    ($($t:ty, $variant:ident);*) => {$(
        impl Shown for $t {
            fn numbers(self) -> Vec<Number> {
                vec![Number::$variant(self.into())]
            }
        }
        impl Shown for [$t; 3] {
            fn numbers(self) -> Vec<Number> {
                self.map(|x| Number::$variant(x.into())).to_vec()
            }
        }
    )*};
}
shown!(f32, F32; f64, F64; i32, Int);

impl Shown for i64 {
    fn numbers(self) -> Vec<Number> {
        vec![Number::Int(self)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_the_digits_of_their_type() {
        let json = |v: Value| serde_json::to_string(&v).unwrap();
        assert_eq!(json(Value(0.1_f32.numbers())), "0.1");
        assert_eq!(json(Value(0.1_f64.numbers())), "0.1");
        assert_eq!(
            json(Value(f64::from(0.1_f32).numbers())),
            "0.10000000149011612"
        );
        assert_eq!(json(Value(i64::MAX.numbers())), "9223372036854775807");
        assert_eq!(json(Value([1_i32, -2, 3].numbers())), "[1,-2,3]");
    }

    #[test]
    fn what_json_cannot_say_is_null_and_named() {
        let value = Value([1.0_f32, f32::NAN, f32::NEG_INFINITY].numbers());
        assert_eq!(serde_json::to_string(&value).unwrap(), "[1.0,null,null]");
        assert_eq!(value.not_finite().unwrap(), "1 NaN -inf");
        assert_eq!(Value(1.0_f32.numbers()).not_finite(), None);
    }
}
