//! Restores a plane by the Richardson–Lucy iteration.

use ndarray::{Array2, ArrayView2, Zip};

use super::operator::{Blur, frame_of};
use super::{DeconvolutionConfig, saturation};
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Below this part of the brightest value, light counts as darkness: quotients stay finite.
const DARKNESS: f32 = 1e-7;

/// What is added to both sides of the quotient where light around the frame is unknown: pixels of which the capture
/// sees less than this part keep their first guess rather than take what is left of others' misfit.
const UNSEEN: f32 = 1e-2;

/// Runs Richardson–Lucy from the capture itself.
///
/// # Equation
/// `x ← x · (Aᵀ(m·y / A x) + ε) / (Aᵀ m + ε)`, so that light which leaves the frame is accounted for. m is 1, and 0 at
/// saturated pixels that the estimate explains, `A x ≥ y`, and in the surrounding of the frame. ε is 1 % there, and
/// nothing but a guard against 0/0 where no light around the frame is unknown.
pub(super) fn restore(
    capture: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
    channel: usize,
    progress: &Progress,
) -> Result<Array2<f32>> {
    let level = config.saturated_from(channel);
    let blur = Blur::new([capture.nrows(), capture.ncols()], psf, config.border)?;
    let brightest = capture.iter().copied().fold(0.0, f32::max);
    if brightest <= 0.0 {
        return Ok(Array2::zeros(capture.dim()));
    }
    let floor = brightest * DARKNESS;
    let unseen = if blur.has_surrounding() { UNSEEN } else { DARKNESS };
    let is_saturated = saturation::any(capture, level);
    let frame = capture.dim();
    let capture = blur.surround(capture);
    let mut x = capture.mapv(|v| v.max(floor));
    // Aᵀ m of the pixels that `predicted` leaves to explain.
    let norm = |predicted: &Array2<f32>| {
        let explained = |y: f32, predicted: f32| y >= level && predicted >= y;
        let part = |&y: &f32, &predicted: &f32| if explained(y, predicted) { 0.0 } else { 1.0 };
        let mut mask = Zip::from(&capture).and(predicted).map_collect(part);
        blur.clear_surrounding(&mut mask);
        (blur.transpose(&mask), mask)
    };
    let (mut norms, mut mask) = norm(&Array2::zeros(capture.dim()));
    for _ in 0..config.iterations {
        progress.check()?;
        let mut ratio = blur.apply(&x);
        if is_saturated {
            (norms, mask) = norm(&ratio);
        }
        Zip::from(&mut ratio)
            .and(&capture)
            .and(&mask)
            .for_each(|r, &y, &mask| *r = mask * y.max(0.0) / r.max(floor));
        let correction = blur.transpose(&ratio);
        Zip::from(&mut x)
            .and(&correction)
            .and(&norms)
            .for_each(|x, &c, &n| *x *= (c.max(0.0) + unseen) / (n.max(0.0) + unseen));
    }
    Ok(frame_of(x, frame))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::restore::deconvolution::{Border, Method};

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

    /// The restoration of a frame that is dark outside.
    fn restored(capture: &Array2<f32>, saturation: f32, iterations: usize) -> Array2<f32> {
        let border = Border::Zero;
        let default = DeconvolutionConfig::of_method(Method::RichardsonLucy);
        let config = DeconvolutionConfig { border, saturation: [saturation; 3], iterations, ..default };
        restore(capture.view(), psf().view(), &config, 0, &Progress::default()).unwrap()
    }

    fn error(a: &Array2<f32>, b: &Array2<f32>) -> f32 {
        ((a - b).mapv(|v| v * v).sum() / a.len() as f32).sqrt()
    }

    /// The frame's border loses light; without Aᵀ1 in the denominator the restoration would be dark there.
    #[test]
    fn sharpens_up_to_the_border() {
        let (scene, psf) = (scene(), psf());
        let capture = Blur::new([24, 31], psf.view(), Border::Zero).unwrap().apply(&scene);
        let restored = restored(&capture, 500.0, 100);
        assert!(error(&restored, &scene) < 0.5 * error(&capture, &scene));
        let border = |a: &Array2<f32>| a.row(0).to_owned().insert_axis(ndarray::Axis(0));
        assert!(error(&border(&restored), &border(&scene)) < 0.5 * error(&border(&capture), &border(&scene)));
    }

    #[test]
    fn finds_more_light_than_a_saturated_pixel_shows() {
        let psf = psf();
        let mut scene = scene();
        scene[[12, 15]] = 100.0;
        let mut capture = Blur::new([24, 31], psf.view(), Border::Zero).unwrap().apply(&scene);
        capture.mapv_inplace(|v| v.min(2.0));
        let (ignorant, restored) = (restored(&capture, f32::INFINITY, 100), restored(&capture, 2.0, 100));
        let light = |x: &Array2<f32>| x.slice(ndarray::s![11..14, 14..17]).sum();
        let (truth, found, shown) = (light(&scene), light(&restored), light(&ignorant));
        assert!((found - truth).abs() < 0.5 * (shown - truth).abs(), "{truth}: {found}, {shown}");
    }

    /// A frame from the middle of a larger scene, lit by what lies around it.
    #[test]
    fn restores_a_frame_whose_scene_goes_on_around_it() {
        let larger =
            Array2::from_shape_fn((64, 71), |(y, x)| if (y / 5 + x / 7) % 2 == 0 { 1.0 } else { 0.1 });
        let captured = Blur::new([64, 71], psf().view(), Border::Zero).unwrap().apply(&larger);
        let frame = ndarray::s![20..44, 20..51];
        let (scene, capture) = (larger.slice(frame).to_owned(), captured.slice(frame).to_owned());
        let config = DeconvolutionConfig::of_method(Method::RichardsonLucy);
        let smooth = restore(capture.view(), psf().view(), &config, 0, &Progress::default()).unwrap();
        let zero = restored(&capture, 500.0, config.iterations);
        let (smooth, zero) = (error(&smooth, &scene), error(&zero, &scene));
        assert!(smooth < 0.7 * error(&capture, &scene) && smooth < 0.7 * zero, "{smooth} against {zero}");
    }

    #[test]
    fn darkness_stays_dark() {
        let restored = restored(&Array2::zeros((8, 8)), 500.0, 5);
        assert!(restored.iter().all(|&v| v == 0.0));
    }
}
