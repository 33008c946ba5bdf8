//! The only opener of files: images, PSFs, kernel banks; whole files only, never half of one.

mod plain;

use std::path::{Path, PathBuf};

use ndarray::Array3;

use super::error::Result;
use super::image::{Domain, Image};
use super::kernel_code::KernelBank;
use super::provenance::Provenance;
use super::psf::Psf;

pub use plain::{list_folder, read_code, read_text};

/// What the numbers of a file mean, where the file says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DomainTag {
    /// Linear irradiance.
    Linear,
    /// After the tone mapping φ.
    ToneMapped,
}

/// The contents of an image file before their meaning is decided.
///
/// # Shapes
/// `planes` is `[channels, height, width]` with 1, 3 or (packed Bayer) 4 channels; integer formats are
/// divided by their type's maximum.
#[derive(Clone, Debug)]
pub struct Pixels {
    /// The values.
    pub planes: Array3<f32>,
    /// The domain that the file declares.
    pub domain: Option<DomainTag>,
    /// The exposure time that the file declares, in seconds.
    pub exposure_s: Option<f64>,
    /// The provenance that the file carries.
    pub provenance: Option<Provenance>,
}

/// How an image is written.
#[derive(Clone, Debug, Default)]
pub struct WriteOptions {
    /// Half floats instead of floats, in formats that have both.
    pub half: bool,
    /// Whether an existing file may be replaced.
    pub overwrite: bool,
    /// What to say about the file's origin, in formats that can carry it.
    pub provenance: Option<Provenance>,
}

/// Reads an image file of any supported format.
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn read_pixels(path: &Path) -> Result<Pixels> {
    todo!("{}", path.display())
}

/// Reads an image of domain `D`; a file that declares another domain is refused.
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn read_image<D: Domain>(path: &Path) -> Result<Image<D>> {
    todo!("{}", path.display())
}

/// Reads a PSF from an image file, non-negative and of unit sum.
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn read_psf(path: &Path) -> Result<Psf> {
    todo!("{}", path.display())
}

/// Writes a PSF as an image file of linear values.
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn write_psf(path: &Path, _psf: &Psf, _options: &WriteOptions) -> Result<()> {
    todo!("{}", path.display())
}

/// Writes an image in the format of the path's extension.
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn write_image<D: Domain>(path: &Path, _image: &Image<D>, _options: &WriteOptions) -> Result<()> {
    todo!("{}", path.display())
}

/// Writes a whole file or nothing: to a temporary name in the same folder, flushed, then renamed.
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn write_atomically(
    path: &Path,
    _overwrite: bool,
    _write: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>,
) -> Result<()> {
    todo!("{}", path.display())
}

/// Expands files, folders and globs to image files, sorted.
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn expand_inputs(_inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    todo!()
}

/// Reads a kernel bank (`*.safetensors`).
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn read_bank(path: &Path) -> Result<KernelBank> {
    todo!("{}", path.display())
}

/// Writes a kernel bank (`*.safetensors`).
///
/// # Errors
/// See [`Error`](super::error::Error).
pub fn write_bank(path: &Path, _bank: &KernelBank, _overwrite: bool) -> Result<()> {
    todo!("{}", path.display())
}
