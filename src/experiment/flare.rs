//! Measures how much light the formation spreads over a scene: what a display in front of the lens adds.

use serde::{Deserialize, Serialize};

use super::regions::{Region, Regions};
use super::values::number;
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::metrics::{MetricDefinition, psnr};
use crate::core::tone::ToneCurve;

/// What the formation did to one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flare {
    /// Share of the pixels in the flare region.
    pub flare_share: f64,
    /// Share of the pixels in the highlight region.
    pub highlight_share: f64,
    /// The largest brightening of a value outside of highlights, tone-mapped: 1 is from black to white.
    pub largest_brightening: f64,
    /// PSNR of the degraded image, tone-mapped, in dB.
    #[serde(deserialize_with = "number")]
    pub psnr: f64,
}

impl Flare {
    /// Compares a degraded image with its clean one, both linear.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::core::error::Error::Shape) when they differ in size.
    pub fn measure(
        clean: &LinearImage,
        degraded: &LinearImage,
        curve: ToneCurve,
        definition: &MetricDefinition,
    ) -> Result<Self> {
        let shown = [clean, degraded].map(|image| curve.tone_map(image));
        let psnr = psnr(&shown[1], &shown[0], definition)?;
        let regions = Regions::divide(clean, degraded, curve);
        let highlights = regions.mask(Region::Highlights);
        let brightening = shown[1]
            .planes()
            .indexed_iter()
            .filter(|((_, y, x), _)| !highlights[[*y, *x]])
            .map(|(at, after)| after - shown[0].planes()[at])
            .fold(0.0, f32::max);
        #[expect(clippy::cast_precision_loss, reason = "images have far fewer than 2⁵³ pixels")]
        let share = |region| regions.count(region) as f64 / (clean.height() * clean.width()) as f64;
        Ok(Self {
            flare_share: share(Region::Flare),
            highlight_share: share(Region::Highlights),
            largest_brightening: f64::from(brightening),
            psnr,
        })
    }

    /// The mean of each number; none without any.
    pub fn mean<'a>(flares: impl Iterator<Item = &'a Self>) -> Option<Self> {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for flare in flares {
            sum.flare_share += flare.flare_share;
            sum.highlight_share += flare.highlight_share;
            sum.largest_brightening += flare.largest_brightening;
            sum.psnr += flare.psnr;
            count += 1.0;
        }
        let Self { flare_share, highlight_share, largest_brightening, psnr } = sum;
        (count > 0.0).then(|| Self {
            flare_share: flare_share / count,
            highlight_share: highlight_share / count,
            largest_brightening: largest_brightening / count,
            psnr: psnr / count,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn spread_light_is_measured_outside_of_the_lamp() {
        let image = |lamp: f32, spread: f32| {
            let value = |x| {
                if x == 0 {
                    lamp
                } else if x == 20 {
                    spread
                } else {
                    0.0
                }
            };
            LinearImage::from_planes(Array3::from_shape_fn((3, 1, 32), |(_, _, x)| value(x))).unwrap()
        };
        // φ brings 0.25 to one half: a black pixel that receives it brightens by one half.
        let (clean, degraded) = (image(500.0, 0.0), image(400.0, 0.25));
        let definition = MetricDefinition::float();
        let flare = Flare::measure(&clean, &degraded, ToneCurve::default(), &definition).unwrap();
        assert_eq!((flare.flare_share, flare.highlight_share), (1.0 / 32.0, 1.0 / 32.0));
        assert!((flare.largest_brightening - 0.5).abs() < 1e-6);
        let unchanged = Flare::measure(&clean, &clean, ToneCurve::default(), &definition).unwrap();
        assert_eq!((unchanged.flare_share, unchanged.largest_brightening), (0.0, 0.0));
        assert_eq!(Flare::mean([&flare, &unchanged].into_iter()).unwrap().flare_share, 1.0 / 64.0);
        assert_eq!(Flare::mean([].into_iter()), None);
    }
}
