//! Turns a configuration of DISCNet into the list of its layers: names, shapes, resolutions, and the counts
//! that follow from them.

use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;

/// Number of resolutions of the network; each has half the sides of the one before.
pub(super) const LEVELS: usize = 3;

/// Image sides must be multiples of this: two halvings.
pub(super) const SIDE_MULTIPLE: usize = 1 << (LEVELS - 1);

/// The family of networks that a model belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The dynamic skip connection network.
    #[default]
    Discnet,
}

/// What the filters of the skip connections are predicted from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// Nothing: plain skip connections, a U-Net (ablations a and b).
    None,
    /// The degraded image (ablation c).
    Image,
    /// The kernel code (ablation d).
    Psf,
    /// Both (ablations e and f).
    #[default]
    #[serde(rename = "image+psf")]
    ImagePsf,
}

impl Condition {
    /// Whether the network reads the degraded image to predict filters.
    pub fn uses_image(self) -> bool {
        matches!(self, Self::Image | Self::ImagePsf)
    }

    /// Whether the network needs a kernel code.
    pub fn uses_code(self) -> bool {
        matches!(self, Self::Psf | Self::ImagePsf)
    }
}

/// Which resolutions have dynamic skip connections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scales {
    /// The coarsest only.
    Single,
    /// All three.
    #[default]
    Multi,
}

/// A configuration of DISCNet; the default is the published network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Architecture {
    /// The family of networks.
    pub kind: Kind,
    /// n: channels of the finest scale; the next ones have 2n and 4n.
    pub features: usize,
    /// What the dynamic filters are predicted from.
    pub condition: Condition,
    /// Which scales have dynamic filters.
    pub scales: Scales,
    /// s: side of the dynamic filters.
    pub filter_size: usize,
    /// b: length of the kernel code.
    pub code_dim: usize,
}

impl Default for Architecture {
    /// n = 32, image and code, three scales, 5 × 5 filters, b = 5, as published.
    fn default() -> Self {
        Self {
            kind: Kind::Discnet,
            features: 32,
            condition: Condition::ImagePsf,
            scales: Scales::Multi,
            filter_size: 5,
            code_dim: 5,
        }
    }
}

/// One layer with weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layer {
    /// The released name, without `.weight` and `.bias`.
    pub(super) name: String,
    /// What it holds.
    pub(super) weights: LayerWeights,
    /// 0 for full resolution, 1 for half, 2 for a quarter: where its output is computed.
    pub(super) level: usize,
}

/// The weights of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LayerWeights {
    /// A convolution with bias; those inside residual blocks are initialised on their own terms.
    Convolution { inputs: usize, outputs: usize, size: usize, residual: bool },
    /// The one slope of a PReLU.
    Slope,
}

/// Name, shape and initial distribution of one weight tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TensorSpec {
    /// The released name.
    pub(super) name: String,
    /// The shape.
    pub(super) shape: Vec<usize>,
    /// The layer that it belongs to.
    pub(super) weights: LayerWeights,
}

impl Architecture {
    /// Checks that such a network can be built.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key that is out of range.
    pub fn validate(&self) -> Result<()> {
        if !(1..=1024).contains(&self.features) {
            let reason = format!("must be between 1 and 1024, found {}", self.features);
            return Err(Error::config("features", reason));
        }
        if ![3, 5, 7, 9].contains(&self.filter_size) {
            return Err(Error::config(
                "filter-size",
                format!("must be 3, 5, 7 or 9, found {}", self.filter_size),
            ));
        }
        if !(1..=1024).contains(&self.code_dim) {
            let reason = format!("must be between 1 and 1024, found {}", self.code_dim);
            return Err(Error::config("code-dim", reason));
        }
        Ok(())
    }

