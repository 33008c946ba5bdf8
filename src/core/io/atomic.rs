//! Writes whole files or nothing: to a temporary name in the same folder, flushed, then renamed.

use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

use tempfile::{Builder, NamedTempFile};

use super::{list_folder, remove};
use crate::core::error::{Error, Result};

/// Large enough that a frame is written in few system calls.
const BUFFER_BYTES: usize = 1 << 20;

/// What the names of files begin and end with while they are written.
const PREFIX: &str = ".udc-";
const SUFFIX: &str = ".partial";

/// What files are written to: tables in front of what they list are filled in later.
pub trait WriteSeek: Write + Seek {}

impl<W: Write + Seek> WriteSeek for W {}

/// Writes a whole file or nothing: to a temporary name in the same folder, flushed, then renamed.
///
/// A run that is killed leaves the old file or the new one. Without `overwrite` an existing file is refused,
/// also when another process made it in the meantime.
///
/// # Errors
/// [`Error::Io`] naming `path`: it exists, its folder does not or is not writable, the disk is full, or
/// `write` failed. Nothing is left behind then.
pub fn write_atomically(
    path: &Path,
    overwrite: bool,
    write: impl FnOnce(&mut dyn WriteSeek) -> io::Result<()>,
) -> Result<()> {
    check_output(path, overwrite)?;
    let fail = |source| Error::io("write", path, source);
    let mut file = temporary_beside(path).map_err(fail)?;
    let mut buffer = BufWriter::with_capacity(BUFFER_BYTES, file.as_file_mut());
    write(&mut buffer).and_then(|()| buffer.flush()).map_err(fail)?;
    drop(buffer);
    file.as_file().sync_all().map_err(fail)?;
    let renamed = if overwrite { file.persist(path) } else { file.persist_noclobber(path) };
    match renamed {
        Ok(_) => Ok(()),
        Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Err(exists(path)),
        Err(error) => Err(fail(error.error)),
    }
}

/// Checks that an output may be written, before the work that makes it starts.
///
/// # Errors
/// [`Error::Io`] when the file exists and may not be replaced, or its folder does not exist.
pub fn check_output(path: &Path, overwrite: bool) -> Result<()> {
    if path.is_dir() {
        return Err(create_error(path, io::ErrorKind::IsADirectory, "it is a folder; name a file".into()));
    }
    if !overwrite && path.symlink_metadata().is_ok() {
        return Err(exists(path));
    }
    let folder = folder_of(path);
    if folder.is_dir() {
        return Ok(());
    }
    let reason = format!("the folder {} does not exist; create it", folder.display());
    Err(create_error(path, io::ErrorKind::NotFound, reason))
}

fn exists(path: &Path) -> Error {
    let reason = "it exists; pass --overwrite to replace it".to_owned();
    create_error(path, io::ErrorKind::AlreadyExists, reason)
}

fn create_error(path: &Path, kind: io::ErrorKind, reason: String) -> Error {
    Error::io("create", path, io::Error::new(kind, reason))
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Removes from a folder what killed processes left of files that they were writing; nothing happens without one.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be read, or a file not be removed.
pub fn remove_unfinished(folder: &Path) -> Result<()> {
    if !folder.is_dir() {
        return Ok(());
    }
    let is_unfinished = |name: &String| name.starts_with(PREFIX) && name.ends_with(SUFFIX);
    list_folder(folder)?
        .iter()
        .filter(|name| is_unfinished(name))
        .try_for_each(|name| remove(&folder.join(name)))
}

fn temporary_beside(path: &Path) -> io::Result<NamedTempFile> {
    let mut builder = Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    // Temporary files are private by default; outputs follow the user's umask as any other file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder_of(path))
}
