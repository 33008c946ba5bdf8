//! Tells of light that every pixel of a picture has in common, as where a sensor's black level was left in.
//!
//! A panel spreads light, and a deconvolution brings it together again; what a sensor adds to every pixel stays. It is the same in all
//! colours of a raw capture, and the darkest light of a scene is not.

use std::fmt;

use ndarray::ArrayView2;
use serde::Serialize;

use crate::core::image::CHANNELS;
use crate::core::tone::ToneCurve;
use crate::io::AnyImage;

/// The share of a picture's pixels that are darker than its darkest light, noise and overshoots among them.
const DARKER: f64 = 0.005;

/// The part of the brightest captured light that the darkest has at least, and how far the colours may lie apart in it. Of 184 views of
/// panoramas and painted scenes 29 have as much, of which the colours of one lie within 5 % and those of none within 4; with a black level
/// of 64 of 1023 in each, those of 79 do.
const LEAST: f32 = 0.015;
const APART: f32 = 0.04;

/// Pixels that are looked at, at most.
const MOST_SAMPLES: usize = 1 << 18;

/// Light that all pixels of a picture have in all colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Floor {
    /// In the capture's units.
    pub light: f32,
    /// As a part of the capture's brightest light.
    pub share: f32,
}

impl fmt::Display for Floor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// Below it, three decimals would not tell it.
        const SMALL: f32 = 0.01;
        let Self { light, share } = *self;
        let light = if light < SMALL { format!("{light:.2e}") } else { format!("{light:.3}") };
        write!(
            f,
            "the darkest light is {light} in all colours, {:.1} % of the brightest, as where a sensor's black level was left in; if so, \
             take it away before, or tell --black, and --white where that is not 1",
            100.0 * share
        )
    }
}

impl Floor {
    /// That of a restored picture, if it has one; its capture is as bright as `brightest` at most, and values of pictures that do not say
    /// how they were tone-mapped are by `curve`.
    pub(super) fn of(restored: &AnyImage, brightest: f32, curve: ToneCurve) -> Option<Self> {
        let darkest: [f32; CHANNELS] = std::array::from_fn(|channel| match restored {
            AnyImage::Linear(image) => darkest(image.channel(channel)),
            AnyImage::ToneMapped(image, own) => own.unwrap_or(curve).expand(darkest(image.channel(channel))),
        });
        let [least, most] = [f32::min, f32::max].map(|of| darkest.into_iter().fold(darkest[0], of));
        let share = least / brightest;
        (share >= LEAST && most <= (1.0 + APART) * least).then_some(Self { light: least, share })
    }
}

/// The brightest light of a capture; values that do not say how they were tone-mapped are by `curve`.
pub(super) fn brightest(image: &AnyImage, curve: ToneCurve) -> f32 {
    match image {
        AnyImage::Linear(image) => image.max(),
        AnyImage::ToneMapped(image, own) => own.unwrap_or(curve).expand(image.max()),
    }
}

/// The darkest light of a plane but for so few pixels.
fn darkest(plane: ArrayView2<'_, f32>) -> f32 {
    let mut sampled: Vec<f32> = plane.iter().step_by(plane.len() / MOST_SAMPLES + 1).copied().collect();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a length")]
    let darker = (DARKER * sampled.len() as f64) as usize;
    if sampled.is_empty() { 0.0 } else { *sampled.select_nth_unstable_by(darker, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;
    use crate::core::image::LinearImage;

    const CURVE: ToneCurve = ToneCurve { alpha: 0.25, x_max: 1.0 };

    /// Light that is a little darker in some colours, over a black level.
    fn image(black: f32, darkest: [f32; CHANNELS]) -> LinearImage {
        LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, 40, 50), |(channel, y, x)| {
            (black + darkest[channel] + 0.9 * (y * 50 + x) as f32 / 2000.0).min(1.0)
        }))
        .unwrap()
    }

    fn floor(black: f32, darkest: [f32; CHANNELS]) -> Option<Floor> {
        Floor::of(&AnyImage::Linear(image(black, darkest)), 1.0, CURVE)
    }

    #[test]
    fn a_black_level_that_was_left_in_is_told() {
        let found = floor(0.0626, [0.0, 0.0005, 0.001]).expect("a floor");
        assert!((found.light - 0.067).abs() < 0.002 && (found.share - found.light).abs() < 1e-6, "{found:?}");
        let mapped = CURVE.tone_map(&image(0.0626, [0.0, 0.0005, 0.001]));
        let of_mapped = Floor::of(&AnyImage::ToneMapped(mapped, None), 1.0, CURVE).expect("a floor");
        assert!((of_mapped.light - found.light).abs() < 1e-4, "{of_mapped:?}");
    }

    #[test]
    fn light_of_small_units_is_told_in_them() {
        let told = |light: f32| Floor { light, share: 0.1 }.to_string();
        assert!(told(6.26e-8).contains("6.26e-8 in all colours"), "{}", told(6.26e-8));
        assert!(told(63.7).contains("63.700 in all colours"), "{}", told(63.7));
    }

    #[test]
    fn darkness_and_light_of_a_colour_are_none() {
        assert_eq!(floor(0.0, [0.0; CHANNELS]), None, "it is dark somewhere");
        assert_eq!(floor(0.0, [0.06, 0.07, 0.1]), None, "a sky");
        assert_eq!(floor(-0.1, [0.0; CHANNELS]), None);
        let empty = LinearImage::from_planes(Array3::zeros((CHANNELS, 0, 0)));
        assert!(empty.is_err() || Floor::of(&AnyImage::Linear(empty.unwrap()), 0.0, CURVE).is_none());
        let dark = AnyImage::Linear(LinearImage::from_planes(Array3::zeros((CHANNELS, 4, 4))).unwrap());
        assert_eq!(Floor::of(&dark, brightest(&dark, CURVE), CURVE), None);
    }
}
