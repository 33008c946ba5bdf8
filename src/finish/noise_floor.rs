//! Tells detail from noise in lightness, so that local contrast is raised for the one and not for the other.

use ndarray::{Array2, ArrayView2, Axis, Zip};
use rayon::prelude::*;
use serde::Serialize;

use crate::core::error::{Error, Result};

/// What is known of the noise in a picture, below which local contrast is not raised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoiseFloor {
    /// Noise is taken for detail, as the published pictures have it.
    #[default]
    Ignored,
    /// It is estimated from the picture, for every lightness.
    Estimated,
    /// Its standard deviation in lightness, in codes of 0 to 255.
    Told(f32),
}

/// Windows are of this many pixels to each side of their middle.
const RADIUS: usize = 2;

/// Ranges of lightness whose noise is estimated apart.
const BINS: usize = 16;

/// Windows that a range needs for an estimate of its own.
const LEAST_WINDOWS: usize = 256;

/// The share of the windows that is taken to be even, but for noise.
const EVEN_SHARE: f64 = 0.1;

/// The variance that a tenth of even windows stay below, of the true one: of χ² with 24 degrees of freedom.
const OF_TRUE: f32 = 0.652;

/// More than this, in codes, is texture: the noise of a picture that can be shown is less.
const MOST_NOISE: f32 = 8.0;

/// Windows whose variance is below this multiple of the noise's are even: their variance is itself uncertain by a third.
const DOUBT: f32 = 2.0;

impl NoiseFloor {
    pub(super) fn check(self) -> Result<()> {
        match self {
            Self::Told(codes) if !(0.0..=255.0).contains(&codes) => Err(Error::config(
                "noise",
                format!("must be from 0 to 255 codes of lightness, found {codes}"),
            )),
            _ => Ok(()),
        }
    }

    /// The part of lightness that is detail; none where noise is not looked for.
    ///
    /// # Equation
    /// Of the mean μ and the variance v of 5 × 5 pixels, and the noise's variance σ² at that lightness: `μ + k·(L − μ)` with
    /// `k = max(0, 1 − 2σ²/v)`, the local Wiener filter (Lee, "Digital image enhancement and noise filtering by use of local
    /// statistics", 1980). σ² at a lightness is what a tenth of the windows there stay below, divided by what that is of the
    /// variance of white noise.
    pub(super) fn detail(self, lightness: ArrayView2<'_, f32>) -> Option<Array2<f32>> {
        if self == Self::Ignored {
            return None;
        }
        let Windows { mean, variance } = Windows::of(lightness);
        let noise = match self {
            Self::Told(codes) => [codes * codes; BINS],
            _ => estimate(&mean, &variance),
        };
        let mut detail = lightness.to_owned();
        Zip::from(&mut detail).and(&mean).and(&variance).par_for_each(|l, mean, variance| {
            let floor = DOUBT * noise_at(&noise, *mean);
            let share = if *variance > floor { 1.0 - floor / variance } else { 0.0 };
            *l = mean + share * (*l - mean);
        });
        Some(detail)
    }
}

/// Mean and variance of the window around every pixel; windows end at the border.
struct Windows {
    mean: Array2<f32>,
    variance: Array2<f32>,
}

impl Windows {
    fn of(plane: ArrayView2<'_, f32>) -> Self {
        let (height, width) = plane.dim();
        let around =
            |place: usize, length: usize| place.saturating_sub(RADIUS)..(place + RADIUS + 1).min(length);
        let sums_of_rows = |power: i32| {
            let mut sums = Array2::zeros((height, width));
            sums.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut row)| {
                for (x, sum) in row.iter_mut().enumerate() {
                    *sum = around(x, width).map(|x| plane[[y, x]].powi(power)).sum::<f32>();
                }
            });
            sums
        };
        let rows: [Array2<f32>; 2] = [1, 2].map(sums_of_rows);
        let (mut mean, mut variance) = (Array2::zeros((height, width)), Array2::zeros((height, width)));
        let lines = mean.axis_iter_mut(Axis(0)).into_par_iter().zip(variance.axis_iter_mut(Axis(0)));
        lines.enumerate().for_each(|(y, (mut mean, mut variance))| {
            let above = around(y, height);
            for x in 0..width {
                let count = (above.len() * around(x, width).len()) as f32;
                let [first, second] =
                    [0, 1].map(|power| above.clone().map(|y| rows[power][[y, x]]).sum::<f32>() / count);
                mean[x] = first;
                // Without bias, as the noise's own variance is counted.
                variance[x] = (second - first * first).max(0.0) * count / (count - 1.0).max(1.0);
            }
        });
        Self { mean, variance }
    }
}

/// The bin of a lightness, and where in it.
fn place_of(lightness: f32) -> f32 {
    (lightness / 256.0 * BINS as f32).clamp(0.0, BINS as f32 - 1e-3)
}

