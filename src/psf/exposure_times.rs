//! Compares exposure times with what the pictures show.

use ndarray::Array3;

use super::bracket::show_time;
use crate::core::error::{Error, Result};

/// A difference, in shares of white, that no noise of a usable picture makes.
const CLEAR_DIFFERENCE: f32 = 0.02;

/// Refuses a shorter exposure that is brighter than a longer one.
pub(super) fn check_order(frames: &[Array3<f32>], times: &[f64], numbers: &[usize]) -> Result<()> {
    for (index, pair) in frames.windows(2).enumerate() {
        let pixels = || pair[0].iter().zip(&pair[1]);
        let brighter = pixels().filter(|(long, short)| **short > **long + CLEAR_DIFFERENCE).count();
        let darker = pixels().filter(|(long, short)| **long > **short + CLEAR_DIFFERENCE).count();
        if brighter > darker {
            return Err(Error::config(
                "exposures",
                format!(
                    "picture {} (exposure {}) is brighter than picture {} (exposure {}); give the times in the \
                     order of the files",
                    numbers[index + 1],
                    show_time(times[index + 1]),
                    numbers[index],
                    show_time(times[index])
                ),
            ));
        }
    }
    Ok(())
}

/// Pixels in common from which on a brightness ratio is believed.
const ENOUGH_PIXELS: usize = 100;

/// Compares neighbouring exposures where the longer one is bright and neither is saturated.
pub(super) fn ratios_found(frames: &[Array3<f32>], times: &[f64], saturation: f64) -> Vec<Option<f64>> {
    let compare = |pair: &[Array3<f32>], times: &[f64]| {
        let usable = |(long, short): &(&f32, &f32)| {
            **long > 0.5 && f64::from(**long) < saturation && f64::from(**short) < saturation
        };
        let (mut count, mut long_sum, mut short_sum) = (0, 0.0, 0.0);
        for (long, short) in pair[0].iter().zip(&pair[1]).filter(usable) {
            count += 1;
            long_sum += f64::from(*long);
            short_sum += f64::from(*short);
        }
        (count >= ENOUGH_PIXELS).then(|| short_sum / long_sum * times[0] / times[1])
    };
    frames.windows(2).zip(times.windows(2)).map(|(pair, times)| compare(pair, times)).collect()
}

/// The times that the pictures show: each is the next longer one's, divided by the brightness ratio found. The longest
/// is believed.
///
/// # Errors
/// [`Error::Config`] when two neighbouring exposures have too few pixels in common.
pub(super) fn estimate_times(times: &[f64], found: &[Option<f64>]) -> Result<Vec<f64>> {
    let mut estimated = vec![times[0]];
    for (index, found) in found.iter().enumerate() {
        let Some(found) = found else {
            return Err(Error::config(
                "estimate-exposures",
                format!(
                    "exposures {} and {} have fewer than {ENOUGH_PIXELS} pixels in common that are bright in the one \
                     and unsaturated in both; add an exposure between them, or trust the times",
                    show_time(times[index]),
                    show_time(times[index + 1])
                ),
            ));
        };
        estimated.push(estimated[index] * times[index + 1] / times[index] * found);
    }
    Ok(estimated)
}
