//! Estimates the noise of a capture that was enlarged, or whose pixels were copied beside each other: its finest bands show none.
//!
//! Interpolation leaves nothing of noise in detail as fine as pixels, where it is looked for, so that such a capture passes for a computed
//! one. Of every second or third pixel alone the noise is as white again as the sensor had it, and that of one colour tells nothing of
//! another's; the detail of a scene without noise does.

use ndarray::s;

use super::super::noise::BANDS;
use super::apart::noise_apart;
use super::interpolation::Finest;
use super::places::places_of;
use crate::core::image::{CHANNELS, LinearImage};

/// Of how many pixels along a row, and along a column, one is looked at.
const STRIDES: [usize; 3] = [2, 3, 4];

/// The standard deviation of white noise of `ln(y + α)` that has as much in the bands that are left as a capture which was enlarged, in
/// each channel; `saturated_from` is the light from which pixels are saturated. None is told of a capture that was not.
///
/// Noise of pixels `stride` apart, spread over all between them, has `stride²` times the power in each of the bands that are left.
pub(super) fn noise_of_enlarged(
    image: &LinearImage,
    alpha: f32,
    saturated_from: [f32; CHANNELS],
) -> Option<[f32; CHANNELS]> {
    STRIDES.into_iter().find_map(|stride| {
        let apart = image.planes().slice(s![.., ..;stride, ..;stride]).to_owned();
        let places = places_of(&LinearImage::from_planes(apart).ok()?, alpha, saturated_from);
        if Finest::of_places(&places).is_interpolated {
            return None;
        }
        // All that is white is noise: what the PSF leaves does not matter.
        let noise = noise_apart(&places, [[1.0; BANDS.len()]; CHANNELS])?;
        #[expect(clippy::cast_precision_loss, reason = "a small number")]
        let times = stride as f32;
        Some(noise.map(|noise| times * noise))
    })
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::core::rng;

    const ALPHA: f32 = 0.25;
    const NOISE: f32 = 0.02;

    /// Slow gradients of all colours, and noise of each.
    fn capture(noise: f32) -> Array3<f32> {
        let mut rng = rng::stream(8, "enlarged");
        Array3::from_shape_fn((CHANNELS, 120, 120), |(channel, y, x)| {
            let light = 0.4 + 0.3 * (x as f32 / 40.0 + channel as f32).sin() * (y as f32 / 30.0).cos();
            let normal: f32 = StandardNormal.sample(&mut rng);
            light + noise * (light + ALPHA) * normal
        })
    }

    /// So many times as large, each pixel the mean of its four neighbours by their distance.
    fn enlarged(planes: &Array3<f32>, times: f32) -> Array3<f32> {
        let (_, height, width) = planes.dim();
        let side = |pixels: usize| ((pixels - 1) as f32 * times) as usize;
        Array3::from_shape_fn((CHANNELS, side(height), side(width)), |(channel, y, x)| {
            let [y, x] = [y, x].map(|at| (at as f32 + 0.2) / times);
            let weights = |at: f32| [1.0 - at.fract(), at.fract()];
            let mut sum = 0.0;
            for (i, along_y) in weights(y).into_iter().enumerate() {
                for (j, along_x) in weights(x).into_iter().enumerate() {
                    let [y, x] = [(y as usize + i).min(height - 1), (x as usize + j).min(width - 1)];
                    sum += along_y * along_x * planes[[channel, y, x]];
                }
            }
            sum
        })
    }

    fn found(planes: Array3<f32>) -> Option<[f32; CHANNELS]> {
        noise_of_enlarged(&LinearImage::from_planes(planes).unwrap(), ALPHA, [15.9; CHANNELS])
    }

    #[test]
    fn the_noise_of_an_enlarged_capture_is_told() {
        let copied = |times: usize| {
            let small = capture(NOISE);
            Array3::from_shape_fn((CHANNELS, 120 * times, 120 * times), |(channel, y, x)| {
                small[[channel, y / times, x / times]]
            })
        };
        for (planes, times) in [
            (copied(2), 2.0),
            (copied(3), 3.0),
            (enlarged(&capture(NOISE), 1.5), 2.0),
            (enlarged(&capture(NOISE), 2.0), 2.0),
        ] {
            let found = found(planes).expect("noise");
            for noise in found {
                // Means of neighbours have less.
                assert!((0.5..1.1).contains(&(noise / (times * NOISE))), "{times}: {found:?}");
            }
        }
    }

    #[test]
    fn detail_that_colours_share_and_smooth_light_are_no_noise() {
        assert_eq!(found(enlarged(&capture(0.0), 2.0)), None);
        let mut rng = rng::stream(9, "detail");
        let detail = Array2::from_shape_simple_fn((120, 120), || -> f32 { StandardNormal.sample(&mut rng) });
        let shared = capture(0.0) * detail.mapv(|detail| 1.0 + 0.1 * detail);
        assert_eq!(found(enlarged(&shared, 2.0)), None);
        assert_eq!(found(Array3::zeros((CHANNELS, 9, 9))), None);
    }
}
