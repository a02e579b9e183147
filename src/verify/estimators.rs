//! stub
use crate::medium::Medium;
use crate::sampling::Stream;
use crate::space::Ray;
use crate::stats::Counts;

#[derive(Clone, Copy)]
pub(super) struct Tracking;
impl Tracking {
    #[allow(clippy::unused_self)]
    pub(super) fn sample_collision(
        &self,
        medium: &Medium,
        ray: &Ray,
        t_max: f64,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> Option<f64> {
        crate::tracking::sample_collision(medium.ray(ray, t_max), stream, counts)
    }
    #[allow(clippy::unused_self)]
    pub(super) fn estimate_transmittance(
        &self,
        medium: &Medium,
        ray: &Ray,
        t_max: f64,
        roulette_weight: f32,
        stream: &mut Stream,
        counts: &mut Counts,
    ) -> f32 {
        crate::tracking::estimate_transmittance(
            medium.ray(ray, t_max),
            roulette_weight,
            stream,
            counts,
        )
    }
}
pub(super) struct Estimator {
    pub(super) name: String,
    pub(super) tracking: Tracking,
}
pub(super) fn distance_estimators() -> Vec<Estimator> {
    vec![Estimator {
        name: "delta".into(),
        tracking: Tracking,
    }]
}
pub(super) fn transmittance_estimators() -> Vec<Estimator> {
    vec![Estimator {
        name: "ratio".into(),
        tracking: Tracking,
    }]
}
