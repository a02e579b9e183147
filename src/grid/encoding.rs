//! Which encoding a grid's values take, and what that costs in optical depth.
//!
//! # The error of a ray
//! A code is off by at most half a step `q` of its brick, as good as uniformly and independently,
//! so with variance `q² / 12`. The optical depth of a ray is a weighted sum of voxels; its
//! weights in one layer of voxels across the ray's main axis are not negative and add up to at
//! most `d`, the longest diagonal of a voxel, so their squares to at most `d²`. Eight layers
//! make a layer of bricks, and with `q` the largest step in each of those
//!
//! ```text
//! RMS error    ≤ sigma_t · d · √(8 Σ q² / 12)       worst ≤ sigma_t · d · 8 Σ q / 2
//! ```
//!
//! for every ray along that main axis; the largest of the three axes holds for all rays. `sigma_t`
//! is that of a density of one. Each is an upper bound: few rays pass the coarsest brick of every
//! layer. What the RMS leaves out are plateaus: where many voxels of a brick have one value that
//! is no code, their errors are equal, and a ray's is up to √8 times as large. The worst case
//! holds all the same.
//!
//! # The default
//! An error of 10⁻³ in optical depth is one of 10⁻³ in the light that passes: what noise hides
//! until some 10⁶ samples a pixel. It differs from voxel to voxel, so a picture's mean, over
//! thousands of rays, is off by far less.

use std::collections::BTreeMap;

use glam::IVec3;
use half::f16;
use rayon::prelude::*;

use super::brick::{BRICK_DIM, BRICK_LEN, BRICK_LOG2};
use super::tree::Tree;
use super::values::extremes;
use crate::space::IndexTransform;

/// How the values of bricks are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As they are.
    F32,
    /// Rounded to 11 significant bits; up to 65504.
    F16,
    /// 65536 levels from each brick's minimum to its maximum.
    U16,
    /// 256 levels.
    U8,
}

impl Encoding {
    /// Returns the bytes of a value.
    pub const fn value_bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 | Self::U16 => 2,
            Self::U8 => 1,
        }
    }

    pub(crate) const fn brick_bytes(self) -> usize {
        self.value_bytes() * BRICK_LEN
    }

    /// Returns how many ranges a number of bricks has.
    pub(crate) fn range_count(self, brick_count: usize) -> usize {
        match self {
            Self::F32 | Self::F16 => 0,
            Self::U16 | Self::U8 => brick_count,
        }
    }

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::U16 => "u16",
            Self::U8 => "u8",
        }
    }

    /// Returns twice the largest error of a value in a brick.
    fn step(self, brick: &BrickSpan) -> f64 {
        let range = f64::from(brick.max) - f64::from(brick.min);
        match self {
            Self::F16 if !brick.is_half => {
                // The spacing of halves at the maximum; 2⁻²⁴ below the first normal one.
                f64::from(brick.max).log2().floor().max(-14.0).exp2() / 1024.0
            }
            Self::F32 | Self::F16 => 0.0,
            Self::U16 => range / 65535.0,
            Self::U8 => range / 255.0,
        }
    }
}

impl std::fmt::Display for Encoding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// How values are asked to be stored.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    serde::Serialize,
    serde::Deserialize,
    schemars::JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum StorageKind {
    /// The smallest encoding within the budget.
    #[default]
    Auto,
    /// The smallest encoding that loses nothing.
    Lossless,
    /// [`Encoding::F32`].
    F32,
    /// [`Encoding::F16`].
    F16,
    /// [`Encoding::U16`].
    U16,
    /// [`Encoding::U8`].
    U8,
}

