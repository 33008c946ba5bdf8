//! Finds in an energy map that is to be a PSF what one exposure cannot hold: a core that was saturated, and flare below its least step.

use ndarray::ArrayView2;

use crate::core::broad_peak::take_region;

/// What is as bright as the peak, as a share of it: above a step of 8 bits, and noise of dark frames.
const LEVEL: f32 = 0.99;

/// The pixels of a level core at least: that of a point between pixels is four alike.
const LEAST_LEVEL: usize = 5;

/// The least share of the pixels above half the peak that are level in a core that was saturated; of a bell it is a seventieth.
const LEAST_SHARE: f64 = 0.25;

/// What is flare, as a share of the peak, and the share of all light that it has beside a core at least. A disc out of focus, whose light
/// is level too, has none.
const FLARE: f32 = 0.1;
const LEAST_FLARE: f64 = 0.05;

/// Pixels of the least step at least. Of light that no sensor counted, one has the least, and eight where layouts are symmetric.
const LEAST_STEP_PIXELS: usize = 16;

/// What is of one step, as a share of it.
const SAME_STEP: f32 = 1.01;

/// Pixels of a core that is level as a saturated one is, with flare around it; none of another.
pub(super) fn saturated_core(plane: ArrayView2<'_, f32>) -> Option<usize> {
    let (at, peak) =
        plane.indexed_iter().fold(
            ([0, 0], 0.0_f32),
            |most, ((y, x), value)| if *value > most.1 { ([y, x], *value) } else { most },
        );
    let around_peak = |share: f32| take_region(&mut plane.mapv(|value| value >= share * peak), at).0;
    let [level, half] = [LEVEL, 0.5].map(around_peak);
    let is_level = level >= LEAST_LEVEL && level as f64 >= LEAST_SHARE * half as f64;
    let light =
        |most: f32| plane.iter().filter(|v| **v > 0.0 && **v < most).map(|v| f64::from(*v)).sum::<f64>();
    (is_level && peak > 0.0 && light(FLARE * peak) >= LEAST_FLARE * light(f32::INFINITY)).then_some(level)
}

/// About the light that lies below the least step of a map of few steps, as a share of all: as much as the pixels of that step have, where
/// what is darker is zero. None of a map of many steps.
pub(super) fn below_steps(plane: ArrayView2<'_, f32>) -> f64 {
    let least =
        plane.iter().filter(|value| **value > 0.0).fold(f32::INFINITY, |least, value| least.min(*value));
    let (mut dark, mut of_step, mut light) = (0_usize, 0_usize, 0.0);
    for value in plane.iter().filter(|value| **value >= 0.0) {
        dark += usize::from(*value == 0.0);
        of_step += usize::from(*value > 0.0 && *value <= SAME_STEP * least);
        light += f64::from(*value);
    }
    let is_cut = of_step >= LEAST_STEP_PIXELS && dark >= of_step;
    if is_cut { of_step as f64 * f64::from(least) / light } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    const SIDE: usize = 129;

    /// A core as wide as that, eight orders, and a haze, with a peak of one.
    fn psf(width: f64) -> Array2<f32> {
        let at = |(y, x): (usize, usize)| {
            let (dy, dx) = (y as f64 - 64.0, x as f64 - 64.0);
            let bell =
                |cy: f64, cx: f64| (-((dy - cy).powi(2) + (dx - cx).powi(2)) / (2.0 * width * width)).exp();
            let orders: f64 = [-20.0, 0.0, 20.0]
                .into_iter()
                .flat_map(|cy| {
                    [-20.0, 0.0, 20.0].map(|cx| if (cy, cx) == (0.0, 0.0) { 0.0 } else { bell(cy, cx) })
                })
                .sum();
            (bell(0.0, 0.0) + 0.03 * orders + 3e-3 / (1.0 + dy.hypot(dx))) as f32
        };
        Array2::from_shape_fn((SIDE, SIDE), at)
    }

    #[test]
    fn a_core_that_was_saturated_is_told() {
        for width in [0.6, 1.5, 4.0] {
            assert_eq!(saturated_core(psf(width).view()), None, "{width}");
        }
        // Three times as bright as what saturates, in units of any size, and with the noise of a dark frame.
        let clipped = psf(1.5).mapv(|value| value.min(0.3));
        assert_eq!(saturated_core(clipped.view()), Some(16 + 5), "{clipped}");
        let scaled =
            clipped.indexed_iter().map(|((y, x), value)| 900.0 * value + 0.5 * ((y * 7 + x * 3) % 5) as f32);
        let scaled = Array2::from_shape_vec((SIDE, SIDE), scaled.collect()).unwrap();
        assert_eq!(saturated_core(scaled.view()), Some(16 + 5));
    }

    /// A disc, a point between pixels, a plane without a core, and one pixel.
    #[test]
    fn light_that_is_level_by_itself_was_not_saturated() {
        let disc = Array2::from_shape_fn((33, 33), |(y, x)| {
            let radius = (y as f32 - 16.0).hypot(x as f32 - 16.0);
            (6.5 - radius).clamp(0.0, 1.0)
        });
        assert_eq!(saturated_core(disc.view()), None);
        let mut between = psf(1.5).mapv(|value| 0.2 * value.min(0.05));
        between.slice_mut(ndarray::s![64..66, 64..66]).fill(1.0);
        assert_eq!(saturated_core(between.view()), None);
        assert_eq!(saturated_core(Array2::ones((20, 20)).view()), None);
        assert_eq!(saturated_core(Array2::ones((1, 1)).view()), None);
        assert_eq!(saturated_core(Array2::zeros((5, 5)).view()), None);
    }

    #[test]
    fn light_below_the_steps_of_one_exposure_is_told() {
        let whole = psf(0.6);
        assert!(
            below_steps(whole.view()) == 0.0
                && below_steps(whole.mapv(|v| half::f16::from_f32(v).to_f32()).view()) == 0.0
        );
        for steps in [255.0, 1023.0] {
            let coarse = whole.mapv(|value| (steps * value).round() / steps);
            let missing = 1.0 - coarse.sum() / whole.sum();
            let told = below_steps(coarse.view());
            assert!(told > 0.02 && missing > 0.02, "{steps}: {told} told, {missing} missing");
        }
        // A core with some orders, and nothing else.
        let mut sparse = Array2::zeros((SIDE, SIDE));
        sparse[[64, 64]] = 1.0_f32;
        for at in [(44, 64), (84, 64), (64, 44), (64, 84), (44, 44), (44, 84), (84, 44), (84, 84)] {
            sparse[at] = 0.02;
        }
        assert_eq!(below_steps(sparse.view()), 0.0);
        assert_eq!(below_steps(Array2::zeros((5, 5)).view()), 0.0);
    }
}