    /// The configuration as JSON, as files carry it.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).expect("architectures are plain data")
    }

    /// Number of trainable numbers.
    pub fn parameters(&self) -> u64 {
        self.tensors().iter().map(|tensor| tensor.shape.iter().product::<usize>() as u64).sum()
    }

    /// Multiply-accumulates of all convolutions for one image of `height` × `width`.
    ///
    /// Sides are rounded up to multiples of 4 as the network does. The application of the predicted filters
    /// (25 · 56 more a pixel for the published network) is not counted, as in the paper's figure.
    pub fn macs(&self, height: usize, width: usize) -> u64 {
        let pixels = |level: usize| {
            (height.next_multiple_of(SIDE_MULTIPLE) >> level)
                * (width.next_multiple_of(SIDE_MULTIPLE) >> level)
        };
        let of_layer = |layer: &Layer| match layer.weights {
            LayerWeights::Convolution { inputs, outputs, size, .. } => {
                (inputs * outputs * size * size) as u64 * pixels(layer.level) as u64
            }
            LayerWeights::Slope => 0,
        };
        self.layers().iter().map(of_layer).sum()
    }

    /// Channels at a level: n, 2n, 4n.
    pub(super) fn channels(&self, level: usize) -> usize {
        self.features << level
    }

    /// Channels that the condition encoder reads; `None` when there is no such encoder.
    pub(super) fn condition_channels(&self) -> Option<usize> {
        let image = if self.condition.uses_image() { CHANNELS } else { 0 };
        let code = if self.condition.uses_code() { self.code_dim } else { 0 };
        (image + code > 0).then_some(image + code)
    }

    /// Whether the skip connection of a level has dynamic filters.
    pub(super) fn has_filters(&self, level: usize) -> bool {
        self.condition != Condition::None && (self.scales == Scales::Multi || level == LEVELS - 1)
    }

    /// Every weight tensor under its released name, in a fixed order.
    pub(super) fn tensors(&self) -> Vec<TensorSpec> {
        let of_layer = |layer: Layer| {
            let weights = layer.weights;
            let tensor =
                |part: &str, shape| TensorSpec { name: format!("{}.{part}", layer.name), shape, weights };
            match weights {
                LayerWeights::Convolution { inputs, outputs, size, .. } => {
                    vec![tensor("weight", vec![outputs, inputs, size, size]), tensor("bias", vec![outputs])]
                }
                LayerWeights::Slope => vec![tensor("weight", vec![1])],
            }
        };
        self.layers().into_iter().flat_map(of_layer).collect()
    }

    /// Every layer with weights, in a fixed order.
    pub(super) fn layers(&self) -> Vec<Layer> {
        let mut list = LayerList(Vec::new());
        self.encoder(&mut list, "conv", CHANNELS);
        if let Some(inputs) = self.condition_channels() {
            self.encoder(&mut list, "kconv", inputs);
        }
        for level in (0..LEVELS).filter(|&level| self.has_filters(level)) {
            self.filter_generator(&mut list, level);
        }
        for level in (0..LEVELS - 1).rev() {
            let (fine, coarse, scale) = (self.channels(level), self.channels(level + 1), level + 1);
            list.convolution(format!("upconv_{scale}1.0"), [coarse, 4 * fine, 3], level + 1);
            list.res_block(&format!("upconv_{scale}2"), fine, level);
            list.res_block(&format!("upconv_{scale}3"), fine, level);
        }
        list.convolution("final_conv.0".to_owned(), [self.features, CHANNELS, 3], 0);
        list.0
    }

    fn encoder(&self, list: &mut LayerList, prefix: &str, inputs: usize) {
        for level in 0..LEVELS {
            let (channels, scale) = (self.channels(level), level + 1);
            let inputs = if level == 0 { inputs } else { self.channels(level - 1) };
            list.convolution(format!("{prefix}_{scale}1.0"), [inputs, channels, 3], level);
            list.res_block(&format!("{prefix}_{scale}2"), channels, level);
            list.res_block(&format!("{prefix}_{scale}3"), channels, level);
        }
    }

    fn filter_generator(&self, list: &mut LayerList, level: usize) {
        let (name, channels) = (filter_generator_name(level), self.channels(level));
        list.convolution(format!("{name}.0.0"), [channels, channels, 3], level);
        list.slope(format!("{name}.0.1"), level);
        list.res_block(&format!("{name}.1"), channels, level);
        list.res_block(&format!("{name}.2"), channels, level);
        let filters = channels * self.filter_size * self.filter_size;
        list.convolution(format!("{name}.3.0"), [channels, filters, 1], level);
        list.slope(format!("{name}.3.1"), level);
    }
}

/// The released name of a level's filter generator; the coarsest has no digit.
pub(super) fn filter_generator_name(level: usize) -> String {
    if level == LEVELS - 1 { "dynamic_kernel".to_owned() } else { format!("dynamic_kernel{}", level + 1) }
}

struct LayerList(Vec<Layer>);

impl LayerList {
    fn convolution(&mut self, name: String, [inputs, outputs, size]: [usize; 3], level: usize) {
        let weights = LayerWeights::Convolution { inputs, outputs, size, residual: false };
        self.0.push(Layer { name, weights, level });
    }

    fn res_block(&mut self, name: &str, channels: usize, level: usize) {
        let weights =
            LayerWeights::Convolution { inputs: channels, outputs: channels, size: 3, residual: true };
        for part in ["conv1", "conv2"] {
            self.0.push(Layer { name: format!("{name}.{part}"), weights, level });
        }
    }

    fn slope(&mut self, name: String, level: usize) {
        self.0.push(Layer { name, weights: LayerWeights::Slope, level });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(condition: Condition, scales: Scales, filter_size: usize) -> Architecture {
        Architecture { condition, scales, filter_size, ..Architecture::default() }
    }

    #[test]
    fn has_the_published_number_of_parameters() {
        assert_eq!(Architecture::default().parameters(), 3_804_617);
        let single = [(3, 3_179_141), (5, 3_443_333), (7, 3_839_621), (9, 4_368_005)];
        for (filter_size, expected) in single {
            assert_eq!(with(Condition::ImagePsf, Scales::Single, filter_size).parameters(), expected);
        }
        assert_eq!(with(Condition::None, Scales::Multi, 5).parameters(), 1_422_883);
    }

    /// The paper prints 364 "GFLOPs" for 800 × 800.
    #[test]
    fn has_the_published_number_of_multiply_accumulates() {
        assert_eq!(Architecture::default().macs(800, 800), 364_339_200_000);
        assert_eq!(Architecture::default().macs(797, 799), 364_339_200_000);
    }

    #[test]
    fn reads_kebab_case_and_refuses_unknown_keys() {
        let text = r#"{"kind":"discnet","condition":"image+psf","scales":"single","filter-size":7}"#;
        let architecture: Architecture = serde_json::from_str(text).unwrap();
        assert_eq!(architecture, with(Condition::ImagePsf, Scales::Single, 7));
        assert!(serde_json::from_str::<Architecture>(r#"{"filter_size":7}"#).is_err());
    }

    #[test]
    fn refuses_an_even_filter() {
        let message = with(Condition::ImagePsf, Scales::Multi, 4).validate().unwrap_err().to_string();
        assert!(message.contains("filter-size") && message.contains("found 4"), "{message}");
    }
}
