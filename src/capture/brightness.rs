//! Compares two exposures by their light: how many times as bright the one is as the other.

use ndarray::Array3;

/// Octaves of the reference below white, the last of which holds whatever is darker, noise below black too.
const OCTAVES: usize = 9;
/// Light of so many octaves below white is compared: in the sixth, at 1/64, offsets begin to count.
const BRIGHT_OCTAVES: usize = 6;
/// So many octaves below the light that is compared, values are its background.
const OCTAVES_TO_BACKGROUND: usize = 2;
/// Values that are compared of one octave at most: these know a ratio of noise of 100 % to a percent.
const SAMPLES: usize = 10_000;
/// From so few values on, their own scatter tells how well they know the ratio.
const FEWEST: usize = 16;
/// A ratio is believed that is known better, as a share: five times as well as the tenth that is told.
const LARGEST_ERROR: f64 = 0.02;
/// What the background may be wrong by, in shares of white: a step of 14 bits, and noise that was cut off at black.
const ERROR_OF_BACKGROUND: f64 = 1e-4;
/// What black may be wrong by where nothing dark shows it: a quarter of a step of 8 bits, sixteen of 14.
const ERROR_OF_BLACK: f64 = 1e-3;
/// Residuals beyond so many standard deviations are hot pixels or other things than noise.
const OUTLIERS: f64 = 5.0;
/// Residuals that are smaller, as a share of the light, are never outliers: pictures may be free of noise.
const NO_OUTLIER: f64 = 0.01;

/// How many times as bright the second picture is as the first, where neither reaches its ceiling, from which on it is
/// saturated; none where they know it to no better than 2 %.
///
/// # Method
/// 1. Values go into octaves of the reference alone: selecting by both would prefer noise of one sign.
/// 2. From the brightest octave downwards, values are taken until they know the ratio well enough.
/// 3. The background, the mean of what is at least four times darker, is subtracted of both, and with it any error of
///    black. Where there is none, black is believed to a thousandth of white.
/// 4. The median of all ratios, weighted by light, is a first guess, which no hot pixel moves. Values that deviate from
///    it by much more than the rest are left out.
/// 5. The ratio is that of the sums, which is the best for photon noise, and its error that of the residuals' scatter.
pub(super) fn brightness_ratio(pair: [&Array3<f32>; 2], ceilings: [f64; 2]) -> Option<f64> {
    let octaves = samples(pair, ceilings);
    (0..BRIGHT_OCTAVES).find_map(|darkest| {
        let bright = octaves[..=darkest].concat();
        let dark = octaves[darkest + 1 + OCTAVES_TO_BACKGROUND..].concat();
        ratio_of(bright, &dark)
    })
}

/// Values of the reference and of the other exposure.
type Pair = [f64; 2];

/// Pairs of each octave, evenly distributed over the pictures.
fn samples([reference, other]: [&Array3<f32>; 2], ceilings: [f64; 2]) -> Vec<Vec<Pair>> {
    let pairs = || {
        let pairs =
            reference.iter().zip(other).map(|(reference, other)| [f64::from(*reference), f64::from(*other)]);
        pairs.filter(|[reference, other]| *reference < ceilings[0] && *other < ceilings[1])
    };
    let mut counts = [0usize; OCTAVES];
    pairs().for_each(|[reference, _]| counts[octave(reference)] += 1);
    // Odd, to meet all colours of a mosaic.
    let strides = counts.map(|count| count.div_ceil(SAMPLES) | 1);
    let mut octaves = vec![Vec::new(); OCTAVES];
    let mut met = [0usize; OCTAVES];
    for pair in pairs() {
        let octave = octave(pair[0]);
        if met[octave].is_multiple_of(strides[octave]) {
            octaves[octave].push(pair);
        }
        met[octave] += 1;
    }
    octaves
}

fn octave(value: f64) -> usize {
    let mut lower = 0.5;
    for octave in 0..OCTAVES - 1 {
        if value >= lower {
            return octave;
        }
        lower *= 0.5;
    }
    OCTAVES - 1
}

