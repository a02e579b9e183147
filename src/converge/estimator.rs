//! Estimators as people write them: `delta+ratio+brick`, `regular+exact`, `residual-ratio`.
//!
//! A list has commas; an estimator is names in any order joined by `+`. A name tells by itself
//! what it is about: how distances are drawn, how transmittance is estimated, which bounds, or
//! which integrator. What is not named is left to `auto`. Two names, `delta` and `closed-form`,
//! are both a distance and a transmittance: they are the distance if none is named before them.
//! `transmittance=delta` says it outright, and so does any `KEY=NAME`.

use std::fmt;

use crate::integrator::{IntegratorKind, Levers, TransportSettings};
use crate::sampling::SamplerKind;
use crate::scene::Scene;
use crate::tracking::{BoundsKind, DistanceEstimator, Tracking, TransmittanceEstimator};

/// A way to render a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimator {
    /// Which integrator.
    pub integrator: IntegratorKind,
    /// Which estimators along its rays.
    pub tracking: Tracking,
    /// Whether points of media that emit are drawn as of a light, and paths sent there: else their
    /// light is met by chance.
    pub emission_light: bool,
}

/// An estimator that cannot be understood.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimatorError {
    /// A word that is no estimator's.
    #[error("estimator {estimator:?}: {word:?} is not known{hint}")]
    Unknown {
        /// The whole estimator.
        estimator: String,
        /// The word.
        word: String,
        /// The nearest known word, or all.
        hint: String,
    },
    /// Two words about the same.
    #[error("estimator {estimator:?}: {word:?} is the second {key}, expected one")]
    Twice {
        /// The whole estimator.
        estimator: String,
        /// The second word.
        word: String,
        /// What it is about.
        key: &'static str,
    },
    /// A number that is none, or out of range.
    #[error("estimator {estimator:?}: {word:?} is not {expected}")]
    Number {
        /// The whole estimator.
        estimator: String,
        /// The number as written.
        word: String,
        /// The range.
        expected: &'static str,
    },
    /// An estimator that this scene does not allow.
    #[error("estimator {estimator:?}: {reason}")]
    Impossible {
        /// The whole estimator.
        estimator: String,
        /// Why.
        reason: &'static str,
    },
}

/// The list that `all` stands for, around `decomposition+residual-ratio`.
const DISTANCES: [&str; 3] = [
    "decomposition+residual-ratio",
    "delta+residual-ratio",
    "regular+residual-ratio",
];
const TRANSMITTANCES: [&str; 8] = [
    "decomposition+exact",
    "decomposition+power-series",
    "decomposition+ratio",
    "decomposition+ratio+rate=4",
    "decomposition+transmittance=delta",
    "decomposition+approx-ray-marching+step=1",
    "decomposition+approx-ray-marching+step=4",
    "decomposition+approx-ray-marching+step=16",
];
const BOUNDS: [&str; 4] = [
    "decomposition+residual-ratio+brick",
    "decomposition+residual-ratio+hierarchy",
    "decomposition+residual-ratio+global",
    "delta+ratio+global",
];

impl Default for Estimator {
    fn default() -> Self {
        Self {
            integrator: IntegratorKind::Path,
            tracking: Tracking::default(),
            emission_light: true,
        }
    }
}

impl Estimator {
    /// Exact in everything along a ray: what others are compared with.
    pub fn exact() -> Self {
        Self {
            tracking: Tracking {
                distance: DistanceEstimator::Regular,
                transmittance: TransmittanceEstimator::Exact,
                ..Tracking::default()
            },
            ..Self::default()
        }
    }

    /// The textbook's: what the exact one is compared with.
    pub fn textbook() -> Self {
        Self {
            tracking: Tracking {
                distance: DistanceEstimator::Delta,
                transmittance: TransmittanceEstimator::Ratio,
                ..Tracking::default()
            },
            ..Self::default()
        }
    }

    /// Returns whether both do the same in a scene, with or without shadow rays.
    pub fn is_same(&self, other: &Self, has_shadow_rays: bool) -> bool {
        let (a, b) = (self.tracking, other.tracking);
        self.integrator == other.integrator
            && self.emission_light == other.emission_light
            && a.distance == b.distance
            && (a.transmittance == b.transmittance || !has_shadow_rays)
    }

    /// Returns whether its expectation is known to be wrong, however little of it is seen.
    pub fn is_approximate(&self) -> bool {
        self.tracking.transmittance == TransmittanceEstimator::ApproxRayMarching
    }

