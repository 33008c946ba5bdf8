//! Says which images of a dataset were measured, and under which image formation.

use serde::{Deserialize, Serialize};

use crate::core::primaries::Primaries;
use crate::dataset::{Dataset, KernelChoice, Split};

/// The images of a dataset that were measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Measured {
    /// The dataset's name, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// α of the tone mapping of all its images.
    pub alpha: f32,
    /// x_max, at which they saturate.
    pub x_max: f32,
    /// The red, green and blue of its scenes, where these are others than those of sRGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub primaries: Option<Primaries>,
    /// Pixels by which its scenes were larger than the frame on each side.
    pub margin: usize,
    /// The part that was measured on.
    pub split: Split,
    /// The kernels whose images count: `"all"`, or their names.
    pub kernels: KernelChoice,
    /// At most the first so many images of these; null for all.
    pub limit: Option<usize>,
}

impl Measured {
    /// The images of `dataset` of a split and of the chosen kernels, the first `limit` of them.
    pub fn of(dataset: &Dataset, split: Split, kernels: KernelChoice, limit: Option<usize>) -> Self {
        let formation = &dataset.formation;
        let (alpha, x_max, margin) = (formation.alpha, formation.x_max, formation.margin);
        let primaries = dataset.scene_primaries();
        Self { dataset: None, alpha, x_max, primaries, margin, split, kernels, limit }
    }
}
