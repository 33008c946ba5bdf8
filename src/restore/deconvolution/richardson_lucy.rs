//! Restores a plane by the Richardson–Lucy iteration.

use ndarray::{Array2, ArrayView2, Zip};

use super::operator::Blur;
use crate::core::error::Result;

/// Below this part of the brightest value, light counts as darkness: quotients stay finite.
const DARKNESS: f32 = 1e-7;

/// Runs Richardson–Lucy from the capture itself.
///
/// # Equation
/// `x ← x · Aᵀ(m·y / A x) / Aᵀ m` with A the convolution inside the frame, so that light which leaves the
/// frame is accounted for. m is 1, and 0 at saturated pixels that the estimate explains: `A x ≥ y`.
pub(super) fn restore(
    capture: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    saturation: f32,
    iterations: usize,
) -> Result<Array2<f32>> {
    let blur = Blur::new([capture.nrows(), capture.ncols()], psf)?;
    let brightest = capture.iter().copied().fold(0.0, f32::max);
    if brightest <= 0.0 {
        return Ok(Array2::zeros(capture.dim()));
    }
    let floor = brightest * DARKNESS;
    let mut x = capture.mapv(|v| v.max(floor));
    let saturated = super::saturation::any(capture, saturation);
    let ones = blur.transpose(&Array2::ones(capture.dim())).mapv(|v| v.max(DARKNESS));
    for _ in 0..iterations {
        let mut ratio = blur.apply(&x);
        let mut mask = saturated.then(|| Array2::ones(capture.dim()));
        if let Some(mask) = &mut mask {
            Zip::from(mask).and(&ratio).and(capture).for_each(|mask, &predicted, &y| {
                if y >= saturation && predicted >= y {
                    *mask = 0.0;
                }
            });
        }
        Zip::from(&mut ratio).and(capture).for_each(|r, &y| *r = y.max(0.0) / r.max(floor));
        if let Some(mask) = &mask {
            ratio *= mask;
        }
        let correction = blur.transpose(&ratio);
        let masked = mask.map(|mask| blur.transpose(&mask).mapv(|v| v.max(DARKNESS)));
        let norm = masked.as_ref().unwrap_or(&ones);
        Zip::from(&mut x).and(&correction).and(norm).for_each(|x, &c, &n| *x *= c.max(0.0) / n);
    }
    Ok(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn psf() -> Array2<f32> {
        let k = Array2::from_shape_fn((9, 9), |(y, x)| {
            let r2 = (y as f32 - 4.0).powi(2) + (x as f32 - 4.0).powi(2);
            (-r2 / 2.0).exp() + 0.01
        });
        let sum = k.sum();
        k / sum
    }

    fn scene() -> Array2<f32> {
        Array2::from_shape_fn((24, 31), |(y, x)| if (y / 5 + x / 7) % 2 == 0 { 1.0 } else { 0.1 })
    }

    fn error(a: &Array2<f32>, b: &Array2<f32>) -> f32 {
        ((a - b).mapv(|v| v * v).sum() / a.len() as f32).sqrt()
    }

    /// The frame's border loses light; without Aᵀ1 in the denominator the restoration would be dark there.
    #[test]
    fn sharpens_up_to_the_border() {
        let (scene, psf) = (scene(), psf());
        let capture = Blur::new([24, 31], psf.view()).unwrap().apply(&scene);
        let restored = restore(capture.view(), psf.view(), 500.0, 100).unwrap();
        assert!(error(&restored, &scene) < 0.5 * error(&capture, &scene));
        let border = |a: &Array2<f32>| a.row(0).to_owned().insert_axis(ndarray::Axis(0));
        assert!(error(&border(&restored), &border(&scene)) < 0.5 * error(&border(&capture), &border(&scene)));
    }

    #[test]
    fn finds_more_light_than_a_saturated_pixel_shows() {
        let psf = psf();
        let mut scene = scene();
        scene[[12, 15]] = 100.0;
        let mut capture = Blur::new([24, 31], psf.view()).unwrap().apply(&scene);
        capture.mapv_inplace(|v| v.min(2.0));
        let restored = restore(capture.view(), psf.view(), 2.0, 100).unwrap();
        let ignorant = restore(capture.view(), psf.view(), f32::INFINITY, 100).unwrap();
        let light = |x: &Array2<f32>| x.slice(ndarray::s![11..14, 14..17]).sum();
        let (truth, found, shown) = (light(&scene), light(&restored), light(&ignorant));
        assert!((found - truth).abs() < 0.5 * (shown - truth).abs(), "{truth}: {found}, {shown}");
    }

    #[test]
    fn darkness_stays_dark() {
        let restored = restore(Array2::zeros((8, 8)).view(), psf().view(), 500.0, 5).unwrap();
        assert!(restored.iter().all(|&v| v == 0.0));
    }
}
