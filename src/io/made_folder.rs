//! The folder of results, made before the work; without a result it goes again.

use std::fs;
use std::path::{Path, PathBuf};

use super::folder::create_folder;
use crate::core::error::Result;

/// A folder that was made for results: it goes with this, and so do those around it that were made for it, as far as they are
/// empty.
#[derive(Debug, Default)]
pub struct MadeFolder {
    /// The folders that were not there, the innermost first.
    made: Vec<PathBuf>,
}

impl MadeFolder {
    /// Makes a folder, with its parents, unless it is there.
    ///
    /// # Errors
    /// Those of [`create_folder`].
    pub fn create(folder: &Path) -> Result<Self> {
        let is_missing = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
        let made = folder.ancestors().take_while(is_missing).map(Path::to_owned).collect();
        let made = Self { made };
        if !folder.as_os_str().is_empty() {
            create_folder(folder)?;
        }
        Ok(made)
    }

    /// Leaves the folder even without a result: others may be about to write into it.
    pub fn keep(mut self) {
        self.made.clear();
    }
}

impl Drop for MadeFolder {
    fn drop(&mut self) {
        // What holds a result is not removed by this.
        self.made.iter().all(|folder| fs::remove_dir(folder).is_ok());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_a_result_goes_again() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("one/two");
        drop(MadeFolder::create(&folder).unwrap());
        assert!(!scratch.path().join("one").exists());
        let made = MadeFolder::create(&folder).unwrap();
        fs::write(folder.join("b.exr"), "a result").unwrap();
        drop(made);
        assert!(folder.join("b.exr").exists());
    }
}
