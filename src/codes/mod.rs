//! Turns PSFs into kernel codes: a rotated set, its PCA basis, the code of each kernel and of new ones.

mod angles;
mod eigen;
mod interpolate;
mod measurement;
mod pca;
mod project;
mod resample;
mod rotation;
mod spline;
mod summary;

pub use angles::parse_angles;
pub use interpolate::interpolate_code;
pub use measurement::MeasurementErrors;
pub use pca::{CODE_DIM, explained_share, make_bank};
pub use project::{Projection, project};
pub use rotation::{rotate, rotate_each};
pub use spline::CubicSpline;
pub use summary::{bank_in_words, code_lines};

use serde_json::json;

use crate::core::error::{Error, Result};
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::psf::{DisplayConfig, simulate_turned};

/// Rotations of the published kernel set, in degrees.
pub const PUBLISHED_ANGLES_DEG: [f64; 9] = [-12.0, -9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0, 12.0];

/// Rotates `psf` to each of `angles_deg` and makes a bank of the set, with codes of `dim` numbers.
///
/// # Errors
/// As [`rotate_each`] and [`make_bank`].
pub fn make_rotated_bank(psf: &Psf, angles_deg: &[f64], dim: usize) -> Result<KernelBank> {
    let bank = make_bank(rotate_each(psf, angles_deg)?, Some(angles_deg.to_vec()), dim)?;
    Ok(bank.with_origin(json!({"rotation": "interpolation"})))
}

/// Simulates a panel that is turned to each of `angles_deg`, and makes a bank of its PSFs.
///
/// # Errors
/// [`Error::Unsupported`] for a bare lens, or fewer angles than codes of `dim` numbers need; as [`simulate_turned`] and
/// [`make_bank`].
pub fn make_turned_bank(
    display: &DisplayConfig,
    angles_deg: &[f64],
    dim: usize,
    progress: &Progress,
) -> Result<KernelBank> {
    if display.display.is_bare() {
        let reason =
            "there is nothing to turn: the PSF of the bare lens is the same at every angle; describe a panel";
        return Err(Error::Unsupported(reason.to_owned()));
    }
    if dim >= angles_deg.len() {
        return Err(Error::Unsupported(format!(
            "{} rotations differ in {} directions at most: choose a smaller --dim, or give more angles",
            angles_deg.len(),
            angles_deg.len().saturating_sub(1)
        )));
    }
    let psfs = simulate_turned(display, angles_deg, progress)?;
    let bank = make_bank(psfs, Some(angles_deg.to_vec()), dim)?;
    Ok(bank.with_origin(json!({"rotation": "propagation", "display": display})))
}