impl StorageKind {
    /// All of them.
    pub const ALL: &'static [Self] = &[
        Self::Auto,
        Self::Lossless,
        Self::F32,
        Self::F16,
        Self::U16,
        Self::U8,
    ];

    /// Returns the name that scene files and the command line use.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Lossless => "lossless",
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::U16 => "u16",
            Self::U8 => "u8",
        }
    }

    /// Returns the encoding, where the kind is one.
    pub fn fixed(self) -> Option<Encoding> {
        match self {
            Self::Auto | Self::Lossless => None,
            Self::F32 => Some(Encoding::F32),
            Self::F16 => Some(Encoding::F16),
            Self::U16 => Some(Encoding::U16),
            Self::U8 => Some(Encoding::U8),
        }
    }
}

/// How values are to be stored, and what for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Storage {
    /// What is asked for.
    pub kind: StorageKind,
    /// Largest RMS error in optical depth of any ray, for [`StorageKind::Auto`].
    pub max_error: f64,
    /// Extinction of a density of one, per world unit; `None` where it is not known yet, which
    /// makes [`StorageKind::Auto`] lossless.
    pub sigma_t_per_density: Option<f32>,
}

impl Storage {
    /// Default of the largest RMS error in optical depth.
    pub const DEFAULT_ERROR: f64 = 1e-3;
    /// Eight bits are taken only where they use at most this share of the budget, 1/√8: then it
    /// holds even if all errors in a brick are equal, as on a plateau of one value.
    pub const MARGIN: f64 = std::f64::consts::FRAC_1_SQRT_2 / 2.0;

    /// Returns a storage that loses nothing.
    pub fn lossless() -> Self {
        Self {
            kind: StorageKind::Lossless,
            max_error: Self::DEFAULT_ERROR,
            sigma_t_per_density: None,
        }
    }

    /// Chooses the encoding of the values of `tree`.
    ///
    /// # Errors
    /// If `f16` is asked for and a value is above 65504.
    ///
    /// # Cost
    /// Reads every value once, in parallel.
    pub fn choose(
        &self,
        tree: &Tree<f32>,
        transform: &IndexTransform,
    ) -> Result<Stored, TooLargeForHalf> {
        let layers = Layers::of_tree(tree, transform);
        let stored = |encoding: Encoding, reason: Reason| Stored {
            encoding,
            reason,
            error: layers.error(encoding),
        };
        if self.kind == StorageKind::F16 && layers.max > f16::MAX.to_f32() {
            return Err(TooLargeForHalf { max: layers.max });
        }
        if let Some(encoding) = self.kind.fixed() {
            return Ok(stored(encoding, Reason::Asked));
        }
        if layers.is_half {
            return Ok(stored(Encoding::F16, Reason::Exact));
        }
        let (StorageKind::Auto, Some(sigma_t)) = (self.kind, self.sigma_t_per_density) else {
            return Ok(stored(Encoding::F32, Reason::Exact));
        };
        let budget = self.max_error;
        let fits = |e: Encoding, budget: f64| layers.error(e).scaled(sigma_t).rms <= budget;
        Ok(if fits(Encoding::U8, budget * Self::MARGIN) {
            stored(Encoding::U8, Reason::WithinBudget(budget))
        } else if fits(Encoding::U16, budget) {
            stored(Encoding::U16, Reason::WithinBudget(budget))
        } else {
            stored(Encoding::F32, Reason::BudgetTooSmall(budget))
        })
    }
}

/// A value is too large for a half.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("a density of {max} is more than a half can hold, expected at most 65504")]
pub struct TooLargeForHalf {
    /// The largest value.
    pub max: f32,
}

/// Why an encoding was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// It was named.
    Asked,
    /// It is the smallest that is exact.
    Exact,
    /// It is the smallest within this budget.
    WithinBudget(f64),
    /// Nothing smaller is within this budget.
    BudgetTooSmall(f64),
    /// A cache file holds it.
    Cached,
    /// A cache file holds it, and it is not within this budget.
    CachedOverBudget(f64),
}

/// How values are stored, and why.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stored {
    /// The encoding.
    pub encoding: Encoding,
    /// Why this one.
    pub reason: Reason,
    /// What it costs, where a density of one has extinction 1.
    pub error: DepthError,
}

