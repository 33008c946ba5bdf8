//! Brings exposure times to one scale, and compares them with what the pictures show.

use ndarray::Array3;

use super::bracket::show_time;
use super::brightness::brightness_ratio;
use crate::core::error::{Error, Result};

/// Times that differ by less, as a share, are one setting of the shutter: files round theirs (1/60 s is also 0.0167 s), the
/// settings themselves lie a quarter apart, and what a sensor collects in the dark is not known better.
pub const SAME_TIME: f64 = 0.01;

/// The largest ratio of two times that is believed: a billion is 30 stops, from 1/8000 s to more than a day.
const LARGEST_RATIO: f64 = 1e9;

/// Refuses times that are not positive, or further apart than those of any bracket.
pub(super) fn check_times(times: &[f64]) -> Result<()> {
    for &time in times {
        if !(time.is_finite() && time > 0.0) {
            return Err(Error::config("exposures", format!("must be positive times, found {time}")));
        }
    }
    let longest = times.iter().copied().fold(0.0, f64::max);
    match times.iter().find(|time| longest / **time > LARGEST_RATIO) {
        None => Ok(()),
        Some(time) => {
            let reason = format!(
                "{longest:e} and {time:e} are further apart than the exposures of any bracket, a ratio of {LARGEST_RATIO:e}; \
                 check the times, which all have one unit"
            );
            Err(Error::config("exposures", reason))
        }
    }
}

/// Ratios this close to a simple fraction are that fraction: four roundings of 64 bits, by which 1/60 and 1/240 may be
/// off when they are written in seconds and divided.
const ROUNDING: f64 = 4.0 * f64::EPSILON;
/// The largest denominator of a simple fraction: two such lie further apart than roundings do.
const LARGEST_DENOMINATOR: f64 = 1e7;

/// Exposure times as shares of the longest.
///
/// Only ratios of times count, so that times in seconds and as shares are the same to the last bit: 1/60 and 1/240 are
/// 1 and 1/4. A quotient that misses a simple fraction by its rounding alone is that fraction.
pub fn relative_times(times: &[f64]) -> Vec<f64> {
    let longest = times.iter().copied().fold(0.0, f64::max);
    times.iter().map(|&time| share_of(time, longest)).collect()
}

fn share_of(time: f64, longest: f64) -> f64 {
    let share = time / longest;
    nearest_fraction(share).unwrap_or(share)
}

/// The simplest fraction that a share is but for rounding, by its continued fraction.
fn nearest_fraction(share: f64) -> Option<f64> {
    let (mut above, mut below) = ([0.0, 1.0], [1.0, 0.0]);
    let mut rest = share;
    loop {
        let whole = rest.floor();
        above = [above[1], whole * above[1] + above[0]];
        below = [below[1], whole * below[1] + below[0]];
        if below[1] > LARGEST_DENOMINATOR {
            return None;
        }
        let fraction = above[1] / below[1];
        if (fraction / share - 1.0).abs() <= ROUNDING {
            return Some(fraction);
        }
        rest = 1.0 / (rest - whole);
        if !rest.is_finite() {
            return None;
        }
    }
}

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

/// Compares neighbouring exposures where neither reaches its ceiling, from which on it is saturated.
pub(super) fn ratios_found(frames: &[Array3<f32>], times: &[f64], ceilings: &[f64]) -> Vec<Option<f64>> {
    let compare = |index: usize| {
        let ratio =
            brightness_ratio([&frames[index], &frames[index + 1]], [ceilings[index], ceilings[index + 1]])?;
        Some(ratio * times[index] / times[index + 1])
    };
    (0..frames.len() - 1).map(compare).collect()
}

/// The times that the pictures show: each is the next longer one's, divided by the brightness ratio found. The longest
/// is believed.
///
/// # Errors
/// [`Error::Config`] when two neighbouring exposures have too little light in common.
pub(super) fn estimate_times(times: &[f64], found: &[Option<f64>]) -> Result<Vec<f64>> {
    let mut estimated = vec![times[0]];
    for (index, found) in found.iter().enumerate() {
        let Some(found) = found else {
            return Err(Error::config(
                "estimate-exposures",
                format!(
                    "exposures {} and {} have too little light in common that is well above black and unsaturated in \
                     both; add an exposure between them, or trust the times",
                    show_time(times[index]),
                    show_time(times[index + 1])
                ),
            ));
        };
        estimated.push(estimated[index] * times[index + 1] / times[index] * found);
    }
    Ok(estimated)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_times_in_seconds_are_those_of_fractions_to_the_last_bit() {
        for seconds in [60.0, 7.0, 0.3, 13.7, 1e6] {
            for below in [1.0, 3.0, 4.0, 16.0, 32.0, 768.0, 1000.0] {
                assert_eq!(
                    share_of(1.0 / (seconds * below), 1.0 / seconds),
                    1.0 / below,
                    "{seconds} {below}"
                );
                assert_eq!(share_of(seconds / below, seconds), 1.0 / below, "{seconds} {below}");
            }
            assert_eq!(share_of(2.0 / seconds, 3.0 / seconds), 2.0 / 3.0);
        }
    }

    /// Times that a camera rounded are no fractions of each other, and stay what they are.
    #[test]
    fn other_shares_stay_what_they_are() {
        for (time, longest) in [(0.004_166_7, 0.016_666_7), (1e-9, 1.0), (std::f64::consts::FRAC_1_PI, 1.0)] {
            let share = share_of(time, longest);
            assert!((share * longest / time - 1.0).abs() < 1e-15, "{time} of {longest}");
        }
        assert_ne!(share_of(0.004_166_7, 0.016_666_7), 0.25);
    }
}
