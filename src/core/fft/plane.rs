//! Convolves single planes: what iterative solvers need, one channel at a time and many times over.

#![expect(clippy::needless_pass_by_value, reason = "views of arrays are values")]

use ndarray::{Array2, ArrayView2};
use rustfft::num_complex::Complex64;

use super::Convolver;
use super::convolver::require_size;
use super::transform::Window;
use crate::core::error::Result;

/// The half spectrum `[kx][ky]` of one plane or of one channel of a kernel, for one [`Convolver`].
pub type PlaneSpectrum = Vec<Complex64>;

impl Convolver {
    /// Transforms one channel of a kernel about its centre.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::core::error::Error::Shape) when the kernel is not of the PSFs' size.
    pub fn kernel_spectrum(&self, kernel: ArrayView2<'_, f32>) -> Result<PlaneSpectrum> {
        require_size("kernel", self.psf_size(), [kernel.nrows(), kernel.ncols()])?;
        Ok(self.transform_kernel(kernel))
    }

    /// Transforms one plane with its border.
    ///
    /// # Panics
    /// When the plane is not of the images' size.
    pub fn plane_spectrum(&self, plane: ArrayView2<'_, f32>) -> PlaneSpectrum {
        assert_eq!(plane.shape(), self.image_size(), "the plane has the images' size");
        self.transform_plane(&self.transform, plane)
    }

    /// Multiplies two half spectra and transforms the product back to the pixels of the image.
    ///
    /// # Panics
    /// When a spectrum is not of this convolver.
    pub fn filter_plane(&self, spectrum: &[Complex64], filter: &[Complex64]) -> Array2<f32> {
        let [height, width] = self.image_size();
        let window = Window { top: self.rows.lead, left: self.columns.lead, height, width };
        self.invert(spectrum, filter, |h| h, window)
    }

    /// A x: convolves one plane with the kernel of spectrum `otf`.
    ///
    /// # Panics
    /// When the plane or the spectrum is not of this convolver.
    pub fn convolve_plane(&self, plane: ArrayView2<'_, f32>, otf: &[Complex64]) -> Array2<f32> {
        let spectrum = self.plane_spectrum(plane);
        let convolved = self.filter_plane(&spectrum, otf);
        self.transform.reuse(spectrum);
        convolved
    }

    /// Aᵀ y: the transpose of [`convolve_plane`](Self::convolve_plane), boundary included.
    ///
    /// # Panics
    /// When the plane or the spectrum is not of this convolver.
    pub fn correlate_plane(&self, plane: ArrayView2<'_, f32>, otf: &[Complex64]) -> Array2<f32> {
        let [height, width] = self.image_size();
        assert_eq!(plane.shape(), [height, width], "the plane has the images' size");
        let (top, left) = (self.rows.lead, self.columns.lead);
        let rows = top..top + height;
        let spectrum = self.transform.forward(std::slice::from_ref(&rows), |row, samples| {
            for (sample, value) in samples[left..left + width].iter_mut().zip(plane.row(row - top)) {
                *sample = f64::from(*value);
            }
        });
        let whole = Window { top: 0, left: 0, height: self.rows.extended, width: self.columns.extended };
        let extended = self.invert(&spectrum, otf, |h| h.conj(), whole);
        self.transform.reuse(spectrum);
        if extended.shape() == [height, width] {
            return extended;
        }
        // The border was copied from the scene; its share returns to the pixels it came from.
        let mut out = Array2::zeros([height, width]);
        for ((y, x), value) in extended.indexed_iter() {
            out[[self.rows.source(y), self.columns.source(x)]] += value;
        }
        out
    }

    fn invert(
        &self,
        spectrum: &[Complex64],
        filter: &[Complex64],
        response: impl Fn(Complex64) -> Complex64 + Copy + Sync,
        window: Window,
    ) -> Array2<f32> {
        assert_eq!(filter.len(), self.transform.spectrum_len(), "the filter belongs to this convolver");
        let product = self.product(spectrum, |range| filter[range].iter().copied().map(response));
        let mut out = Array2::zeros((window.height, window.width));
        let slice = out.as_slice_mut().expect("new arrays are contiguous");
        self.transform.inverse(product, window, slice);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::Boundary;
    use super::*;

    /// ⟨A x, y⟩ = ⟨x, Aᵀ y⟩ in sums of 63 products of numbers below 1: 1e-5 is far above their rounding.
    #[test]
    fn correlation_is_the_transpose_of_convolution() {
        let plane = |seed: usize| {
            Array2::from_shape_fn((9, 7), |(y, x)| ((y * 31 + x * 17 + seed) % 23) as f32 / 23.0)
        };
        let kernel = Array2::from_shape_fn((5, 12), |(y, x)| ((y * 7 + x * 3) % 11) as f32 / 300.0);
        for boundary in [Boundary::Zero, Boundary::Replicate, Boundary::Reflect, Boundary::Periodic] {
            let convolver = Convolver::new([9, 7], [5, 12], boundary).unwrap();
            let otf = convolver.kernel_spectrum(kernel.view()).unwrap();
            let (x, y) = (plane(3), plane(8));
            let forward = (convolver.convolve_plane(x.view(), &otf) * &y).sum();
            let backward = (convolver.correlate_plane(y.view(), &otf) * &x).sum();
            assert!((forward - backward).abs() < 1e-5, "{boundary:?}: {forward} {backward}");
        }
    }
}