impl Stored {
    /// Says why, and what it costs where a density of one has this extinction.
    pub fn explain(&self, sigma_t_per_density: f32) -> String {
        let why = match self.reason {
            Reason::Asked => "asked for".to_owned(),
            Reason::Exact => return "the smallest encoding that loses nothing".to_owned(),
            Reason::WithinBudget(budget) => {
                format!("auto, the smallest within storage_error = {budget:e}")
            }
            Reason::BudgetTooSmall(budget) => {
                return format!("auto, nothing smaller is within storage_error = {budget:e}");
            }
            Reason::Cached => "as in the cache file".to_owned(),
            Reason::CachedOverBudget(budget) => {
                format!("as in the cache file, MORE THAN storage_error = {budget:e}")
            }
        };
        let DepthError { rms, worst } = self.error.scaled(sigma_t_per_density);
        // Zero: exact.
        if rms == 0.0 {
            return format!("{why}; exact");
        }
        format!("{why}; optical depths are off by at most {rms:.1e} RMS, {worst:.1e} at worst")
    }
}

/// Upper bounds of the error in optical depth of any ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthError {
    /// Root of the mean square.
    pub rms: f64,
    /// No error is larger.
    pub worst: f64,
}

impl DepthError {
    /// Returns the error where a density of one has this extinction.
    #[must_use]
    pub fn scaled(self, sigma_t_per_density: f32) -> Self {
        let scale = f64::from(sigma_t_per_density);
        Self {
            rms: self.rms * scale,
            worst: self.worst * scale,
        }
    }
}

/// What matters of a brick's values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BrickSpan {
    min: f32,
    max: f32,
    /// Whether all are halves.
    is_half: bool,
}

impl BrickSpan {
    pub(crate) fn new(values: &[f32]) -> Self {
        let (min, max) = extremes(values);
        // Halves have 13 bits less of mantissa; the range is checked with the exact conversion,
        // which takes ten times as long, for what passes this.
        let coarse = values.iter().fold(0, |bits, v| bits | v.to_bits());
        let coarse = coarse.trailing_zeros() >= 13;
        let is_half = coarse
            && values
                .iter()
                .all(|&v| v >= 0.0 && f16::from_f32(v).to_f32() == v);
        Self { min, max, is_half }
    }
}

/// The largest steps of each layer of bricks, along each axis. Tiles are always exact.
pub(crate) struct Layers {
    /// For each axis, by the layer's coordinate: the largest steps of U8 and F16.
    steps: [BTreeMap<i32, [f64; 2]>; 3],
    /// World length of the longest diagonal of a voxel.
    diagonal: f64,
    max: f32,
    is_half: bool,
}

impl Layers {
    pub(crate) fn new<'a>(
        bricks: impl Iterator<Item = (&'a BrickSpan, IVec3)>,
        transform: &IndexTransform,
    ) -> Self {
        let m = transform.world_from_index().matrix3;
        let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let diagonals = signs.map(|(a, b)| (m.x_axis + m.y_axis * a + m.z_axis * b).length());
        let mut layers = Self {
            steps: [BTreeMap::new(), BTreeMap::new(), BTreeMap::new()],
            diagonal: diagonals.into_iter().fold(0.0, f64::max),
            max: 0.0,
            is_half: true,
        };
        for (span, origin) in bricks {
            layers.max = layers.max.max(span.max);
            layers.is_half &= span.is_half;
            let steps = [Encoding::U8.step(span), Encoding::F16.step(span)];
            let layer = (origin >> BRICK_LOG2).to_array();
            for (of_axis, layer) in layers.steps.iter_mut().zip(layer) {
                let most = of_axis.entry(layer).or_default();
                *most = [most[0].max(steps[0]), most[1].max(steps[1])];
            }
        }
        layers
    }

    fn of_tree(tree: &Tree<f32>, transform: &IndexTransform) -> Self {
        let spans: Vec<_> = (0..tree.brick_count())
            .into_par_iter()
            .with_min_len(64)
            .map(|b| BrickSpan::new(tree.brick(b)))
            .collect();
        let origins = tree.brick_origins().iter().copied();
        Self::new(spans.iter().zip(origins), transform)
    }

