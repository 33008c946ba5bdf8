//! Tells the parts of a degraded scene apart: what saturates, where the formation spread light to, the rest.

use std::collections::BTreeMap;

use ndarray::{Array2, Axis, s};
use serde::{Deserialize, Serialize};

use crate::core::image::{CHANNELS, LinearImage};
use crate::core::metrics::Mask;
use crate::core::saturation::{SATURATED_SHARE, saturated_from};
use crate::core::tone::ToneCurve;

/// Light that counts as much, relative to what was there and α.
const FLARE_SHARE: f32 = 0.25;

/// Pixels on each side over which the core of a PSF blurs: light that moves within is no flare.
const BLUR_REACH: usize = 7;

/// The irradiance of a lit surface at most; what is brighter is a light source.
const WHITE: f32 = 1.0;

/// A part of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Region {
    /// A channel of the clean or the degraded image is saturated.
    Highlights,
    /// No highlight, and much brighter in the degraded image than blurred surfaces nearby could make it.
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

    /// The definitions in words, by name; that of `pooling` says how pixels are put together.
    pub fn definitions() -> BTreeMap<String, String> {
        let highlights =
            format!("any channel of the clean or the degraded image at {SATURATED_SHARE}·x_max or above");
        let flare = format!(
            "no highlight, and d − b > {FLARE_SHARE}·(b + α), with c and d the means of the channels of the clean \
             and the degraded image, linear, and b the larger of c and the mean of min(c, {WHITE}) over \
             {0} × {0} pixels",
            2 * BLUR_REACH + 1
        );
        let pooling = "PSNR is that of the mean squared error, SSIM the mean index, over all pixels of the region in \
                       all images; SSIM counts a window by its middle pixel";
        [
            (Self::Highlights.name(), highlights),
            (Self::Flare.name(), flare),
            (Self::Rest.name(), "every other pixel".to_owned()),
            ("pooling", pooling.to_owned()),
        ]
        .map(|(name, definition)| (name.to_owned(), definition))
        .into()
    }
}

