//! What is compared and how it scored: methods, labels, the metrics of one image, images left out.

use serde::{Deserialize, Serialize};

use super::regions::Region;
use crate::core::error::{Error, Result};
use crate::core::metrics::{Measure, Metric, Pool};

/// The side of the image that tables give the cost of a network for, as the paper does.
const PUBLISHED_SIDE: usize = 800;

/// One of the things that are compared: a model, a method, or the degraded image itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct ComparedMethod {
    /// Its name in tables.
    pub name: String,
    /// Whether it stands for "nothing was done", to compare with.
    pub baseline: bool,
    /// The dataset that it was measured on, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// What it costs, where that is counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<Cost>,
}

/// What a network costs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Cost {
    /// Number of its weights.
    pub parameters: u64,
    /// Multiply-accumulates for an image of 800 × 800, in 10⁹.
    #[serde(rename = "gmac-800x800")]
    pub gmac_published: f64,
    /// Multiply-accumulates for an image that was measured, their mean over all of them, in 10⁹.
    pub gmac_evaluated: f64,
}

/// What a sample is called in tables.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Label {
    /// The scene.
    pub id: String,
    /// The kernel that degraded it, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kernel: Option<String>,
    /// The rotation of that kernel, where it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle_deg: Option<f64>,
}

/// The metrics of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Score {
    /// The image.
    pub label: Label,
    /// Index of the method that made it.
    pub method: usize,
    /// One value a metric.
    pub values: Vec<f64>,
    /// The metrics of its parts, where they were asked for.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub regions: Vec<RegionScore>,
}

/// The metrics of a part of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct RegionScore {
    /// Which part.
    pub region: Region,
    /// How many pixels it has.
    pub pixels: usize,
    /// What each metric that is a mean over pixels averages.
    pub pools: Vec<Pool>,
}

/// An image that could not be measured, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exclusion {
    /// The dataset, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// The scene.
    pub id: String,
    /// The kernel, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kernel: Option<String>,
    /// What was wrong.
    pub reason: String,
}

impl ComparedMethod {
    /// A method that restores.
    pub fn restored(name: impl Into<String>) -> Self {
        Self { name: name.into(), baseline: false, dataset: None, cost: None }
    }

    /// What nothing was done to.
    pub fn baseline(name: impl Into<String>) -> Self {
        Self { baseline: true, ..Self::restored(name) }
    }
}

impl Cost {
    /// Counts a network's cost; `macs` tells the multiply-accumulates for an image of a height and a width, of
    /// which `sizes` counts those that were measured.
    #[expect(clippy::cast_precision_loss, reason = "a figure of few digits")]
    pub fn of(parameters: u64, sizes: &[([usize; 2], usize)], macs: impl Fn(usize, usize) -> u64) -> Self {
        let giga = |[height, width]: [usize; 2]| macs(height, width) as f64 / 1e9;
        let images: usize = sizes.iter().map(|(_, count)| count).sum();
        let sum: f64 = sizes.iter().map(|(size, count)| giga(*size) * *count as f64).sum();
        let gmac_published = giga([PUBLISHED_SIDE; 2]);
        Self { parameters, gmac_published, gmac_evaluated: sum / images as f64 }
    }
}

/// The multiply-accumulates of a network: what its [`Cost`] is made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) struct MacCounts {
    pub(super) parameters: u64,
    /// By height and width.
    pub(super) macs: Vec<([usize; 2], u64)>,
}

impl MacCounts {
    /// Counts them for images of these sizes, and for what tables give the cost for.
    pub(super) fn of(
        parameters: u64,
        sizes: &[([usize; 2], usize)],
        macs: impl Fn(usize, usize) -> u64,
    ) -> Self {
        let sizes = sizes.iter().map(|(size, _)| *size).chain([[PUBLISHED_SIDE; 2]]);
        Self {
            parameters,
            macs: sizes.map(|[height, width]| ([height, width], macs(height, width))).collect(),
        }
    }

    /// Adds what was counted of the same network for more sizes.
    pub(super) fn add(&mut self, other: Self) {
        for (size, macs) in other.macs {
            if self.count(size).is_none() {
                self.macs.push((size, macs));
            }
        }
    }

    fn count(&self, size: [usize; 2]) -> Option<u64> {
        self.macs.iter().find(|(known, _)| *known == size).map(|(_, macs)| *macs)
    }

    /// The cost of images of these sizes.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when one of them was not counted.
    pub(super) fn cost(&self, sizes: &[([usize; 2], usize)]) -> Result<Cost> {
        let count = |size: [usize; 2]| self.count(size);
        if let Some((size, _)) = sizes.iter().find(|(size, _)| count(*size).is_none()) {
            let reason = format!("the cost of images of {size:?} pixels was not counted");
            return Err(Error::Unsupported(reason));
        }
        Ok(Cost::of(self.parameters, sizes, |height, width| count([height, width]).unwrap_or_default()))
    }
}

impl Label {
    /// A scene of which no kernel is known.
    pub fn scene(id: impl Into<String>) -> Self {
        Self { id: id.into(), kernel: None, angle_deg: None }
    }
}

impl std::fmt::Display for Label {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.kernel {
            Some(kernel) => write!(f, "{} through {kernel}", self.id),
            None => f.write_str(&self.id),
        }
    }
}

/// Those of the metrics that can be taken over parts of an image.
pub(super) fn pixelwise(measures: &[Measure]) -> Vec<Metric> {
    let metrics = measures.iter().map(Measure::metric);
    metrics.filter(|metric| Metric::PIXELWISE.contains(metric)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_the_cost_over_the_images_that_were_measured() {
        let sizes = [([1000, 1000], 3), ([1000, 2000], 1)];
        let cost = Cost::of(7, &sizes, |height, width| (height * width) as u64 * 1000);
        assert_eq!((cost.parameters, cost.gmac_published, cost.gmac_evaluated), (7, 0.64, 1.25));
    }
}