    /// Makes `scene` render by this estimator.
    pub fn apply(&self, scene: &mut Scene) {
        scene.transport = TransportSettings {
            integrator: self.integrator,
            tracking: self.tracking,
            levers: Levers {
                emission_light: self.emission_light,
                ..scene.transport.levers
            },
            // The metrics take an image's noise to be that of independent samples.
            sampler: SamplerKind::Independent,
            ..scene.transport
        };
    }

    fn parse(text: &str) -> Result<Self, EstimatorError> {
        let mut parser = Parser {
            text,
            integrator: None,
            distance: None,
            transmittance: None,
            bounds: None,
            tracking: Tracking::default(),
            emission_light: true,
        };
        for word in text.split('+') {
            parser.word(word.trim())?;
        }
        let Parser {
            integrator,
            distance,
            transmittance,
            bounds,
            tracking,
            emission_light,
            ..
        } = parser;
        Ok(Self {
            integrator: integrator.unwrap_or_default(),
            tracking: Tracking {
                distance: distance.unwrap_or_default(),
                transmittance: transmittance.unwrap_or_default(),
                bounds: bounds.unwrap_or_default(),
                ..tracking
            },
            emission_light,
        })
    }

    fn check(&self, scene: &Scene) -> Result<(), EstimatorError> {
        let Self {
            integrator,
            tracking,
            emission_light: _,
        } = self;
        let closed = tracking.distance == DistanceEstimator::ClosedForm
            || tracking.transmittance == TransmittanceEstimator::ClosedForm;
        let varies = scene.media.iter().any(|m| !m.is_homogeneous());
        // `auto` raises a rate by 4 at most.
        let rate = 4.0 * tracking.rate.max(tracking.flight_rate);
        let largest_rate = scene
            .media
            .iter()
            .fold(0.0, |max: f32, m| max.max(m.majorant() * rate));
        let analog = *integrator == IntegratorKind::Analog;
        let suns = &scene.lights.distant;
        let has_parallel_light = suns.iter().any(|s| s.radiance(s.direction()).is_black());
        let reason = if closed && varies {
            "closed-form is for homogeneous volumes, this one varies: take regular or exact"
        } else if analog && has_parallel_light {
            "analog cannot see a sun of zero diameter: take path"
        } else if analog && tracking.transmittance != TransmittanceEstimator::Auto {
            "analog estimates no transmittance: name none"
        } else if !largest_rate.is_finite() {
            "the rate times the largest extinction is beyond all numbers: lower it"
        } else {
            return Ok(());
        };
        Err(EstimatorError::Impossible {
            estimator: self.to_string(),
            reason,
        })
    }
}

/// The name that parses to the estimator.
impl fmt::Display for Estimator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use TransmittanceEstimator as T;
        let Tracking {
            distance,
            transmittance,
            bounds,
            rate,
            flight_rate,
            march_step,
        } = self.tracking;
        let default = Tracking::default();
        let mut words = Vec::new();
        if self.integrator == IntegratorKind::Analog {
            words.push("analog".to_owned());
        }
        if distance != DistanceEstimator::Auto {
            words.push(distance.to_string());
        }
        match transmittance {
            T::Auto => {}
            T::Delta | T::ClosedForm => words.push(format!("transmittance={transmittance}")),
            _ => words.push(transmittance.to_string()),
        }
        if bounds != BoundsKind::Auto {
            words.push(bounds.to_string());
        }
        if rate != default.rate {
            words.push(format!("rate={rate}"));
        }
        if flight_rate != default.flight_rate {
            words.push(format!("flight-rate={flight_rate}"));
        }
        if transmittance == T::ApproxRayMarching {
            words.push(format!("step={march_step}"));
        }
        if !self.emission_light {
            words.push(BY_CHANCE.to_owned());
        }
        if words.is_empty() {
            words.push("auto".to_owned());
        }
        f.write_str(&words.join("+"))
    }
}

/// Returns whether paths ask for transmittances: towards suns, or what media emit.
pub fn has_shadow_rays(scene: &Scene) -> bool {
    !scene.lights.distant.is_empty() || scene.media.iter().any(|m| m.emission().is_some())
}

