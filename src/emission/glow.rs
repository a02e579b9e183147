//! The law by which a field glows.

use glam::{DAffine3, DVec3};

use crate::blackbody::{Brightness, Table};
use crate::field::Field;
use crate::spectrum::Rgb;

/// What the numbers of a field mean as light.
#[derive(Clone, Debug)]
pub enum Law {
    /// Emitted radiance per unit length: the field's value times `scale`.
    Direct {
        /// A colour for a scalar field; the same in all channels for one of colours.
        scale: Rgb,
    },
    /// Emitted radiance per unit length is the absorption times the radiance of a black body.
    Thermal {
        /// Kelvin for each unit of the field.
        scale: f32,
        /// Kelvin of a value of zero.
        offset: f32,
        /// What the black body's radiance is multiplied by.
        intensity: f32,
        /// Of the black body, up to the highest temperature of the field.
        table: Table,
    },
}

/// A field that glows.
#[derive(Clone, Debug)]
pub struct Glow {
    field: Field,
    law: Law,
}

impl Glow {
    /// Makes a field of values that are light.
    pub fn direct(field: Field, scale: Rgb) -> Self {
        let law = Law::Direct { scale };
        Self { field, law }
    }

    /// Makes a field of temperatures, of `scale · value + offset` kelvin.
    ///
    /// Where the field is not stored it is dark, whatever the offset.
    pub fn thermal(
        field: Field,
        (scale, offset): (f32, f32),
        (intensity, brightness): (f32, Brightness),
    ) -> Self {
        let most = (scale * field.max() + offset).clamp(1.0, f32::MAX);
        let law = Law::Thermal {
            scale,
            offset,
            intensity,
            table: Table::new(most, brightness),
        };
        Self { field, law }
    }

    /// Returns the field.
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// Returns the range of temperatures, in kelvin, if there are any: from next to nothing to the
    /// field's highest value.
    pub fn kelvin(&self) -> Option<[f32; 2]> {
        match self.law {
            Law::Direct { .. } => None,
            Law::Thermal { scale, offset, .. } => Some([offset, scale * self.field.max() + offset]),
        }
    }

    /// Returns this glow moved by `map`, from world to world; `None` if it cannot be inverted.
    pub fn moved(&self, map: DAffine3) -> Option<Self> {
        let field = self.field.moved(map)?;
        let law = self.law.clone();
        Some(Self { field, law })
    }

    /// Returns the radiance emitted per unit length at a point in world space, where `sigma_a` looks
    /// up the absorption there if that is needed.
    #[inline] // bench: frame
    pub fn emitted(&self, p_world: DVec3, sigma_a: impl FnOnce() -> Rgb) -> Rgb {
        let value = self.field.at(p_world);
        match &self.law {
            Law::Direct { scale } => value * *scale,
            Law::Thermal {
                scale,
                offset,
                intensity,
                table,
            } => {
                // Zero: outside of what is stored.
                let value = value.max_channel();
                if value <= 0.0 {
                    return Rgb::BLACK;
                }
                let radiance = table.radiance(scale * value + offset);
                if radiance.is_black() {
                    return Rgb::BLACK;
                }
                radiance * sigma_a() * *intensity
            }
        }
    }
}
