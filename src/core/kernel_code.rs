//! Describes PSFs by few numbers: the PCA basis of a kernel set, the code of each kernel, and the bank that
//! keeps them together.

use ndarray::{Array1, Array2, ArrayView1};
use serde_json::Value;

use super::error::{Error, Result};
use super::psf::Psf;

/// The coefficients of one PSF in a [`CodeBasis`], `[b]`.
pub type KernelCode = Array1<f32>;

/// Mean and principal components of a kernel set.
///
/// # Shapes
/// With n = 3·H·W values a PSF in `[3, H, W]` order: `mean` is `[n]`, `components` is `[b, n]` with
/// orthonormal rows, `explained_variance` is `[b]`.
#[derive(Clone, Debug, PartialEq)]
pub struct CodeBasis {
    /// The mean PSF of the set.
    pub mean: Array1<f32>,
    /// The principal components, strongest first.
    pub components: Array2<f32>,
    /// The variance of the set along each component, with K − 1 in the denominator.
    pub explained_variance: Array1<f32>,
}

/// A set of PSFs of one size with their codes and the basis of these codes.
///
/// # Shapes
/// K PSFs, `codes` is `[K, b]`.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelBank {
    /// The kernels, all of one size.
    pub psfs: Vec<Psf>,
    /// One code a row, in the order of the kernels.
    pub codes: Array2<f32>,
    /// The basis of the codes.
    pub basis: CodeBasis,
    /// The rotation of each kernel in degrees, counter-clockwise; `None` for a set that was not made by
    /// rotation.
    pub angles_deg: Option<Vec<f64>>,
    /// How the kernels were made, where it is known: `rotation` is `interpolation` of one PSF, or `propagation` through
    /// the turned panel, whose description is then `display`.
    pub origin: Option<Value>,
}

/// The codes of a bank without its PSFs: all that a network is told.
///
/// # Shapes
/// `codes` is `[K, b]`.
#[derive(Clone, Debug, PartialEq)]
pub struct BankCodes {
    codes: Array2<f32>,
    angles_deg: Option<Vec<f64>>,
}

impl BankCodes {
    /// Checks that there is at least one code and an angle for each, if there are angles.
    ///
    /// # Errors
    /// [`Error::Shape`] otherwise.
    pub fn new(codes: Array2<f32>, angles_deg: Option<Vec<f64>>) -> Result<Self> {
        let count = codes.nrows();
        let angles = angles_deg.as_ref().map_or(count, Vec::len);
        if count == 0 || angles != count {
            let found = format!("{angles} angles and {count} codes");
            return Err(Error::shape("kernel bank", "one angle for each of its codes", found));
        }
        Ok(Self { codes, angles_deg })
    }

    /// The code of kernel `index`.
    ///
    /// # Panics
    /// When there is no such kernel.
    pub fn code(&self, index: usize) -> ArrayView1<'_, f32> {
        self.codes.row(index)
    }

    /// The rotation of each kernel in degrees, if the set was made by rotation.
    pub fn angles_deg(&self) -> Option<&[f64]> {
        self.angles_deg.as_deref()
    }
}

impl KernelBank {
    /// The codes alone.
    pub fn to_codes(&self) -> BankCodes {
        BankCodes { codes: self.codes.clone(), angles_deg: self.angles_deg.clone() }
    }

    /// Checks that the parts fit together and keeps them as a bank.
    ///
    /// # Errors
    /// [`Error::Shape`] naming the part that does not fit.
    pub fn new(
        psfs: Vec<Psf>,
        codes: Array2<f32>,
        basis: CodeBasis,
        angles_deg: Option<Vec<f64>>,
    ) -> Result<Self> {
        let Some(first) = psfs.first() else {
            return Err(Error::shape("kernel bank", "at least one PSF", "none"));
        };
        let size = (first.height(), first.width());
        if let Some(other) = psfs.iter().find(|psf| (psf.height(), psf.width()) != size) {
            let found = format!("{} × {}", other.height(), other.width());
            return Err(Error::shape("PSFs of a kernel bank", format!("all {} × {}", size.0, size.1), found));
        }
        let dim = basis.components.nrows();
        let expected = [
            ("codes", codes.shape().to_vec(), vec![psfs.len(), dim]),
            ("mean", basis.mean.shape().to_vec(), vec![3 * size.0 * size.1]),
            ("components", basis.components.shape().to_vec(), vec![dim, 3 * size.0 * size.1]),
            ("explained variance", basis.explained_variance.shape().to_vec(), vec![dim]),
            ("angles", vec![angles_deg.as_ref().map_or(psfs.len(), Vec::len)], vec![psfs.len()]),
        ];
        for (what, found, expected) in expected {
            if found != expected {
                let what = format!("{what} of a kernel bank");
                return Err(Error::shape(what, format!("{expected:?}"), format!("{found:?}")));
            }
        }
        Ok(Self { psfs, codes, basis, angles_deg, origin: None })
    }

