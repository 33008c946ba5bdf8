//! Reads parts of one file on several threads.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use crate::core::error::{Error, Result};

/// An open file of which any part can be read by any thread: all of one version, should it be replaced meanwhile.
#[derive(Debug)]
pub struct SharedInput {
    file: File,
    path: PathBuf,
    size: u64,
}

impl SharedInput {
    /// Opens a file.
    ///
    /// # Errors
    /// [`Error::Io`] when that is not possible.
    pub fn open(path: &Path) -> Result<Self> {
        let open = || {
            let file = File::open(path)?;
            let size = file.metadata()?.len();
            Ok(Self { file, path: path.to_owned(), size })
        };
        open().map_err(|error| Error::io("read", path, error))
    }

    /// Its size in bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Fills `bytes` with those from `offset` on.
    ///
    /// # Errors
    /// [`Error::Io`] when there are not so many, or they cannot be read.
    pub fn read_at(&self, offset: u64, bytes: &mut [u8]) -> Result<()> {
        read_exact_at(&self.file, bytes, offset).map_err(|error| Error::io("read", &self.path, error))
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                bytes = &mut bytes[count..];
                offset += count as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_those_of_the_version_that_was_opened() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, b"0123456789").unwrap();
        let file = SharedInput::open(&path).unwrap();
        let other = folder.path().join("other");
        std::fs::write(&other, b"abc").unwrap();
        std::fs::rename(other, &path).unwrap();
        let mut part = [0; 3];
        file.read_at(4, &mut part).unwrap();
        assert_eq!((part, file.size()), (*b"456", 10));
        assert!(matches!(file.read_at(8, &mut part), Err(Error::Io { .. })), "two bytes are left");
        assert!(matches!(SharedInput::open(&folder.path().join("absent")), Err(Error::Io { .. })));
    }
}
