//! What a network is configured by, and what follows from it: the list of its layers, the numbers of weights
//! and operations, the surroundings that a pixel depends on.

use serde::{Deserialize, Serialize};

use super::family::{Family, Kind};
use super::inputs::Plane;
use super::layers::{Layer, LayerWeights, TensorSpec};
use crate::core::error::{Error, Result};

/// The side of the image that descriptions give the cost of.
const DESCRIBED_SIDE: usize = 800;

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

/// A configuration of a network; the default is the published DISCNet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Architecture {
    /// The family of networks.
    pub kind: Kind,
    /// n: channels of the finest scale; coarser ones have 2n, 4n, …
    pub features: usize,
    /// What the dynamic filters are predicted from; for the other kinds, what the network reads.
    pub condition: Condition,
    /// Which scales have dynamic filters (DISCNet).
    pub scales: Scales,
    /// s: side of the dynamic filters (DISCNet).
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
        self.family().validate(self)
    }

    /// The configuration as JSON, as files carry it.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).expect("architectures are plain data")
    }

    /// The configuration and what it costs, a line each, for people to read; keys that this kind of network does
    /// not look at are left out.
    pub fn describe(&self) -> String {
        let json = self.to_json();
        let is_read = |key: &str| match key {
            "code-dim" => self.code_len().is_some(),
            key => self.family().reads_key(self, key),
        };
        let of_key = |(key, value): (&String, &serde_json::Value)| {
            let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            format!("  {key:<14}{text}")
        };
        let mut lines: Vec<String> =
            json.as_object().into_iter().flatten().filter(|(key, _)| is_read(key)).map(of_key).collect();
        if !self.planes().is_empty() {
            let planes: Vec<&str> = self.planes().iter().map(|plane| plane.name()).collect();
            lines.push(format!("  {:<14}image, {}", "reads", planes.join(", ")));
        }
        lines.push(format!("  {:<14}{}", "parameters", self.parameters()));
        #[expect(clippy::cast_precision_loss, reason = "a figure of five digits")]
        let macs = self.macs(DESCRIBED_SIDE, DESCRIBED_SIDE) as f64;
        let (gmac, kmac) = (macs / 1e9, macs / (DESCRIBED_SIDE * DESCRIBED_SIDE) as f64 / 1e3);
        lines.push(format!(
            "  {:<14}{gmac:.2} GMAC for {DESCRIBED_SIDE} × {DESCRIBED_SIDE} pixels, {kmac:.1} thousand each",
            "cost"
        ));
        lines.join("\n")
    }

    /// Number of trainable numbers.
    pub fn parameters(&self) -> u64 {
        self.tensors().iter().map(|tensor| tensor.shape.iter().product::<usize>() as u64).sum()
    }

    /// Multiply-accumulates of all convolutions for one image of `height` × `width`.
    ///
    /// Sides are rounded up as the network does. The application of the predicted filters
    /// (25 · 56 more a pixel for the published network) is not counted, as in the paper's figure.
    pub fn macs(&self, height: usize, width: usize) -> u64 {
        let multiple = self.side_multiple();
        let pixels = |level: usize| {
            (height.next_multiple_of(multiple) >> level) * (width.next_multiple_of(multiple) >> level)
        };
        let of_layer = |layer: &Layer| match layer.weights {
            LayerWeights::Convolution { inputs, outputs, size, .. } => {
                (inputs * outputs * size * size) as u64 * pixels(layer.level) as u64
            }
            LayerWeights::Slope => 0,
        };
        self.layers().iter().map(of_layer).sum()
    }

    /// What the sides that the network computes are multiples of: it halves its resolution so many times.
    /// Images of other sides are continued by repetition at the bottom and on the right.
    pub fn side_multiple(&self) -> usize {
        self.family().side_multiple()
    }

    /// Pixels around a tile, starting at a multiple of [`Self::side_multiple`], that its restoration may
    /// depend on, rounded up to such a multiple.
    pub fn halo(&self) -> usize {
        self.family().halo()
    }

    /// Length of the kernel codes that the network reads; `None` when it reads none.
    pub fn code_len(&self) -> Option<usize> {
        self.family().code_len(self)
    }

    /// Whether the network reads kernel codes.
    pub fn reads_code(&self) -> bool {
        self.code_len().is_some()
    }

    /// The planes that the network reads beside the image.
    pub fn planes(&self) -> &'static [Plane] {
        self.family().planes()
    }

    /// What the networks of this kind have in common.
    pub(super) fn family(&self) -> &'static dyn Family {
        self.kind.family()
    }

    /// Every weight tensor under its released name, in a fixed order.
    pub(super) fn tensors(&self) -> Vec<TensorSpec> {
        self.layers().into_iter().flat_map(Layer::tensors).collect()
    }

    /// Every layer with weights, in a fixed order.
    pub(super) fn layers(&self) -> Vec<Layer> {
        self.family().layers(self)
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

    /// The paper prints 1.49 M and 951, 3.85 M and 2460 (with an addition for each bias), 9.02 M and 169.
    #[test]
    fn the_networks_compared_with_have_the_published_size() {
        let of_kind = |kind, features, condition| {
            let architecture = Architecture { kind, features, condition, ..Architecture::default() };
            architecture.validate().unwrap();
            (architecture.parameters(), architecture.macs(800, 800))
        };
        assert_eq!(of_kind(Kind::Unet, 32, Condition::None).0, 1_422_883);
        assert_eq!(of_kind(Kind::Srmdnf, 128, Condition::ImagePsf), (1_488_643, 951_828_480_000));
        assert_eq!(of_kind(Kind::Sftmd, 64, Condition::ImagePsf), (3_844_227, 2_454_773_760_000));
        assert_eq!(of_kind(Kind::DeUnet, 32, Condition::Image), (9_019_459, 169_267_200_000));
    }

    #[test]
    fn a_condition_that_a_kind_does_not_read_is_refused() {
        let architecture = Architecture { kind: Kind::Unet, ..Architecture::default() };
        let message = architecture.validate().unwrap_err().to_string();
        assert!(message.contains("condition") && message.contains("\"none\""), "{message}");
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
