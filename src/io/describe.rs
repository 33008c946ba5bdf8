//! Describes any file of the project: what it is, how it is stored, and what its numbers look like.

mod image;
mod psf;
mod tensors;

use std::path::Path;

use ndarray::ArrayD;
use serde::Serialize;

use super::{inspect_image, read_array};
use crate::core::error::Result;

pub use image::{ImageDescription, Statistics};
pub use psf::{PsfChannel, PsfDescription, describe_psf};
pub use tensors::{BankDescription, ModelDescription};

/// What a file is.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum FileDescription {
    /// An image.
    Image(ImageDescription),
    /// An image, looked at as a PSF.
    Psf(PsfDescription),
    /// A kernel bank.
    KernelBank(BankDescription),
    /// A network's weights, or tensors of unknown use.
    Model(ModelDescription),
    /// An array that is no image.
    Array(ArrayDescription),
}

/// An array that is no image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArrayDescription {
    /// Its axes.
    pub shape: Vec<usize>,
    /// The smallest value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// The values, of a small array.
    pub values: Option<Vec<f64>>,
}

/// Arrays up to this length are described by all of their values.
const SMALL_ARRAY: usize = 64;

/// Describes a file, recognised by its contents.
///
/// # Errors
/// [`Error::Io`](crate::core::error::Error::Io) when it cannot be read; [`Error::Format`](crate::core::error::Error::Format) when it is damaged or of no known kind.
pub fn describe(path: &Path) -> Result<FileDescription> {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("safetensors") => tensors::describe_tensors(path),
        Some("npy") => match inspect_image(path) {
            Ok((pixels, encoding)) => Ok(FileDescription::Image(image::describe_image(pixels, encoding))),
            // What is no image may still be an array; if it is neither, the first reason says more.
            Err(no_image) => match read_array(path) {
                Ok(array) if !array.is_empty() => Ok(describe_array(&array)),
                _ => Err(no_image),
            },
        },
        _ => inspect_image(path)
            .map(|(pixels, encoding)| FileDescription::Image(image::describe_image(pixels, encoding))),
    }
}

fn describe_array(array: &ArrayD<f64>) -> FileDescription {
    let (min, max) =
        array.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), &v| (min.min(v), max.max(v)));
    let shape = array.shape().to_vec();
    let values = (array.len() <= SMALL_ARRAY).then(|| array.iter().copied().collect());
    FileDescription::Array(ArrayDescription { shape, min, max, values })
}
