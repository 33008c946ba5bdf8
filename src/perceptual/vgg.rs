//! The perceptual loss: how far apart two images are in VGG-19's features conv5_4, and which way they approach.

use std::path::Path;

use burn::tensor::Device;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::features::{Features, Frozen};
use super::pool::{max_pool, rectified_pool_gradient};
use super::tensors::PerceptualTensors;
use super::weights::Source;
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::kernels::Shape;

/// Outputs of the convolutions of each of VGG-19's five resolutions, between which it pools.
const STAGES: [&[usize]; 5] =
    [&[64, 64], &[128, 128], &[256, 256, 256, 256], &[512, 512, 512, 512], &[512, 512, 512, 512]];

/// Mean and standard deviation of the images that the network was trained with.
pub(super) const MEAN: [f32; CHANNELS] = [0.485, 0.456, 0.406];
pub(super) const DEVIATION: [f32; CHANNELS] = [0.229, 0.224, 0.225];

/// Sides below this do not survive four halvings.
const SHORTEST_SIDE: usize = 16;

const SOURCE: Source = Source {
    network: "VGG-19",
    origin: "torchvision's, https://download.pytorch.org/models/vgg19-dcbb9e9d.pth, or a .safetensors file of the \
             same tensors (features.0.weight [64, 3, 3, 3], features.0.bias [64], … up to features.34)",
};

/// How features are compared; always the mean over all of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureDistance {
    /// The squared difference (the paper's text).
    #[default]
    SquaredL2,
    /// The absolute difference (the published code).
    L1,
}

impl FeatureDistance {
    /// The mean distance and its gradient to `features`.
    fn measure(self, features: &Features, target: &Features) -> (f64, Features) {
        #[expect(clippy::cast_precision_loss, reason = "counts of features are far below 2²⁴")]
        let count = features.values.len() as f32;
        let mut sum = 0.0;
        let slope = |(a, b): (&f32, &f32)| {
            let difference = a - b;
            match self {
                Self::SquaredL2 => {
                    sum += f64::from(difference) * f64::from(difference);
                    2.0 * difference / count
                }
                Self::L1 => {
                    sum += f64::from(difference.abs());
                    if difference == 0.0 { 0.0 } else { difference.signum() / count }
                }
            }
        };
        let values = features.values.iter().zip(&target.values).map(slope).collect();
        (sum / f64::from(count), Features { values, shape: features.shape })
    }
}

/// VGG-19 up to conv5_4, before its rectifier.
///
/// # Memory
/// The weights are packed for both directions: about 0.7 GB.
pub struct PerceptualLoss {
    /// The convolutions of each resolution.
    stages: Vec<Vec<Frozen>>,
    distance: FeatureDistance,
}

impl std::fmt::Debug for PerceptualLoss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PerceptualLoss").field("distance", &self.distance).finish_non_exhaustive()
    }
}

impl PerceptualLoss {
    /// Reads VGG-19's weights (`.pth` or `.safetensors`, torchvision's names; the classifier is not needed).
    ///
    /// # Errors
    /// [`Error::Format`] when the file is missing, damaged or another network's, saying what it should be.
    ///
    /// # Panics
    /// Never: a file that was read has every tensor.
    pub fn load(path: &Path, distance: FeatureDistance) -> Result<Self> {
        Ok(Self::of_convolutions(&read_convolutions(path)?, distance))
    }

    /// The same on a device, in Burn's operations.
    ///
    /// # Errors
    /// Those of [`load`](Self::load).
    pub fn load_tensors(
        path: &Path,
        distance: FeatureDistance,
        device: &Device,
    ) -> Result<PerceptualTensors> {
        Ok(PerceptualTensors::new(&read_convolutions(path)?, distance, device))
    }

    /// A network of convolutions, stage by stage: weights `[outputs, inputs, 3, 3]` and bias `[outputs]` of each.
    pub(crate) fn of_convolutions(stages: &[Vec<(Vec<f32>, Vec<f32>)>], distance: FeatureDistance) -> Self {
        let frozen = |(weight, bias): &(Vec<f32>, Vec<f32>)| Frozen::new(weight, bias);
        Self { stages: stages.iter().map(|stage| stage.iter().map(frozen).collect()).collect(), distance }
    }

    /// What the weight file should be, for messages.
    pub fn expected_file() -> String {
        SOURCE.describe()
    }

