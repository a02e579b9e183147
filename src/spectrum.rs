//! Linear RGB triples for coefficients, radiance and throughput.
//!
//! The primaries are Rec. 709's with a D65 white point; nothing here converts to a display.

use std::ops::{Add, AddAssign, Mul, MulAssign};

use serde::{Deserialize, Serialize};

/// Three linear Rec. 709 channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Rgb(pub [f32; 3]);

impl Rgb {
    /// No light.
    pub const BLACK: Self = Self([0.0; 3]);
    /// One in every channel.
    pub const WHITE: Self = Self([1.0; 3]);

    /// The same value in every channel.
    pub const fn splat(value: f32) -> Self {
        Self([value; 3])
    }

    /// Returns the largest channel.
    pub fn max_channel(self) -> f32 {
        self.0[0].max(self.0[1]).max(self.0[2])
    }

    /// Returns the luminance, Y of CIE 1931 for the primaries of Rec. 709.
    pub fn luminance(self) -> f32 {
        0.2126 * self.0[0] + 0.7152 * self.0[1] + 0.0722 * self.0[2]
    }

    /// Returns whether all channels are zero.
    pub fn is_black(self) -> bool {
        self.0 == [0.0; 3]
    }

    /// Returns whether all channels are finite.
    pub fn is_finite(self) -> bool {
        self.0.iter().all(|c| c.is_finite())
    }
}

impl Add for Rgb {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + o.0[i]))
    }
}

impl AddAssign for Rgb {
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl Mul for Rgb {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * o.0[i]))
    }
}

impl Mul<f32> for Rgb {
    type Output = Self;
    fn mul(self, s: f32) -> Self {
        Self(self.0.map(|c| c * s))
    }
}

impl MulAssign for Rgb {
    fn mul_assign(&mut self, o: Self) {
        *self = *self * o;
    }
}

impl MulAssign<f32> for Rgb {
    fn mul_assign(&mut self, s: f32) {
        *self = *self * s;
    }
}
