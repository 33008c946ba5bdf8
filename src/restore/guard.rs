//! Keeps a network's corrections to what the capture allows.

use ndarray::{Array2, Axis, Zip};

use super::deconvolution::Border;
use crate::core::error::Result;
use crate::core::fft::{Boundary, PlaneOperator, TransformPrecision};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;

/// How far a correction may move the blurred scene, in standard deviations of the capture's noise: what noise and a PSF that is
/// a little off leave open.
const MOST_DEVIATIONS: f64 = 3.0;

/// How much brighter than the frame what lies beyond the border may be on average: a correction may take so much light from
/// the scene, which then came from there.
const BRIGHTEST_OUTSIDE: f32 = 4.0;

/// What is known of a capture that corrections have to agree with.
pub(super) struct Guard<'a> {
    pub(super) capture: &'a LinearImage,
    pub(super) psf: &'a Psf,
    /// [`Plane::Outside`](crate::network::Plane::Outside) of the capture, if it was made.
    pub(super) outside: Option<&'a ToneMappedImage>,
    pub(super) border: Border,
    pub(super) curve: ToneCurve,
    pub(super) saturation: [f32; CHANNELS],
    /// The standard deviation of the noise of `log(y + α)`.
    pub(super) noise: [f32; CHANNELS],
}

