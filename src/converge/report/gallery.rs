//! Where the errors and the work of each estimator are: four pictures in false colours.

use super::super::Reference;
use super::super::bias::pixel_z;
use super::super::ladder::Record;
use super::super::metrics::relative_error;
use super::super::picture::{Picture, colour_bar, diverging, heat};
use super::super::results::Results;
use super::{Page, number, percent, verdict};
use crate::film::PixelCost;
use crate::plot::escape;

/// Range of the error pictures, in powers of ten.
const ERROR_RANGE: [f64; 2] = [-3.0, 0.0];

/// z that the pictures show in full colour.
const Z_RANGE: f64 = 4.0;

impl Page {
    pub(super) fn gallery(
        &mut self,
        results: &Results,
        records: &[&Record],
        references: &[Reference],
    ) {
        let per_sample = |count: u64, samples: u64| count as f64 / samples.max(1) as f64;
        let highest = |cost: fn(&PixelCost) -> u64| {
            let of = |record: &Record| {
                let pixels = record.film.pixels().iter().zip(&record.costs);
                let costs = pixels.map(|(p, c)| per_sample(cost(c), p.count));
                costs.fold(0.0, f64::max)
            };
            records.iter().map(|r| of(r)).fold(1.0, f64::max)
        };
        let values_max = highest(|c| c.values_read);
        let nulls_max = highest(|c| c.null_collisions);
        // Logarithmic from a tenth of an event, which is as good as none.
        let cost_heat = |x: f64, max: f64| heat((x * 10.0).max(1.0).log10() / (max * 10.0).log10());
        let [low, high] = ERROR_RANGE;
        let error_bar = colour_bar(heat, (0.0, 1.0), ["0.1 %", "100 %"]);
        let z_bar = colour_bar(diverging, (-1.0, 1.0), ["−4", "+4"]);
        let values_bar = colour_bar(heat, (0.0, 1.0), ["0.1", &number(values_max)]);
        let nulls_bar = colour_bar(heat, (0.0, 1.0), ["0.1", &number(nulls_max)]);
        self.push(format_args!(
            "<h2>Where the errors and the work are</h2><p>All renders of an estimator together, \
             so at about equal CPU time. Error is relative to the reference, and logarithmic. z \
             is the difference of the green channel in its own standard errors: without bias it \
             is noise without a pattern. Voxel values read and null collisions are those of one sample.</p>\
             <ul class=\"scales\"><li>error {error_bar}<li>z {z_bar}<li>values read {values_bar}\
             <li>null collisions {nulls_bar}</ul>"
        ));
        for (e, record) in results.estimators.iter().zip(records) {
            let Some(reference) = references.get(e.reference) else {
                continue;
            };
            let pixels = record.film.pixels();
            let errors = pixels.iter().zip(&reference.mean).map(|(p, &r)| {
                let error = relative_error(p, r).max(1e-30).log10();
                heat((error - low) / (high - low))
            });
            let zs = (0..pixels.len()).map(|i| {
                let z = pixel_z(&record.film, reference, i, 1).unwrap_or(0.0);
                diverging(z / Z_RANGE)
            });
            let costs = pixels.iter().zip(&record.costs);
            let values = costs
                .clone()
                .map(|(p, c)| cost_heat(per_sample(c.values_read, p.count), values_max));
            let nulls =
                costs.map(|(p, c)| cost_heat(per_sample(c.null_collisions, p.count), nulls_max));
            let name = escape(&e.name);
            let (spp, cpu) = (e.summary.total_spp, number(e.summary.timing.cpu_secs));
            let bias = &e.summary.bias;
            let (mean, std) = (format!("{:.3}", bias.z_mean), format!("{:.3}", bias.z_std));
            let mean = mean.replace('-', "−");
            let beyond = percent(bias.z_beyond_3);
            let verdict = verdict(bias);
            self.push(format_args!(
                "<h3>{name}</h3><p class=\"caption\">{spp} samples a pixel in {cpu} CPU s; \
                 {verdict}; z has mean {mean}, standard deviation {std}, {beyond} beyond ±3\
                 </p><div class=\"row\">"
            ));
            let pictures: [(&str, Vec<[u8; 3]>); 4] = [
                ("error", errors.collect()),
                ("z", zs.collect()),
                ("values read", values.collect()),
                ("null collisions", nulls.collect()),
            ];
            for (what, pixels) in pictures {
                let picture = Picture {
                    width: record.film.width(),
                    height: record.film.height(),
                    pixels,
                };
                let uri = picture.data_uri();
                self.push(format_args!(
                    "<figure><img src=\"{uri}\" alt=\"{name}: {what}\"><figcaption>{what}\
                     </figcaption></figure>"
                ));
            }
            self.push(format_args!("</div>"));
        }
    }
}
