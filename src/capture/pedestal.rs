//! Finds a black level that was left in the exposures of a bracket: light grows with time, and it does not.

use ndarray::Array3;

/// The least black level that is told, as a share of white, and as one of the median of the shorter exposure.
const LEAST: f64 = 1e-3;
const LEAST_SHARE: f64 = 0.5;

/// How far what pairs of exposures tell may lie apart, as a share of it.
const APART: f64 = 0.2;

/// The share of white above which a median tells nothing.
const SATURATED: f64 = 0.9;

/// Values of which a median is taken, at most.
const MOST_SAMPLES: usize = 1 << 18;

/// What is in all exposures alike, as a share of white, by their medians; none where that is little, or what is told of it differs.
///
/// # Equation
/// `p = (r·m₂ − m₁)/(r − 1)` for medians `m = p + light·time` of two exposures, the first r times as long.
pub(super) fn pedestal(frames: &[Array3<f32>], times: &[f64]) -> Option<f64> {
    let medians: Vec<f64> = frames.iter().map(median).collect();
    let of_pair = |pair: usize| {
        let [long, short] = [medians[pair], medians[pair + 1]];
        let ratio = times[pair] / times[pair + 1];
        let is_told = ratio > 1.0 && long < SATURATED;
        is_told.then(|| (ratio * short - long) / (ratio - 1.0))
    };
    let told: Vec<f64> = (0..frames.len().saturating_sub(1)).filter_map(of_pair).collect();
    let (last, shortest) = (*told.last()?, *medians.last()?);
    let is_alike = told.iter().all(|other| (other - last).abs() <= APART * last);
    (is_alike && last >= LEAST && last >= LEAST_SHARE * shortest).then_some(last)
}

fn median(frame: &Array3<f32>) -> f64 {
    let mut sampled: Vec<f32> = frame.iter().step_by(frame.len() / MOST_SAMPLES + 1).copied().collect();
    let middle = sampled.len() / 2;
    if sampled.is_empty() {
        0.0
    } else {
        f64::from(*sampled.select_nth_unstable_by(middle, f32::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lamp with its haze, over a black level, as three exposures have them.
    fn bracket(black: f32, times: &[f64]) -> Vec<Array3<f32>> {
        let light = |y: usize, x: usize| {
            2e-3 + 60.0 / (1.0 + (y as f32 - 20.0).hypot(x as f32 - 20.0).powi(2)).powi(2)
        };
        let exposure = |time: &f64| {
            Array3::from_shape_fn((3, 40, 40), |(_, y, x)| (black + *time as f32 * light(y, x)).min(1.0))
        };
        times.iter().map(exposure).collect()
    }

    #[test]
    fn a_black_level_that_was_left_in_is_told() {
        let times = [1.0, 1.0 / 32.0, 1.0 / 768.0];
        let told = pedestal(&bracket(0.0156, &times), &times).unwrap();
        assert!((told / 0.0156 - 1.0).abs() < 0.02, "{told}");
        assert_eq!(pedestal(&bracket(0.0, &times), &times), None);
        assert_eq!(pedestal(&bracket(0.0002, &times), &times), None, "hardly any");
    }

    /// A time that is wrong by a tenth, and a single exposure.
    #[test]
    fn light_is_no_black_level() {
        let frames = bracket(0.0, &[1.0, 0.22]);
        assert_eq!(pedestal(&frames, &[1.0, 0.25]), None);
        assert_eq!(pedestal(&frames[..1], &[1.0]), None);
    }
}
