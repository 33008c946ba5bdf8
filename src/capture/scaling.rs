//! Brings pictures to black = 0 and white = 1, and refuses values that their levels cannot explain.

use ndarray::{Array2, Array3};

use super::bayer::unpack;
use super::fuse::FuseConfig;
use crate::core::error::{Error, Result};

/// Brings the pictures to black = 0 and white = 1, mosaics to one plane.
pub(super) fn scaled_frames(pictures: Vec<Array3<f32>>, config: &FuseConfig) -> Result<Vec<Array3<f32>>> {
    let channels = pictures[0].dim().0;
    match (channels, config.bayer) {
        (3, None) | (1 | 4, Some(_)) => {}
        (3, Some(_)) => {
            let found = "3 channels of colour; leave the pattern out for pictures without mosaic";
            return Err(Error::shape("bracket with a Bayer pattern", "1 or 4 channels", found));
        }
        _ => {
            let grey = if channels == 1 {
                "; pictures of a monochrome camera are to have three equal channels"
            } else {
                ""
            };
            let reason =
                format!("pictures of {channels} channels are mosaics; say rggb, bggr, grbg or gbrg{grey}");
            return Err(Error::config("bayer", reason));
        }
    }
    let scale = 1.0 / (config.white - config.black);
    #[expect(clippy::cast_possible_truncation, reason = "pictures are kept in 32 bit")]
    let scaled = |value: f32| ((f64::from(value) - config.black) * scale) as f32;
    let frame = |planes: Array3<f32>| {
        let mut planes = if channels == 4 { unpack(planes.view()) } else { planes };
        planes.par_mapv_inplace(scaled);
        planes
    };
    Ok(pictures.into_iter().map(frame).collect())
}

/// Refuses values that are not finite; those that the mask discards become black until they are filled.
pub(super) fn check_finite(
    frames: &mut [Array3<f32>],
    valid: Option<&Array2<bool>>,
    numbers: &[usize],
) -> Result<()> {
    for (frame, number) in frames.iter_mut().zip(numbers) {
        for ((c, y, x), value) in frame.indexed_iter_mut().filter(|(_, value)| !value.is_finite()) {
            if valid.is_none_or(|valid| valid[[y, x]]) {
                return Err(Error::Unsupported(format!(
                    "picture {number} of the bracket holds {value} at row {y}, column {x}, channel {c}; replace such \
                     pixels by numbers, or discard them by a mask"
                )));
            }
            *value = 0.0;
        }
    }
    Ok(())
}

/// Values below black by this share of the range are not noise: a sensor's read noise is a tenth of that.
pub(super) const BELOW_BLACK: f32 = 0.01;

/// What a value that sits at black may read below it, as a share of the range between black and white: what 32 bits round,
/// and half a digital step of 16 bits, since black levels are often means and no integers.
fn rounding_of_black(config: &FuseConfig) -> f32 {
    const OF_FLOATS: f64 = 1.0 / 1_048_576.0;
    const HALF_A_STEP: f64 = 0.5 / 65535.0;
    #[expect(clippy::cast_possible_truncation, reason = "pictures are kept in 32 bit")]
    let rounding = (OF_FLOATS + HALF_A_STEP / (config.white - config.black)) as f32;
    rounding
}

/// Refuses a black level that an exposure mostly stays below, where noise alone puts half of it: three quarters of
/// the longest by more than rounding, or half of any by more than noise.
pub(super) fn check_black(frames: &[Array3<f32>], config: &FuseConfig) -> Result<()> {
    let share_below = |frame: &Array3<f32>, level: f32| {
        frame.iter().filter(|v| **v < level).count() as f64 / frame.len() as f64
    };
    let darkest = frames.iter().map(|frame| share_below(frame, -BELOW_BLACK)).fold(0.0, f64::max);
    let longest = share_below(&frames[0], -rounding_of_black(config));
    if longest > 0.75 || darkest > 0.5 {
        let percent = 100.0 * longest.max(darkest);
        return Err(Error::config(
            "black",
            format!("lies above {percent:.0} % of an exposure's values; lower it"),
        ));
    }
    Ok(())
}
