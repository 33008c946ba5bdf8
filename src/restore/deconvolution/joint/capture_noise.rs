//! What a capture tells of its noise: how much of it there is in each channel, and what its finest detail is.

use rayon::prelude::*;

use super::super::DeconvolutionConfig;
use super::apart::{is_quantised, noise_apart};
use super::frame::Frame;
use super::interpolation::Finest;
use super::known::Known;
use super::noise_level::{NOISE_FREE, NoiseLevel};
use super::places::places_of;
use crate::core::error::Result;
use crate::core::fft::TransformPrecision;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;

/// What a capture tells of its noise, for windows of it whose scenes are solved for one by one.
#[derive(Clone, Debug)]
pub(in crate::restore) struct CaptureNoise {
    pub(super) levels: Vec<NoiseLevel>,
    pub(super) finest: Finest,
}

impl CaptureNoise {
    /// That of a capture which is solved for in windows of `[height, width]`.
    pub(in crate::restore::deconvolution) fn of(
        image: &LinearImage,
        psf: &Psf,
        config: &DeconvolutionConfig,
        window: [usize; 2],
    ) -> Result<Self> {
        let from = config.saturation.map(saturated_from);
        let finest = Finest::of(image, config.alpha, from);
        let known = |channel: usize| {
            let (capture, psf) = (image.channel(channel), psf.channel(channel));
            let is_interpolated = finest.is_interpolated;
            Known { capture, psf, channel, config, is_interpolated, is_reduced: false }
        };
        let frame =
            Frame::new(window, [psf.height(), psf.width()], config.border, TransformPrecision::Single);
        Ok(Self { levels: noise_levels(&frame, (image, config), known)?, finest })
    }

    /// The standard deviation of the noise of `log(capture + α)` in each channel, where it is of middling brightness.
    pub(in crate::restore) fn relative(&self) -> [f32; CHANNELS] {
        std::array::from_fn(|channel| self.levels[channel].middle())
    }

    /// Whether there is none, as in computed captures.
    pub(in crate::restore) fn is_clean(&self) -> bool {
        self.relative().iter().all(|sigma| *sigma <= NOISE_FREE)
    }
}

/// The noise of all channels, as seen through a PSF in a frame.
pub(super) fn noise_levels<'a>(
    frame: &Frame,
    (image, config): (&LinearImage, &DeconvolutionConfig),
    known: impl Fn(usize) -> Known<'a> + Sync,
) -> Result<Vec<NoiseLevel>> {
    let of_channel = |channel| Ok(frame.blur(known(channel).psf)?.parts_left());
    let left: Vec<_> = (0..CHANNELS).map(of_channel).collect::<Result<_>>()?;
    let of_channel = |channel: usize| known(channel).noise_level(left[channel]);
    let mut levels: Vec<_> = (0..CHANNELS).into_par_iter().map(of_channel).collect();
    if config.noise.is_none() {
        if NoiseLevel::hide(&levels) && is_quantised(image) {
            // The capture has noise, and detail as fine.
            let places = places_of(image, config.alpha, config.saturation.map(saturated_from));
            if let Some(apart) = noise_apart(&places, std::array::from_fn(|channel| left[channel])) {
                levels.iter_mut().zip(apart).for_each(|(level, noise)| *level = NoiseLevel::even(noise));
            }
        }
        NoiseLevel::agree(&mut levels);
    }
    Ok(levels)
}
