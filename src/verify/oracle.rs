//! Answers that owe nothing to the renderer: closed forms, published tables, and one integral
//! equation solved here.

use std::f64::consts::PI;

/// Nodes and weights of Gauss and Legendre's quadrature with `n` points on [0, 1].
pub(super) fn gauss_legendre(n: u32) -> Vec<(f64, f64)> {
    let order = f64::from(n);
    (0..n)
        .map(|i| {
            // Newton's iteration from the usual cosine: six rounds reach the last digit.
            let mut x = (PI * (f64::from(i) + 0.75) / (order + 0.5)).cos();
            let mut slope = 0.0;
            for _ in 0..6 {
                let (mut p, mut before) = (1.0, 0.0);
                for k in 0..n {
                    let k = f64::from(k);
                    (p, before) = (((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0), p);
                }
                slope = order * (x * p - before) / (x * x - 1.0);
                x -= p / slope;
            }
            (0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// Chandrasekhar's H function of an isotropically scattering half-space.
///
/// Solves `1/H(μ) = √(1 − w) + (w/2) ∫₀¹ μ′ H(μ′) / (μ + μ′) dμ′` by iteration on Gauss–Legendre
/// nodes in √μ, where the function is smooth.
///
/// # Reference
/// `[Chandrasekhar1960]`, chapter 5.
pub(super) struct HFunction {
    albedo: f64,
    /// μ, its weight, H(μ).
    nodes: Vec<(f64, f64, f64)>,
}

impl HFunction {
    pub(super) fn new(albedo: f64) -> Self {
        let nodes = gauss_legendre(64);
        let nodes = nodes.iter().map(|&(x, w)| (x * x, 2.0 * x * w, 1.0));
        let mut h = Self {
            albedo,
            nodes: nodes.collect(),
        };
        // The mean of two successive iterates converges fast where the iterates swing.
        for _ in 0..400 {
            let next: Vec<f64> = h.nodes.iter().map(|&(mu, ..)| h.at(mu)).collect();
            for (node, value) in h.nodes.iter_mut().zip(next) {
                node.2 = 0.5 * (node.2 + value);
            }
        }
        h
    }

    pub(super) fn at(&self, mu: f64) -> f64 {
        let terms = self.nodes.iter().map(|&(x, w, h)| w * x * h / (mu + x));
        let integral: f64 = terms.sum();
        ((1.0 - self.albedo).sqrt() + 0.5 * self.albedo * integral).recip()
    }

    /// The radiance at μ for light of unit irradiance, measured across its beam, at μ₀.
    pub(super) fn radiance(&self, mu: f64, mu_0: f64) -> f64 {
        self.albedo * self.at(mu) * self.at(mu_0) * mu_0 / (4.0 * PI * (mu + mu_0))
    }

    /// The same for a slab of optical thickness `tau`, without absorption: what the light lost
    /// below would have added, up to terms of e^(−τ).
    pub(super) fn conservative_radiance(&self, mu: f64, mu_0: f64, tau: f64) -> f64 {
        let lost = self.at(mu) * self.at(mu_0) * mu_0 / (4.0 * PI * (tau + 2.0 * HOPF));
        self.radiance(mu, mu_0) - lost
    }

    /// The fraction of a beam at `mu` that comes back.
    pub(super) fn plane_albedo(&self, mu: f64) -> f64 {
        1.0 - self.at(mu) * (1.0 - self.albedo).sqrt()
    }

    /// The fraction of diffuse light that comes back.
    pub(super) fn spherical_albedo(&self) -> f64 {
        let moment: f64 = self.nodes.iter().map(|&(x, w, h)| w * x * h).sum();
        1.0 - 2.0 * moment * (1.0 - self.albedo).sqrt()
    }
}

/// Hopf's constant: how far beyond a thick slab, in mean free paths, its flux would vanish.
pub(super) const HOPF: f64 = 0.710446089598763;

/// The diffuse transmittance of a thick conservative slab, up to terms of e^(−τ), isotropic.
pub(super) fn thick_transmittance(tau: f64) -> f64 {
    4.0 / 3.0 / (tau + 2.0 * HOPF)
}

/// The spherical albedo of a half-space by similarity, good to a few thousandths.
///
/// # Reference
/// `[Hulst1980]`.
pub(super) fn similar_spherical_albedo(albedo: f64, g: f64) -> f64 {
    let s = ((1.0 - albedo) / (1.0 - albedo * g)).sqrt();
    (1.0 - s) * (1.0 - 0.139 * s) / (1.0 + 1.170 * s)
}

/// The fraction of parallel light that a ball of optical diameter `td` absorbs.
pub(super) fn absorbed_by_ball(td: f64) -> f64 {
    1.0 + 2.0 * (-td).exp() / td + 2.0 * (-td).exp_m1() / (td * td)
}

/// The once scattered radiance at cosine `mu` of an isotropic slab of albedo 1, light and camera
/// on one side, for unit irradiance along the normal.
pub(super) fn once_reflected(tau: f64, mu: f64) -> f64 {
    -(-tau * (1.0 + mu.recip())).exp_m1() / (4.0 * PI * (1.0 + mu))
}

/// The same on the far side.
pub(super) fn once_transmitted(tau: f64, mu: f64) -> f64 {
    if (1.0 - mu).abs() < 1e-9 {
        return tau * (-tau).exp() / (4.0 * PI);
    }
    ((-tau).exp() - (-tau / mu).exp()) / (4.0 * PI * (1.0 - mu))
}

/// The hemispherical integral of a radiance over its cosine.
pub(super) fn flux(radiance: impl Fn(f64) -> f64) -> f64 {
    let nodes = gauss_legendre(64);
    let terms = nodes.iter().map(|&(mu, w)| w * mu * radiance(mu));
    2.0 * PI * terms.sum::<f64>()
}

/// Reflection and transmission of a slab with Henyey–Greenstein scattering.
pub(super) struct SlabRow {
    pub(super) g: f32,
    pub(super) tau: f32,
    /// Light along the normal, for albedos 0.9, 0.99 and 1.
    pub(super) normal: [(f64, f64); 3],
    /// Diffuse light, for albedos 0.9 and 1.
    pub(super) diffuse: [(f64, f64); 2],
}

/// How far the values of [`SLABS`] may be off: half of the last digit, and more for albedo 1,
/// which was computed at 1 − 1e-9.
pub(super) const SLABS_UNCERTAINTY: f64 = 2e-6;

/// Computed by double-Gauss discrete ordinates of 96 streams; that program gives van de Hulst's
/// 0.09739 and 0.66096 for g 0.75, τ 2, albedo 0.9 `[Hulst1980]` and Heaslet and Warming's 0.5534
/// for g 0, τ 1, albedo 1, diffuse `[Heaslet1965]`.
pub(super) const SLABS: [SlabRow; 7] = {
    const fn row(g: f32, tau: f32, normal: [(f64, f64); 3], diffuse: [(f64, f64); 2]) -> SlabRow {
        SlabRow {
            g,
            tau,
            normal,
            diffuse,
        }
    }
    [
        row(
            0.0,
            1.0,
            [
                (0.267410, 0.591625),
                (0.332922, 0.650978),
                (0.341329, 0.658671),
            ],
            [(0.352712, 0.474746), (0.446594, 0.553406)],
        ),
        row(
            0.0,
            4.0,
            [
                (0.408142, 0.128524),
                (0.645047, 0.275480),
                (0.690926, 0.309074),
            ],
            [(0.473186, 0.090564), (0.754029, 0.245971)],
        ),
        row(
            0.0,
            16.0,
            [
                (0.414947, 0.000240),
                (0.751259, 0.029598),
                (0.903631, 0.096368),
            ],
            [(0.478024, 0.000165), (0.923464, 0.076536)],
        ),
        row(
            0.75,
            2.0,
            [
                (0.097395, 0.660958),
                (0.154400, 0.816038),
                (0.163176, 0.836824),
            ],
            [(0.191090, 0.501816), (0.304040, 0.695960)],
        ),
        row(
            0.85,
            4.0,
            [
                (0.081289, 0.493072),
                (0.172836, 0.766170),
                (0.190915, 0.809085),
            ],
            [(0.161382, 0.341791), (0.340402, 0.659598)],
        ),
        row(
            0.85,
            16.0,
            [
                (0.103783, 0.031691),
                (0.417722, 0.306103),
                (0.557209, 0.442791),
            ],
            [(0.178611, 0.019489), (0.651687, 0.348313)],
        ),
        row(
            0.85,
            64.0,
            [
                (0.103872, 0.000000),
                (0.471968, 0.011340),
                (0.846281, 0.153719),
            ],
            [(0.178666, 0.000000), (0.879095, 0.120904)],
        ),
    ]
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadrature_is_exact_for_polynomials() {
        let nodes = gauss_legendre(5);
        for power in 0..10 {
            let sum: f64 = nodes.iter().map(|&(x, w)| w * x.powi(power)).sum();
            let expected = 1.0 / f64::from(power + 1);
            assert!((sum - expected).abs() < 1e-14, "x^{power}: {sum}");
        }
    }

    /// Published digits: Chandrasekhar's, and Kawabata and Limaye's to eleven places.
    #[test]
    fn the_h_function_has_the_published_digits() {
        let table = [
            (0.5, [1.072369, 1.129653, 1.187735, 1.224933, 1.251260]),
            (0.8, [1.138808, 1.266322, 1.413263, 1.518169, 1.598220]),
            (0.9, [1.172143, 1.343271, 1.556034, 1.719001, 1.850099]),
            (0.99, [1.224875, 1.480743, 1.848601, 2.175394, 2.472793]),
            (0.999, [1.240425, 1.526165, 1.958687, 2.365660, 2.756073]),
            (1.0, [1.2473504, 1.5473262, 2.0127788, 2.4634597, 2.9078105]),
        ];
        for (albedo, values) in table {
            let h = HFunction::new(albedo);
            for (mu, expected) in [0.1, 0.25, 0.5, 0.75, 1.0].into_iter().zip(values) {
                let got = h.at(mu);
                assert!(
                    (got - expected).abs() < 6e-7,
                    "H({mu}) at albedo {albedo}: {got}, published {expected}"
                );
            }
        }
        for (albedo, plane, spherical) in [
            (0.5, 0.1152259, 0.1465444),
            (0.9, 0.4149475, 0.4780245),
            (0.999, 0.9128453, 0.9297133),
        ] {
            let h = HFunction::new(albedo);
            assert!((h.plane_albedo(1.0) - plane).abs() < 1e-7, "at {albedo}");
            let got = h.spherical_albedo();
            assert!((got - spherical).abs() < 1e-7, "{got}, not {spherical}");
        }
    }

    #[test]
    fn closed_forms_have_the_digits_of_the_tables() {
        for (td, a) in [(0.1, 0.0642320), (1.0, 0.4715178), (10.0, 0.9800100)] {
            assert!((absorbed_by_ball(td) - a).abs() < 6e-8, "ball {td}");
        }
        assert!((once_reflected(1.0, 0.5) - 0.0504104).abs() < 6e-8);
        for (tau, r, t) in [(0.1, 0.0399332, 0.0397264), (1.0, 0.1420154, 0.1061729)] {
            let (got_r, got_t) = (
                flux(|mu| once_reflected(tau, mu)),
                flux(|mu| once_transmitted(tau, mu)),
            );
            assert!((got_r - r).abs() < 1e-6, "R1 at {tau}: {got_r}");
            assert!((got_t - t).abs() < 1e-6, "T1 at {tau}: {got_t}");
        }
        assert!((thick_transmittance(16.0) - 0.076536).abs() < 4e-6);
    }
}