/// The ratio that some values of light show above their background, if they know it well.
fn ratio_of(bright: Vec<Pair>, dark: &[Pair]) -> Option<f64> {
    if bright.len() < FEWEST {
        return None;
    }
    let is_backed = dark.len() >= FEWEST;
    let background = if is_backed { mean(dark) } else { [0.0; 2] };
    let mut light: Vec<Pair> = bright.iter().map(|pair| [0, 1].map(|k| pair[k] - background[k])).collect();
    let guess = median_ratio(&mut light)?;
    let light = without_outliers(light, guess);
    if light.len() < FEWEST {
        return None;
    }
    let [reference, other] = mean(&light);
    let ratio = other / reference;
    let (black, dark_variance) = if is_backed {
        let dark: Vec<Pair> = dark.iter().map(|pair| [0, 1].map(|k| pair[k] - background[k])).collect();
        (ERROR_OF_BACKGROUND, variance_of_mean(&dark, ratio))
    } else {
        (ERROR_OF_BLACK, 0.0)
    };
    let variance = variance_of_mean(&light, ratio) + dark_variance + black * black;
    (other > 0.0 && variance.sqrt() < LARGEST_ERROR * other).then_some(ratio)
}

fn mean(pairs: &[Pair]) -> Pair {
    [0, 1].map(|k| pairs.iter().map(|pair| pair[k]).sum::<f64>() / pairs.len() as f64)
}

/// The variance of the mean of residuals.
fn variance_of_mean(pairs: &[Pair], ratio: f64) -> f64 {
    let squares: f64 = pairs.iter().map(|pair| residual(pair, ratio).powi(2)).sum();
    let count = pairs.len() as f64;
    squares / (count * (count - 1.0))
}

fn residual([reference, other]: &Pair, ratio: f64) -> f64 {
    other - ratio * reference
}

/// The median of the ratios, each weighted by the light of the reference, if it is positive.
fn median_ratio(light: &mut [Pair]) -> Option<f64> {
    light.sort_unstable_by(|a, b| (a[1] / a[0]).total_cmp(&(b[1] / b[0])));
    let half = 0.5 * light.iter().map(|pair| pair[0]).sum::<f64>();
    let mut sum = 0.0;
    let middle = light.iter().find(|pair| {
        sum += pair[0];
        sum >= half
    })?;
    Some(middle[1] / middle[0]).filter(|ratio| *ratio > 0.0)
}