/// Reads a list of estimators for a scene; each is in the result once, in order.
///
/// # Errors
/// At the first that cannot be understood or that the scene does not allow.
pub fn parse_list(list: &str, scene: &Scene) -> Result<Vec<Estimator>, EstimatorError> {
    let has_suns = has_shadow_rays(scene);
    let mut estimators = Vec::new();
    let mut add = |text: &str| {
        let estimator = Estimator::parse(text)?;
        estimator.check(scene)?;
        if !estimators.contains(&estimator) {
            estimators.push(estimator);
        }
        Ok(())
    };
    for text in list.split(',').map(str::trim) {
        if text != "all" {
            add(text)?;
            continue;
        }
        add("auto")?;
        DISTANCES.iter().try_for_each(|text| add(text))?;
        if has_suns {
            TRANSMITTANCES.iter().try_for_each(|text| add(text))?;
            add("regular+exact")?;
        } else {
            // Without shadow rays all transmittances are the same.
            add("analog")?;
        }
        BOUNDS.iter().try_for_each(|text| add(text))?;
    }
    Ok(estimators)
}

struct Parser<'a> {
    text: &'a str,
    integrator: Option<IntegratorKind>,
    distance: Option<DistanceEstimator>,
    transmittance: Option<TransmittanceEstimator>,
    bounds: Option<BoundsKind>,
    tracking: Tracking,
    emission_light: bool,
}

/// The word for light of volumes that is met by chance alone.
const BY_CHANCE: &str = "emission-by-chance";

/// What a rate may be.
const RATES: &str = "a number from 1 to 1000000";

/// Keys that may stand before a value.
const KEYS: [&str; 7] = [
    "integrator",
    "distance",
    "transmittance",
    "bounds",
    "rate",
    "flight-rate",
    "step",
];

impl Parser<'_> {
    fn word(&mut self, word: &str) -> Result<(), EstimatorError> {
        if let Some((key, value)) = word.split_once('=') {
            return self.keyed(word, key.trim(), value.trim());
        }
        // An `auto` among others says that whatever is not named is automatic, which it is.
        if word == "auto" {
            return Ok(());
        }
        if word == BY_CHANCE {
            self.emission_light = false;
            return Ok(());
        }
        let is_distance = distance(word).is_some() && self.distance.is_none();
        let key = if is_distance {
            "distance"
        } else if transmittance(word).is_some() {
            "transmittance"
        } else if distance(word).is_some() {
            "distance"
        } else if bounds(word).is_some() {
            "bounds"
        } else if integrator(word).is_some() {
            "integrator"
        } else {
            return Err(self.unknown(word, &known_words()));
        };
        self.keyed(word, key, word)
    }

    fn keyed(&mut self, word: &str, key: &str, value: &str) -> Result<(), EstimatorError> {
        fn names<T: Copy>(all: &[T], name: fn(T) -> &'static str) -> Vec<&'static str> {
            all.iter().map(|&x| name(x)).collect()
        }
        let (key, twice) = match key {
            "integrator" => {
                let found = integrator(value);
                let found = found.ok_or_else(|| self.unknown(value, &["path", "analog"]))?;
                ("integrator", self.integrator.replace(found).is_some())
            }
            "distance" => {
                let known = || names(DistanceEstimator::ALL, DistanceEstimator::name);
                let found = distance(value).ok_or_else(|| self.unknown(value, &known()))?;
                ("distance", self.distance.replace(found).is_some())
            }
            "transmittance" => {
                let known = || names(TransmittanceEstimator::ALL, TransmittanceEstimator::name);
                let found = transmittance(value).ok_or_else(|| self.unknown(value, &known()))?;
                ("transmittance", self.transmittance.replace(found).is_some())
            }
            "bounds" => {
                let known = || names(BoundsKind::ALL, BoundsKind::name);
                let found = bounds(value).ok_or_else(|| self.unknown(value, &known()))?;
                ("bounds", self.bounds.replace(found).is_some())
            }
            "rate" => {
                self.tracking.rate = self.number(value, 1.0..=1e6, RATES)?;
                return Ok(());
            }
            "flight-rate" => {
                self.tracking.flight_rate = self.number(value, 1.0..=1e6, RATES)?;
                return Ok(());
            }
            "step" => {
                let expected = "a number of voxels from 0.01 to 1000000";
                self.tracking.march_step = self.number(value, 0.01..=1e6, expected)?;
                return Ok(());
            }
            _ => return Err(self.unknown(key, &KEYS)),
        };
        if twice {
            let (estimator, word) = (self.text.to_owned(), word.to_owned());
            return Err(EstimatorError::Twice {
                estimator,
                word,
                key,
            });
        }
        Ok(())
    }

    fn number<T: std::str::FromStr + PartialOrd>(
        &self,
        word: &str,
        range: std::ops::RangeInclusive<T>,
        expected: &'static str,
    ) -> Result<T, EstimatorError> {
        let number = word.parse().ok().filter(|x| range.contains(x));
        number.ok_or_else(|| EstimatorError::Number {
            estimator: self.text.to_owned(),
            word: word.to_owned(),
            expected,
        })
    }

    fn unknown(&self, word: &str, known: &[&str]) -> EstimatorError {
        let nearest = known
            .iter()
            .map(|name| (strsim::damerau_levenshtein(word, name), name))
            .min()
            // Beyond half its letters a name is another word.
            .filter(|&(distance, name)| 2 * distance <= name.len());
        let hint = match nearest {
            Some((_, name)) => format!("; did you mean {name:?}?"),
            None => format!(", expected one of {}", known.join(", ")),
        };
        EstimatorError::Unknown {
            estimator: self.text.to_owned(),
            word: word.to_owned(),
            hint,
        }
    }
}

