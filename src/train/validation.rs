//! Measures a network in training on images that it does not learn from.

use serde::Serialize;

use super::config::TrainConfig;
use super::data::{Patch, TrainingData};
use crate::core::error::Result;
use crate::core::image::ToneMappedImage;
use crate::core::metrics::{MetricDefinition, psnr};
use crate::core::rng;
use crate::network::weights::Weights;
use crate::network::{Backend, Model};

/// What equal images count as: no restored photograph comes near it.
const HIGHEST_PSNR: f64 = 100.0;

/// The mean quality over the validation images, before and after restoration, in dB.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Validation {
    /// Number of steps that the network was trained for.
    pub iteration: u64,
    /// PSNR of the restored images, tone-mapped.
    pub psnr: f64,
    /// PSNR of the degraded images, tone-mapped.
    pub degraded_psnr: f64,
}

/// The images of every validation of a run, cut once.
#[derive(Clone, Debug)]
pub(super) struct Validator {
    patches: Vec<Patch>,
}

impl Validator {
    /// Cuts one crop out of each of `validation.images` items, spread evenly.
    pub(super) fn new(data: &dyn TrainingData, config: &TrainConfig) -> Result<Self> {
        let count = config.validation.images.min(data.len());
        let patch = |i: usize| {
            let mut rng = rng::stream(config.seed, &format!("validation/{i}"));
            data.patch(i * data.len() / count, config.validation.crop, &mut rng)
        };
        Ok(Self { patches: (0..count).map(patch).collect::<Result<_>>()? })
    }

    /// Restores every image and takes the mean of the measures.
    pub(super) fn run(&self, weights: &Weights, backend: Backend, iteration: u64) -> Result<Validation> {
        let model = Model::new(weights, backend);
        let (mut restored_psnr, mut degraded_psnr) = (0.0, 0.0);
        for patch in &self.patches {
            let restored = model.restore(&patch.degraded, patch.code.as_ref())?;
            restored_psnr += measure(&restored, &patch.ground_truth)?;
            degraded_psnr += measure(&patch.degraded, &patch.ground_truth)?;
        }
        let count = self.patches.len() as f64;
        Ok(Validation { iteration, psnr: restored_psnr / count, degraded_psnr: degraded_psnr / count })
    }
}

/// PSNR without rounding, kept finite for equal images.
fn measure(image: &ToneMappedImage, ground_truth: &ToneMappedImage) -> Result<f64> {
    psnr(image, ground_truth, &MetricDefinition::float()).map(|value| value.min(HIGHEST_PSNR))
}
