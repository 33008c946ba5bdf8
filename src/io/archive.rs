//! Tar archives of many files, for file systems that bear few large files better: `images.tar/a.gt.npy` is a file in one.
//!
//! An archive is read in place, any member at any time: its headers are read once, when its first member is asked for.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::SystemTime;

use tempfile::NamedTempFile;

use super::atomic::{folder_of, persist_new, temporary_beside};
use super::written;
use crate::core::error::{Error, Result};

/// The end of an archive's name.
const EXTENSION: &str = "tar";

/// Members are read and written in few system calls.
const BUFFER_BYTES: usize = 1 << 20;

/// A file, or a member of an archive, open to be read from its beginning.
pub(super) struct Opened {
    file: io::Take<File>,
    bytes: u64,
}

impl Opened {
    /// Bytes in all.
    pub(super) fn len(&self) -> u64 {
        self.bytes
    }
}

impl Read for Opened {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.file.read(buffer)
    }

    fn read_to_end(&mut self, bytes: &mut Vec<u8>) -> io::Result<usize> {
        self.file.read_to_end(bytes)
    }
}

/// Opens a file, or the member of an archive that a path names.
pub(super) fn open(path: &Path) -> io::Result<Opened> {
    let Some((archive, member)) = split(path) else {
        let file = File::open(path)?;
        let bytes = file.metadata()?.len();
        // What is no file, such as a pipe, has no length.
        return Ok(Opened { file: file.take(u64::MAX), bytes });
    };
    let (mut file, index) = Index::of(archive)?;
    let Some(Place { start, bytes }) = index.0.get(member).copied() else {
        let reason = format!("{} has no member {member}", archive.display());
        return Err(io::Error::new(io::ErrorKind::NotFound, reason));
    };
    file.seek(SeekFrom::Start(start))?;
    Ok(Opened { file: file.take(bytes), bytes })
}

/// Bytes of a file, or of a member of an archive.
///
/// # Errors
/// [`Error::Io`] when there is none.
pub fn file_bytes(path: &Path) -> Result<u64> {
    open(path).map(|file| file.len()).map_err(|source| Error::io("read", path, source))
}

/// Whether a path names a file, or a member of an archive.
pub fn is_file(path: &Path) -> bool {
    match split(path) {
        None => path.is_file(),
        Some((archive, member)) => Index::of(archive).is_ok_and(|(_, index)| index.0.contains_key(member)),
    }
}

/// The archive that a path leads through, and the member behind it.
fn split(path: &Path) -> Option<(&Path, &str)> {
    let is_archive = |folder: &&Path| {
        folder.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(EXTENSION))
            && folder.is_file()
    };
    let archive = path.ancestors().skip(1).find(is_archive)?;
    Some((archive, path.strip_prefix(archive).ok()?.to_str()?))
}

/// Where a member's bytes are in its archive.
#[derive(Clone, Copy, Debug)]
struct Place {
    start: u64,
    bytes: u64,
}

/// The members of an archive by their names.
#[derive(Debug)]
struct Index(BTreeMap<String, Place>);

/// What tells one version of a file from another.
type Version = (u64, Option<SystemTime>);

/// The indices that were read, of their versions of the archives.
type Indices = HashMap<PathBuf, (Version, Arc<Index>)>;

static INDICES: LazyLock<Mutex<Indices>> = LazyLock::new(Mutex::default);

impl Index {
    /// That of an archive, with the archive.
    fn of(archive: &Path) -> io::Result<(File, Arc<Self>)> {
        let file = File::open(archive)?;
        let metadata = file.metadata()?;
        let version = (metadata.len(), metadata.modified().ok());
        // Who waits here for the headers to be read would otherwise read them too.
        let mut indices = INDICES.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, index)) = indices.get(archive)
            && *known == version
        {
            return Ok((file, Arc::clone(index)));
        }
        let index = Self::read(&file, metadata.len()).map_err(|error| {
            let reason = format!("{} is damaged: {error}", archive.display());
            io::Error::new(error.kind(), reason)
        })?;
        let index = Arc::new(index);
        indices.insert(archive.to_owned(), (version, Arc::clone(&index)));
        Ok((file, index))
    }

    fn read(file: &File, length: u64) -> io::Result<Self> {
        let mut archive = tar::Archive::new(file);
        let mut places = BTreeMap::new();
        for entry in archive.entries_with_seek()? {
            let entry = entry?;
            if !entry.header().entry_type().is_file() {
                continue;
            }
            let (start, bytes) = (entry.raw_file_position(), entry.size());
            if start.checked_add(bytes).is_none_or(|end| end > length) {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            if let Some(name) = entry.path()?.to_str() {
                places.insert(name.to_owned(), Place { start, bytes });
            }
        }
        Ok(Self(places))
    }
}

/// An archive that is being written: nothing has its name before it is whole.
pub struct ArchiveWriter {
    tar: tar::Builder<BufWriter<NamedTempFile>>,
    path: PathBuf,
    bytes: u64,
    /// Whether a part of a member may be missing.
    is_broken: bool,
}

