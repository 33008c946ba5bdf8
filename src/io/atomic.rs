//! Writes whole files or nothing: to a temporary name in the same folder, flushed, then renamed.

use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use tempfile::{Builder, NamedTempFile, PersistError};

use super::{list_folder, read_bytes, remove, written};
use crate::core::error::{Error, Result};

/// How temporary files are named: with random letters between the two.
const PREFIX: &str = ".udc-";
const SUFFIX: &str = ".partial";

/// Large enough that a frame is written in few system calls.
const BUFFER_BYTES: usize = 1 << 20;

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
    let renamed = if overwrite { file.persist(path) } else { persist_new(file, path) };
    match renamed {
        Ok(_) => {
            written::tell(path);
            Ok(())
        }
        Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Err(exists(path)),
        Err(error) => Err(fail(error.error)),
    }
}

/// Gives a file its name where there is none of that name.
///
/// Mounted object stores and some other file systems of user space know neither a renaming that keeps what is there nor hard
/// links; there a file that another process makes at the same moment is replaced.
///
/// # Errors
/// As [`NamedTempFile::persist_noclobber`].
pub(super) fn persist_new(file: NamedTempFile, path: &Path) -> std::result::Result<File, PersistError> {
    match file.persist_noclobber(path) {
        Err(error)
            if error.error.kind() != io::ErrorKind::AlreadyExists && path.symlink_metadata().is_err() =>
        {
            error.file.persist(path)
        }
        named => named,
    }
}

/// Writes a file that others may be about to write too, with the same contents, and never replaces one: whoever has it open
/// keeps what it reads, also on network file systems.
///
/// # Errors
/// As [`write_atomically`]; [`Error::Format`] when a file is there whose contents are others.
pub fn write_once(path: &Path, contents: &[u8]) -> Result<()> {
    let written = match path.is_file() {
        true => Err(exists(path)),
        false => write_atomically(path, false, |file| file.write_all(contents)),
    };
    match written {
        Err(error) if error.is_already_there() && path.is_file() => {
            let is_same = read_bytes(path)? == contents;
            let reason =
                "is there already, with other contents; another run may have begun otherwise at this moment";
            if is_same { Ok(()) } else { Err(Error::format(path, reason)) }
        }
        written => written,
    }
}

/// Replaces a file, and keeps the new one open behind its contents and held, as
/// [`AppendFile::try_lock`](super::AppendFile::try_lock) holds it.
///
/// No other process has it open: one that still writes the old file writes where nobody reads.
pub(super) fn replace_and_hold(path: &Path, contents: &[u8]) -> Result<File> {
    let fail = |source| Error::io("write", path, source);
    let mut file = temporary_beside(path).map_err(fail)?;
    if !cfg!(windows) {
        // Nobody else can hold what has no name yet; where files cannot be locked, nobody holds anything.
        let _ = file.as_file().try_lock();
    }
    file.write_all(contents).map_err(fail)?;
    file.as_file().sync_all().map_err(fail)?;
    file.persist(path).map_err(|error| fail(error.error))
}

/// Removes the temporary files directly inside of a folder that killed runs left there: those that nobody has changed
/// for so long. Younger ones may be of a run that goes on. Nothing happens where there is no folder.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be listed or a file cannot be removed.
pub fn remove_unfinished(folder: &Path, unchanged_for: Duration) -> Result<()> {
    let now = SystemTime::now();
    for path in list_unfinished(folder)? {
        // A file that is renamed meanwhile is no longer there.
        let changed = path.symlink_metadata().and_then(|file| file.modified()).unwrap_or(now);
        let age = now.duration_since(changed).unwrap_or_default();
        if age >= unchanged_for {
            remove(&path)?;
        }
    }
    Ok(())
}

/// Lists the temporary files directly inside of a folder: of runs that go on, or that killed ones left. None where there is
/// no folder.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be listed.
pub fn list_unfinished(folder: &Path) -> Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let is_temporary = |name: &String| name.starts_with(PREFIX) && name.ends_with(SUFFIX);
    Ok(list_folder(folder)?.into_iter().filter(is_temporary).map(|name| folder.join(name)).collect())
}

