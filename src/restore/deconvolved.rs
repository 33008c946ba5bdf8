//! Restores a capture by inverting the convolution with its PSF.

use super::capture::{Capture, Restored};
use super::deconvolution::{
    DeconvolutionConfig, Method, Relieved, doubt_told_noise, invert, without_lamps_outside,
};
use super::highlights::blend_highlights;
use super::lamps::find_lamps;
use super::levels::{doubted_levels, find_levels_below, info_of, is_surpassed, reached_levels};
use super::restoration::Restoration;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::progress::Progress;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::io::AnyImage;

impl Restoration {
    /// Restores a capture that saturates at `saturation`, as far as is told of it.
    pub(super) fn restore_by_deconvolution(
        &self,
        config: &DeconvolutionConfig,
        capture: Capture,
        (curve, told): (ToneCurve, [f32; CHANNELS]),
        progress: &Progress,
    ) -> Result<Restored> {
        let Capture { image, info } = capture;
        let coding_error = info.as_ref().and_then(|info| info.coding_error);
        let most = image.curve().map(|own| own.x_max);
        let image: LinearImage = image.into_linear(curve);
        let is_joint = config.method == Method::Joint;
        let (mut saturation, mut levels, mut is_doubtful) = (told, None, true);
        let is_told = info.as_ref().is_some_and(|info| info.saturation.is_some());
        if self.asks_for_levels() && !is_told {
            let (found, count) = find_levels_below(&image, curve, most);
            match count {
                // Above all that there is.
                0 => saturation = found,
                _ if is_joint => (saturation, levels) = (found, Some(found)),
                // Light above what is usual is no light that is unknown.
                _ => saturation = std::array::from_fn(|channel| saturation[channel].max(found[channel])),
            }
            is_doubtful = count > 0 && levels.is_none();
        }
        let doubted = match is_doubtful && config.knows_saturated() {
            true => doubted_levels(&image, saturation),
            false => None,
        };
        let known = ToneCurve { x_max: saturation.into_iter().fold(0.0, f32::max), ..curve };
        let alpha = self.curve_of(known, &image, is_told).alpha;
        let config = DeconvolutionConfig { saturation, alpha, coding_error, ..*config };
        let psf = self.kernel().needed_psf()?;
        let doubted_noise = doubt_told_noise(&image, psf, &config, [image.height(), image.width()])?;
        let relieved = match is_joint {
            true => without_lamps_outside(&image, psf, &config, progress)?,
            false => None,
        };
        let (seen, lamps_outside) = match &relieved {
            Some(Relieved { image, lamps }) => (image, lamps.clone()),
            None => (&image, Vec::new()),
        };
        let restored = invert(seen, psf, &config, progress)?;
        let lamps = if is_joint { find_lamps(seen, &restored, saturation) } else { Vec::new() };
        let level = saturation.map(saturated_from);
        let restored = blend_highlights(restored, &image, level, self.highlights())?;
        let shines_above = is_joint && is_surpassed(saturation, &restored);
        let info = info_of(info, levels, shines_above);
        // No light that the capture may hold is cut off.
        let curve = ToneCurve { x_max: curve.x_max.max(known.x_max), ..curve };
        let levels = levels.map(|levels| reached_levels(&image, levels));
        let restored = Restored::new(AnyImage::Linear(restored), info, curve).with_alpha(alpha);
        Ok(Restored { lamps, lamps_outside, levels, doubted_levels: doubted, doubted_noise, ..restored })
    }
}
