//! Describes an image: how it is stored and where its values lie.

mod text;

use std::path::Path;

use ndarray::{Array3, Axis};
use serde::Serialize;

use crate::core::capture::CaptureInfo;
use crate::core::error::Result;
use crate::core::provenance::Provenance;
use crate::io::{ColorTag, DomainTag, Encoding, ImageLayer, Pixels, RawMetadata, inspect_image, read_layers};

/// An image file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImageDescription {
    /// The file format.
    pub format: &'static str,
    /// The stored sample type.
    pub sample_type: String,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// What else can be read of the file, where it has several layers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<ImageLayer>,
    /// The domain that the file declares.
    pub domain: Option<&'static str>,
    /// What the file says of its colours, which changes no value.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub color_tags: Vec<ColorTag>,
    /// The exposure time that the file declares.
    pub exposure_s: Option<f64>,
    /// The sensitivity (ISO) that the file declares.
    pub iso: Option<f64>,
    /// What a camera's raw file says of its values.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub raw: Option<Box<RawMetadata>>,
    /// What the file says of the capture that it was made of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capture: Option<Box<CaptureInfo>>,
    /// What the file says and reading it does not heed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub doubts: Vec<String>,
    /// Number of values that are NaN or infinite.
    pub non_finite: usize,
    /// Number of values below zero.
    pub negative: usize,
    /// One entry a channel.
    pub channels: Vec<Statistics>,
    /// The provenance that the file carries.
    pub provenance: Option<Provenance>,
}

/// Where the finite values of one channel lie.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// The smallest value.
    pub min: f32,
    /// The value that 1 % of the pixels stay below.
    pub percentile_1: f32,
    /// The value that half of the pixels stay below.
    pub median: f32,
    /// The value that 99 % of the pixels stay below.
    pub percentile_99: f32,
    /// The value that 99.9 % of the pixels stay below.
    pub percentile_99_9: f32,
    /// The largest value.
    pub max: f32,
    /// The mean.
    pub mean: f64,
}

impl ImageDescription {
    /// Describes the image that a file holds.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let (pixels, encoding) = inspect_image(path)?;
        let layers = read_layers(path)?;
        let layers = if layers.len() > 1 { layers } else { Vec::new() };
        Ok(Self { layers, ..Self::new(pixels, encoding) })
    }

    /// Describes what was read of a file.
    pub(super) fn new(pixels: Pixels, encoding: Encoding) -> Self {
        let (_, height, width) = pixels.planes.dim();
        Self {
            doubts: pixels.all_doubts(),
            format: encoding.format.name(),
            sample_type: encoding.sample_type,
            width,
            height,
            layers: Vec::new(),
            domain: pixels.domain.map(DomainTag::name),
            color_tags: pixels.color_tags,
            exposure_s: pixels.exposure_s,
            iso: pixels.iso,
            raw: pixels.raw.map(Box::new),
            capture: pixels.capture.map(Box::new),
            non_finite: pixels.planes.iter().filter(|value| !value.is_finite()).count(),
            negative: pixels.planes.iter().filter(|value| **value < 0.0).count(),
            channels: channel_statistics(&pixels.planes),
            provenance: pixels.provenance,
        }
    }
}

/// Channel sums this close to one are those of a PSF, whose half floats are off by 2⁻¹¹ at most.
const PSF_SUM_TOLERANCE: f64 = 1.0 / (1 << 11) as f64;

impl ImageDescription {
    /// Whether it is a PSF as this program writes them: three channels of unit sum, nothing of which is negative.
    pub fn is_likely_psf(&self) -> bool {
        let pixels = (self.width * self.height) as f64;
        let sums_to_one = |mean: f64| (mean * pixels - 1.0).abs() < PSF_SUM_TOLERANCE;
        let is_energy = self.negative == 0 && self.non_finite == 0;
        self.channels.len() == 3 && is_energy && self.channels.iter().all(|channel| sums_to_one(channel.mean))
    }
}

fn channel_statistics(planes: &Array3<f32>) -> Vec<Statistics> {
    planes.axis_iter(Axis(0)).map(|plane| statistics(plane.iter().copied())).collect()
}

/// Statistics of the finite ones among values; all NaN when there is none.
fn statistics(values: impl Iterator<Item = f32>) -> Statistics {
    let mut values: Vec<f32> = values.filter(|value| value.is_finite()).collect();
    let mean = values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
    values.sort_unstable_by(f32::total_cmp);
    let at_permille = |permille: usize| match values.len() {
        0 => f32::NAN,
        length => values[(length - 1) * permille / 1000],
    };
    Statistics {
        min: at_permille(0),
        percentile_1: at_permille(10),
        median: at_permille(500),
        percentile_99: at_permille(990),
        percentile_99_9: at_permille(999),
        max: at_permille(1000),
        mean,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_skip_what_is_not_finite() {
        let values = (0..=1000).map(|i| i as f32).chain([f32::NAN, f32::INFINITY]);
        let found = statistics(values);
        assert_eq!((found.min, found.percentile_1, found.median), (0.0, 10.0, 500.0));
        assert_eq!((found.percentile_99, found.percentile_99_9, found.max), (990.0, 999.0, 1000.0));
        assert!((found.mean - 500.0).abs() < 1e-9);
    }
}