    /// Says how the kernels were made.
    #[must_use]
    pub fn with_origin(self, origin: Value) -> Self {
        Self { origin: Some(origin), ..self }
    }

    /// Keeps one PSF as a bank of one kernel at 0 degrees. Its code has no numbers: there is nothing to tell
    /// it from.
    ///
    /// # Panics
    /// Never: the parts fit together.
    pub fn single(psf: Psf) -> Self {
        let mean = Array1::from_vec(psf.as_slice().to_vec());
        let components = Array2::zeros((0, mean.len()));
        let basis = CodeBasis { mean, components, explained_variance: Array1::zeros(0) };
        Self::new(vec![psf], Array2::zeros((1, 0)), basis, Some(vec![0.0])).expect("the parts fit together")
    }

    /// Number of kernels, K.
    pub fn len(&self) -> usize {
        self.psfs.len()
    }

    /// Whether the bank is empty; it never is.
    pub fn is_empty(&self) -> bool {
        self.psfs.is_empty()
    }

    /// Length of a kernel code, b.
    pub fn code_dim(&self) -> usize {
        self.codes.ncols()
    }

    /// The code of kernel `index`.
    ///
    /// # Panics
    /// When `index` is not below [`len`](Self::len).
    pub fn code(&self, index: usize) -> ArrayView1<'_, f32> {
        self.codes.row(index)
    }

    /// The folder name of kernel `index` in a dataset: `r-12`, `r+03` for rotations, `k01` otherwise.
    pub fn kernel_name(&self, index: usize) -> String {
        match self.angles_deg.as_ref().map(|angles| round_angle(angles[index])) {
            Some(angle) if angle.fract() == 0.0 => format!("r{angle:+03.0}"),
            Some(angle) => format!("r{angle:+}"),
            None => format!("k{:02}", index + 1),
        }
    }
}

/// Rounds an angle to a billionth of a degree, below which angles are the same: sums of steps such as 3·0.1 become the
/// numbers that were meant, and no zero is negative.
pub fn round_angle(angle_deg: f64) -> f64 {
    const PER_DEGREE: f64 = 1e9;
    let rounded = (angle_deg * PER_DEGREE).round() / PER_DEGREE + 0.0;
    if rounded.is_finite() { rounded } else { angle_deg }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn bank(angles: Vec<f64>) -> Result<KernelBank> {
        let psf = Psf::from_energy(Array3::ones((3, 2, 2))).unwrap();
        let basis = CodeBasis {
            mean: Array1::zeros(12),
            components: Array2::zeros((1, 12)),
            explained_variance: Array1::zeros(1),
        };
        KernelBank::new(vec![psf.clone(), psf], Array2::zeros((2, 1)), basis, Some(angles))
    }

    #[test]
    fn names_kernels_by_signed_angle() {
        let bank = bank(vec![-3.0, 12.0]).unwrap();
        assert_eq!((bank.kernel_name(0), bank.kernel_name(1)), ("r-03".into(), "r+12".into()));
    }

    #[test]
    fn names_have_no_digits_of_rounding() {
        let bank = bank(vec![3.0 * 0.1, -0.0]).unwrap();
        assert_eq!((bank.kernel_name(0), bank.kernel_name(1)), ("r+0.3".into(), "r+00".into()));
        assert!((round_angle(f64::MAX) / f64::MAX - 1.0).abs() < f64::EPSILON);
    }

    #[test]
    fn refuses_parts_that_do_not_fit() {
        let message = bank(vec![0.0]).unwrap_err().to_string();
        assert!(message.contains("angles of a kernel bank"), "{message}");
    }
}
