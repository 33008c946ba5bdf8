//! The convolution with one channel of a PSF as a matrix A with its transpose, the scene dark outside of the
//! frame.

use ndarray::{Array2, ArrayView2};

use rustfft::num_complex::Complex64;

use crate::core::error::Result;
use crate::core::fft::{Boundary, Convolver, PlaneSpectrum, fast_length};

/// A of Eq. 1: `A x = x ∗ k` on the frame, x being zero outside of it.
pub(super) struct Blur {
    convolver: Convolver,
    otf: PlaneSpectrum,
}

impl Blur {
    /// Prepares the convolution of `[height, width]` planes with `psf`.
    pub(super) fn new(image: [usize; 2], psf: ArrayView2<'_, f32>) -> Result<Self> {
        let convolver = Convolver::new(image, [psf.nrows(), psf.ncols()], Boundary::Zero)?;
        let otf = convolver.kernel_spectrum(psf)?;
        Ok(Self { convolver, otf })
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

    /// The OTF, `[kx][ky]` with the length of a column.
    pub(super) fn otf(&self) -> (&[Complex64], usize) {
        (&self.otf, self.convolver.transform_size()[0])
    }

    /// Height and width of the grid of the transforms.
    pub(super) fn grid(&self) -> [usize; 2] {
        self.convolver.transform_size()
    }
}

/// Height and width of the grid of the transforms, before anything is allocated.
pub(super) fn grid_size(image: [usize; 2], psf: [usize; 2]) -> [usize; 2] {
    std::array::from_fn(|axis| fast_length(image[axis] + (psf[axis] / 2).min(image[axis] - 1)))
}
