//! Finds hot pixels in an energy map that is to be a PSF.

use ndarray::{Array3, ArrayView2, Axis};

use crate::core::lone::stands_alone;

/// The least light of a lone pixel that is worth a word, as a share of the peak. One of 0.3 took 11 dB.
const LEAST: f32 = 0.01;

/// Deviations of the map's noise that it is above.
const OVER_NOISE: f64 = 20.0;

/// The brightest pixel that stands alone: its channel, row and column, and its light as a share of the channel's peak.
pub(super) fn lone_pixel(planes: &Array3<f32>, noise: [Option<f64>; 3]) -> Option<([usize; 3], f32)> {
    let of_channel = |(channel, (plane, noise)): (usize, (ArrayView2<'_, f32>, Option<f64>))| {
        let ((y, x), share) = lone_in(plane, noise.unwrap_or_default())?;
        Some(([channel, y, x], share))
    };
    let found = planes.axis_iter(Axis(0)).zip(noise).enumerate().filter_map(of_channel);
    found.max_by(|(_, a), (_, b)| a.total_cmp(b))
}

fn lone_in(plane: ArrayView2<'_, f32>, noise: f64) -> Option<((usize, usize), f32)> {
    let (height, width) = plane.dim();
    let peak = plane.iter().copied().fold(0.0, f32::max);
    let bright = plane.indexed_iter().filter(|(_, value)| {
        **value < peak && **value >= LEAST * peak && f64::from(**value) > OVER_NOISE * noise
    });
    let is_lone = |at: (usize, usize)| stands_alone(plane, at, [height / 2, width / 2], 1);
    let lone = bright.filter(|(at, _)| is_lone(*at)).map(|(at, value)| (at, value / peak));
    lone.max_by(|(_, a), (_, b)| a.total_cmp(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A core, two orders, and a pixel as bright as told.
    fn psf(pixel: f32) -> Array3<f32> {
        Array3::from_shape_fn((3, 33, 32), |(channel, y, x)| match (channel, y, x) {
            (_, 16, 16) => 1.0,
            (_, 8, 16) | (_, 24, 16) => 0.2,
            (2, 4, 9) => pixel,
            _ => 1e-4,
        })
    }

    #[test]
    fn a_hot_pixel_has_no_counterpart_and_orders_have_one() {
        assert_eq!(lone_pixel(&psf(0.3), [None; 3]), Some(([2, 4, 9], 0.3)));
        assert_eq!(lone_pixel(&psf(1e-3), [None; 3]), None);
        assert_eq!(lone_pixel(&psf(0.3), [Some(0.02); 3]), None, "of noise as large");
        let mut spread = psf(0.3);
        spread[[2, 5, 9]] = 0.05;
        assert_eq!(lone_pixel(&spread, [None; 3]), None);
        let mut pair = psf(0.3);
        pair[[2, 28, 23]] = 0.2;
        assert_eq!(lone_pixel(&pair, [None; 3]), None);
    }

    #[test]
    fn at_any_border_and_of_any_size_there_may_be_one() {
        for at in [[0, 0, 0], [1, 32, 31], [2, 0, 31]] {
            let mut planes = psf(0.0);
            planes[at] = 0.5;
            assert_eq!(lone_pixel(&planes, [None; 3]), Some((at, 0.5)));
        }
        for size in [(3, 1, 1), (3, 2, 1), (3, 3, 3)] {
            assert_eq!(lone_pixel(&Array3::ones(size), [None; 3]), None);
        }
    }
}