/// Leaves out what deviates by much more than the rest, in units of photon noise.
fn without_outliers(mut light: Vec<Pair>, ratio: f64) -> Vec<Pair> {
    let deviation = |pair: &Pair| residual(pair, ratio).abs() / (ratio * pair[0]).sqrt();
    let mut deviations: Vec<f64> = light.iter().map(deviation).collect();
    let middle = deviations.len() / 2;
    let (_, median, _) = deviations.select_nth_unstable_by(middle, f64::total_cmp);
    // The median of |normal| is 0.6745 σ.
    let limit = OUTLIERS * *median / 0.6745;
    let is_light =
        |pair: &Pair| deviation(pair) <= limit || residual(pair, ratio).abs() <= NO_OUTLIER * ratio * pair[0];
    light.retain(is_light);
    light
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng::stream;
    use rand::RngExt as _;

    /// 14 bits above a black level, shot noise of 10 000 electrons, read noise of 2 e⁻.
    fn exposed(scene: &Array3<f32>, time: f64, black: f64) -> Array3<f32> {
        let mut rng = stream(11, &format!("exposure {time} {black}"));
        scene.mapv(|light| {
            let electrons = 1e4 * f64::from(light) * time;
            let normal = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            let value = (electrons + normal * (4.0 + electrons).sqrt()) / 1e4 + black;
            (((value * 16383.0).round() / 16383.0).clamp(-0.01, 1.0)) as f32
        })
    }

    /// The halo of a lamp, of which few values are bright and unsaturated.
    fn point_source() -> Array3<f32> {
        Array3::from_shape_fn((3, 96, 96), |(_, y, x)| {
            let squared = (y as f32 - 47.0).powi(2) + (x as f32 - 48.0).powi(2);
            500.0 / (1.0 + squared).powf(1.5)
        })
    }

    fn found(scene: &Array3<f32>, times: [f64; 2], black: f64) -> Option<f64> {
        let pair = times.map(|time| exposed(scene, time, black));
        let ratio = brightness_ratio([&pair[0], &pair[1]], [0.99; 2])?;
        Some(ratio * times[0] / times[1])
    }

    #[test]
    fn few_bright_values_of_a_point_source_are_enough() {
        for times in [[1.0, 1.0 / 32.0], [1.0 / 32.0, 1.0 / 768.0]] {
            let long = exposed(&point_source(), times[0], 0.0);
            let bright = long.iter().filter(|v| **v > 0.5 && **v < 0.99).count();
            assert!(times[0] > 0.9 || bright < 100, "{bright} values are bright, too many to test anything");
            let ratio = found(&point_source(), times, 0.0).expect("the halo is in both");
            assert!((ratio - 1.0).abs() < 0.03, "{ratio} of {times:?}");
        }
    }

    /// 16 of 16383 is a level that was measured at another temperature.
    #[test]
    fn a_black_level_that_is_off_feigns_no_wrong_time() {
        let texture = Array3::from_shape_fn((3, 96, 96), |(c, y, x)| {
            0.001 + 0.4 * ((0.11 * x as f32 + c as f32).sin() * (0.07 * y as f32).sin()).powi(2)
        });
        for scene in [point_source(), texture] {
            for black in [-0.001, 0.001] {
                for times in [[1.0, 1.0 / 16.0], [1.0, 1.0]] {
                    let ratio = found(&scene, times, black).expect("the light is in both");
                    assert!((ratio - 1.0).abs() < 0.05, "{ratio} of {times:?}, black off by {black}");
                }
            }
        }
    }

    #[test]
    fn dim_pictures_are_compared_too() {
        let scene = Array3::from_shape_fn((3, 64, 64), |(_, y, x)| 0.1 * ((y * x) % 64) as f32 / 64.0);
        let ratio = found(&scene, [1.0, 0.25], 0.0).expect("a tenth of white is light");
        assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
    }

    #[test]
    fn stuck_pixels_are_no_light() {
        let mut pair = [1.0, 1.0 / 24.0].map(|time| exposed(&point_source(), time, 0.0));
        for (index, place) in [[0, 3, 5], [1, 60, 80], [2, 90, 17]].into_iter().enumerate() {
            pair.iter_mut().for_each(|picture| picture[place] = 0.6 + 0.1 * index as f32);
        }
        let ratio = brightness_ratio([&pair[0], &pair[1]], [0.99; 2]).unwrap();
        assert!((24.0 * ratio - 1.0).abs() < 0.03, "{ratio}");
    }

    #[test]
    fn a_displacement_of_half_a_pixel_feigns_no_wrong_time() {
        let scene = |shift: f32| {
            Array3::from_shape_fn((3, 96, 96), |(_, y, x)| {
                0.4 + 0.3 * (0.9 * (x as f32 + shift)).sin() * (0.8 * y as f32).cos()
            })
        };
        let pair = [exposed(&scene(0.0), 1.0, 0.0), exposed(&scene(0.5), 0.25, 0.0)];
        let ratio = brightness_ratio([&pair[0], &pair[1]], [0.99; 2]).unwrap();
        assert!((4.0 * ratio - 1.0).abs() < 0.1, "{ratio}");
    }

    #[test]
    fn darkness_and_noise_have_no_ratio() {
        for light in [0.0, 0.001, 0.01] {
            let scene = Array3::from_elem((3, 64, 64), light);
            assert_eq!(found(&scene, [1.0, 1.0 / 16.0], 0.0), None, "{light}");
        }
        // Grey that is cut off in the longer one, and six steps of 14 bits in the shorter one.
        assert_eq!(found(&Array3::from_elem((3, 64, 64), 0.3), [1.0, 1.0 / 768.0], 0.0), None);
        assert_eq!(found(&Array3::from_elem((3, 64, 64), 3.0), [1.0, 0.25], 0.0), None);
    }
}
