//! The spectra that the Wiener filters are made of: PSF, Laplacian and data on one periodic grid.

use ndarray::{Array2, ArrayView2, arr2};
use rustfft::num_complex::Complex64;

use super::Border;
use super::border::{extend, extended_size};
use crate::core::error::Result;
use crate::core::fft::{Boundary, Convolver, PlaneSpectrum};

/// A periodic grid with the transforms of a PSF and of the Laplacian on it.
pub(super) struct Spectral {
    convolver: Convolver,
    otf: PlaneSpectrum,
    laplacian: PlaneSpectrum,
    border: Border,
}

impl Spectral {
    /// Chooses the grid for planes of `image` `[height, width]` and transforms the PSF.
    pub(super) fn new(image: [usize; 2], psf: ArrayView2<'_, f32>, border: Border) -> Result<Self> {
        let psf_size = [psf.nrows(), psf.ncols()];
        let size = extended_size(image, psf_size, border);
        let convolver = Convolver::new(size, psf_size, Boundary::Periodic)?;
        let otf = convolver.kernel_spectrum(psf)?;
        let stencil = arr2(&[[0.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 0.0]]);
        let laplacian = Convolver::new(size, [3, 3], Boundary::Periodic)?.kernel_spectrum(stencil.view())?;
        Ok(Self { convolver, otf, laplacian, border })
    }

    /// The transform H of the PSF.
    pub(super) fn otf(&self) -> &[Complex64] {
        &self.otf
    }

    /// The transform Λ of the Laplacian.
    pub(super) fn laplacian(&self) -> &[Complex64] {
        &self.laplacian
    }

    /// Rows of the grid, the length of a spectrum's column.
    pub(super) fn height(&self) -> usize {
        self.convolver.transform_size()[0]
    }

    /// Columns of the grid.
    pub(super) fn width(&self) -> usize {
        self.convolver.transform_size()[1]
    }

    /// `γₙ·H̄ / (γₙ·|H|² + γₓ·|Λ|²)`; zero where both vanish.
    pub(super) fn wiener_filter(&self, noise_precision: f64, scene_precision: f64) -> PlaneSpectrum {
        let filter = |(h, l): (&Complex64, &Complex64)| {
            let precision = noise_precision * h.norm_sqr() + scene_precision * l.norm_sqr();
            if precision > 0.0 { h.conj() * (noise_precision / precision) } else { Complex64::default() }
        };
        self.otf.iter().zip(&self.laplacian).map(filter).collect()
    }

    /// The transform of a plane, continued to the grid.
    pub(super) fn transform(&self, plane: ArrayView2<'_, f32>) -> PlaneSpectrum {
        self.convolver.plane_spectrum(extend(plane, self.convolver.image_size(), self.border).view())
    }

    /// Filters a spectrum and transforms it back to the whole grid.
    pub(super) fn inverse(&self, spectrum: &[Complex64], filter: &[Complex64]) -> Array2<f32> {
        self.convolver.filter_plane(spectrum, filter)
    }
}
