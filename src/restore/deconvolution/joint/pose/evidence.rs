//! How much a fit tells: standard deviations from what it leaves unexplained, correlated as scenes are.

use ndarray::{Array2, Zip, s};

use super::super::sums::inner;
use super::Pose2;

/// The side of the blocks whose errors count as independent, in pixels.
const BLOCK_PX: usize = 16;

/// The least part of the product of two parameters' information that is not shared by them.
const LEAST_DETERMINANT: f64 = 1e-6;

/// The sums of a·b over blocks of pixels.
fn block_sums(a: &Array2<f32>, b: &Array2<f32>) -> Vec<f64> {
    let (height, width) = a.dim();
    let mut sums = Vec::new();
    for top in (0..height).step_by(BLOCK_PX) {
        for left in (0..width).step_by(BLOCK_PX) {
            let block = s![top..(top + BLOCK_PX).min(height), left..(left + BLOCK_PX).min(width)];
            let mut sum = 0.0;
            Zip::from(a.slice(block)).and(b.slice(block)).for_each(|a, b| sum += f64::from(a * b));
            sums.push(sum);
        }
    }
    sums
}

/// The standard deviations of two parameters whose derivatives are `told`, from what is `left`; none where they tell nothing.
pub(super) fn deviations(told: &[Array2<f32>; 2], left: &Array2<f32>) -> Option<Pose2> {
    let [tt, ts, ss] = [(0, 0), (0, 1), (1, 1)].map(|(i, j): (usize, usize)| inner(&told[i], &told[j]));
    let determinant = tt * ss - ts * ts;
    if determinant.is_nan() || determinant <= LEAST_DETERMINANT * tt * ss {
        return None;
    }
    let [turns, scales] = told.each_ref().map(|told| block_sums(told, left));
    let mut variance = [0.0; 2];
    for (turn, scale) in turns.iter().zip(&scales) {
        variance[0] += ((ss * turn - ts * scale) / determinant).powi(2);
        variance[1] += ((tt * scale - ts * turn) / determinant).powi(2);
    }
    Some(variance.map(f64::sqrt))
}

/// A light over its standard deviation, where it is `seen` as a plane and the rest is `left`.
pub(super) fn light_to_noise(seen: &Array2<f32>, left: &Array2<f32>) -> f64 {
    let noise: f64 = block_sums(seen, left).iter().map(|sum| sum.powi(2)).sum();
    inner(seen, seen) / noise.sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng::stream;
    use rand::RngExt as _;
    use rand_distr::StandardNormal;

    /// Of independent noise of deviation σ, a parameter with the derivative J has σ/|J|.
    #[test]
    fn independent_noise_gives_the_deviations_of_least_squares() {
        let mut rng = stream(3, "evidence");
        let mut plane = |deviation: f64| {
            Array2::from_shape_simple_fn((200, 250), || {
                (deviation * rng.sample::<f64, _>(StandardNormal)) as f32
            })
        };
        let (told, left) = ([plane(1.0), plane(4.0)], plane(0.5));
        let [turn, scale] = deviations(&told, &left).unwrap();
        let expected = 0.5 / 50_000f64.sqrt();
        assert!((turn / expected - 1.0).abs() < 0.15, "{turn} for {expected}");
        assert!((4.0 * scale / expected - 1.0).abs() < 0.15, "{scale} for {expected} / 4");
    }

    #[test]
    fn parameters_that_cannot_be_told_apart_have_no_deviation() {
        let plane = Array2::from_shape_fn((40, 40), |(y, x)| ((y * 7 + x * 3) % 11) as f32);
        assert!(deviations(&[plane.clone(), 2.0 * &plane], &plane).is_none());
        assert!(deviations(&[Array2::zeros((40, 40)), plane.clone()], &plane).is_none());
    }
}
