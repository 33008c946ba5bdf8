//! Estimates the noise of a capture's colours from the detail that each has apart from the others.
//!
//! Detail of a scene is much the same in all colours, relative to their brightness, and noise of measured pixels is not: what the
//! detail of one colour shares with that of the others is the scene's, however fine. Of what is left the noise is estimated as of a
//! colour alone ([`of_details`]).

use std::array;

use half::f16;
use ndarray::ArrayView2;

use super::super::noise::{BANDS, Detail, of_details};
use super::interpolation::{Finest, WHITE};
use super::noise_level::{NOISE_FREE, variance_of};
use super::places::Place;
use crate::core::image::{CHANNELS, LinearImage};

/// Pixels without which nothing is told.
const LEAST_PLACES: usize = 400;

/// The correlation of two colours below which they share nothing that could be divided by.
const LEAST_CORRELATION: f64 = 0.05;

/// Colours that have to show noise, for what one has apart may be a scene of that colour.
const LEAST_COLORS: usize = 2;

/// How many times as much noise as rounding makes what is apart has to be.
const LEAST_OF_STEPS: f32 = 2.0;

/// Pixels that are looked at to see whether values are steps of a converter, and of how many of them one has to have another's value.
const LOOKED_AT: usize = 4096;
const EQUAL_OF: usize = 20;

/// Values of a plane's pixels that are not black, in ascending order.
fn values_of(plane: ArrayView2<'_, f32>) -> Vec<f32> {
    let step = plane.len() / LOOKED_AT + 1;
    let mut values: Vec<f32> = plane.iter().step_by(step).copied().filter(|value| *value > 0.0).collect();
    values.sort_unstable_by(f32::total_cmp);
    values
}

/// Whether values are steps of a sensor's converter, and so have noise: many are equal, which light is not that was computed, unless
/// it was rounded to half floats.
pub(super) fn is_quantised(image: &LinearImage) -> bool {
    (0..CHANNELS).all(|channel| {
        let values = values_of(image.channel(channel));
        let equal = values.windows(2).filter(|pair| pair[0].total_cmp(&pair[1]).is_eq()).count();
        let are_half = values.iter().all(|value| f16::from_f32(*value).to_f32().total_cmp(value).is_eq());
        let are_counts = || values.iter().all(|value| value.fract().abs() < f32::EPSILON);
        EQUAL_OF * equal > values.len() && (!are_half || are_counts())
    })
}

/// The standard deviation of the noise of `ln(y + α)` in each channel, where the capture shows one; `left` are the parts of the scene's
/// detail that the PSF leaves in each band of each channel.
///
/// # Method
/// With detail `dᵢ = nᵢ + aᵢ·s`, n independent and s shared, the covariances are `Cᵢⱼ = aᵢ·aⱼ·Var s`, so that
/// `Cᵢⱼ·Cᵢₖ / Cⱼₖ` is the variance of what i shares. Covariances are robust:
/// `Cᵢⱼ = σᵢ·σⱼ·(m²(dᵢ/σᵢ + dⱼ/σⱼ) − m²(dᵢ/σᵢ − dⱼ/σⱼ)) / 4`, m being the median modulus over that of a normal variable.
pub(super) fn noise_apart(places: &[Place], left: [[f64; BANDS.len()]; CHANNELS]) -> Option<[f32; CHANNELS]> {
    if places.len() < LEAST_PLACES {
        return None;
    }
    let variances: [[f64; CHANNELS]; BANDS.len()] = array::from_fn(|band| variances_apart(places, band));
    let noise: [f32; CHANNELS] = array::from_fn(|channel| {
        let detail = |band: usize| Detail { variance: variances[band][channel], left: left[channel][band] };
        #[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
        let noise = of_details(array::from_fn(detail)) as f32;
        noise
    });
    let noisy = noise.iter().filter(|sigma| **sigma > NOISE_FREE).count();
    (noisy >= LEAST_COLORS).then_some(noise)
}

