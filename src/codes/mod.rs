//! Turns PSFs into kernel codes: a rotated set, its PCA basis, the code of each kernel and of new ones.

mod angles;
mod eigen;
mod interpolate;
mod pca;
mod project;
mod rotation;

pub use angles::parse_angles;
pub use interpolate::interpolate_code;
pub use pca::{CODE_DIM, explained_share, make_bank};
pub use project::{Projection, project};
pub use rotation::{rotate, rotate_each};

use crate::core::error::Result;
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;

/// Rotates `psf` to each of `angles_deg` and makes a bank of the set, with codes of `dim` numbers.
///
/// # Errors
/// As [`rotate_each`] and [`make_bank`].
pub fn make_rotated_bank(psf: &Psf, angles_deg: &[f64], dim: usize) -> Result<KernelBank> {
    make_bank(rotate_each(psf, angles_deg)?, Some(angles_deg.to_vec()), dim)
}
