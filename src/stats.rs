//! Counters of what rays did: always on, summed per tile, never logged inside a ray.
//!
//! They are counted in the random stream that each ray is given (`sampling`), one for a tile;
//! [`Counts::add`] sums those of tiles in any order to the same total.

use serde::{Deserialize, Serialize};

macro_rules! counts {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {
        /// Numbers of events, summed over all rays of a render.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
        pub struct Counts {
            $($(#[$doc])* pub $name: u64,)*
        }

        impl Counts {
            /// Adds another set of counts to this one.
            pub fn add(&mut self, other: &Self) {
                let Self { $($name),* } = other;
                $(self.$name += $name;)*
            }
        }
    };
}

counts! {
    /// Rays from the camera: pixels times samples.
    camera_rays,
    /// Rays that continue a path after a scattering event.
    scattered_rays,
    /// Rays towards a light, for transmittance.
    shadow_rays,
    /// Segments of constant bound that rays walked through, empty ones not included.
    segments,
    /// Collisions at the majorant rate, real and null.
    tentative_collisions,
    /// Tentative collisions that turned out to be with nothing.
    null_collisions,
    /// Scattering or absorbing collisions: the vertices of paths.
    real_collisions,
    /// Voxel values read at points.
    lookups,
    /// Points at which what a volume emits was read.
    emission_lookups,
    /// Voxel cells of eight values each that were integrated exactly.
    voxel_cells,
    /// Values above the bound of their segment. Anything but 0 is a bug: the image is biased.
    bound_violations,
    /// Paths ended by Russian roulette.
    roulette_kills,
    /// Samples that were not finite and were left out of the image. Anything but 0 is a bug.
    non_finite_samples,
}

impl Counts {
    /// Returns how many voxel values were read, at points and for whole cells.
    pub fn values_read(&self) -> u64 {
        self.lookups + 8 * self.voxel_cells
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adding_sums_every_counter() {
        let mut a = Counts {
            camera_rays: 1,
            lookups: 2,
            ..Counts::default()
        };
        a.add(&Counts {
            camera_rays: 10,
            bound_violations: 5,
            ..Counts::default()
        });
        let expected = Counts {
            camera_rays: 11,
            lookups: 2,
            bound_violations: 5,
            ..Counts::default()
        };
        assert_eq!(a, expected);
    }
}