/// The same of a capture that shows noise, where its finest detail is shared by all colours, and so is the scene's: gravel, lawn, cloth.
///
/// Noise that a picture shares among its colours, as one has of which those were smoothed, is not distinguished from detail by that. There
/// what is apart is smooth, or no more than the steps of its values.
pub(super) fn noise_below_detail(
    places: &[Place],
    left: [[f64; BANDS.len()]; CHANNELS],
    (image, alpha): (&LinearImage, f32),
) -> Option<[f32; CHANNELS]> {
    if !Finest::of_places(places).is_shared {
        return None;
    }
    let noise = noise_apart(places, left)?;
    let [finest, fine] = [0, 1].map(|band| variances_apart(places, band));
    let is_white = |channel: usize| finest[channel] >= f64::from(WHITE[0]) * fine[channel];
    let is_above_steps =
        |channel: usize| noise[channel] >= LEAST_OF_STEPS * noise_of_steps(image.channel(channel), alpha);
    let white = (0..CHANNELS).filter(|channel| is_white(*channel) && is_above_steps(*channel)).count();
    (white >= LEAST_COLORS).then_some(noise)
}

/// The standard deviation of `ln(y + α)` that rounding gives to values in middling brightness.
fn noise_of_steps(plane: ArrayView2<'_, f32>, alpha: f32) -> f32 {
    /// The rounding of a step of one is evenly spread.
    const OF_STEP: f32 = 0.288_675;
    /// What differs by less is the same, but for rounding to 32 bits.
    const LEAST_STEP: f32 = 1e-6;
    let values = values_of(plane);
    let quarter = values.len() / 4;
    let middle = &values[quarter..values.len() - quarter];
    let Some(median) = middle.get(middle.len() / 2) else { return 0.0 };
    let steps = middle.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > LEAST_STEP * median);
    let least = steps.fold(f32::INFINITY, f32::min);
    if least.is_finite() { OF_STEP * least / (median + alpha) } else { 0.0 }
}

