//! Where the results of one or several inputs go: to the file that the user names, or to files of a folder.

use std::path::{Path, PathBuf, is_separator};

use anyhow::{Context as _, Result, bail};

use udc::io::{Format, check_output};

/// What `-o` names, and how files are named in it if it is a folder.
pub(crate) struct Destination<'a> {
    pub(crate) path: &'a Path,
    pub(crate) extension: &'a str,
    /// Whether files that are there do not matter.
    pub(crate) accepts_existing: bool,
}

/// A result before it has a file.
pub(crate) struct Unplaced {
    /// Its file's name in a folder, without extension.
    pub(crate) name: String,
    /// What it is made of, for messages.
    pub(crate) source: String,
}

impl Unplaced {
    /// The result of one file, named as it.
    pub(crate) fn of_file(file: &Path) -> Self {
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self { name, source: file.display().to_string() }
    }
}

impl Destination<'_> {
    /// Names a file for each result, before any work; `in_folder` says that they belong to one whatever their number.
    ///
    /// A folder that is there, or a name that ends in a separator, is a folder for a single result too.
    ///
    /// # Errors
    /// When several results have one file, or a file is there that may not be replaced.
    pub(crate) fn place(&self, results: &[Unplaced], in_folder: bool) -> Result<Vec<PathBuf>> {
        let names_folder = self.path.is_dir() || ends_in_separator(self.path);
        let in_folder = in_folder || results.len() > 1;
        if in_folder && !names_folder && (self.path.exists() || Format::of_extension(self.path).is_ok()) {
            bail!(
                "several inputs, or those of a folder, need a folder to be written to, and {} names a file; write -o {}/",
                self.path.display(),
                self.path.with_extension("").display()
            );
        }
        if !in_folder && !names_folder {
            Format::of_extension(self.path)?;
            check_output(self.path, self.accepts_existing)?;
            return Ok(vec![self.path.to_owned()]);
        }
        let file = |result: &Unplaced| self.path.join(format!("{}.{}", result.name, self.extension));
        let files: Vec<PathBuf> = results.iter().map(file).collect();
        for (index, file) in files.iter().enumerate() {
            if let Some(other) = files[..index].iter().position(|earlier| earlier == file) {
                let (a, b) = (&results[other].source, &results[index].source);
                bail!("{a} and {b} would both be written to {}", file.display());
            }
        }
        if self.path.is_dir() {
            files.iter().try_for_each(|file| check_output(file, self.accepts_existing))?;
        }
        Ok(files)
    }
}

fn ends_in_separator(path: &Path) -> bool {
    path.to_string_lossy().ends_with(is_separator)
}

/// The folder of results, made before the work; without a result it goes again.
pub(crate) struct OutputFolder {
    /// The folders that were not there, the innermost first.
    made: Vec<PathBuf>,
}

impl OutputFolder {
    /// Makes the folder of results that are all written to one.
    pub(crate) fn of(outputs: &mut dyn Iterator<Item = &Path>) -> Result<Self> {
        let Some(folder) = outputs.next().and_then(Path::parent) else {
            return Ok(Self { made: Vec::new() });
        };
        let is_missing = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
        let made = folder.ancestors().take_while(is_missing).map(Path::to_owned).collect::<Vec<_>>();
        let made = Self { made };
        if !folder.as_os_str().is_empty() {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("creating the folder {}", folder.display()))?;
        }
        Ok(made)
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
