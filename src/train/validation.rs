//! Measures a network in training on images that it does not learn from.

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
use crate::network::{Inputs, Model};

/// What equal images count as: no restored photograph comes near it.
const HIGHEST_PSNR: f64 = 100.0;

/// The mean quality over the validation images; as JSON `{"iteration", "psnr", "degraded_psnr", …}`.
#[derive(Clone, Debug, PartialEq)]
pub struct Validation {
    /// Number of steps that the network was trained for.
    pub iteration: u64,
    /// One entry a metric, of tone-mapped images without rounding.
    pub scores: Vec<ValidationScore>,
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
}

impl Validation {
    /// Each mean with its name in the log.
    pub(super) fn named(&self) -> Vec<(String, f64)> {
        let of_metric = |score: &ValidationScore| {
            let name = score.metric.name();
            [(name.to_owned(), score.restored), (format!("degraded_{name}"), score.degraded)]
        };
        self.scores.iter().flat_map(of_metric).collect()
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
        self.named().iter().try_for_each(|(name, mean)| map.serialize_entry(name, mean))?;
        map.end()
    }
}

/// The images of every validation of a run, cut once, and what is measured of them.
#[derive(Clone, Debug)]
pub(super) struct Validator {
    patches: Vec<Patch>,
    measures: Vec<Measure>,
}

impl Validator {
    /// Cuts one crop out of each of `validation.images` items, spread evenly.
    pub(super) fn new(data: &dyn TrainingData, measures: &[Measure], config: &TrainConfig) -> Result<Self> {
        let patch = |(i, item): (usize, usize)| {
            let mut rng = rng::stream(config.seed, &format!("validation/{i}"));
            data.patch(item, config.validation.crop, &mut rng)
        };
        let items = spread(config.validation.images, data.len()).enumerate();
        let patches = items.map(patch).collect::<Result<_>>()?;
        Ok(Self { patches, measures: measures.to_vec() })
    }

    /// Restores every image and takes the mean of the measures; the pictures of the first go to `previews`.
    pub(super) fn run(&self, weights: &Weights, iteration: u64, previews: &Path) -> Result<Validation> {
        let model = Model::new(weights.clone());
        let (mut restored, mut degraded) = (vec![0.0; self.measures.len()], vec![0.0; self.measures.len()]);
        for (index, patch) in self.patches.iter().enumerate() {
            let inputs = Inputs::new(&patch.degraded, patch.code.as_ref()).with_planes(&patch.planes);
            let image = model.restore(&inputs)?;
            for (index, measure) in self.measures.iter().enumerate() {
                restored[index] += compare(measure, &image, &patch.ground_truth)?;
                degraded[index] += compare(measure, &patch.degraded, &patch.ground_truth)?;
            }
            preview::write(previews, index, patch, &image)?;
        }
        let count = self.patches.len() as f64;
        let score = |(index, measure): (usize, &Measure)| ValidationScore {
            metric: measure.metric(),
            restored: restored[index] / count,
            degraded: degraded[index] / count,
        };
        Ok(Validation { iteration, scores: self.measures.iter().enumerate().map(score).collect() })
    }
}

/// A metric without rounding, kept finite for equal images.
fn compare(measure: &Measure, image: &ToneMappedImage, ground_truth: &ToneMappedImage) -> Result<f64> {
    let value = measure.compare(image, ground_truth, &MetricDefinition::float())?;
    Ok(if measure.metric() == Metric::Psnr { value.min(HIGHEST_PSNR) } else { value })
}