/// The variance of noise in each range of lightness; of ranges with few pixels that of the nearest with many. It changes
/// slowly: a range that has more than its neighbours is one of edges and texture.
fn estimate(mean: &Array2<f32>, variance: &Array2<f32>) -> [f32; BINS] {
    let mut windows: [Vec<f32>; BINS] = Default::default();
    for (mean, variance) in mean.iter().zip(variance) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the bins")]
        let bin = place_of(*mean) as usize;
        windows[bin].push(*variance);
    }
    let found = windows.map(|mut windows| {
        let count = windows.len();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "an index of the windows"
        )]
        let index = (EVEN_SHARE * count as f64) as usize;
        (count >= LEAST_WINDOWS).then(|| {
            let even = *windows.select_nth_unstable_by(index, f32::total_cmp).1;
            (even / OF_TRUE).min(MOST_NOISE * MOST_NOISE)
        })
    });
    let known: [f32; BINS] = std::array::from_fn(|bin| {
        let nearest =
            (0..BINS).filter(|other| found[*other].is_some()).min_by_key(|other| other.abs_diff(bin));
        nearest.and_then(|other| found[other]).unwrap_or(0.0)
    });
    let around = |bin: usize| known[bin.saturating_sub(1)..(bin + 2).min(BINS)].iter();
    std::array::from_fn(|bin| around(bin).copied().fold(f32::INFINITY, f32::min))
}

/// The variance of noise at a lightness, between the middles of two ranges.
fn noise_at(noise: &[f32; BINS], lightness: f32) -> f32 {
    let place = (place_of(lightness) - 0.5).max(0.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the bins")]
    let below = place as usize;
    let share = place - below as f32;
    noise[below] * (1.0 - share) + noise[(below + 1).min(BINS - 1)] * share
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    /// Dark on the left, bright on the right, the noise growing with it, and an edge every 40 rows.
    fn noisy(sides: (usize, usize), noise_of: impl Fn(usize) -> f32) -> Array2<f32> {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        Array2::from_shape_fn(sides, |(y, x)| {
            let step = if y % 80 < 40 { 0.0 } else { 60.0 };
            let noise: f32 = Normal::new(0.0, noise_of(x)).unwrap().sample(&mut random);
            (if x < 100 { 30.0 } else { 150.0 }) + step + noise
        })
    }

    #[test]
    fn the_noise_of_every_lightness_is_found() {
        let plane = noisy((240, 200), |x| if x < 100 { 3.0 } else { 1.0 });
        let Windows { mean, variance } = Windows::of(plane.view());
        let noise = estimate(&mean, &variance);
        for (lightness, expected) in [(30.0, 3.0), (90.0, 3.0), (150.0, 1.0), (210.0, 1.0)] {
            let found = noise_at(&noise, lightness).sqrt();
            assert!((found / expected - 1.0).abs() < 0.25, "at {lightness}: {found} instead of {expected}");
        }
    }

    #[test]
    fn noise_is_no_detail_and_edges_are() {
        let plane = noisy((240, 200), |_| 2.0);
        let detail = NoiseFloor::Estimated.detail(plane.view()).unwrap();
        let spread = |plane: &Array2<f32>| {
            let rows = plane.slice(ndarray::s![5..35, 10..90]);
            rows.std(1.0)
        };
        assert!(spread(&plane) > 1.9 && spread(&detail) < 0.8, "{} {}", spread(&plane), spread(&detail));
        let edge = detail[[40, 50]] - detail[[39, 50]];
        assert!(edge > 50.0, "an edge of 60 is {edge}");
        assert_eq!(NoiseFloor::Ignored.detail(plane.view()), None);
        let told = NoiseFloor::Told(0.0).detail(plane.view()).unwrap();
        assert!(told.iter().zip(&plane).all(|(a, b)| (a - b).abs() < 1e-3), "without noise all is detail");
    }

    #[test]
    fn pictures_of_a_few_pixels_have_no_noise_to_find() {
        for sides in [(1, 1), (1, 7), (3, 2)] {
            let plane = Array2::from_shape_fn(sides, |(y, x)| (y * 10 + x) as f32);
            let detail = NoiseFloor::Estimated.detail(plane.view()).unwrap();
            assert!(detail.iter().zip(&plane).all(|(a, b)| (a - b).abs() < 1e-3), "{sides:?}");
        }
    }

    #[test]
    fn noise_that_no_picture_has_is_refused() {
        assert!(NoiseFloor::Told(-1.0).check().is_err() && NoiseFloor::Told(f32::NAN).check().is_err());
        assert!(NoiseFloor::Told(2.0).check().is_ok() && NoiseFloor::Estimated.check().is_ok());
    }
}
