//! Finds the light at which a capture saturates, where nobody says it.

use ndarray::ArrayView2;

use crate::core::image::{CHANNELS, LinearImage};
use crate::core::saturation::saturated_from;

/// Pixels that have to be equally bright to be taken for saturated: fewer may be the core of a lamp.
const LEAST_PIXELS: usize = 16;

/// The part of the brightest value that counts as just as bright: rounding to half floats.
const SAME: f32 = 0.998;

/// Saturated pixels for each that is nearly as bright: a sensor's white ends like a cut, a lamp's image like a bell.
const CUT: usize = 2;

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
    (brightest > 0.0 && equal >= LEAST_PIXELS && equal >= CUT * near).then_some((brightest, equal))
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

    #[test]
    fn a_flat_or_dark_image_is_not_white() {
        let dark = LinearImage::from_planes(Array3::zeros((3, 8, 8))).unwrap();
        assert_eq!(find_levels(&dark, 500.0), ([500.0; 3], 0));
    }
}
