//! The convolution with one channel of a PSF as a matrix A with its transpose, on the frame or on the frame with
//! what lies around it.

use ndarray::{Array2, ArrayView2, s};

use rustfft::num_complex::Complex64;

use super::{Border, border};
use crate::core::error::Result;
use crate::core::fft::{Boundary, Convolver, PlaneSpectrum, fast_length};

/// A of Eq. 1, `A x = x ∗ k`, and the place of the frame in x.
///
/// x is dark outside of the frame, or the frame again, or, where the scene goes on beyond the border, larger than the
/// frame by the reach of the PSF: light in this surrounding is unknown, and seen only as far as it shines in. The far
/// sides of the surrounding touch, so that a constant stays constant.
pub(super) struct Blur {
    convolver: Convolver,
    otf: PlaneSpectrum,
    frame: [usize; 2],
}

impl Blur {
    /// Prepares the convolution of `[height, width]` frames with `psf`.
    pub(super) fn new(frame: [usize; 2], psf: ArrayView2<'_, f32>, border: Border) -> Result<Self> {
        let psf_size = [psf.nrows(), psf.ncols()];
        let boundary = match border {
            Border::Zero => Boundary::Zero,
            Border::Smooth | Border::Periodic => Boundary::Periodic,
        };
        let convolver = Convolver::new(plane_size(frame, psf_size, border), psf_size, boundary)?;
        let otf = convolver.kernel_spectrum(psf)?;
        Ok(Self { convolver, otf, frame })
    }

    /// Whether light around the frame is unknown.
    pub(super) fn has_surrounding(&self) -> bool {
        self.convolver.image_size() != self.frame
    }

    /// Continues a frame into its surrounding, as a first guess.
    pub(super) fn surround(&self, frame: ArrayView2<'_, f32>) -> Array2<f32> {
        border::extend(frame, self.convolver.image_size(), Border::Smooth)
    }

    /// Sets the surrounding, of which no capture tells, to zero.
    pub(super) fn clear_surrounding(&self, plane: &mut Array2<f32>) {
        let [height, width] = self.frame;
        plane.slice_mut(s![height.., ..]).fill(0.0);
        plane.slice_mut(s![..height, width..]).fill(0.0);
    }

    /// A x.
    pub(super) fn apply(&self, x: &Array2<f32>) -> Array2<f32> {
        self.convolver.convolve_plane(x.view(), &self.otf)
    }

    /// Aᵀ y.
    pub(super) fn transpose(&self, y: &Array2<f32>) -> Array2<f32> {
        self.convolver.correlate_plane(y.view(), &self.otf)
    }

    /// Applies another filter, of the OTF's grid.
    pub(super) fn filter(&self, x: &Array2<f32>, filter: &[Complex64]) -> Array2<f32> {
        self.convolver.convolve_plane(x.view(), filter)
    }

    /// The OTF, `[kx][ky]`, with height and width of the grid of the transforms.
    pub(super) fn otf(&self) -> (&[Complex64], [usize; 2]) {
        (&self.otf, self.convolver.transform_size())
    }
}

/// Cuts the frame out.
pub(super) fn frame_of(plane: Array2<f32>, (height, width): (usize, usize)) -> Array2<f32> {
    if plane.dim() == (height, width) { plane } else { plane.slice(s![..height, ..width]).to_owned() }
}

/// Height and width of x.
pub(super) fn plane_size(frame: [usize; 2], psf: [usize; 2], border: Border) -> [usize; 2] {
    match border {
        Border::Zero | Border::Periodic => frame,
        Border::Smooth => border::extended_size(frame, psf, border),
    }
}

/// Height and width of the grid of the transforms, before anything is allocated.
pub(super) fn grid_size(frame: [usize; 2], psf: [usize; 2], border: Border) -> [usize; 2] {
    match border {
        Border::Zero => {
            std::array::from_fn(|axis| fast_length(frame[axis] + (psf[axis] / 2).min(frame[axis] - 1)))
        }
        Border::Smooth | Border::Periodic => plane_size(frame, psf, border),
    }
}
