//! Takes the noise of a measurement out of an energy map that is to be a PSF.

use ndarray::{Array3, ArrayView2, Axis};
use rayon::prelude::*;

use crate::core::haze;

/// The share of pixels below zero from which on they may be noise around it.
const LEAST_NEGATIVE: f64 = 0.05;

/// Fewer pixels below zero are no noise that can be measured.
const LEAST_PIXELS: usize = 50;

/// The share of pixels within two deviations that may be negative: of noise around zero a half and less, of a background that was
/// subtracted twice nearly all.
const MOST_NEGATIVE: f64 = 0.6;

/// The median of the absolute values of noise, as a share of its deviation.
const MEDIAN: f64 = 0.674_489_8;

/// The standard deviation of noise around zero, told by what is below that; none of a map without noise, or with a wrong background.
pub(super) fn noise_of(plane: ArrayView2<'_, f32>) -> Option<f64> {
    let mut below: Vec<f32> = plane.iter().filter(|value| **value < 0.0).map(|value| -value).collect();
    if below.len() < LEAST_PIXELS || (below.len() as f64) < LEAST_NEGATIVE * plane.len() as f64 {
        return None;
    }
    let middle = below.len() / 2;
    let deviation = f64::from(*below.select_nth_unstable_by(middle, f32::total_cmp).1) / MEDIAN;
    let [negative, within] = plane.iter().fold([0_usize; 2], |[negative, within], value| {
        let is_within = f64::from(value.abs()) <= 2.0 * deviation;
        [negative + usize::from(is_within && *value < 0.0), within + usize::from(is_within)]
    });
    (negative as f64 <= MOST_NEGATIVE * within as f64).then_some(deviation)
}

/// Replaces what noise hides in the channels that have some by local means: cut off at zero, it would be a haze.
pub(super) fn without_noise(mut planes: Array3<f32>, noise: [Option<f64>; 3]) -> Array3<f32> {
    let channels: Vec<_> = planes.axis_iter_mut(Axis(0)).zip(noise).collect();
    channels.into_par_iter().for_each(|(mut plane, noise)| {
        if let Some(deviation) = noise {
            let kept = haze::without_noise(plane.mapv(f64::from).view(), deviation);
            #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
            plane.zip_mut_with(&kept, |value, kept| *value = *kept as f32);
        }
    });
    planes
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use rand_distr::{Distribution as _, Normal};

    use super::*;
    use crate::core::rng::stream;

    const SIDE: usize = 129;

    /// A core, eight orders, and haze; with noise of a deviation.
    fn psf(deviation: f64) -> (Array2<f32>, Array2<f32>) {
        let light = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
            let (dy, dx) = (y as f64 - 64.0, x as f64 - 64.0);
            let is_order = dy.abs().max(dx.abs()) == 20.0 && dy % 20.0 == 0.0 && dx % 20.0 == 0.0;
            let core = 0.3 * (-(dy * dy + dx * dx) / 3.0).exp();
            core + 2e-5 * (-dy.hypot(dx) / 15.0).exp() + if is_order { 2e-3 } else { 0.0 }
        });
        let mut rng = stream(3, "noise of a PSF");
        let normal = Normal::new(0.0, deviation).unwrap();
        let noisy = light.mapv(|light| (light + normal.sample(&mut rng)) as f32);
        (light.mapv(|light| light as f32), noisy)
    }

    #[test]
    fn noise_is_measured_below_zero() {
        // Of faint noise haze leaves too little.
        for (deviation, off) in [(1e-6, 0.25), (1e-5, 0.1), (1e-4, 0.1)] {
            let found = noise_of(psf(deviation).1.view()).unwrap();
            assert!((found / deviation - 1.0).abs() < off, "{deviation}: {found}");
        }
        assert_eq!(noise_of(psf(0.0).1.view()), None);
        let background = psf(1e-6).1.mapv(|value| value - 1e-5);
        assert_eq!(noise_of(background.view()), None, "a background that was subtracted twice");
        assert_eq!(noise_of(Array2::from_elem((5, 5), -1.0).view()), None);
    }

    /// Cut off at zero, the noise would be two fifths of the light, and haze by itself 2 %.
    #[test]
    fn what_stands_out_is_kept_and_noise_is_no_haze() {
        let deviation = 3e-5;
        let (light, noisy) = psf(deviation);
        let planes = Array3::from_shape_fn((3, SIDE, SIDE), |(_, y, x)| noisy[[y, x]]);
        let kept = without_noise(planes.clone(), [Some(deviation), None, Some(deviation)]);
        assert_eq!(kept.index_axis(Axis(0), 1), noisy);
        let kept = kept.index_axis(Axis(0), 0);
        assert!(kept.iter().all(|value| *value >= 0.0));
        assert_eq!([kept[[64, 64]], kept[[44, 64]]], [noisy[[64, 64]], noisy[[44, 64]]]);
        let far = |plane: ArrayView2<'_, f32>| -> f32 {
            let is_far = |(y, x): (usize, usize)| y.abs_diff(64).max(x.abs_diff(64)) > 24;
            plane.indexed_iter().filter(|(at, _)| is_far(*at)).map(|(_, value)| value.max(0.0)).sum()
        };
        let [true_far, cut, found] = [far(light.view()), far(noisy.view()), far(kept)];
        assert!(cut > 0.1 && (found - true_far).abs() < 0.1 * cut, "{true_far} {cut} {found}");
        let near = |plane: ArrayView2<'_, f32>| -> f32 {
            let is_near = |(y, x): (usize, usize)| (4..14).contains(&y.abs_diff(64).max(x.abs_diff(64)));
            plane.indexed_iter().filter(|(at, _)| is_near(*at)).map(|(_, value)| value).sum()
        };
        let [true_near, found] = [near(light.view()), near(kept)];
        assert!((found / true_near - 1.0).abs() < 0.3, "haze about the core: {true_near} {found}");
    }
}
