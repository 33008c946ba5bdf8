//! Measures a network in training on images that it does not learn from.

use std::collections::BTreeMap;
use std::path::Path;

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use super::config::TrainConfig;
use super::data::{Patch, TrainingData};
use super::preview;
use crate::core::error::Result;
use crate::core::image::ToneMappedImage;
use crate::core::metrics::{Measure, Metric, MetricDefinition};
use crate::core::rng;
use crate::core::spread::spread;
use crate::network::weights::Weights;
use crate::network::{Backend, Inputs, Model, Plane};

/// What equal images count as: no restored photograph comes near it.
const HIGHEST_PSNR: f64 = 100.0;

/// The mean quality over the validation images; as JSON `{"iteration", "psnr", "degraded_psnr", …, "tags": {…}}`.
#[derive(Clone, Debug, PartialEq)]
pub struct Validation {
    /// Number of steps that the network was trained for.
    pub iteration: u64,
    /// One entry a metric, of tone-mapped images without rounding.
    pub scores: Vec<ValidationScore>,
    /// The same over the images of each tag, where the data have tags.
    pub tags: BTreeMap<String, Vec<ValidationScore>>,
}

/// The mean of one metric before and after restoration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValidationScore {
    /// The metric.
    pub metric: Metric,
    /// That of the restored images.
    pub restored: f64,
    /// That of the degraded images.
    pub degraded: f64,
    /// That of the deconvolved images, where the network reads them.
    pub deconvolved: Option<f64>,
}

impl ValidationScore {
    /// Each mean with its name in the log.
    fn named(&self) -> impl Iterator<Item = (String, f64)> {
        let name = self.metric.name();
        let deconvolved = self.deconvolved.map(|value| (format!("deconvolved_{name}"), value));
        [(name.to_owned(), self.restored), (format!("degraded_{name}"), self.degraded)]
            .into_iter()
            .chain(deconvolved)
    }

    /// The mean of scores of one metric.
    fn mean<'a>(scores: impl Iterator<Item = &'a Self> + Clone) -> Option<Self> {
        let count = scores.clone().count() as f64;
        let mean = |value: fn(&Self) -> f64| scores.clone().map(value).sum::<f64>() / count;
        let deconvolved: Option<f64> = scores.clone().map(|score| score.deconvolved).sum();
        Some(Self {
            metric: scores.clone().next()?.metric,
            restored: mean(|score| score.restored),
            degraded: mean(|score| score.degraded),
            deconvolved: deconvolved.map(|sum| sum / count),
        })
    }
}

impl Validation {
    /// Takes the means over all images, of each of which there is one score a metric, and over those of each tag.
    fn of_images(iteration: u64, images: &[(Vec<ValidationScore>, &[String])]) -> Self {
        let means = |is_meant: &dyn Fn(&[String]) -> bool| -> Vec<ValidationScore> {
            let metrics = images.first().map_or(0, |(scores, _)| scores.len());
            let meant = images.iter().filter(|(_, tags)| is_meant(tags));
            (0..metrics)
                .filter_map(|metric| ValidationScore::mean(meant.clone().map(|(scores, _)| &scores[metric])))
                .collect()
        };
        let tags = images.iter().flat_map(|(_, tags)| tags.iter());
        let of_tag = |tag: &String| (tag.clone(), means(&|tags| tags.contains(tag)));
        Self { iteration, scores: means(&|_| true), tags: tags.map(of_tag).collect() }
    }

    /// Each mean with its name in the log; those of a tag behind its name.
    pub(super) fn named(&self) -> Vec<(String, f64)> {
        let of_tag = |(tag, scores): (&String, &Vec<ValidationScore>)| {
            let named = scores.iter().flat_map(ValidationScore::named);
            named.map(|(name, mean)| (format!("{tag}/{name}"), mean)).collect::<Vec<_>>()
        };
        let all = self.scores.iter().flat_map(ValidationScore::named);
        all.chain(self.tags.iter().flat_map(of_tag)).collect()
    }

    /// The mean of a metric over the restored images, if it was measured.
    pub(super) fn restored(&self, metric: Metric) -> Option<f64> {
        self.scores.iter().find(|score| score.metric == metric).map(|score| score.restored)
    }
}

impl Serialize for Validation {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("iteration", &self.iteration)?;
        let mut means = self.scores.iter().flat_map(ValidationScore::named);
        means.try_for_each(|(name, mean)| map.serialize_entry(&name, &mean))?;
        if !self.tags.is_empty() {
            let of_tag = |(tag, scores): (&String, &Vec<ValidationScore>)| {
                let means: BTreeMap<_, _> = scores.iter().flat_map(ValidationScore::named).collect();
                (tag.clone(), means)
            };
            let tags: BTreeMap<_, _> = self.tags.iter().map(of_tag).collect();
            map.serialize_entry("tags", &tags)?;
        }
        map.end()
    }
}