/// Checks that an output may be written, before the work that makes it starts.
///
/// # Errors
/// [`Error::Io`] when the file exists and may not be replaced, or its folder does not exist or may not be written to.
pub fn check_output(path: &Path, overwrite: bool) -> Result<()> {
    if path.is_dir() {
        return Err(create_error(path, io::ErrorKind::IsADirectory, "it is a folder; name a file".into()));
    }
    if !overwrite && path.symlink_metadata().is_ok() {
        return Err(exists(path));
    }
    let folder = folder_of(path);
    if folder.is_dir() {
        return match is_writable(folder) {
            true => Ok(()),
            false => {
                let reason = format!("the folder {} may not be written to; name another", folder.display());
                Err(create_error(path, io::ErrorKind::PermissionDenied, reason))
            }
        };
    }
    let (kind, what) = match folder.symlink_metadata() {
        Ok(_) => (io::ErrorKind::NotADirectory, "is not a folder; name another"),
        Err(_) => (io::ErrorKind::NotFound, "does not exist; create it"),
    };
    Err(create_error(path, kind, format!("the folder {} {what}", folder.display())))
}

/// Whether files may be made in a folder: false where it is known that they may not.
fn is_writable(folder: &Path) -> bool {
    #[cfg(unix)]
    {
        use rustix::fs::{Access, access};
        use rustix::io::Errno;

        let refused = access(folder, Access::WRITE_OK | Access::EXEC_OK);
        !matches!(refused, Err(Errno::ACCESS | Errno::PERM | Errno::ROFS))
    }
    #[cfg(not(unix))]
    true
}

fn exists(path: &Path) -> Error {
    let reason = "it exists; pass --overwrite to replace it".to_owned();
    create_error(path, io::ErrorKind::AlreadyExists, reason)
}

fn create_error(path: &Path, kind: io::ErrorKind, reason: String) -> Error {
    Error::io("create", path, io::Error::new(kind, reason))
}

pub(super) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

pub(super) fn temporary_beside(path: &Path) -> io::Result<NamedTempFile> {
    let mut builder = Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    // Temporary files are private by default; outputs follow the user's umask as any other file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder_of(path))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn what_several_processes_write_is_written_by_the_first_and_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dataset.toml");
        std::thread::scope(|scope| {
            let writers: Vec<_> = (0..8).map(|_| scope.spawn(|| write_once(&path, b"same"))).collect();
            writers.into_iter().for_each(|writer| writer.join().unwrap().unwrap());
        });
        let reader = File::open(&path).unwrap();
        write_once(&path, b"same").unwrap();
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt as _;
            assert_eq!(reader.metadata().unwrap().ino(), path.metadata().unwrap().ino());
        }
        drop(reader);
        let message = write_once(&path, b"other").unwrap_err().to_string();
        assert!(message.contains("dataset.toml") && message.contains("other contents"), "{message}");
        assert_eq!(list_folder(folder.path()).unwrap(), ["dataset.toml"]);
    }

    #[test]
    fn only_old_temporary_files_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let hour = Duration::from_secs(3600);
        for (name, age) in [(".udc-a.partial", 2), (".udc-b.partial", 0), (".udc-a", 2), ("a.partial", 2)] {
            let file = File::create(folder.path().join(name)).unwrap();
            file.set_modified(SystemTime::now() - age * hour).unwrap();
        }
        fs::create_dir(folder.path().join("inner")).unwrap();
        remove_unfinished(folder.path(), hour).unwrap();
        assert_eq!(list_folder(folder.path()).unwrap(), [".udc-a", ".udc-b.partial", "a.partial", "inner"]);
        remove_unfinished(folder.path(), Duration::ZERO).unwrap();
        assert_eq!(list_folder(folder.path()).unwrap(), [".udc-a", "a.partial", "inner"]);
        remove_unfinished(&folder.path().join("none"), hour).unwrap();
    }
}