    /// The loss of a batch of tone-mapped images against the clean ones, and its gradient to them.
    ///
    /// # Shapes
    /// Both are `[items, 3, height, width]` in C order, `sides` being items, height and width; so is the gradient.
    ///
    /// # Errors
    /// [`Error::Shape`] when the images are shorter than 16 pixels.
    ///
    /// # Panics
    /// When the slices are not of these sides.
    pub fn value_and_gradient(
        &self,
        restored: &[f32],
        clean: &[f32],
        [items, height, width]: [usize; 3],
    ) -> Result<(f64, Vec<f32>)> {
        check_sides([height, width])?;
        let shape = Shape::new(items, height, width, CHANNELS);
        let scale = DEVIATION.map(f32::recip);
        let shift = std::array::from_fn(|c| -MEAN[c] / DEVIATION[c]);
        let input = |planes: &[f32]| Features::of_planes(planes, shape, scale, shift);
        let target = self.activations(input(clean)).pop().and_then(|mut stage| stage.pop());
        let target = target.expect("there are five stages");
        let activations = self.activations(input(restored));
        let features = activations.last().and_then(|stage| stage.last()).expect("there are five stages");
        let (value, gradient) = self.distance.measure(features, &target);
        Ok((value, self.take_back(&activations, gradient).to_planes(scale)))
    }

    /// What each resolution's convolutions read and finally give: one more than there are convolutions.
    fn activations(&self, input: Features) -> Vec<Vec<Features>> {
        let last = self.stages.len() - 1;
        let mut stages: Vec<Vec<Features>> = Vec::with_capacity(self.stages.len());
        for (s, stage) in self.stages.iter().enumerate() {
            let first = match stages.last().and_then(|before| before.last()) {
                Some(before) => max_pool(before, 2, 2),
                None => input.clone(),
            };
            let mut found = vec![first];
            for (c, layer) in stage.iter().enumerate() {
                let slope = if s == last && c == stage.len() - 1 { 1.0 } else { 0.0 };
                let next = found.last().expect("there is the first").convolve(&layer.forward, slope);
                found.push(next);
            }
            stages.push(found);
        }
        stages
    }

    /// Takes the gradient of conv5_4's output to that of the normalised image.
    fn take_back(&self, activations: &[Vec<Features>], mut gradient: Features) -> Features {
        for (s, (stage, found)) in self.stages.iter().zip(activations).enumerate().rev() {
            for (c, layer) in stage.iter().enumerate().rev() {
                gradient = layer.take_back(&gradient);
                if c > 0 {
                    rectify(&mut gradient, &found[c]);
                }
            }
            if s > 0 {
                let before = activations[s - 1].last().expect("every stage gives something");
                gradient = rectified_pool_gradient(before, &found[0], &gradient);
            }
        }
        gradient
    }
}

/// Refuses images that four halvings would leave nothing of.
pub(super) fn check_sides([height, width]: [usize; 2]) -> Result<()> {
    if height.min(width) < SHORTEST_SIDE {
        let expected = format!("at least {SHORTEST_SIDE} × {SHORTEST_SIDE} pixels");
        return Err(Error::shape("crop of the perceptual loss", expected, format!("{height} × {width}")));
    }
    Ok(())
}

/// Weight `[outputs, inputs, 3, 3]` and bias `[outputs]` of the convolutions of each resolution.
pub(super) type Convolutions = Vec<Vec<(Vec<f32>, Vec<f32>)>>;

fn read_convolutions(path: &Path) -> Result<Convolutions> {
    let mut tensors = SOURCE.read(path, &tensor_list())?.into_iter();
    let mut convolution = |_: &usize| {
        let [weight, bias] = [(); 2].map(|()| tensors.next().expect("two tensors for each convolution"));
        (weight, bias)
    };
    Ok(STAGES.iter().map(|outputs| outputs.iter().map(&mut convolution).collect()).collect())
}

/// Takes a gradient back through the ReLU that gave `output`.
fn rectify(gradient: &mut Features, output: &Features) {
    gradient.values.par_iter_mut().zip(&output.values).for_each(|(gradient, value)| {
        if *value <= 0.0 {
            *gradient = 0.0;
        }
    });
}

/// Names and shapes of weight and bias of every convolution; torchvision counts rectifiers and poolings too.
fn tensor_list() -> Vec<(String, Vec<usize>)> {
    let (mut index, mut inputs) = (0, CHANNELS);
    let mut list = Vec::new();
    for stage in STAGES {
        for &outputs in stage {
            list.push((format!("features.{index}.weight"), vec![outputs, inputs, 3, 3]));
            list.push((format!("features.{index}.bias"), vec![outputs]));
            (index, inputs) = (index + 2, outputs);
        }
        index += 1;
    }
    list
}
