//! Reads and writes plain arrays — kernel codes, colour matrices — as `.npy`.

use std::path::Path;

use ndarray::ArrayD;

use super::atomic::write_atomically;
use super::format::read_all;
use super::npy::{Npy, encode_array};
use crate::core::error::{Error, Result};

/// Reads an `.npy` array of any shape and number type, unscaled.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is damaged, no array, or holds a
/// value that is not finite.
pub fn read_array(path: &Path) -> Result<ArrayD<f64>> {
    let bytes = read_all(path)?;
    let array = Npy::parse(&bytes).and_then(Npy::into_array).map_err(|reason| Error::format(path, reason))?;
    if array.iter().any(|value| !value.is_finite()) {
        return Err(Error::format(path, "holds a NaN or an infinity"));
    }
    Ok(array)
}

/// Writes an array as `.npy` of little-endian floats.
///
/// # Errors
/// [`Error::Io`] when the file cannot be written, or exists without `overwrite`.
pub fn write_array(path: &Path, array: &ArrayD<f32>, overwrite: bool) -> Result<()> {
    write_atomically(path, overwrite, |file| file.write_all(&encode_array(array)))
}