impl fmt::Debug for ArchiveWriter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ArchiveWriter")
            .field("path", &self.path)
            .field("bytes", &self.bytes)
            .finish_non_exhaustive()
    }
}

impl ArchiveWriter {
    /// Begins an archive that is to lie at `path`.
    ///
    /// # Errors
    /// [`Error::Io`] when its folder cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let file = temporary_beside(path).map_err(|source| Error::io("write", path, source))?;
        let tar = tar::Builder::new(BufWriter::with_capacity(BUFFER_BYTES, file));
        Ok(Self { tar, path: path.to_owned(), bytes: 0, is_broken: false })
    }

    /// Appends a member; of its file nothing is told but the name, so that the same members make the same archive.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written, as on a full disk.
    pub fn append(&mut self, name: &str, contents: &[u8]) -> Result<()> {
        let mut header = tar::Header::new_ustar();
        header.set_size(contents.len() as u64);
        header.set_mode(0o644);
        // What follows a member that is not whole is lost.
        let was_broken = std::mem::replace(&mut self.is_broken, true);
        let appended = self.tar.append_data(&mut header, name, contents);
        appended.map_err(|source| Error::io("write", &self.path, source))?;
        self.is_broken = was_broken;
        self.bytes += contents.len() as u64;
        Ok(())
    }

    /// Bytes of its members.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Gives the archive its name. A file of that name is not replaced: the next of `names` is tried.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written, or a member could not; nothing is left behind then.
    pub fn finish(self, names: impl Iterator<Item = PathBuf>) -> Result<PathBuf> {
        let fail = |source| Error::io("write", &self.path, source);
        if self.is_broken {
            return Err(fail(io::Error::other("a member could not be written before")));
        }
        let buffer = self.tar.into_inner().map_err(fail)?;
        let mut file = buffer.into_inner().map_err(|error| fail(error.into_error()))?;
        file.as_file_mut().flush().and_then(|()| file.as_file().sync_all()).map_err(fail)?;
        for name in names {
            debug_assert_eq!(folder_of(&name), folder_of(&self.path), "renamed within one folder");
            match persist_new(file, &name) {
                Ok(_) => {
                    written::tell(&name);
                    return Ok(name);
                }
                Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => file = error.file,
                Err(error) => return Err(fail(error.error)),
            }
        }
        Err(fail(io::ErrorKind::AlreadyExists.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn archive(folder: &Path, members: &[(&str, &[u8])]) -> PathBuf {
        let before = std::fs::read_dir(folder).unwrap().count();
        let mut writer = ArchiveWriter::create(&folder.join("a.tar")).unwrap();
        members.iter().for_each(|(name, contents)| writer.append(name, contents).unwrap());
        assert_eq!(super::super::list_unfinished(folder).unwrap().len(), 1, "no archive before it is whole");
        let path = writer.finish(["a.tar", "b.tar"].iter().map(|name| folder.join(name))).unwrap();
        assert_eq!(std::fs::read_dir(folder).unwrap().count(), before + 1);
        path
    }

    fn read(path: &Path) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        open(path)?.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    #[test]
    fn members_are_read_in_any_order() {
        let folder = tempfile::tempdir().unwrap();
        let long = format!("{}.gt.npy", "x".repeat(150));
        let path = archive(folder.path(), &[("a.npy", b"first"), (&long, b""), ("folder/b", &[7; 1000])]);
        assert_eq!(read(&path.join("folder/b")).unwrap(), [7; 1000]);
        assert_eq!(read(&path.join("a.npy")).unwrap(), b"first");
        assert_eq!(open(&path.join(&long)).unwrap().len(), 0);
        assert!(is_file(&path.join("a.npy")) && !is_file(&path.join("b")) && is_file(&path));
        assert_eq!(open(&path.join("b")).err().unwrap().kind(), io::ErrorKind::NotFound);
        assert_eq!(open(&folder.path().join("none.tar/b")).err().unwrap().kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn the_same_members_make_the_same_archive_and_none_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second] = [(); 2].map(|()| archive(folder.path(), &[("a", b"one"), ("b", b"two")]));
        assert_ne!(first, second);
        assert_eq!(std::fs::read(first).unwrap(), std::fs::read(&second).unwrap());
    }

    #[test]
    fn an_archive_with_half_a_member_gets_no_name() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = ArchiveWriter::create(&folder.path().join("a.tar")).unwrap();
        writer.append("a", b"whole").unwrap();
        writer.append("../b", b"leads out").unwrap_err();
        writer.finish([folder.path().join("a.tar")].into_iter()).unwrap_err();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn another_version_and_a_truncated_one_are_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = archive(folder.path(), &[("a", &[1; 2000]), ("b", &[2; 2000])]);
        assert!(is_file(&path.join("b")));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..3000]).unwrap();
        let error = open(&path.join("a")).err().unwrap();
        assert!(error.to_string().contains("damaged"), "{error}");
        assert!(!is_file(&path.join("b")));
    }
}
