//! Solves for the scene of a capture that a network corrects.

use super::deconvolution::{
    CaptureNoise, LampOutside, Relieved, Solution, solve, solve_window, without_lamps_outside,
};
use super::lamps::light_of_lamps;
use super::planes::PlaneConfig;
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::progress::Progress;
use crate::core::psf::Psf;

/// The part of a scene's light from which on that of its lamps is much. Ten captures of leaves whose brightest pixels are clipped have up to
/// 0.1 %: limits on corrections gain them 0.5 to 3 dB. Of 21 others that change, three with up to 1.4 % gain, and of eighteen with 2 % and
/// more fourteen lose, up to 2.6.
const MUCH_LIGHT: f64 = 0.01;

/// What a deconvolution makes of a capture with a PSF.
pub(super) struct Solved {
    /// The capture without the flare of lamps outside of it, if there are any.
    pub(super) relieved: Option<LinearImage>,
    pub(super) lamps_outside: Vec<LampOutside>,
    /// Whether lamps throw much light over the frame, from in it or beyond.
    pub(super) has_flare: bool,
    pub(super) solution: Solution,
}

impl Solved {
    /// Of a capture, or of a window of one, whose noise is then that of all of it.
    pub(super) fn of(
        (image, psf): (&LinearImage, &Psf),
        (planes, has_none_outside): (&PlaneConfig, bool),
        noise: Option<&CaptureNoise>,
        progress: &Progress,
    ) -> Result<Self> {
        let config = planes.deconvolution();
        let relieved = match has_none_outside {
            true => None,
            false => without_lamps_outside(image, psf, &config, &progress.without_bars())?,
        };
        let (relieved, lamps_outside) = match relieved {
            Some(Relieved { image, lamps }) => (Some(image), lamps),
            None => (None, Vec::new()),
        };
        let image = relieved.as_ref().unwrap_or(image);
        let solution = match noise {
            Some(noise) => solve_window((image, psf), &config, noise, progress)?,
            None => solve(image, psf, &config, progress)?,
        };
        let above = light_of_lamps(image, &solution.scene, planes.saturation);
        let has_flare = !lamps_outside.is_empty() || is_much(above, &solution.scene);
        Ok(Self { relieved, lamps_outside, has_flare, solution })
    }

    /// The scene.
    pub(super) fn scene(&self) -> &LinearImage {
        &self.solution.scene
    }

    /// The sum of squares of what the scene leaves of the capture.
    pub(super) fn left(&self) -> f64 {
        self.solution.residual.iter().map(|left| f64::from(*left).powi(2)).sum()
    }
}

/// Whether so much light above what saturates is much of an image's.
pub(super) fn is_much(above: f64, image: &LinearImage) -> bool {
    let all: f64 = image.as_slice().iter().map(|light| f64::from(light.max(0.0))).sum();
    above > MUCH_LIGHT * all
}
