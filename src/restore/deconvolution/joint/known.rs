//! What a capture tells of one of its channels before a scene is looked for: its brightness, its noise, the light of its lamps.

use ndarray::{Array2, ArrayView2};

use super::super::DeconvolutionConfig;
use super::frame::Frame;
use super::lamps::{Light, Saturated};
use super::noise_level::NoiseLevel;
use super::smooth::local_mean;
use crate::core::error::Result;
use crate::core::progress::Progress;
use crate::core::saturation::saturated_from;

/// Standard deviation of the bell that local brightness is taken over, in pixels: wide enough to commute with the core of a
/// PSF, narrow enough to tell a window from its wall.
pub(super) const NEAR_PX: f32 = 4.0;

/// The local mean of light, and α.
pub(super) fn local_brightness(light: &Array2<f32>, alpha: f32) -> Array2<f32> {
    let mut brightness = local_mean(light, NEAR_PX);
    brightness.par_mapv_inplace(|mean| mean + alpha);
    brightness
}

/// What is known of a channel from without.
#[derive(Clone, Copy)]
pub(super) struct Known<'a> {
    /// y, of the frame's size.
    pub(super) capture: ArrayView2<'a, f32>,
    pub(super) psf: ArrayView2<'a, f32>,
    /// Which channel it is.
    pub(super) channel: usize,
    pub(super) config: &'a DeconvolutionConfig,
    /// Whether pixels beside saturated ones may have been interpolated from them.
    pub(super) is_guarded: bool,
    /// Whether pixels are the means of blocks.
    pub(super) is_reduced: bool,
}

impl<'a> Known<'a> {
    /// The light at which pixels are saturated.
    pub(super) fn level(&self) -> f32 {
        self.config.saturation[self.channel]
    }

    /// Whether any pixel is saturated.
    pub(super) fn is_saturated(&self) -> bool {
        let from = saturated_from(self.level());
        self.capture.iter().any(|y| *y >= from)
    }

    /// D: the local brightness of the capture, which is `surrounded`.
    pub(super) fn brightness(&self, surrounded: &Array2<f32>) -> Array2<f32> {
        local_brightness(surrounded, self.config.alpha)
    }

    /// The channel's saturated `pixels`.
    pub(super) fn saturated<'p>(&self, frame: &'p Frame, pixels: &'p Array2<bool>) -> Saturated<'p>
    where
        'a: 'p,
    {
        Saturated { frame, capture: self.capture, psf: self.psf, pixels, level: self.level() }
    }

    /// Finds the light of the pixels that are saturated, if there are any, of which `saturated` has those of each colour, after a `coarse`
    /// scene at half the resolution where there is one.
    pub(super) fn find_light(
        &self,
        frame: &Frame,
        (saturated, coarse): (&[Array2<bool>], Option<ArrayView2<'_, f32>>),
        progress: &Progress,
    ) -> Result<Option<Light>> {
        let pixels = &saturated[self.channel];
        if !pixels.iter().any(|saturated| *saturated) {
            return Ok(None);
        }
        let brightness = self.brightness(&frame.surround(self.capture));
        let known = (frame.cut(&brightness), saturated);
        self.saturated(frame, pixels).light(known, (coarse, self.is_reduced), progress).map(Some)
    }

    /// The noise of the channel alone; `left` are the parts of the scene's detail that the PSF leaves.
    pub(super) fn noise_level(&self, left: [f64; 3]) -> NoiseLevel {
        let known = (self.config.alpha, saturated_from(self.level()));
        match &self.config.noise {
            Some(curve) => NoiseLevel::told(self.capture, known, |light| curve.at(self.channel, light)),
            None => NoiseLevel::estimate(self.capture, known, left),
        }
    }

    /// That noise, but no less than this deviation of the channel's light anywhere.
    pub(super) fn noise_level_with(&self, noise: &NoiseLevel, least: impl Fn(f32) -> f32) -> NoiseLevel {
        let known = (self.config.alpha, saturated_from(self.level()));
        NoiseLevel::told(self.capture, known, least).or_more(noise)
    }
}