impl Guard<'_> {
    /// Takes as much of the correction from `deconvolved` to `restored` as the capture allows, and of that the part `refine`.
    ///
    /// # Equation
    /// `d + ρ·t·(r − d)` in the tone-mapped domain, `t = min(1, 3σ/q)` for each channel, σ the standard deviation of the noise,
    /// or where nothing comes from outside the root mean square of `(y − A d)/(y + α)` if that is less, q that over the
    /// unsaturated pixels of `max(|A(r − d)| − 4o, 0)/(y + α)` in linear light, o the light that would come from outside if
    /// that were as bright as the frame: a correction within the noise is believed as a whole, one that contradicts a capture
    /// without noise is not, unless light from beyond the border explains it.
    ///
    /// # Errors
    /// Never for images of one size.
    pub(super) fn refine(
        &self,
        deconvolved: &ToneMappedImage,
        restored: ToneMappedImage,
        refine: f32,
    ) -> Result<ToneMappedImage> {
        let moved = self.norms(|channel, y, out| {
            let [restored, deconvolved] = [&restored, deconvolved].map(|image| image.channel(channel));
            for ((out, r), d) in out.iter_mut().zip(restored.row(y)).zip(deconvolved.row(y)) {
                *out = self.curve.expand(*r) - self.curve.expand(*d);
            }
        })?;
        let noise = self.unexplained(deconvolved)?;
        let mut planes = restored.into_planes();
        for (channel, (moved, noise)) in moved.into_iter().zip(noise).enumerate() {
            let allowed = MOST_DEVIATIONS * noise;
            #[expect(clippy::cast_possible_truncation, reason = "a share")]
            let share = refine * (allowed / moved.max(f64::MIN_POSITIVE)).min(1.0) as f32;
            let deconvolved = deconvolved.channel(channel);
            if share < 1.0 {
                let plane = planes.index_axis_mut(Axis(0), channel);
                Zip::from(plane).and(deconvolved).par_for_each(|r, d| *r = d + share * (*r - d));
            }
        }
        ToneMappedImage::from_planes(planes)
    }

    /// The noise, or what is less: what the deconvolved image leaves of the capture, where all of its light is in the image.
    fn unexplained(&self, deconvolved: &ToneMappedImage) -> Result<[f64; CHANNELS]> {
        let mut unexplained = self.noise.map(f64::from);
        if self.border != Border::Smooth {
            let light = |channel: usize, y: usize, out: &mut [f32]| {
                for (out, d) in out.iter_mut().zip(deconvolved.channel(channel).row(y)) {
                    *out = self.curve.expand(*d);
                }
            };
            self.blur(light, |channel, blurred| {
                let left = self.relative_norm(&(blurred - &self.capture.channel(channel)), channel);
                unexplained[channel] = unexplained[channel].min(left);
            })?;
        }
        Ok(unexplained)
    }

    /// The norm of each channel of what is made row by row, once it is blurred.
    fn norms(&self, light: impl Fn(usize, usize, &mut [f32]) + Sync) -> Result<[f64; CHANNELS]> {
        let mut norms = [0.0; CHANNELS];
        self.blur(light, |channel, blurred| norms[channel] = self.relative_norm(blurred, channel))?;
        Ok(norms)
    }

    /// Blurs each channel of what is made row by row.
    fn blur(
        &self,
        light: impl Fn(usize, usize, &mut [f32]) + Sync,
        mut each: impl FnMut(usize, &Array2<f32>),
    ) -> Result<()> {
        let boundary = match self.border {
            Border::Periodic => Boundary::Periodic,
            // Beyond the border nothing is corrected.
            Border::Zero | Border::Smooth => Boundary::Zero,
        };
        let size = [self.capture.height(), self.capture.width()];
        let of_psf = [self.psf.height(), self.psf.width()];
        let operator = PlaneOperator::new(size, of_psf, boundary, TransformPrecision::Single);
        let mut blurred = Array2::zeros(size);
        for channel in 0..CHANNELS {
            let otf = operator.transfer_function(self.psf.channel(channel), |k| k)?;
            operator.convolve(
                &otf,
                (size[0], |y: usize, out: &mut [f32]| light(channel, y, out)),
                &mut blurred,
            );
            each(channel, &blurred);
        }
        Ok(())
    }

    /// The root mean square over `y + α` of what light from outside leaves of a plane, where the capture y is not saturated.
    fn relative_norm(&self, plane: &Array2<f32>, channel: usize) -> f64 {
        let from = saturated_from(self.saturation[channel]);
        let outside = self.outside.map(|outside| outside.channel(channel));
        let (mut sum, mut count) = (0.0, 0_u32);
        for ((at, value), y) in plane.indexed_iter().zip(self.capture.channel(channel)) {
            if *y < from {
                let explained =
                    outside.map_or(0.0, |outside| BRIGHTEST_OUTSIDE * self.curve.expand(outside[at]));
                let left = (value.abs() - explained).max(0.0);
                sum += f64::from(left / (y.max(0.0) + self.curve.alpha)).powi(2);
                count += 1;
            }
        }
        (sum / f64::from(count.max(1))).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn guard<'a>(capture: &'a LinearImage, psf: &'a Psf, noise: f32) -> Guard<'a> {
        let curve = ToneCurve { alpha: 0.25, x_max: 4.0 };
        Guard {
            capture,
            psf,
            outside: None,
            border: Border::Zero,
            curve,
            saturation: [4.0; 3],
            noise: [noise; 3],
        }
    }

    /// A network that adds a hundredth to everything, after a capture whose noise is estimated.
    fn refined([noise, estimated]: [f32; 2], refine: f32) -> (f32, f32) {
        // Noise of that deviation relative to y + α, around an even scene.
        let value = |(_, y, x)| 0.5 + 0.75 * if (x + y) % 2 == 0 { noise } else { -noise };
        let capture = LinearImage::from_planes(Array3::from_shape_fn((3, 16, 16), value)).unwrap();
        let psf = Psf::from_energy(Array3::ones((3, 1, 1))).unwrap();
        let guard = guard(&capture, &psf, estimated);
        let deconvolved = guard.curve.tone_map(&capture.map_values(|_| 0.5));
        let restored = deconvolved.map_values(|v| v + 0.01);
        let refined = guard.refine(&deconvolved, restored, refine).unwrap();
        (deconvolved.as_slice()[0], refined.as_slice()[0])
    }

    #[test]
    fn a_correction_within_the_noise_is_taken_and_one_that_contradicts_the_capture_is_not() {
        let (before, after) = refined([0.05; 2], 1.0);
        assert!((after - before - 0.01).abs() < 1e-6, "{before} {after}");
        let (before, after) = refined([1e-4; 2], 1.0);
        assert!((after - before).abs() < 2e-4, "{before} {after}");
    }

    #[test]
    fn noise_that_is_estimated_too_large_allows_no_more_than_the_capture_has() {
        let (before, after) = refined([1e-4, 0.05], 1.0);
        assert!((after - before).abs() < 2e-4, "{before} {after}");
    }

    /// Without noise, a correction of a hundredth is believed where that may have come from outside, and there alone.
    #[test]
    fn a_correction_that_light_from_outside_explains_is_taken() {
        let capture = LinearImage::from_planes(Array3::from_elem((3, 16, 16), 0.5)).unwrap();
        let psf = Psf::from_energy(Array3::ones((3, 1, 1))).unwrap();
        let deconvolved = guard(&capture, &psf, 0.0).curve.tone_map(&capture);
        let taken = |light: f32| {
            let outside = deconvolved.map_values(|_| light);
            let guard =
                Guard { outside: Some(&outside), border: Border::Smooth, ..guard(&capture, &psf, 1e-6) };
            let refined = guard.refine(&deconvolved, deconvolved.map_values(|v| v - 0.01), 1.0).unwrap();
            deconvolved.as_slice()[0] - refined.as_slice()[0]
        };
        assert!((taken(0.1) - 0.01).abs() < 1e-6, "{}", taken(0.1));
        assert!(taken(0.0) < 1e-4, "{}", taken(0.0));
    }

    #[test]
    fn half_of_a_correction_is_half_of_it_and_none_is_the_deconvolution() {
        let (before, after) = refined([0.05; 2], 0.5);
        assert!((after - before - 0.005).abs() < 1e-6, "{before} {after}");
        let (before, after) = refined([0.05; 2], 0.0);
        assert_eq!(before, after);
    }
}
