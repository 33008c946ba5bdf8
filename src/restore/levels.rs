//! Finds the light at which a capture saturates, where nobody says it, and the tone curve that suits its units.

use ndarray::ArrayView2;

use crate::core::image::{CHANNELS, LinearImage};
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;

/// Pixels that have to be equally bright to be taken for saturated: fewer may be the core of a lamp.
const LEAST_PIXELS: usize = 16;

/// The part of the brightest value that counts as just as bright: rounding to half floats.
const SAME: f32 = 0.998;

/// Saturated pixels for each that is nearly as bright: a sensor's white ends like a cut, a lamp's image like a bell.
const CUT: usize = 2;

/// Of so many pixels one may be saturated: an image that is flat for the most part is of something flat.
const MOST_OF: usize = 2;

/// What light is in multiples of α where it saturates, at least and at most, in the captures that networks are trained on.
const LEVELS: [f32; 2] = [4.0, 2000.0];

/// α of a scene exposed like those, over the median of its green light.
const ALPHA_OVER_MEDIAN: f32 = 2.0;

/// The curve itself where a capture is of light as networks know it; for one in much larger units, counts of a sensor for
/// example, one whose α is as large beside its light as theirs.
pub(super) fn suited_curve(curve: ToneCurve, image: &LinearImage) -> ToneCurve {
    let [least, most] = LEVELS;
    if curve.x_max <= most * curve.alpha {
        return curve;
    }
    let mut green: Vec<f32> = image.channel(1).iter().copied().collect();
    let middle = green.len() / 2;
    let (_, median, _) = green.select_nth_unstable_by(middle, f32::total_cmp);
    let alpha = (ALPHA_OVER_MEDIAN * *median).clamp(curve.x_max / most, curve.x_max / least);
    ToneCurve { alpha, ..curve }
}

/// Finds the white level of each channel of a capture: the value that its brightest pixels share, if that ends like a cut.
/// Channels without such a value saturate above all that they show, and at no less than `usual`.
///
/// The second number is how many pixels were found to be saturated.
pub(super) fn find_levels(image: &LinearImage, usual: f32) -> ([f32; CHANNELS], usize) {
    let found: [Option<(f32, usize)>; CHANNELS] =
        std::array::from_fn(|channel| plateau(image.channel(channel)));
    let count = found.iter().flatten().map(|(_, count)| count).sum();
    let levels = std::array::from_fn(|channel| {
        found[channel].map_or_else(
            || {
                let brightest = image.channel(channel).iter().fold(0.0, |most: f32, value| most.max(*value));
                usual.max(brightest / saturated_from(1.0) * (1.0 + f32::EPSILON.sqrt()))
            },
            |(level, _)| level,
        )
    });
    (levels, count)
}

/// The value of the brightest pixels and their number, if they are many and few are nearly as bright.
fn plateau(plane: ArrayView2<'_, f32>) -> Option<(f32, usize)> {
    let brightest = plane.iter().fold(0.0, |most: f32, value| most.max(*value));
    let (mut equal, mut near) = (0, 0);
    for value in plane {
        if *value >= SAME * brightest {
            equal += 1;
        } else if *value >= (2.0 * SAME - 1.0 - 4.0 * (1.0 - SAME)) * brightest {
            near += 1;
        }
    }
    let is_cut = equal >= LEAST_PIXELS && equal >= CUT * near && MOST_OF * equal <= plane.len();
    (brightest > 0.0 && is_cut).then_some((brightest, equal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn scene(limit: f32) -> LinearImage {
        let light = |y: usize, x: usize| {
            0.2 + 90.0 * (-((y as f32 - 30.0).powi(2) + (x as f32 - 20.0).powi(2)) / 80.0).exp()
        };
        LinearImage::from_planes(Array3::from_shape_fn((3, 64, 64), |(_, y, x)| light(y, x).min(limit)))
            .unwrap()
    }

    #[test]
    fn a_lamp_that_is_cut_off_saturates_and_one_that_is_not_does_not() {
        let (levels, count) = find_levels(&scene(16.0), 500.0);
        assert_eq!(levels, [16.0; 3]);
        assert!(count > 3 * 100, "{count}");
        assert_eq!(find_levels(&scene(1e3), 500.0), ([500.0; 3], 0));
    }

    #[test]
    fn an_image_that_is_brighter_than_usual_is_below_its_own_level() {
        let bright = LinearImage::from_planes(scene(1e3).into_planes() * 10.0).unwrap();
        let (levels, count) = find_levels(&bright, 500.0);
        let brightest = bright.as_slice().iter().fold(0.0f32, |a, b| a.max(*b));
        assert!(count == 0 && levels.iter().all(|level| saturated_from(*level) > brightest), "{levels:?}");
    }

    /// What is 2000 times as large is tone-mapped to the same.
    #[test]
    fn counts_are_mapped_as_the_light_that_they_count() {
        let light = ToneCurve::new(0.25, 8.0).unwrap();
        let image = scene(8.0).map_values(|value| 0.6 * value);
        assert_eq!(suited_curve(light, &image), light);
        let counts = image.map_values(|value| 2000.0 * value);
        let curve = suited_curve(ToneCurve::new(0.25, 16_000.0).unwrap(), &counts);
        let median = 0.6 * 0.2;
        assert!((curve.alpha / (2000.0 * 2.0 * median) - 1.0).abs() < 0.1, "{curve:?}");
        assert_eq!(curve.x_max, 16_000.0);
        let black = LinearImage::from_planes(Array3::zeros((3, 8, 8))).unwrap();
        assert_eq!(suited_curve(curve, &black).alpha, curve.alpha);
        assert_eq!(suited_curve(ToneCurve { alpha: 0.25, ..curve }, &black).alpha, 8.0);
    }

    #[test]
    fn a_flat_or_dark_image_is_not_white() {
        let dark = LinearImage::from_planes(Array3::zeros((3, 8, 8))).unwrap();
        assert_eq!(find_levels(&dark, 500.0), ([500.0; 3], 0));
        let wall = LinearImage::from_planes(Array3::from_elem((3, 8, 8), 0.5)).unwrap();
        assert_eq!(find_levels(&wall, 500.0), ([500.0; 3], 0));
    }
}
