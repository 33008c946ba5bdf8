//! Turns PSFs into kernel codes: a rotated set, its PCA basis, the code of each kernel and of new ones.

mod angles;
mod eigen;
mod interpolate;
mod pca;
mod project;
mod resample;
mod rotation;

pub use angles::parse_angles;
pub use interpolate::interpolate_code;
pub use pca::{CODE_DIM, explained_share, make_bank};
pub use project::{Projection, project};
pub use rotation::{rotate, rotate_each};

use serde::Serialize;
use serde_json::json;

use crate::core::error::Result;
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;

/// Rotates `psf` to each of `angles_deg` and makes a bank of the set, with codes of `dim` numbers.
///
/// # Errors
/// As [`rotate_each`] and [`make_bank`].
pub fn make_rotated_bank(psf: &Psf, angles_deg: &[f64], dim: usize) -> Result<KernelBank> {
    let bank = make_bank(rotate_each(psf, angles_deg)?, Some(angles_deg.to_vec()), dim)?;
    Ok(bank.with_origin(json!({"rotation": "interpolation"})))
}

/// Makes a bank of the simulated PSFs of a panel that was turned to each of `angles_deg`; `display` describes the panel.
///
/// # Errors
/// As [`make_bank`].
pub fn make_turned_bank(
    psfs: Vec<Psf>,
    angles_deg: &[f64],
    dim: usize,
    display: &impl Serialize,
) -> Result<KernelBank> {
    let bank = make_bank(psfs, Some(angles_deg.to_vec()), dim)?;
    Ok(bank.with_origin(json!({"rotation": "propagation", "display": display})))
}