fn known_words() -> Vec<&'static str> {
    let distances = DistanceEstimator::ALL.iter().map(|x| x.name());
    let transmittances = TransmittanceEstimator::ALL.iter().map(|x| x.name());
    let bounds = BoundsKind::ALL.iter().map(|x| x.name());
    let mut words: Vec<_> = distances.chain(transmittances).chain(bounds).collect();
    words.extend(["path", "analog", BY_CHANCE, "all"]);
    let mut seen = Vec::new();
    words.retain(|word| {
        let new = !seen.contains(word);
        seen.push(word);
        new
    });
    words
}

fn distance(word: &str) -> Option<DistanceEstimator> {
    let mut all = DistanceEstimator::ALL.iter().copied();
    all.find(|x| x.name() == word)
}

fn transmittance(word: &str) -> Option<TransmittanceEstimator> {
    let mut all = TransmittanceEstimator::ALL.iter().copied();
    all.find(|x| x.name() == word)
}

fn bounds(word: &str) -> Option<BoundsKind> {
    let mut all = BoundsKind::ALL.iter().copied();
    all.find(|x| x.name() == word)
}

fn integrator(word: &str) -> Option<IntegratorKind> {
    match word {
        "path" => Some(IntegratorKind::Path),
        "analog" => Some(IntegratorKind::Analog),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> String {
        match Estimator::parse(text) {
            Ok(estimator) => estimator.to_string(),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn names_stand_in_any_order() {
        for (text, expected) in [
            ("auto", "auto"),
            ("path", "auto"),
            ("brick+ratio+delta", "delta+ratio+brick"),
            ("regular+exact", "regular+exact"),
            ("residual-ratio", "residual-ratio"),
            ("delta", "delta"),
            ("delta+delta", "delta+transmittance=delta"),
            ("transmittance=delta + auto", "transmittance=delta"),
            ("ratio+rate=4", "ratio+rate=4"),
            ("approx-ray-marching", "approx-ray-marching+step=1"),
            (
                "step=0.5+approx-ray-marching",
                "approx-ray-marching+step=0.5",
            ),
            ("analog+global", "analog+global"),
            ("flight-rate=2+delta", "delta+flight-rate=2"),
            ("emission-by-chance+delta", "delta+emission-by-chance"),
        ] {
            assert_eq!(name(text), expected, "{text}");
            assert_eq!(name(expected), expected, "the name parses to itself");
        }
    }

    #[test]
    fn mistakes_are_told_with_what_was_meant() {
        for (text, expected) in [
            (
                "delta+rato",
                "estimator \"delta+rato\": \"rato\" is not known; did you mean \"ratio\"?",
            ),
            (
                "residual_ratio",
                "estimator \"residual_ratio\": \"residual_ratio\" is not known; did you mean \"residual-ratio\"?",
            ),
            (
                "bound=brick",
                "estimator \"bound=brick\": \"bound\" is not known; did you mean \"bounds\"?",
            ),
            (
                "bounds=bricks",
                "estimator \"bounds=bricks\": \"bricks\" is not known; did you mean \"brick\"?",
            ),
            (
                "ratio+exact",
                "estimator \"ratio+exact\": \"exact\" is the second transmittance, expected one",
            ),
            (
                "ratio+rate=0.5",
                "estimator \"ratio+rate=0.5\": \"0.5\" is not a number from 1 to 1000000",
            ),
            (
                "step=nan",
                "estimator \"step=nan\": \"nan\" is not a number of voxels from 0.01 to 1000000",
            ),
            (
                "integrator=magic",
                "estimator \"integrator=magic\": \"magic\" is not known, expected one of path, analog",
            ),
        ] {
            assert_eq!(name(text), expected);
        }
        assert!(
            name("").contains("expected one of auto, closed-form, regular"),
            "{}",
            name("")
        );
    }
}