impl Regions {
    /// Divides the pixels of a scene by its clean and its degraded image, linear.
    ///
    /// # Equation
    /// A pixel is a highlight where any channel of either is ≥ 0.99·x_max; flare where it is none and
    /// `d − b > 0.25·(b + α)`, with c and d the means over the channels of the clean and the degraded image, and
    /// b the larger of c and the mean of `min(c, 1)` over 15 × 15 pixels around. So the blur of surfaces does not
    /// count as flare, and neither does, by α, the irradiance that is shown as one half, a little light in
    /// darkness.
    ///
    /// # Panics
    /// When the images differ in size.
    pub fn divide(clean: &LinearImage, degraded: &LinearImage, curve: ToneCurve) -> Self {
        assert_eq!(clean.planes().dim(), degraded.planes().dim(), "regions need images of one size");
        let saturated = saturated_from(curve.x_max);
        let is_highlight = |(y, x): (usize, usize)| {
            let pixels = [clean, degraded].map(|image| image.planes().slice_move(s![.., y, x]));
            pixels.iter().flatten().any(|value| *value >= saturated)
        };
        let [clean_mean, degraded_mean] = [clean, degraded].map(mean_of_channels);
        let nearby = box_mean(&clean_mean.mapv(|c| c.min(WHITE)), BLUR_REACH);
        let region = |at: (usize, usize)| {
            let blurred = clean_mean[at].max(nearby[at]);
            let added = degraded_mean[at] - blurred;
            match (is_highlight(at), added > FLARE_SHARE * (blurred + curve.alpha)) {
                (true, _) => Region::Highlights,
                (false, true) => Region::Flare,
                (false, false) => Region::Rest,
            }
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

fn mean_of_channels(image: &LinearImage) -> Array2<f32> {
    #[expect(clippy::cast_precision_loss, reason = "three channels")]
    let sum = image.planes().sum_axis(Axis(0)) / CHANNELS as f32;
    sum
}

/// The mean over the pixels at most `reach` away in rows and columns, as far as there are any.
fn box_mean(values: &Array2<f32>, reach: usize) -> Array2<f32> {
    let (height, width) = values.dim();
    // Entry (y, x) is the sum of all values above and left of it.
    let mut sums = Array2::<f64>::zeros((height + 1, width + 1));
    for ((y, x), value) in values.indexed_iter() {
        sums[[y + 1, x + 1]] = f64::from(*value) + sums[[y, x + 1]] + sums[[y + 1, x]] - sums[[y, x]];
    }
    Array2::from_shape_fn((height, width), |(y, x)| {
        let (top, bottom) = (y.saturating_sub(reach), height.min(y + reach + 1));
        let (left, right) = (x.saturating_sub(reach), width.min(x + reach + 1));
        let sum = sums[[bottom, right]] - sums[[top, right]] - sums[[bottom, left]] + sums[[top, left]];
        #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "a mean of f32")]
        let mean = (sum / ((bottom - top) * (right - left)) as f64) as f32;
        mean
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn row(width: usize, values: &[(usize, f32)]) -> LinearImage {
        let value = |x| values.iter().find(|(at, _)| *at == x).map_or(0.05, |(_, value)| *value);
        LinearImage::from_planes(Array3::from_shape_fn((3, 1, width), |(_, _, x)| value(x))).unwrap()
    }

    #[test]
    fn every_pixel_has_its_region() {
        // A lamp, its light spread to the dark, a bright wall that gains little, darkness that gains little, a
        // highlight that the panel dims.
        let clean = row(70, &[(0, 600.0), (30, 10.0), (60, 498.0)]);
        let degraded = row(70, &[(0, 500.0), (15, 0.4), (30, 11.0), (45, 0.1), (60, 300.0)]);
        let regions = Regions::divide(&clean, &degraded, ToneCurve::default());
        let expected = [(0, Region::Highlights), (15, Region::Flare), (30, Region::Rest), (45, Region::Rest)];
        expected.into_iter().for_each(|(x, region)| assert_eq!(regions.0[[0, x]], region, "{x}"));
        assert_eq!(Region::ALL.map(|region| regions.count(region)), [2, 1, 67]);
        assert!(regions.mask(Region::Flare)[[0, 15]] && !regions.mask(Region::Flare)[[0, 0]]);
    }

    /// Stripes of black and white that become grey brighten by more than flare would, of their own light.
    #[test]
    fn blur_is_no_flare() {
        let stripes: Vec<(usize, f32)> = (0..40).map(|x| (x, (x % 2) as f32)).collect();
        let grey: Vec<(usize, f32)> = (0..40).map(|x| (x, 0.5)).collect();
        let regions = Regions::divide(&row(40, &stripes), &row(40, &grey), ToneCurve::default());
        assert_eq!(regions.count(Region::Rest), 40);
    }

    #[test]
    fn box_means_are_those_of_the_pixels_there_are() {
        let values = Array2::from_shape_fn((5, 6), |(y, x)| (y * y + 3 * x) as f32);
        let means = box_mean(&values, 2);
        for ((y, x), mean) in means.indexed_iter() {
            let near = values.indexed_iter().filter(|((v, u), _)| v.abs_diff(y) <= 2 && u.abs_diff(x) <= 2);
            let near: Vec<f32> = near.map(|(_, value)| *value).collect();
            assert!((mean - near.iter().sum::<f32>() / near.len() as f32).abs() < 1e-5, "{y} {x}");
        }
    }

    #[test]
    fn one_saturated_channel_makes_a_highlight() {
        let mut planes = Array3::zeros((3, 1, 1));
        planes[[2, 0, 0]] = 500.0;
        let clean = LinearImage::from_planes(planes).unwrap();
        let regions = Regions::divide(&clean, &row(1, &[]), ToneCurve::default());
        assert_eq!(regions.count(Region::Highlights), 1);
    }
}
