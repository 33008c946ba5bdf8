//! Tells the parts of a degraded scene apart: what saturates, where the formation spread light to, the rest.

use ndarray::Array2;
use serde_json::{Value, json};

use crate::core::image::{CHANNELS, LinearImage};
use crate::core::metrics::Mask;
use crate::core::tone::ToneCurve;

/// Share of x_max from which a value counts as saturated: noise and half floats leave it below x_max itself.
const SATURATED_SHARE: f32 = 0.99;

/// Light that counts as much, relative to what was there and α.
const FLARE_SHARE: f32 = 0.25;

/// A part of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Region {
    /// A channel of the clean or the degraded image is saturated.
    Highlights,
    /// No highlight, and the degraded image is much brighter than the clean one.
    Flare,
    /// Neither.
    Rest,
}

/// Which pixels of one image belong to which region; every pixel belongs to one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Regions(Array2<Region>);

impl Region {
    /// All regions, in the order of tables.
    pub const ALL: [Self; 3] = [Self::Highlights, Self::Flare, Self::Rest];

    /// The name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Highlights => "highlights",
            Self::Flare => "flare",
            Self::Rest => "rest",
        }
    }

    /// The definitions in words, by name.
    pub fn definitions() -> Value {
        json!({
            "highlights": format!("any channel of the clean or the degraded image at {SATURATED_SHARE}·x_max or above"),
            "flare": format!(
                "no highlight, and d − c > {FLARE_SHARE}·(c + α), with c and d the means of the channels of the clean \
                 and the degraded image, linear"
            ),
            "rest": "every other pixel",
            "pooling": "PSNR is that of the mean squared error, SSIM the mean index, over all pixels of the region in \
                        all images; SSIM counts a window by its middle pixel",
        })
    }
}

impl Regions {
    /// Divides the pixels of a scene by its clean and its degraded image, linear.
    ///
    /// # Equation
    /// A pixel is a highlight where any channel of either is ≥ 0.99·x_max; flare where it is none and
    /// `d − c > 0.25·(c + α)`, with c and d the means over the channels of the clean and the degraded image.
    /// α, the irradiance that the tone mapping shows as one half, keeps darkness from counting as flare.
    ///
    /// # Panics
    /// When the images differ in size.
    pub fn divide(clean: &LinearImage, degraded: &LinearImage, curve: ToneCurve) -> Self {
        assert_eq!(clean.planes().dim(), degraded.planes().dim(), "regions need images of one size");
        let saturated = SATURATED_SHARE * curve.x_max;
        let region = |(y, x): (usize, usize)| {
            let pixel = |image: &LinearImage| [0, 1, 2].map(|channel| image.planes()[[channel, y, x]]);
            let (clean, degraded) = (pixel(clean), pixel(degraded));
            if clean.into_iter().chain(degraded).any(|value| value >= saturated) {
                return Region::Highlights;
            }
            #[expect(clippy::cast_precision_loss, reason = "three channels")]
            let mean = |values: [f32; CHANNELS]| values.iter().sum::<f32>() / CHANNELS as f32;
            let (clean, degraded) = (mean(clean), mean(degraded));
            if degraded - clean > FLARE_SHARE * (clean + curve.alpha) { Region::Flare } else { Region::Rest }
        };
        Self(Array2::from_shape_fn((clean.height(), clean.width()), region))
    }

    /// The pixels of a region.
    pub fn mask(&self, region: Region) -> Mask {
        self.0.mapv(|found| found == region)
    }

    /// The number of pixels of a region.
    pub fn count(&self, region: Region) -> usize {
        self.0.iter().filter(|found| **found == region).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn grey(values: &[f32]) -> LinearImage {
        LinearImage::from_planes(Array3::from_shape_fn((3, 1, values.len()), |(_, _, x)| values[x])).unwrap()
    }

    #[test]
    fn every_pixel_has_its_region() {
        // A lamp, its spread light, a bright wall that gains little, darkness that gains little, a highlight
        // that the panel dims.
        let clean = grey(&[600.0, 0.1, 10.0, 0.0, 498.0]);
        let degraded = grey(&[500.0, 0.4, 11.0, 0.05, 300.0]);
        let regions = Regions::divide(&clean, &degraded, ToneCurve::default());
        let expected = [Region::Highlights, Region::Flare, Region::Rest, Region::Rest, Region::Highlights];
        assert_eq!(regions.0.as_slice().unwrap(), expected);
        assert_eq!(Region::ALL.map(|region| regions.count(region)), [2, 1, 2]);
        assert!(regions.mask(Region::Flare)[[0, 1]] && !regions.mask(Region::Flare)[[0, 0]]);
    }

    #[test]
    fn one_saturated_channel_makes_a_highlight() {
        let mut planes = Array3::zeros((3, 1, 1));
        planes[[2, 0, 0]] = 500.0;
        let clean = LinearImage::from_planes(planes).unwrap();
        let regions = Regions::divide(&clean, &grey(&[0.0]), ToneCurve::default());
        assert_eq!(regions.count(Region::Highlights), 1);
    }
}
