//! Reads the small files beside images: text, folder listings, kernel codes as NumPy vectors.

use std::fs;
use std::path::Path;

use ndarray::Array1;
use npyz::{DType, NpyFile};

use crate::core::error::{Error, Result};
use crate::core::kernel_code::KernelCode;

/// The longest kernel code that is believed: a larger file is something else, such as an image.
const LONGEST_CODE: u64 = 4096;

/// Reads a whole text file.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    fs::read_to_string(path).map_err(|error| Error::io("read", path, error))
}

/// Reads a whole file that is carried along as it is.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|error| Error::io("read", path, error))
}

/// Lists the names in a folder, sorted.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be listed.
pub fn list_folder(folder: &Path) -> Result<Vec<String>> {
    let list = || -> std::io::Result<Vec<String>> {
        fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned())).collect()
    };
    let mut names = list().map_err(|error| Error::io("read", folder, error))?;
    names.sort_unstable();
    Ok(names)
}

/// Reads a kernel code from a NumPy file of f4 or f8 with one axis longer than 1.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no such vector or holds a value
/// that is not finite.
pub fn read_code(path: &Path) -> Result<KernelCode> {
    let bytes = fs::read(path).map_err(|error| Error::io("read", path, error))?;
    let bad = |reason: String| Error::format(path, reason);
    let npy = NpyFile::new(&bytes[..]).map_err(|error| bad(format!("is no NumPy file: {error}")))?;
    let shape = npy.shape().to_vec();
    let longest = shape.iter().copied().max().unwrap_or(0);
    let length = shape.iter().try_fold(1u64, |product, side| product.checked_mul(*side));
    if length != Some(longest) || !(1..=LONGEST_CODE).contains(&longest) {
        return Err(bad(format!("has shape {shape:?}; a kernel code is a vector")));
    }
    let name = match npy.dtype() {
        DType::Plain(plain) => plain.to_string(),
        other => other.descr(),
    };
    let values = match name.trim_matches(['\'', '"']) {
        "<f4" => npy.into_vec::<f32>(),
        "<f8" => npy.into_vec::<f64>().map(narrow),
        other => return Err(bad(format!("holds {other}; a kernel code is f4 or f8"))),
    };
    let values = values.map_err(|error| bad(format!("ends early: {error}")))?;
    if values.iter().any(|value| !value.is_finite()) {
        return Err(bad("holds a value that is not finite".to_owned()));
    }
    Ok(Array1::from_vec(values))
}

#[expect(clippy::cast_possible_truncation, reason = "kernel codes are f32 throughout")]
fn narrow(values: Vec<f64>) -> Vec<f32> {
    values.into_iter().map(|value| value as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use npyz::WriterBuilder;

    fn write_npy<T: npyz::AutoSerialize>(path: &Path, shape: &[u64], values: Vec<T>) {
        let mut file = fs::File::create(path).unwrap();
        let options = npyz::WriteOptions::new().default_dtype().shape(shape);
        let mut writer = options.writer(&mut file).begin_nd().unwrap();
        writer.extend(values).unwrap();
        writer.finish().unwrap();
    }

    #[test]
    fn reads_codes_of_both_precisions_and_refuses_images() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("code.npy");
        write_npy(&path, &[3], vec![1.0f32, -2.0, 0.5]);
        assert_eq!(read_code(&path).unwrap().to_vec(), [1.0, -2.0, 0.5]);
        write_npy(&path, &[2, 1], vec![1.0f64, -2.0]);
        assert_eq!(read_code(&path).unwrap().to_vec(), [1.0, -2.0]);
        write_npy(&path, &[2, 2], vec![0.0f32; 4]);
        assert!(read_code(&path).unwrap_err().to_string().contains("is a vector"));
        write_npy(&path, &[1], vec![f32::NAN]);
        assert!(read_code(&path).is_err());
        write_npy(&path, &[2], vec![1i32, 2]);
        assert!(read_code(&path).unwrap_err().to_string().contains("f4 or f8"));
        fs::write(&path, b"\x93NUMPY").unwrap();
        assert!(read_code(&path).is_err());
    }
}
