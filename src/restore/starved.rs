//! Keeps a network from lighting dots where so few photons are counted that it knows nothing of.

use ndarray::{Array2, ArrayView2, Zip};
use rayon::prelude::*;

use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::tone::ToneCurve;

/// The relative noise of a capture from which on it is starved of photons. Of eight scenes with 190 photoelectrons at white it is 0.27 to
/// 0.38, and with 60, which the limit changes by 0.01 dB at most, 0.51 to 0.65. Of frames of which a pixel counts one and less it is 0.7
/// and more, and single counts came out up to 76 times as bright as any.
const STARVED: f32 = 0.5;

/// How much brighter than the brightest of a pixel and its neighbours, in the capture and its deconvolution, it may be.
const BRIGHTER: f32 = 1.5;

/// Limits a restored image of a capture whose relative noise says that it is starved; others stay as they are.
///
/// # Errors
/// Never for images of one size.
pub(super) fn without_dots(
    restored: ToneMappedImage,
    (capture, deconvolved): (&LinearImage, &ToneMappedImage),
    (relative_noise, curve): ([f32; CHANNELS], ToneCurve),
) -> Result<ToneMappedImage> {
    if relative_noise.iter().all(|noise| *noise < STARVED) {
        return Ok(restored);
    }
    let mut planes = restored.into_planes();
    planes.outer_iter_mut().into_par_iter().enumerate().for_each(|(channel, mut plane)| {
        let seen = Zip::from(capture.channel(channel))
            .and(deconvolved.channel(channel))
            .map_collect(|captured, found| captured.max(curve.expand(*found)));
        let most = brightest_around(seen.view());
        Zip::from(&mut plane).and(&most).for_each(|value, most| {
            *value = value.min(curve.compress(BRIGHTER * most));
        });
    });
    ToneMappedImage::from_planes(planes)
}

/// The brightest of each pixel and its neighbours.
fn brightest_around(plane: ArrayView2<'_, f32>) -> Array2<f32> {
    let (height, width) = plane.dim();
    let around = |place: usize, length: usize| place.saturating_sub(1)..(place + 2).min(length);
    Array2::from_shape_fn((height, width), |(y, x)| {
        let rows = around(y, height);
        rows.flat_map(|y| around(x, width).map(move |x| plane[[y, x]])).fold(0.0, f32::max)
    })
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    #[test]
    fn a_starved_capture_gets_no_light_that_nothing_shows() {
        let curve = ToneCurve::new(0.25, 16.0).unwrap();
        let seen = Array3::from_shape_fn((3, 6, 7), |(_, y, x)| if (y, x) == (2, 3) { 0.02 } else { 0.001 });
        let capture = LinearImage::from_planes(seen.clone()).unwrap();
        let deconvolved = curve.tone_map(&LinearImage::from_planes(0.5 * seen).unwrap());
        let restored = || ToneMappedImage::from_planes(Array3::from_elem((3, 6, 7), 0.9)).unwrap();
        let of = |noise: f32| {
            without_dots(restored(), (&capture, &deconvolved), ([noise; CHANNELS], curve)).unwrap()
        };
        assert_eq!(of(0.4), restored());
        let limited = curve.inverse_tone_map(&of(0.8));
        for (at, expected) in [((2, 3), 0.03), ((3, 4), 0.03), ((2, 5), 0.0015), ((0, 0), 0.0015)] {
            let light = limited.channel(1)[at];
            assert!((light / expected - 1.0).abs() < 1e-3, "{at:?}: {light}");
        }
    }
}
