//! Makes, publishes and removes folders, and appends lines to logs: what a long run needs beside whole files.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::atomic::replace_and_hold;
use super::written;
use crate::core::error::{Error, Result};

/// Makes a folder, with its parents, unless it is there.
///
/// # Errors
/// [`Error::Io`] when it cannot be made, as when a file of its name is there.
pub fn create_folder(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).map_err(|source| match source.kind() {
        // Of the folder's name, or above it.
        ErrorKind::AlreadyExists | ErrorKind::NotADirectory => {
            let reason = "a file is in its place; name another folder, or move the file away";
            Error::io("create", folder, std::io::Error::new(source.kind(), reason))
        }
        _ => Error::io("create", folder, source),
    })
}

/// Waits until no other process holds a folder, and holds it until the returned file is dropped, or the process ends.
///
/// Processes that do not ask are not kept out. Where folders cannot be locked, as on some network file systems and on
/// Windows, nobody waits and nothing is returned.
pub fn lock_folder(folder: &Path) -> Option<File> {
    let file = File::open(folder).ok()?;
    file.lock().ok()?;
    Some(file)
}

/// Holds a folder until the returned file is dropped, or the process ends, unless another process holds it.
///
/// As with [`lock_folder`], nothing is returned where folders cannot be locked.
///
/// # Errors
/// [`Error::Format`] when another process holds it.
pub fn try_lock_folder(folder: &Path) -> Result<Option<File>> {
    let Ok(file) = File::open(folder) else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => {
            let reason = "another process is writing there; wait for its end, or name another folder";
            Err(Error::format(folder, reason))
        }
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Removes a folder with all that is in it, or a file; nothing happens when there is none.
///
/// # Errors
/// [`Error::Io`] when it cannot be removed.
pub fn remove(path: &Path) -> Result<()> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(source) if source.kind() != ErrorKind::NotFound => Err(Error::io("remove", path, source)),
        _ => Ok(()),
    }
}

/// Gives a finished folder, or a file of an unfinished one, its name: readers see it whole or not at all.
///
/// # Errors
/// [`Error::Io`] when it cannot be renamed, as a folder where `to` exists and is not empty.
pub fn publish(from: &Path, to: &Path) -> Result<()> {
    fs::rename(from, to).map_err(|source| Error::io("create", to, source))?;
    written::tell(to);
    Ok(())
}

/// A file that grows piece by piece.
#[derive(Debug)]
pub struct AppendFile {
    path: PathBuf,
    file: File,
}

impl AppendFile {
    /// Puts a new file in the place of one, or of none, and goes on behind its contents; it is held from the beginning.
    ///
    /// A process that still appends to the old file does not change the new one.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written.
    pub fn replace(path: &Path, contents: &[u8]) -> Result<Self> {
        Ok(Self { path: path.to_owned(), file: replace_and_hold(path, contents)? })
    }

    /// Opens a file at its end, or a new one.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn at(path: &Path) -> Result<Self> {
        let fail = |source| Error::io("write", path, source);
        let file = OpenOptions::new().create(true).append(true).open(path).map_err(fail)?;
        if file.metadata().map_err(fail)?.len() == 0 {
            // Mounted object stores have a new file, and can replace it, only when it was written out.
            file.sync_all().map_err(fail)?;
        }
        Ok(Self { path: path.to_owned(), file })
    }

    /// Holds the file until this is dropped, or the process ends, unless another process holds it.
    ///
    /// Processes that do not ask are not kept out. Where files cannot be locked, as on some network file systems, nobody
    /// is; nor on Windows, where a lock would keep readers out.
    ///
    /// # Errors
    /// [`Error::Format`] when another process holds it.
    pub fn try_lock(&self) -> Result<()> {
        if cfg!(windows) {
            return Ok(());
        }
        match self.file.try_lock() {
            Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
            Err(TryLockError::WouldBlock) => {
                let reason = "another process is writing it; wait for its end";
                Err(Error::format(&self.path, reason))
            }
        }
    }

    /// Appends bytes in one piece.
    ///
    /// # Errors
    /// [`Error::Io`] when the disk is full or gone.
    pub fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|source| Error::io("write", &self.path, source))
    }

    /// Waits until all is on the disk.
    ///
    /// # Errors
    /// [`Error::Io`] when it does not get there.
    pub fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(|source| Error::io("write", &self.path, source))
    }
}

