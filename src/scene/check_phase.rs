//! Checks the phase function of a scene description.
//!
//! Its keys depend on its type; one that belongs to another type is an error, not ignored.

use toml::Spanned;

use super::desc::{PhaseDesc, PhaseKind};
use super::error::{Check, Source};
use super::value::number;
use crate::phase::{Droplets, Phase};

pub(super) fn check_phase(source: &Source, phase: &Spanned<PhaseDesc>) -> Check<Phase> {
    let desc = phase.get_ref();
    foreign_keys(source, desc)?;
    match desc.kind {
        PhaseKind::Isotropic => Ok(Phase::Isotropic),
        PhaseKind::Rayleigh => Ok(Phase::Rayleigh),
        PhaseKind::HenyeyGreenstein => {
            let expected = "g = the mean cosine, say 0.85 for clouds";
            let g = required(source, phase, desc.g.as_ref(), "g", expected)?;
            let g = mean_cosine(source, "g", number(source, "g", g)?, g)?;
            Ok(Phase::HenyeyGreenstein { g })
        }
        PhaseKind::DoubleHenyeyGreenstein => {
            let expected = "gs = the mean cosines of both lobes, say [0.9, -0.3]";
            let gs = required(source, phase, desc.gs.as_ref(), "gs", expected)?;
            let expected = "first_weight = the share of the first lobe, say 0.8";
            let key = "first_weight";
            let weight = required(source, phase, desc.first_weight.as_ref(), key, expected)?;
            let share = number(source, key, weight)?;
            if !(0.0..=1.0).contains(&share) {
                let message = format!("{key} is {share}");
                return Err(source.error(weight.span(), message, "a share from 0 to 1"));
            }
            let [a, b] = *gs.get_ref();
            #[expect(clippy::cast_possible_truncation, reason = "parameters are f32")]
            Ok(Phase::DoubleHenyeyGreenstein {
                gs: [
                    mean_cosine(source, "gs", a, gs)?,
                    mean_cosine(source, "gs", b, gs)?,
                ],
                first_weight: share as f32,
            })
        }
        PhaseKind::Droplets => {
            let key = "diameter_micrometres";
            let expected = "diameter_micrometres = say 10 for fog, 20 for clouds";
            let diameter = desc.diameter_micrometres.as_ref();
            let diameter = required(source, phase, diameter, key, expected)?;
            let micrometres = number(source, key, diameter)?;
            let droplets = Droplets::new(micrometres).ok_or_else(|| {
                let message = format!("{key} is {micrometres}");
                let expected = format!("a diameter above 0, to {}", Droplets::MAX_MICROMETRES);
                source.error(diameter.span(), message, expected)
            })?;
            Ok(Phase::Droplets(droplets))
        }
    }
}

fn mean_cosine<T>(source: &Source, key: &str, g: f64, at: &Spanned<T>) -> Check<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "checked after rounding")]
    let rounded = g as f32;
    // Rounding to f32 may reach 1, where the density has no limit.
    if rounded.abs() < 1.0 {
        return Ok(rounded);
    }
    let message = format!("{key} is {g}");
    let expected = "a mean cosine above -1 and below 1";
    Err(source.error(at.span(), message, expected))
}

fn required<'a, T>(
    source: &Source,
    phase: &Spanned<PhaseDesc>,
    value: Option<&'a Spanned<T>>,
    key: &str,
    expected: &str,
) -> Check<&'a Spanned<T>> {
    value.ok_or_else(|| {
        let name = phase.get_ref().kind.name();
        let message = format!("a {name} phase function needs {key}");
        source.error(phase.span(), message, expected)
    })
}

/// Refuses keys that phase functions of another type have.
fn foreign_keys(source: &Source, desc: &PhaseDesc) -> Check<()> {
    use PhaseKind as K;
    let PhaseDesc {
        kind,
        g,
        gs,
        first_weight,
        diameter_micrometres,
    } = desc;
    let span = |x: &Option<Spanned<f64>>| x.as_ref().map(Spanned::span);
    for (key, owner, at) in [
        ("g", K::HenyeyGreenstein, span(g)),
        (
            "gs",
            K::DoubleHenyeyGreenstein,
            gs.as_ref().map(Spanned::span),
        ),
        (
            "first_weight",
            K::DoubleHenyeyGreenstein,
            span(first_weight),
        ),
        (
            "diameter_micrometres",
            K::Droplets,
            span(diameter_micrometres),
        ),
    ] {
        let Some(at) = at.filter(|_| *kind != owner) else {
            continue;
        };
        let article = if *kind == K::Isotropic { "an" } else { "a" };
        let message = format!("{article} {} phase function has no {key}", kind.name());
        let mut error = source.error(at, message, format!("no {key}"));
        error.help = Some(format!(
            "write type = \"{}\" to scatter by {key}",
            owner.name()
        ));
        return Err(error);
    }
    Ok(())
}
