//! Expands what a user names — files, folders, patterns — to a list of image files.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use super::format::Format;
use crate::core::error::{Error, Result};

/// Expands files, folders and globs to image files.
///
/// A folder stands for the image files directly inside of it that are not hidden, a pattern for the files that match, as in
/// a shell: hidden ones only if the pattern spells the dot. Both are sorted by name. Files keep the order in which they are named.
///
/// # Errors
/// [`Error::Io`] when a name does not exist; [`Error::Format`] when a folder or a pattern yields no file.
pub fn expand_inputs(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for input in inputs {
        files.extend(expand(input)?);
    }
    Ok(files)
}

fn expand(input: &Path) -> Result<Vec<PathBuf>> {
    if input.is_dir() {
        return images_of_folder(input);
    }
    // A file whose name holds pattern characters is that file.
    if input.exists() {
        return Ok(vec![input.to_owned()]);
    }
    match input.to_str().filter(|text| text.contains(['*', '?', '['])) {
        Some(pattern) => files_of_pattern(input, pattern),
        None => {
            let reason = std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such file or folder");
            Err(Error::io("read", input, reason))
        }
    }
}

fn images_of_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let read_error = |source| Error::io("read", folder, source);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read_error)? {
        let path = entry.map_err(read_error)?.path();
        if path.is_file() && is_image(&path) && !path.file_name().is_some_and(is_hidden) {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(Error::format(
            folder,
            "the folder holds no image (.exr, .npy, .hdr, .png, .tif, .dng, .jpg)",
        ));
    }
    files.sort();
    Ok(files)
}

/// Whether the name is that of an image: of a format that is written, or of a camera's raw file.
fn is_image(path: &Path) -> bool {
    let is_raw = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("dng"));
    is_raw || Format::known_extension(path).is_some()
}

/// Whether a file's name begins with a dot, as those of temporary files and of what macOS keeps beside others.
pub fn is_hidden(name: impl AsRef<OsStr>) -> bool {
    name.as_ref().as_encoded_bytes().starts_with(b".")
}

fn files_of_pattern(input: &Path, pattern: &str) -> Result<Vec<PathBuf>> {
    let options = glob::MatchOptions { require_literal_leading_dot: true, ..glob::MatchOptions::new() };
    let paths = glob::glob_with(pattern, options).map_err(|error| Error::format(input, error.to_string()))?;
    let mut files = Vec::new();
    for path in paths {
        let path = path.map_err(|error| {
            let folder = error.path().to_owned();
            Error::io("read", folder, error.into())
        })?;
        if path.is_file() {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(Error::format(input, "no file matches this pattern"));
    }
    files.sort();
    Ok(files)
}