/// The images of every validation of a run, cut once, and what is measured of them.
#[derive(Clone, Debug)]
pub(super) struct Validator {
    /// Each with its tags.
    patches: Vec<(Patch, Vec<String>)>,
    measures: Vec<Measure>,
}

impl Validator {
    /// Cuts one crop out of each of `validation.images` items, spread evenly.
    pub(super) fn new(data: &dyn TrainingData, measures: &[Measure], config: &TrainConfig) -> Result<Self> {
        let patch = |(i, item): (usize, usize)| {
            let mut rng = rng::stream(config.seed, &format!("validation/{i}"));
            Ok((data.patch(item, config.validation.crop, &mut rng)?, data.tags(item).to_vec()))
        };
        let items = spread(config.validation.images, data.len()).enumerate();
        let patches = items.map(patch).collect::<Result<_>>()?;
        Ok(Self { patches, measures: measures.to_vec() })
    }

    /// Restores every image on a backend and takes the mean of the measures; the pictures of the first go to `previews`.
    pub(super) fn run(
        &self,
        (weights, backend): (&Weights, Backend),
        iteration: u64,
        previews: &Path,
    ) -> Result<Validation> {
        let model = Model::new(weights.clone()).with_backend(backend);
        let mut images = Vec::with_capacity(self.patches.len());
        for (index, (patch, tags)) in self.patches.iter().enumerate() {
            let inputs = Inputs::new(&patch.degraded, patch.code.as_ref()).with_planes(&patch.planes);
            let image = model.restore(&inputs)?;
            let scores = self.measures.iter().map(|measure| score(measure, &image, patch));
            images.push((scores.collect::<Result<_>>()?, &tags[..]));
            preview::write(previews, index, patch, &image)?;
        }
        Ok(Validation::of_images(iteration, &images))
    }
}

/// One metric of one image.
fn score(measure: &Measure, restored: &ToneMappedImage, patch: &Patch) -> Result<ValidationScore> {
    let deconvolved = patch.planes.get(Plane::Deconvolved);
    Ok(ValidationScore {
        metric: measure.metric(),
        restored: compare(measure, restored, &patch.ground_truth)?,
        degraded: compare(measure, &patch.degraded, &patch.ground_truth)?,
        deconvolved: deconvolved.map(|image| compare(measure, image, &patch.ground_truth)).transpose()?,
    })
}

/// A metric without rounding, kept finite for equal images.
fn compare(measure: &Measure, image: &ToneMappedImage, ground_truth: &ToneMappedImage) -> Result<f64> {
    let value = measure.compare(image, ground_truth, &MetricDefinition::float())?;
    Ok(if measure.metric() == Metric::Psnr { value.min(HIGHEST_PSNR) } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn image(restored: f64, deconvolved: Option<f64>) -> Vec<ValidationScore> {
        vec![ValidationScore { metric: Metric::Psnr, restored, degraded: restored - 10.0, deconvolved }]
    }

    #[test]
    fn means_are_taken_over_all_and_over_each_tag() {
        let [hard, easy] = [["harder".to_owned()], ["simulator".to_owned()]];
        let images = [
            (image(20.0, Some(18.0)), &hard[..]),
            (image(30.0, Some(29.0)), &easy[..]),
            (image(40.0, Some(40.0)), &easy[..]),
        ];
        let validation = Validation::of_images(7, &images);
        assert_eq!(
            serde_json::to_value(&validation).unwrap(),
            json!({
                "iteration": 7, "psnr": 30.0, "degraded_psnr": 20.0, "deconvolved_psnr": 29.0,
                "tags": {
                    "harder": {"psnr": 20.0, "degraded_psnr": 10.0, "deconvolved_psnr": 18.0},
                    "simulator": {"psnr": 35.0, "degraded_psnr": 25.0, "deconvolved_psnr": 34.5},
                },
            })
        );
        assert!(validation.named().contains(&("simulator/psnr".to_owned(), 35.0)));
    }

    #[test]
    fn data_without_tags_and_planes_are_logged_without_them() {
        let validation = Validation::of_images(7, &[(image(20.0, None), &[]), (image(30.0, None), &[])]);
        let expected = json!({"iteration": 7, "psnr": 25.0, "degraded_psnr": 15.0});
        assert_eq!(serde_json::to_value(&validation).unwrap(), expected);
    }
}
