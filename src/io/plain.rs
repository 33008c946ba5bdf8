//! Reads the small files beside images: text, folder listings, kernel codes as NumPy vectors.

use std::fs;
use std::io::{ErrorKind, Read};
use std::path::Path;

use sha2::{Digest, Sha256};

use super::archive;
use super::array::read_array;
use super::layer::locate;
use crate::core::error::{Error, Result};
use crate::core::kernel_code::KernelCode;
use crate::core::psf::hex;

/// The longest kernel code that is believed: a larger file is something else, such as an image.
const LONGEST_CODE: usize = 4096;

/// Reads a whole text file, without the byte order mark that some editors put before it.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    let mut text = fs::read_to_string(path).map_err(|error| match error.kind() {
        ErrorKind::InvalidData => {
            Error::format(path, "is not a text file (UTF-8); name the one that is meant")
        }
        _ => Error::io("read", path, error),
    })?;
    if text.starts_with('\u{feff}') {
        text.remove(0);
    }
    Ok(text)
}

/// Reads a configuration file, as [`read_text`] does, and refuses one without any key: it would stand for its defaults, and
/// is mostly a file that was never written, or another one than is meant.
///
/// # Errors
/// As [`read_text`]; [`Error::Format`] when the file holds nothing, or nothing but comments.
pub fn read_configuration(path: &Path) -> Result<String> {
    let text = read_text(path)?;
    let says_something = |line: &str| !matches!(line.trim_start().chars().next(), None | Some('#'));
    if text.lines().any(says_something) {
        return Ok(text);
    }
    let reason = "is empty, and is not taken for a configuration of nothing but defaults: name the file that is meant, or \
                  write one of its keys into it, as the files in configs/ have them";
    Err(Error::format(path, reason))
}

/// Reads a whole file that is carried along as it is.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    let read = || -> std::io::Result<Vec<u8>> {
        let mut file = archive::open(path)?;
        let mut bytes = Vec::with_capacity(usize::try_from(file.len()).unwrap_or_default());
        file.read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    read().map_err(|error| Error::io("read", path, error))
}

/// SHA-256 of a file, in hexadecimal; behind a colon the layer that is meant of it, if one is named.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read.
pub fn sha256_of_file(path: &Path) -> Result<String> {
    const BLOCK_BYTES: usize = 1 << 18;
    let mut hash = Sha256::new();
    let mut block = vec![0; BLOCK_BYTES];
    let (place, layer) = locate(path);
    let mut file = archive::open(place).map_err(|error| Error::io("read", path, error))?;
    loop {
        match file.read(&mut block) {
            Ok(0) => {
                let layer = layer.map_or(String::new(), |layer| format!(":{layer}"));
                return Ok(hex(&hash.finalize()) + &layer);
            }
            Ok(count) => hash.update(&block[..count]),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(Error::io("read", path, error)),
        }
    }
}

/// SHA-256 of what a file holds, in hexadecimal.
pub fn sha256_of_bytes(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Reads the first bytes of a file, of which a layer may be named.
pub(super) fn read_head(path: &Path, count: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    archive::open(locate(path).0)
        .and_then(|file| file.take(count).read_to_end(&mut bytes))
        .map_err(|error| Error::io("read", path, error))?;
    Ok(bytes)
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

/// Reads a kernel code from a NumPy file with one axis longer than 1.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is no such vector or holds a value
/// that is not finite.
pub fn read_code(path: &Path) -> Result<KernelCode> {
    let array = read_array(path)?;
    let length = array.len();
    if !(1..=LONGEST_CODE).contains(&length) || !array.shape().contains(&length) {
        return Err(Error::format(path, format!("has shape {:?}; a kernel code is a vector", array.shape())));
    }
    #[expect(clippy::cast_possible_truncation, reason = "kernel codes are f32 throughout")]
    Ok(array.iter().map(|&value| value as f32).collect())
}

#[cfg(test)]
mod tests {
    use ndarray::{ArrayD, IxDyn};

    use super::*;
    use crate::io::write_array;

    #[test]
    fn a_configuration_holds_a_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("panel.toml");
        for text in ["", " \n\t\n", "# a = 1\n\n  # b\n", "\u{feff}"] {
            fs::write(&path, text).unwrap();
            let message = read_configuration(&path).unwrap_err().to_string();
            assert!(message.contains("panel.toml: is empty"), "{text}: {message}");
        }
        fs::write(&path, "# c\na = 1\n").unwrap();
        assert_eq!(read_configuration(&path).unwrap(), "# c\na = 1\n");
    }

    #[test]
    fn reads_vectors_and_refuses_images() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("code.npy");
        let write = |shape: &[usize], value: f32| {
            write_array(&path, &ArrayD::from_elem(IxDyn(shape), value), true).unwrap();
        };
        write(&[3], -2.0);
        assert_eq!(read_code(&path).unwrap().to_vec(), [-2.0; 3]);
        write(&[2, 1], 0.5);
        assert_eq!(read_code(&path).unwrap().to_vec(), [0.5; 2]);
        write(&[2, 2], 0.0);
        assert!(read_code(&path).unwrap_err().to_string().contains("is a vector"));
        write(&[1], f32::NAN);
        assert!(read_code(&path).is_err());
        fs::write(&path, b"\x93NUMPY").unwrap();
        assert!(read_code(&path).is_err());
    }
}