    /// Returns the error that the module's documentation derives, where a density of one has
    /// extinction 1.
    pub(crate) fn error(&self, encoding: Encoding) -> DepthError {
        let step = |[u8_step, f16_step]: &[f64; 2]| match encoding {
            Encoding::F32 => 0.0,
            Encoding::F16 => *f16_step,
            Encoding::U8 => *u8_step,
            Encoding::U16 => u8_step * 255.0 / 65535.0,
        };
        let voxels = f64::from(BRICK_DIM);
        let mut error = DepthError::default();
        for layers in &self.steps {
            let (mut sum, mut squares) = (0.0, 0.0);
            for q in layers.values().map(step) {
                sum += q;
                squares += q * q;
            }
            let rms = self.diagonal * (voxels * squares / 12.0).sqrt();
            error.rms = error.rms.max(rms);
            error.worst = error.worst.max(self.diagonal * voxels * sum / 2.0);
        }
        error
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(value: impl Fn(IVec3) -> f32) -> Tree<f32> {
        let voxels = (0..32 * 32 * 32).map(|i| IVec3::new(i / 1024, i / 32 % 32, i % 32));
        Tree::from_voxels(0.0, voxels.map(|p| (p, value(p))))
    }

    fn noise(p: IVec3) -> f32 {
        let n = p.x * 7919 + p.y * 104_729 + p.z * 1_299_709;
        (n.rem_euclid(10_007)) as f32 / 10_006.0
    }

    fn choose(kind: StorageKind, sigma_t: Option<f32>, tree: &Tree<f32>) -> Stored {
        let storage = Storage {
            kind,
            max_error: 1e-3,
            sigma_t_per_density: sigma_t,
        };
        storage
            .choose(tree, &IndexTransform::uniform(1.0))
            .expect("small values")
    }

    #[test]
    fn auto_takes_the_smallest_within_the_budget() {
        let tree = tree(noise);
        let encoding = |sigma_t| choose(StorageKind::Auto, sigma_t, &tree).encoding;
        // RMS: sigma_t · √3 · √(8 · 4 / 12) / 255, that is 0.0111 sigma_t.
        assert_eq!(encoding(Some(0.031)), Encoding::U8, "3.44e-4");
        assert_eq!(encoding(Some(0.0325)), Encoding::U16, "3.6e-4, no margin");
        assert_eq!(encoding(Some(23.0)), Encoding::U16, "9.9e-4");
        assert_eq!(encoding(Some(24.0)), Encoding::F32, "1.04e-3");
        assert_eq!(encoding(None), Encoding::F32, "no scale, no error allowed");
    }

    #[test]
    fn halves_stay_halves() {
        let tree = tree(|p| f16::from_f32(noise(p)).to_f32());
        for kind in [StorageKind::Auto, StorageKind::Lossless] {
            let stored = choose(kind, Some(0.0), &tree);
            assert_eq!(stored.encoding, Encoding::F16);
            assert_eq!(stored.error, DepthError::default());
        }
    }

    #[test]
    fn what_is_no_half_is_not_taken_for_one() {
        for value in [65_536.0, f32::MIN_POSITIVE, 0.1] {
            let tree = Tree::from_voxels(0.0, [(IVec3::ZERO, value)]);
            let stored = choose(StorageKind::Lossless, None, &tree);
            assert_eq!(stored.encoding, Encoding::F32, "{value}");
        }
    }

    #[test]
    fn halves_have_an_end() {
        let tree = Tree::from_voxels(0.0, [(IVec3::ZERO, 65_520.0)]);
        let storage = Storage {
            kind: StorageKind::F16,
            ..Storage::lossless()
        };
        let error = storage.choose(&tree, &IndexTransform::uniform(1.0));
        assert_eq!(error, Err(TooLargeForHalf { max: 65_520.0 }));
    }
}
