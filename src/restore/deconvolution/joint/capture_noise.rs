//! What a capture tells of its noise: how much of it there is in each channel, and what its finest detail is.

use std::fmt;

use rayon::prelude::*;

use super::super::DeconvolutionConfig;
use super::apart::{is_quantised, noise_apart, noise_below_detail};
use super::enlarged::noise_of_enlarged;
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

/// How many times as much noise as a capture shows, or as little, is that of light in other units: of 48 captures, what is told is 0.7
/// to 2.5 times what they show.
const OTHER_UNITS: f32 = 5.0;

/// The same of noise above what a capture shows that may be demosaiced, which hides a part of it.
const HIDDEN: f32 = 20.0;

/// The part of what a JPEG's quantisation may make wrong that counts as noise: most coefficients of high frequencies are less than a step.
const CODING_SHARE: f32 = 0.6;

/// Noise that is told, and the one that a capture shows, where they cannot be of the same units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DoubtedNoise {
    /// Standard deviations of the noise of `log(capture + α)` in middling brightness, of each channel.
    pub told: [f32; CHANNELS],
    /// As the capture shows it.
    pub shown: [f32; CHANNELS],
}

impl DoubtedNoise {
    /// Whether all of this noise is far above, or far below, what is shown.
    fn of(told: [f32; CHANNELS], shown: [f32; CHANNELS], is_interpolated: bool) -> Option<Self> {
        let times = |channel: usize| told[channel] / shown[channel].max(NOISE_FREE);
        let most = if is_interpolated { HIDDEN } else { OTHER_UNITS };
        let is_above = (0..CHANNELS).all(|channel| times(channel) > most);
        let is_below = (0..CHANNELS).all(|channel| times(channel) < 1.0 / OTHER_UNITS);
        (is_above || is_below).then_some(Self { told, shown })
    }
}

impl fmt::Display for DoubtedNoise {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [told, shown] = [self.told, self.shown].map(|noise| 100.0 * noise[1]);
        write!(
            f,
            "--noise tells {told:.2} % of green light, and the capture shows {shown:.2} %: gaussian:SIGMA counts the capture's own light, a \
             sensor's file light whose white is 1; tell the noise so, or leave --noise out"
        )
    }
}

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
            let is_guarded = finest.is_guarded;
            Known { capture, psf, channel, config, is_guarded, is_reduced: false }
        };
        let frame =
            Frame::new(window, [psf.height(), psf.width()], config.border, TransformPrecision::Single);
        Ok(Self { levels: noise_levels(&frame, (image, config), known)?, finest })
    }

    /// Doubts the noise that is told of a capture, if any is, where the capture shows quite another; it is solved for in windows of
    /// `[height, width]`.
    pub(in crate::restore::deconvolution) fn doubt(
        image: &LinearImage,
        psf: &Psf,
        config: &DeconvolutionConfig,
        window: [usize; 2],
    ) -> Result<Option<DoubtedNoise>> {
        if config.noise.is_none() {
            return Ok(None);
        }
        let told = Self::of(image, psf, config, window)?;
        let shown = Self::of(image, psf, &DeconvolutionConfig { noise: None, ..*config }, window)?;
        Ok(DoubtedNoise::of(told.relative(), shown.relative(), shown.finest.is_interpolated))
    }

    /// Whether the capture has no noise, as computed ones have none.
    pub(in crate::restore) fn is_clean(&self) -> bool {
        self.relative().iter().all(|sigma| *sigma <= NOISE_FREE)
    }

    /// The standard deviation of the noise of `log(capture + α)` in each channel, where it is of middling brightness.
    pub(in crate::restore) fn relative(&self) -> [f32; CHANNELS] {
        std::array::from_fn(|channel| self.levels[channel].middle())
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
        let from = config.saturation.map(saturated_from);
        if is_quantised(image) {
            // The capture has noise, and detail as fine.
            let places = places_of(image, config.alpha, from);
            let left = std::array::from_fn(|channel| left[channel]);
            let apart = match NoiseLevel::hide(&levels) {
                true => noise_apart(&places, left),
                false => noise_below_detail(&places, left, (image, config.alpha)),
            };
            set_all(&mut levels, apart);
        }
        if NoiseLevel::hide(&levels) {
            set_all(&mut levels, noise_of_enlarged(image, config.alpha, from));
        }
        NoiseLevel::agree(&mut levels);
        if let Some(errors) = config.coding_error {
            for (channel, (level, error)) in levels.iter_mut().zip(errors).enumerate() {
                *level = known(channel).noise_level_with(level, |light| deviation_of_coding(error, light));
            }
        }
    }
    Ok(levels)
}

/// Gives each channel this noise at any brightness, if any is told.
fn set_all(levels: &mut [NoiseLevel], noise: Option<[f32; CHANNELS]>) {
    for (level, noise) in levels.iter_mut().zip(noise.into_iter().flatten()) {
        *level = NoiseLevel::even(noise);
    }
}

/// The deviation of light that was encoded by the curve of sRGB with this error.
fn deviation_of_coding(error: f32, light: f32) -> f32 {
    /// Up to this light, the curve is straight.
    const STRAIGHT: f32 = 0.003_130_8;
    // The derivative of the curve's inverse: 2.4·((v + 0.055)/1.055)^1.4/1.055 where light is ((v + 0.055)/1.055)^2.4.
    let slope = if light <= STRAIGHT { 1.0 / 12.92 } else { 2.4 / 1.055 * light.powf(1.4 / 2.4) };
    CODING_SHARE * error * slope
}

#[cfg(test)]
mod tests {
    use super::super::super::Method;
    use super::*;
    use ndarray::Array3;

    /// A flat grey shows none, whatever the coding took of it.
    #[test]
    fn the_coding_of_a_jpeg_is_noise_that_it_hides() {
        let image = LinearImage::from_planes(Array3::from_elem((CHANNELS, 64, 64), 0.2)).unwrap();
        let psf = Psf::from_energy(Array3::ones((CHANNELS, 3, 3))).unwrap();
        let told = |coding_error| {
            let config =
                DeconvolutionConfig { coding_error, ..DeconvolutionConfig::of_method(Method::Joint) };
            CaptureNoise::of(&image, &psf, &config, [64, 64]).unwrap().relative()
        };
        assert!(told(None).iter().all(|noise| *noise <= NOISE_FREE));
        // Of values of 0.2, the curve of sRGB rises by 1 / 0.89.
        let [red, green, blue] = told(Some([0.02, 0.01, 0.02]));
        let expected = CODING_SHARE * 0.01 * 0.89 / (0.2 + 0.25);
        assert!((green / expected - 1.0).abs() < 0.02, "{green} {expected}");
        assert!((red / green - 2.0).abs() < 1e-3 && (blue / red - 1.0).abs() < 1e-3);
    }

    #[test]
    fn noise_of_other_units_is_doubted_and_no_other() {
        let doubt = |told: f32, is_interpolated| DoubtedNoise::of([told; 3], [0.01; 3], is_interpolated);
        assert!(doubt(0.03, false).is_none() && doubt(0.003, false).is_none());
        assert!(doubt(0.2, false).is_some() && doubt(0.0005, false).is_some());
        assert!(doubt(0.15, true).is_none() && doubt(0.3, true).is_some() && doubt(0.0005, true).is_some());
        assert!(DoubtedNoise::of([0.001; 3], [0.0; 3], false).is_none(), "too little to be seen");
    }
}
