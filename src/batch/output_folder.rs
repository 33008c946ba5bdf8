//! The folder of results, made before the work; without a result it goes again.

use std::path::{Path, PathBuf};

use crate::core::error::{Error, Result};

/// A folder of results, as long as they are made.
pub(super) struct OutputFolder {
    /// The folders that were not there, the innermost first.
    made: Vec<PathBuf>,
}

impl OutputFolder {
    /// Makes the folder of results that are all written to one.
    ///
    /// # Errors
    /// When it cannot be made.
    pub(super) fn of(outputs: &mut dyn Iterator<Item = &Path>) -> Result<Self> {
        let Some(folder) = outputs.next().and_then(Path::parent) else {
            return Ok(Self { made: Vec::new() });
        };
        let is_missing = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
        let made = folder.ancestors().take_while(is_missing).map(Path::to_owned).collect::<Vec<_>>();
        let made = Self { made };
        if !folder.as_os_str().is_empty() {
            std::fs::create_dir_all(folder).map_err(|source| Error::While {
                doing: format!("creating the folder {}", folder.display()),
                source: source.into(),
            })?;
        }
        Ok(made)
    }
}

impl OutputFolder {
    /// Leaves the folder even without a result: others may be about to write into it.
    pub(super) fn keep(mut self) {
        self.made.clear();
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        // What holds a result is not removed by this.
        self.made.iter().all(|folder| std::fs::remove_dir(folder).is_ok());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_a_result_goes_again() {
        let scratch = tempfile::tempdir().unwrap();
        let outputs = ["one/two/a.exr", "one/two/b.exr"].map(|name| scratch.path().join(name));
        let folder = || OutputFolder::of(&mut outputs.iter().map(PathBuf::as_path)).unwrap();
        drop(folder());
        assert!(!scratch.path().join("one").exists());
        let made = folder();
        std::fs::write(&outputs[1], "a result").unwrap();
        drop(made);
        assert!(outputs[1].exists());
    }
}