/// A text file that grows line by line.
#[derive(Debug)]
pub struct LineLog(AppendFile);

impl LineLog {
    /// Puts a new log in the place of one, as [`AppendFile::replace`] does.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn replace(path: &Path, text: &str) -> Result<Self> {
        AppendFile::replace(path, text.as_bytes()).map(Self)
    }

    /// Opens a log at its end, or a new one.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn open(path: &Path) -> Result<Self> {
        AppendFile::at(path).map(Self)
    }

    /// Holds the log, as [`AppendFile::try_lock`] does.
    ///
    /// # Errors
    /// [`Error::Format`] when another process holds it.
    pub fn try_lock(&self) -> Result<()> {
        self.0.try_lock()
    }

    /// Appends one line in one piece.
    ///
    /// # Errors
    /// [`Error::Io`] when the disk is full or gone.
    pub fn append(&mut self, line: &str) -> Result<()> {
        self.0.append(format!("{line}\n").as_bytes())
    }

    /// Waits until all lines are on the disk.
    ///
    /// # Errors
    /// [`Error::Io`] when they do not get there.
    pub fn sync(&self) -> Result<()> {
        self.0.sync()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_goes_on_where_it_ended() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        LineLog::open(&path).unwrap().append("one").unwrap();
        let mut log = LineLog::open(&path).unwrap();
        log.append("two").unwrap();
        log.sync().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "one\ntwo\n");
    }

    #[test]
    #[cfg(unix)]
    fn a_folder_is_held_by_one() {
        let root = tempfile::tempdir().unwrap();
        let held = try_lock_folder(root.path()).unwrap();
        assert!(held.is_some());
        let message = try_lock_folder(root.path()).unwrap_err().to_string();
        assert!(message.contains("another process"), "{message}");
        drop(held);
        assert!(try_lock_folder(root.path()).unwrap().is_some());
    }

    #[test]
    #[cfg(unix)]
    fn a_log_is_held_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let held = LineLog::open(&path).unwrap();
        held.try_lock().unwrap();
        let other = LineLog::open(&path).unwrap();
        assert!(other.try_lock().unwrap_err().to_string().contains("another process is writing it"));
        drop(held);
        other.try_lock().unwrap();
    }

    /// As two processes that take up the same part where files cannot be locked.
    #[test]
    fn nobody_writes_into_a_log_that_another_has_begun() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut first = LineLog::replace(&path, "zero\n").unwrap();
        first.append("one").unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let mut second = LineLog::replace(&path, &text).unwrap();
        first.append("lost").unwrap();
        second.append("two").unwrap();
        first.append("lost").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "zero\none\ntwo\n");
        let third = LineLog::open(&path).unwrap();
        #[cfg(unix)]
        assert!(third.try_lock().is_err(), "the second holds it");
        drop(second);
        third.try_lock().unwrap();
    }

    #[test]
    fn a_folder_is_published_once_and_removed_at_will() {
        let root = tempfile::tempdir().unwrap();
        let (draft, name) = (root.path().join("draft"), root.path().join("a/b"));
        create_folder(&draft.join("inner")).unwrap();
        assert!(publish(&draft, &name).is_err(), "the folder above is missing");
        create_folder(name.parent().unwrap()).unwrap();
        publish(&draft, &name).unwrap();
        assert!(name.join("inner").is_dir() && !draft.exists());
        remove(&name).unwrap();
        remove(&name).unwrap();
        assert!(!name.exists());
    }
}
