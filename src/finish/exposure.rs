//! Chooses from a picture which of its light is shown as middle grey and which as white.

use ndarray::{ArrayView3, s};
use rayon::prelude::*;

use super::{Curve, Look};
use crate::core::color::LUMINANCE;
use crate::core::image::LinearImage;

/// The share of white that is shown as middle grey: a card that reflects 18 %.
pub(super) const MIDDLE_GREY: f64 = 0.18;

/// The share of unclipped light that stays below white.
const BELOW_WHITE: f64 = 0.99;

/// How much brighter than the camera exposed it a picture is shown at most, as a factor: three stops. Beyond, there is
/// more noise than picture, and a night stays a night.
const LARGEST_PUSH: f64 = 8.0;

/// Values that are looked at, at most: more change no digit that is seen.
const MOST_SAMPLES: usize = 1 << 22;

/// Chooses the curve of a picture.
///
/// # Equation
/// Of the luminance Y after highlights and colour matrix: grey g is the median of Y, white w the value that 99 % of the
/// unclipped pixels stay below. Then
/// 1. `g ← max(g, 0.18·2⁻ᵇ/8)`, b being the baseline exposure in stops (1 is white of the longest exposure);
/// 2. `w ← min(max(w, g/0.18), m)`, with m = 2⁻ᵇ times the lowest white level of the channels, but not above the highest:
///    clipped light is white; of an image without levels, m is its `ceiling`;
/// 3. `g ← min(g, 0.18·w)`;
///
/// and [`Curve::Photographic`] shows g as middle grey and w as white. It is linear where the picture has no more range
/// than a lit page, and has a shoulder for more: the tone reproduction of Reinhard et al. (2002), whose key is the median
/// here, so that lamps do not darken the rest. Lamps brighter than w are white.
pub fn automatic_curve(image: &LinearImage, look: &Look, ceiling: f32) -> Curve {
    let (height, width) = (image.height(), image.width());
    let step = (1..).find(|step| (height / step + 1) * (width / step + 1) <= MOST_SAMPLES).unwrap_or(1);
    let sampled = image.planes().slice_move(s![.., ..;step, ..;step]);
    let samples: Vec<(f32, bool)> =
        (0..sampled.dim().1).into_par_iter().flat_map_iter(|y| row_of(sampled, y, look)).collect();
    let mut all: Vec<f32> = samples.iter().map(|(luminance, _)| *luminance).collect();
    let mut unclipped: Vec<f32> =
        samples.iter().filter(|(_, is_clipped)| !is_clipped).map(|(luminance, _)| *luminance).collect();
    let (median, high) = (quantile(&mut all, 0.5), quantile(&mut unclipped, BELOW_WHITE));
    let stops = f64::from(look.baseline_exposure_ev.unwrap_or(0.0));
    let grey = median.max(MIDDLE_GREY * (-stops).exp2() / LARGEST_PUSH);
    let mut most = f64::from(ceiling);
    if let Some(levels) = look.saturation {
        let levels = levels.map(f64::from);
        let [lowest, highest] =
            [levels.into_iter().fold(f64::INFINITY, f64::min), levels.into_iter().fold(0.0, f64::max)];
        most = (lowest * (-stops).exp2()).min(highest);
    }
    let white = high.max(grey / MIDDLE_GREY).min(most);
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    let [grey, white] = [grey.min(MIDDLE_GREY * white), white].map(|value| value as f32);
    Curve::Photographic { grey, white }
}

/// The luminance of a row's pixels, and whether they are clipped.
fn row_of<'a>(
    planes: ArrayView3<'a, f32>,
    y: usize,
    look: &'a Look,
) -> impl Iterator<Item = (f32, bool)> + 'a {
    (0..planes.dim().2).map(move |x| {
        let pixel = [planes[[0, y, x]], planes[[1, y, x]], planes[[2, y, x]]];
        let luminance =
            look.light_of(pixel).iter().zip(LUMINANCE).map(|(light, weight)| light * weight).sum();
        (luminance, look.is_clipped(pixel))
    })
}

/// The value that a share of the values stay below; 0 of none.
fn quantile(values: &mut [f32], share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index of the values")]
    let index = ((values.len() - 1) as f64 * share).round() as usize;
    f64::from(*values.select_nth_unstable_by(index, f32::total_cmp).1).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn image(light: impl Fn(usize) -> f32) -> LinearImage {
        LinearImage::from_planes(Array3::from_shape_fn((3, 20, 50), |(_, y, x)| light(50 * y + x))).unwrap()
    }

    fn shown(image: &LinearImage, look: &Look, light: f32) -> f32 {
        255.0 * automatic_curve(image, look, 500.0).apply(light)
    }

    fn capture(baseline_exposure_ev: Option<f32>) -> Look {
        Look { saturation: Some([1.9, 1.0, 1.6]), baseline_exposure_ev, ..Look::default() }
    }

    /// sRGB shows 18 % as 118 of 255.
    #[test]
    fn the_median_of_a_dark_capture_is_shown_as_middle_grey() {
        for median in [0.03, 0.1, 0.17] {
            let dark = image(|i| median * (0.5 + i as f32 / 1000.0));
            assert!((shown(&dark, &capture(None), median) - 118.0).abs() < 1.5, "{median}");
        }
    }

    #[test]
    fn lamps_are_white_and_do_not_darken_the_rest() {
        let card = image(|i| if i < 60 { 1.9 } else { 0.2 });
        assert!((shown(&card, &capture(None), 0.2) - 118.0).abs() < 12.0);
        assert_eq!(shown(&card, &capture(None), 1.9), 255.0);
        let scene = image(|i| if i < 60 { 400.0 } else { 0.2 });
        assert!((shown(&scene, &Look::default(), 0.2) - 118.0).abs() < 1.5);
        assert_eq!(shown(&scene, &Look::default(), 400.0), 255.0);
    }

    #[test]
    fn a_night_stays_darker_than_a_day_and_a_bright_page_is_white() {
        let night = image(|i| if i < 9 { 0.9 } else { 0.0005 });
        let grey = shown(&night, &capture(None), 0.0005);
        assert!((5.0..60.0).contains(&grey), "{grey}");
        let page = image(|i| if i < 100 { 0.1 } else { 0.9 });
        assert!(shown(&page, &capture(None), 0.9) > 235.0);
        assert_eq!(shown(&image(|_| 0.0), &capture(None), 0.0), 0.0);
        assert_eq!(shown(&image(|_| 1.9), &capture(None), 1.9), 255.0);
    }

    /// A camera that wants a stop more has its bright page at 0.45 of the photosites' range.
    #[test]
    fn baseline_exposure_is_respected() {
        let page = image(|i| if i < 100 { 0.05 } else { 0.45 });
        assert!(shown(&page, &capture(Some(1.0)), 0.45) > 235.0);
        assert!(shown(&page, &capture(None), 0.45) < 190.0);
        let dark = image(|_| 0.004);
        assert!(shown(&dark, &capture(Some(1.0)), 0.004) > shown(&dark, &capture(None), 0.004) + 5.0);
    }

    #[test]
    fn a_large_picture_is_sampled_evenly() {
        let planes = Array3::from_shape_fn((3, 3000, 2000), |(_, y, _)| y as f32 / 3000.0);
        let large = LinearImage::from_planes(planes).unwrap();
        let Curve::Photographic { grey, .. } = automatic_curve(&large, &Look::default(), 500.0) else {
            panic!("a photographic curve")
        };
        assert!((grey - 0.18).abs() < 0.01 || (grey - 0.5).abs() < 0.01, "{grey}");
    }
}