/// The variance of what each colour has apart from the others in a band.
fn variances_apart(places: &[Place], band: usize) -> [f64; CHANNELS] {
    let mut moduli = Vec::with_capacity(places.len());
    let mut variance = |of: &dyn Fn(&[f32; CHANNELS]) -> f32| {
        moduli.clear();
        moduli.extend(places.iter().map(|place| of(&place.details[band]).abs()));
        variance_of(&mut moduli)
    };
    let whole: [f64; CHANNELS] = array::from_fn(|channel| variance(&|details| details[channel]));
    #[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
    let inverse = whole.map(|variance| variance.sqrt().max(f64::MIN_POSITIVE).recip() as f32);
    let mut correlation = |a: usize, b: usize| {
        let sum = variance(&|details| details[a] * inverse[a] + details[b] * inverse[b]);
        let difference = variance(&|details| details[a] * inverse[a] - details[b] * inverse[b]);
        0.25 * (sum - difference)
    };
    // Of the two colours beside each.
    let opposite = [correlation(1, 2), correlation(2, 0), correlation(0, 1)];
    array::from_fn(|channel| {
        let [beside, other] = [opposite[(channel + 1) % CHANNELS], opposite[(channel + 2) % CHANNELS]];
        let is_shared = opposite[channel] > LEAST_CORRELATION && beside > 0.0 && other > 0.0;
        let shared = if is_shared { (beside * other / opposite[channel]).min(1.0) } else { 0.0 };
        whole[channel] * (1.0 - shared)
    })
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3, Axis, s};
    use rand_distr::{Distribution, StandardNormal};

    use super::super::places::places_of;
    use super::*;
    use crate::core::rng;

    const ALPHA: f32 = 0.25;
    const DETAIL: f32 = 0.04;

    /// Brightness that differs from pixel to pixel, alike in all colours, and noise of each colour.
    fn capture(noise: [f32; CHANNELS]) -> LinearImage {
        let mut rng = rng::stream(7, "noise apart");
        let mut normal = move || -> f32 { StandardNormal.sample(&mut rng) };
        let mut planes = Array3::<f32>::zeros((CHANNELS, 128, 160));
        for y in 0..128 {
            for x in 0..160 {
                let detail = DETAIL * normal();
                for channel in 0..CHANNELS {
                    let error = noise[channel] * normal();
                    planes[[channel, y, x]] =
                        (0.3 + ALPHA + 0.1 * channel as f32) * (detail + error).exp() - ALPHA;
                }
            }
        }
        LinearImage::from_planes(planes).unwrap()
    }

    /// As of a PSF that leaves all detail as it is, which is then no less in the finest band than in others.
    fn found(capture: &LinearImage) -> Option<[f32; CHANNELS]> {
        noise_apart(&places_of(capture, ALPHA, [16.0; CHANNELS]), [[0.2, 0.5, 0.8]; CHANNELS])
    }

    #[test]
    fn noise_below_detail_that_colours_share_is_told() {
        let noise = [0.01, 0.02, 0.015];
        for (found, expected) in found(&capture(noise)).unwrap().into_iter().zip(noise) {
            assert!((found / expected - 1.0).abs() < 0.2, "{found} {expected}");
        }
    }

    #[test]
    fn noise_below_detail_is_told_of_what_is_white_and_above_steps() {
        let noise = [0.01, 0.02, 0.015];
        let found = |capture: &LinearImage| {
            let places = places_of(capture, ALPHA, [16.0; CHANNELS]);
            noise_below_detail(&places, [[0.2, 0.5, 0.8]; CHANNELS], (capture, ALPHA))
        };
        let steps = |of_white: f32, capture: &LinearImage| {
            capture.map_values(move |value| (value * of_white).round() / of_white)
        };
        // Four times the noise.
        let detailed = capture(noise.map(|noise| 0.5 * noise));
        for (found, expected) in found(&steps(4095.0, &detailed)).unwrap().into_iter().zip(noise) {
            assert!((found / (0.5 * expected) - 1.0).abs() < 0.3, "{found} {expected}");
        }
        assert_eq!(found(&capture([0.05; CHANNELS])), None, "noise, not detail");
        // Detail alone, as of a picture whose colours were smoothed.
        assert_eq!(found(&steps(255.0, &capture([0.0; CHANNELS]))), None, "steps alone");
        let mut smooth = detailed.clone().into_planes();
        let green = smooth.index_axis(Axis(0), 1).to_owned();
        for channel in [0, 2] {
            let ratio = smooth.index_axis(Axis(0), channel).to_owned() / &green;
            let mean = Array2::from_shape_fn(ratio.dim(), |(y, x)| {
                let [rows, columns] =
                    [(y, 128), (x, 160)].map(|(at, end)| at.saturating_sub(2)..(at + 3).min(end));
                ratio.slice(s![rows, columns]).mean().unwrap()
            });
            smooth.index_axis_mut(Axis(0), channel).assign(&(mean * &green));
        }
        assert_eq!(found(&LinearImage::from_planes(smooth).unwrap()), None, "colours that were smoothed");
    }

    #[test]
    fn steps_of_a_converter_are_told_from_light_and_from_its_rounding() {
        let light = capture([0.01; CHANNELS]);
        let steps = |of_white: f32| light.map_values(move |value| (value * of_white).round() / of_white);
        assert!(is_quantised(&steps(1023.0)) && is_quantised(&steps(4095.0)));
        assert!(is_quantised(&light.map_values(|value| (1023.0 * value).round())));
        assert!(!is_quantised(&light));
        assert!(!is_quantised(&light.map_values(|value| f16::from_f32(value).to_f32())));
    }

    #[test]
    fn without_noise_or_pixels_nothing_is_told() {
        assert_eq!(found(&capture([0.0; CHANNELS])), None);
        assert_eq!(found(&LinearImage::from_planes(Array3::zeros((CHANNELS, 64, 64))).unwrap()), None);
        assert_eq!(found(&LinearImage::from_planes(Array3::from_elem((CHANNELS, 5, 5), 0.3)).unwrap()), None);
    }
}
