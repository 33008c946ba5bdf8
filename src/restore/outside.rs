//! Tells how much of a frame's light may have come from outside of it.

use std::ops::Range;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Array3, ArrayView1, ArrayView2, Axis};

use super::deconvolution::Border;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;

/// The light that enters each pixel from beyond the border, if all that lies there is as bright as the frame is on average.
///
/// # Equation
/// `φ((1 − (A 1)/Σk)·ȳ)`, A 1 the blur of an even frame in darkness, ȳ the mean of the capture's channel. Zero where nothing
/// comes from outside, be it dark or the frame again.
///
/// # Errors
/// Never for a capture that is an image.
pub(super) fn light_from_outside(
    capture: &LinearImage,
    psf: &Psf,
    border: Border,
    curve: ToneCurve,
) -> Result<ToneMappedImage> {
    let (height, width) = (capture.height(), capture.width());
    let mut planes = Array3::zeros((CHANNELS, height, width));
    if border == Border::Smooth {
        for (channel, mut plane) in planes.axis_iter_mut(Axis(0)).enumerate() {
            let kernel = psf.channel(channel);
            let sums = SummedKernel::new(kernel);
            let whole = sums.0[kernel.dim()];
            let mean = mean_of(capture.channel(channel));
            let columns: Vec<_> = (0..width).map(|x| samples_inside(x, width, kernel.ncols())).collect();
            plane.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut row)| {
                let sums = sums.of_rows(&samples_inside(y, height, kernel.nrows()));
                for (value, columns) in row.iter_mut().zip(&columns) {
                    let outside = 1.0 - (sums[columns.end] - sums[columns.start]) / whole;
                    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
                    let light = (outside.max(0.0) * mean) as f32;
                    *value = curve.compress(light);
                }
            });
        }
    }
    ToneMappedImage::from_planes(planes)
}

fn mean_of(plane: ArrayView2<'_, f32>) -> f64 {
    let of_row = |row: ArrayView1<'_, f32>| row.iter().map(|&value| f64::from(value.max(0.0))).sum::<f64>();
    let of_rows: Vec<f64> = plane.axis_iter(Axis(0)).into_par_iter().map(of_row).collect();
    of_rows.iter().sum::<f64>() / plane.len().max(1) as f64
}

/// The samples of a kernel about its centre that meet the frame, at a pixel of one axis.
fn samples_inside(at: usize, frame: usize, kernel: usize) -> Range<usize> {
    let end = at + kernel / 2 + 1;
    end.saturating_sub(frame).min(kernel)..end.min(kernel)
}

/// A kernel summed from its corner on.
struct SummedKernel(Array2<f64>);

impl SummedKernel {
    fn new(kernel: ArrayView2<'_, f32>) -> Self {
        let mut sums = Array2::zeros((kernel.nrows() + 1, kernel.ncols() + 1));
        for ((y, x), &value) in kernel.indexed_iter() {
            sums[[y + 1, x + 1]] = f64::from(value) + sums[[y, x + 1]] + sums[[y + 1, x]] - sums[[y, x]];
        }
        Self(sums)
    }

    /// Some rows, summed from their beginning on.
    fn of_rows(&self, rows: &Range<usize>) -> Vec<f64> {
        let [start, end] = [rows.start, rows.end].map(|y| self.0.row(y));
        start.iter().zip(end).map(|(start, end)| end - start).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::{Boundary, Convolver};

    const CURVE: ToneCurve = ToneCurve { alpha: 0.25, x_max: 4.0 };

    /// A PSF without any symmetry, of even and odd sides, wider and narrower than the frame.
    fn psf(height: usize, width: usize) -> Psf {
        let value = |(c, y, x)| ((c * 5 + y * 31 + x * 17) % 23) as f32 + 1.0;
        Psf::from_energy(Array3::from_shape_fn((CHANNELS, height, width), value)).unwrap()
    }

    #[test]
    fn it_is_what_the_blur_of_an_even_frame_lacks() {
        for [height, width] in [[6, 7], [5, 4], [31, 16]] {
            let (psf, level) = (psf(height, width), 0.5_f32);
            let capture = LinearImage::from_planes(Array3::from_elem((CHANNELS, 9, 12), level)).unwrap();
            let convolver = Convolver::new([9, 12], [height, width], Boundary::Zero).unwrap();
            let spectrum = convolver.spectrum(&capture).unwrap();
            let blurred = convolver.convolve(&spectrum, &convolver.otf(&psf).unwrap());
            let found = light_from_outside(&capture, &psf, Border::Smooth, CURVE).unwrap();
            for (found, blurred) in found.as_slice().iter().zip(&blurred) {
                let expected = CURVE.compress((level - blurred).max(0.0));
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
            assert!(found.as_slice()[0] > 0.1, "a corner sees much of the outside");
        }
    }

    #[test]
    fn nothing_comes_from_a_border_that_is_known() {
        let capture = LinearImage::from_planes(Array3::from_elem((CHANNELS, 9, 12), 0.5)).unwrap();
        for border in [Border::Zero, Border::Periodic] {
            let found = light_from_outside(&capture, &psf(5, 5), border, CURVE).unwrap();
            assert!(found.as_slice().iter().all(|&value| value == 0.0));
        }
    }
}
